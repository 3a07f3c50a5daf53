"""Fitting a live camera: landmarks, identity, fit and recording, frame by frame, without a user interface."""

import threading
import time
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8

from workbench.config import DEFAULT_PRESET, FACE_IT_PRESETS, Config, preset
from workbench.errors import InputError
from workbench.face import FaceModel, in_scheme
from workbench.landmarks.detection import LandmarkDetector
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.scheme import IBUG68, LandmarkScheme, error_unit
from workbench.landmarks.schemes import detector_scheme
from workbench.landmarks.tracker_options import options_for
from workbench.landmarks.tracking import LandmarkTracker
from workbench.planning import plan_of
from workbench.session.gesture import Gesture
from workbench.session.history import History
from workbench.session.live_frame import LIVE_SIZE, LiveFrame
from workbench.session.recording import Recorder, Recording
from workbench.tracker import identity_settings
from workbench.tracking import FrameFit, FrameObservation
from workbench.tracking.face_it_fitter import FaceItFitter
from workbench.tracking.fitting import Calibrated, Continuation
from workbench.tracking.observation import motion_of
from workbench.tracking.walk import Walk

FIRST_FRAMES = 24
"""Frames with a face used for the first identity: about one second."""
NEUTRAL_FRAMES = 16
"""Frames for which the user holds a neutral face."""
NEUTRAL_EXPRESSION = 1e4
"""ω of the weights while calibrating on a neutral face: everything observed is identity."""
STEADY_FACE = 0.02
"""Largest motion between frames, in units of errors (`error_unit`), at which a neutral frame is sharp enough."""
HISTORY = 100
"""Maximum number of undo steps."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Frames used to calibrate an identity, and whether the face was neutral in them."""

    observations: tuple[FrameObservation, ...]
    neutral: bool


@dataclass(frozen=True)
class LiveState:
    """The state that undo restores."""

    config: Config
    calibration: Calibration | None
    """On a neutral face; None: on the first second, which does not count as a change by the user."""


@dataclass(frozen=True)
class LiveFit:
    """A frame with its fit."""

    frame: LiveFrame
    fit: FrameFit
    milliseconds: float
    """Time from the encoded picture to the fit."""


class LiveSession:
    """Fits one person in front of a live camera, frame by frame.

    Call `step` from one thread only; everything else may be called from any thread and takes effect at the next frame.
    The identity is calibrated on the first second with a face, and again by `calibrate_neutral`. Raises `InputError`
    for a Deep Energies configuration, which takes seconds per frame.
    """

    def __init__(
        self,
        model: FaceModel,
        config: Config | None = None,
        detector: LandmarkDetector | None = None,
    ) -> None:
        config = preset(DEFAULT_PRESET) if config is None else config
        _check_live(config)
        model = in_scheme(model, IBUG68 if detector is not None else detector_scheme(config.landmarks.detector))
        self.model, self.base = model, config
        self._history = History(LiveState(config, None), HISTORY)
        self._first: Calibration | None = None
        self._gathered: list[FrameObservation] = []
        self._lock = threading.RLock()
        self._detector = detector
        self._landmarks: LandmarkTracker | None = None
        self._fitter, self._fitter_config = FaceItFitter(model, plan_of(config, model.scheme)), config
        self._identity = self._fitter.mean_identity()
        self._identity_of: tuple[str, Calibration | None] = (self._identity_settings(config), None)
        self._recorder: Recorder | None = None
        self._walk = Walk(self._fitter)
        self._picture: UInt8[np.ndarray, "h w 3"] | None = None
        self.start_anew()

    def __repr__(self) -> str:
        return f"LiveSession({self.model.name!r}, {self.config.preset!r}, {self._frames} frames)"

    # --- settings, from any thread ---

    @property
    def config(self) -> Config:
        """The configuration of the next frame."""
        return self._history.present.config

    @property
    def identity(self) -> Float[np.ndarray, "i"]:
        """The face shape in use."""
        return self._identity

    @property
    def calibrated(self) -> str:
        """Where the identity comes from: "mean face", "first second" or "neutral face"."""
        calibration = self._identity_of[1]
        if calibration is None or not _calibrates(self.model, self.config):
            return "mean face"
        return "neutral face" if calibration.neutral else "first second"

    @property
    def gathering(self) -> tuple[int, int] | None:
        """Frames that a neutral calibration has and needs; None if none is in progress."""
        with self._lock:
            return (len(self._gathered), NEUTRAL_FRAMES) if self._gathering == "neutral" else None

    def use(self, config: Config, gesture: Gesture | str | None = None) -> None:
        """Change the configuration: a new undo step, or part of the last one within a drag or shortly after it.

        Raises `InputError` for Deep Energies, a detector of other points, and other stages or terms while recording.
        """
        _check_live(config)
        with self._lock:
            if config == self.config:
                return
            _check_recording(self._recorder, self.config, config)
            _check_points(self._detector, self.model, config)
            self._history.change(replace(self._history.present, config=config), gesture=gesture)

    def undo(self) -> bool:
        """Undo the last change of settings or the last neutral calibration; False if there is none.

        A neutral calibration in progress is the last change. Raises `InputError` where that brings other stages or
        terms back while recording.
        """
        with self._lock:
            if self._gathering == "neutral":
                self._gathering = ""
                return True
            before = self._history.previous
            if before is None:
                return False
            _check_recording(self._recorder, self.config, before.config)
            self._history.undo()
            return True

    def calibrate_neutral(self) -> None:
        """Treat the next frames with a steady face as neutral: the whole shape seen in them becomes identity.

        Raises `InputError` where the settings keep the average face, and for a model with one face alone.
        """
        with self._lock:
            _check_calibrates(self.model, self.config)
            self._gathering, self._gathered = "neutral", []

    def start_anew(self) -> None:
        """Forget the face being tracked; settings and a neutral calibration are kept."""
        with self._lock:
            self._first, self._gathering, self._fresh = None, "", True
        self._frames = 0

    # --- recording, from any thread ---

    @property
    def recording(self) -> tuple[int, float] | None:
        """Frames and seconds of the recording in progress."""
        recorder = self._recorder
        return None if recorder is None else (len(recorder), recorder.seconds)

    @property
    def recording_ended(self) -> str:
        """Why the recording takes no more frames, in one sentence; empty if it is in progress."""
        recorder = self._recorder
        return "" if recorder is None else recorder.ended

    def start_recording(self, keep_pictures: bool = True) -> None:
        """Keep every frame from now on; a recording in progress is discarded."""
        with self._lock:
            self._recorder = Recorder(keep_pictures)

    def stop_recording(self, source: str = "camera") -> Recording:
        """End the recording. Raises `InputError` if there is none or it has no face."""
        with self._lock:
            recorder, self._recorder = self._recorder, None
            if recorder is None:
                raise InputError("Nothing is being recorded; press record first.")
            detector = "" if self._landmarks is None else self._landmarks.detector.name
            return recorder.finish(self.model, self.config, source, detector)

    # --- frames, from one thread ---

    def warm_up(self) -> None:
        """Load the detector and compile every program a frame can need, so that the first frame is not slow."""
        self._tracker()
        self._fitter.warm_up(LIVE_SIZE)
        self._fitter.calibrate([self._fitter.neutral_observation(LIVE_SIZE)], self.config.identity.frames)

    def step(self, frame: LiveFrame) -> LiveFit:
        """Fit the next frame. Raises `InputError` for a frame that cannot be read."""
        began = time.perf_counter()
        picture = frame.picture
        tracker = self._tracker()
        with self._lock:
            if self._fresh:
                tracker.reset()
                self._walk, self._fresh = Walk(self._fitter), False
                self._walk.begin_shot()
        found = tracker.step(picture)
        size = (picture.shape[1], picture.shape[0])
        times = (found.milliseconds["detect"], found.milliseconds["landmarks"])
        observation = FrameObservation(self._frames, found.landmarks, size, found.source, found.cut, times)
        self._gather(observation)
        self._follow_state()
        if found.cut:
            self._walk.begin_shot()
        self._walk.calibrated = Calibrated(self._identity, {})
        fit, _ = self._walk.step(replace(observation, motion=motion_of(self._picture, picture)))
        self._picture = picture
        self._frames += 1
        self._record(fit, frame)
        return LiveFit(frame, fit, 1e3 * (time.perf_counter() - began))

    def _tracker(self) -> LandmarkTracker:
        if self._landmarks is None:
            landmarks, detector = self.config.landmarks, self._detector
            if detector is None:
                detector = make_detector(landmarks.detector, landmarks.face_landmarker)
            self._landmarks = LandmarkTracker(detector, options_for(detector.name, landmarks.face))
        return self._landmarks

    def _gather(self, observation: FrameObservation) -> None:
        """Add a frame to the calibration in progress; once complete, it becomes part of the state."""
        with self._lock:
            state = self._history.present
            if not self._gathering and self._first is None and _wants_first_second(self.model, state):
                self._gathering, self._gathered = "first", []
            if not self._gathering or observation.landmarks is None:
                return
            neutral = self._gathering == "neutral"
            last = self._walk.last
            if neutral and last is not None and _motion(last, observation) > STEADY_FACE:
                return
            self._gathered.append(observation)
            if len(self._gathered) < (NEUTRAL_FRAMES if neutral else FIRST_FRAMES):
                return
            calibration = Calibration(tuple(self._gathered), neutral)
            if neutral:
                self._history.change(replace(state, calibration=calibration))
            else:
                self._first = calibration
            self._gathering, self._gathered = "", []

    def _follow_state(self) -> None:
        """Bring fitter and identity in line with the current state."""
        state = self._history.present
        calibration = state.calibration or self._first
        if state.config is not self._fitter_config:
            self._fitter.configure(plan_of(state.config, self.model.scheme))
            self._fitter_config = state.config
        elif calibration is self._identity_of[1]:
            return
        key = (self._identity_settings(state.config), calibration)
        if key[0] == self._identity_of[0] and key[1] is self._identity_of[1]:
            return
        self._identity = _identity_from(self._fitter, self.model.scheme, state.config, calibration)
        self._identity_of = key

    def _identity_settings(self, config: Config) -> str:
        return identity_settings(config, self._fitter.plan.camera, self.model.scheme)

    def _record(self, fit: FrameFit, frame: LiveFrame) -> None:
        with self._lock:
            if self._recorder is not None:
                self._recorder.add(fit, frame)


def _identity_from(
    fitter: FaceItFitter, scheme: LandmarkScheme, config: Config, calibration: Calibration | None
) -> Float[np.ndarray, "i"]:
    """The identity that a calibration gives under these settings, to which the fitter is set; else the mean one."""
    if calibration is None or not config.identity.calibrate:
        return fitter.mean_identity()
    observations = list(calibration.observations)
    if not calibration.neutral:
        return fitter.calibrate(observations, config.identity.frames).identity
    fitter.configure(plan_of(config.changed(identity={"expression": NEUTRAL_EXPRESSION}), scheme))
    try:
        return fitter.calibrate(observations, config.identity.frames).identity
    finally:
        fitter.configure(plan_of(config, scheme))


def _calibrates(model: FaceModel, config: Config) -> bool:
    """Whether an identity is calibrated: the settings ask for it, and the model has an identity basis."""
    return config.identity.calibrate and model.has_identities


def _check_calibrates(model: FaceModel, config: Config) -> None:
    if not model.has_identities:
        raise InputError(
            f"{model.name} has no identity basis, so a neutral face changes nothing; choose a model with one, such as "
            "the default head."
        )
    if not config.identity.calibrate:
        raise InputError(
            "These settings keep the average face, so a neutral face changes nothing: switch identity.calibrate on."
        )


def _wants_first_second(model: FaceModel, state: LiveState) -> bool:
    """Whether the identity of a state is calibrated on the first second."""
    return _calibrates(model, state.config) and state.calibration is None


def _check_live(config: Config) -> None:
    if not config.traits.real_time:
        raise InputError(
            f"{config.traits.title} takes seconds per frame and cannot follow a camera; use one of "
            f"{', '.join(FACE_IT_PRESETS)}."
        )


def _check_points(given: LandmarkDetector | None, model: FaceModel, config: Config) -> None:
    """The detector stays, and with it the points that are fitted; one that was `given` needs no name."""
    name = config.landmarks.detector
    if given is None and detector_scheme(name) is not model.scheme:
        raise InputError(
            f"The detector {name!r} finds different points from those this session fits, {model.scheme.name}; open "
            "another live "
            "session or panel with this configuration."
        )


def _check_recording(recorder: Recorder | None, present: Config, config: Config) -> None:
    """The frames of a recording have the same stages, and energies of the same terms."""
    if recorder is not None and _layout(config) != _layout(present):
        raise InputError("Another preset has other stages or terms; stop the recording first.")


def _layout(config: Config) -> tuple[list[str], tuple[str, ...]]:
    """The stages that run, and the terms of their energies."""
    return [stage.name for stage in config.stages if stage.enabled], config.terms


def _motion(last: Continuation, observation: FrameObservation) -> float:
    """Mean motion of the landmarks since the last frame, in units of errors (`error_unit`)."""
    before, now = last.points, observation.landmarks.points
    return float(np.linalg.norm(now - before, axis=1).mean() / error_unit(before))
