"""Either system over a stream of landmarks: calibration of each shot, and one frame after the other."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields

import jax.numpy as jnp
import numpy as np

from workbench.config import Config
from workbench.face import FaceModel, FaceParameters
from workbench.geometry import Camera
from workbench.landmarks.observations import scheme_of_faces
from workbench.landmarks.scheme import LandmarkScheme
from workbench.planning import plan_of
from workbench.rendering import Appearance
from workbench.tracking.fitting import Calibrated, Continuation, Fitter, FrameContext, StageTrace, corrected, with_face
from workbench.tracking.observation import FrameObservation
from workbench.tracking.plan import CameraPlan
from workbench.tracking.records import FrameFit
from workbench.tracking.systems import configured, make_fitter
from workbench.tracking.walk import Walk, context_of


class FaceTracker:
    """Landmarks in, fits out. `push` may hold frames back until the identity of their shot is calibrated."""

    def __init__(self, model: FaceModel, config: Config, stills: bool = False):
        """`stills`: every frame is its own shot, no term links it to another."""
        self.model = model
        self.stills = stills
        self._config = config
        self._walk = Walk(make_fitter(model, plan_of(config, model.scheme)))
        self._pending: list[FrameObservation] = []
        self._start_shot()

    @property
    def config(self) -> Config:
        """The configuration of the next frame."""
        return self._config

    def warm_up(self, image_size: tuple[int, int]) -> None:
        """Compile (or load from the cache) all that a run needs, so that its first frames are as fast as the others."""
        self.fitter.warm_up(image_size)
        if self.fitter.calibrates:
            self.fitter.calibrate([self.fitter.neutral_observation(image_size)], self._calibration_frames())

    def configure(self, config: Config) -> None:
        """Use another configuration from the next frame on. Another system starts from scratch, in the same shot."""
        fitter = configured(self.fitter, plan_of(config, self.model.scheme))
        if fitter is not self.fitter:
            self._walk.last = None
        self._config, self._walk.fitter = config, fitter

    def push(self, observation: FrameObservation) -> list[FrameFit]:
        """Take the next frame; return the fits that are ready, in order."""
        return [fit for fit, _ in self.advance(observation)]

    def advance(self, observation: FrameObservation) -> list[tuple[FrameFit, FrameContext]]:
        """As `push`, each fit with the context that it was fitted in."""
        return [(self.fit_prepared(*pair), pair[1]) for pair in self.prepare(observation)]

    def prepare(self, observation: FrameObservation) -> Iterator[tuple[FrameObservation, FrameContext]]:
        """Take the next frame; yield the frames that can be fitted, each with its context, without fitting them.

        Only where frames are independent (`Fitter.links_frames`) may they be fitted elsewhere, and in any order.
        """
        observation = corrected(observation, self.config.moved_points(observation.index))
        if self._begins_shot(observation):
            yield from self.prepare_rest()
            self._start_shot()
        self._seen = True
        self._pending.append(observation)
        if not self._waits_for_more():
            yield from self.prepare_rest()

    def fit_prepared(self, observation: FrameObservation, context: FrameContext) -> FrameFit:
        """The fit of a prepared frame; where frames are linked, of the next one."""
        return self._walk.fit(observation, context)

    @property
    def fitter(self) -> Fitter:
        """What fits the frames."""
        return self._walk.fitter

    def finish(self) -> list[FrameFit]:
        """Fits of the frames still held back: the shot has ended."""
        return [fit for fit, _ in self.complete()]

    def complete(self) -> list[tuple[FrameFit, FrameContext]]:
        """As `finish`, each fit with its context."""
        return [(self.fit_prepared(*pair), pair[1]) for pair in self.prepare_rest()]

    def prepare_rest(self) -> Iterator[tuple[FrameObservation, FrameContext]]:
        """As `prepare`, for the frames still held back."""
        if self._to_be_calibrated and any(observation.landmarks is not None for observation in self._pending):
            self._walk.calibrated = self.fitter.calibrate(self._pending, self._calibration_frames())
            self._calibrated = True
        yield from self._flush()

    def explain(self, observation: FrameObservation) -> tuple[FrameFit, tuple[StageTrace, ...]]:
        """Fit one frame as the next `push` would, with every iteration kept; the tracker itself does not move.

        The identity is the calibrated one if the shot has it, else (and for stills and cuts) calibrated on this frame
        alone. Raises `InputError` for a frame without landmarks.
        """
        observation = with_face(corrected(observation, self.config.moved_points(observation.index)))
        shot, calibrated, last = self._walk.shot, self._walk.calibrated, self._walk.last
        begins = self._begins_shot(observation)
        if begins:
            shot, calibrated, last = shot + 1, Calibrated(self.fitter.mean_identity(), {}), None
        if self.fitter.calibrates and (begins or not self._calibrated):
            calibrated = self.fitter.calibrate([observation], self._calibration_frames())
        return self.fitter.explain(observation, context_of(observation, shot, calibrated, last))

    def resume(self, context: FrameContext) -> None:
        """Continue as if the next frame were the one of this context."""
        self._pending, self._seen, self._calibrated = [], True, True
        self._walk.shot, self._walk.last = context.shot, context.last
        self._walk.calibrated = Calibrated(context.identity, {}, context.appearance)

    def fit_all(self, observations: Iterable[FrameObservation]) -> Iterator[FrameFit]:
        """`push` for each observation, then `finish`."""
        for observation in observations:
            yield from self.push(observation)
        yield from self.finish()

    def state(self) -> dict[str, np.ndarray] | None:
        """Everything the next frame depends on, as plain arrays; None while frames are held back."""
        if self._pending:
            return None
        walk = self._walk
        arrays = {"shot": np.array(walk.shot), "seen": np.array(self._seen)}
        if self._calibrated:
            arrays["identity"] = walk.calibrated.identity
        if walk.calibrated.appearance is not None:
            colours = vars(walk.calibrated.appearance)
            arrays |= {f"appearance_{name}": np.asarray(value) for name, value in colours.items()}
        if walk.last is not None:
            arrays |= {f"parameters_{k}": np.asarray(value) for k, value in enumerate(walk.last.parameters)}
            arrays |= {"pose": np.asarray(walk.last.pose), "last_pose": np.asarray(walk.last.last_pose)}
            arrays |= {"frames": np.array(walk.last.frames), "points": walk.last.points}
        return arrays

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Continue from a `state`."""
        self._start_shot()
        self._walk.shot, self._seen = int(arrays["shot"]), bool(arrays["seen"])
        appearance = None
        if "appearance_albedo" in arrays:
            parts = {field.name: arrays[f"appearance_{field.name}"] for field in fields(Appearance)}
            appearance = Appearance(**{**parts, "residual": float(parts["residual"])})
        if "identity" in arrays:
            self._walk.calibrated, self._calibrated = Calibrated(arrays["identity"], {}, appearance), True
        self.continue_from(arrays)

    def continue_from(self, arrays: dict[str, np.ndarray]) -> None:
        """Link the next frame to the last one of a `state`, whatever the shot and identity are now."""
        if "pose" in arrays:
            parameters = FaceParameters(*(jnp.asarray(arrays[f"parameters_{k}"]) for k in range(6)))
            self._walk.last = Continuation(
                parameters,
                jnp.asarray(arrays["pose"]),
                jnp.asarray(arrays["last_pose"]),
                int(arrays["frames"]),
                arrays["points"],
            )

    def camera(self, image_size: tuple[int, int]) -> Camera:
        """The camera used for pictures of this size."""
        return self.fitter.camera(image_size)

    def _start_shot(self) -> None:
        self._walk.begin_shot()
        self._seen = False
        self._calibrated = not self.fitter.calibrates

    def _begins_shot(self, observation: FrameObservation) -> bool:
        return (observation.cut or self.stills) and (bool(self._pending) or self._seen)

    @property
    def _to_be_calibrated(self) -> bool:
        return not self._calibrated and self.fitter.calibrates

    def _waits_for_more(self) -> bool:
        """Whether the shot's face shape is to be calibrated on more frames than there are.

        Frames in which only a rig's other views see the face wait for it, too, but no longer than a window.
        """
        if not self._to_be_calibrated or not any(observation.faces for observation in self._pending):
            return False
        window = 1 if self.stills else self.config.identity.window
        return len(calibration_window(self._pending, window) or self._pending) < window

    def _flush(self) -> Iterator[tuple[FrameObservation, FrameContext]]:
        pending, self._pending = self._pending, []
        for observation in pending:
            # Made one at a time: a context holds what the frame before left.
            yield observation, self._walk.context(observation)

    def _calibration_frames(self) -> int:
        return 1 if self.stills else self.config.identity.frames


def calibration_window(shot: Sequence[FrameObservation], window: int) -> Sequence[FrameObservation]:
    """The frames of a shot that the tracker looks at for its identity: `window` from the first face on."""
    first = next((k for k, observation in enumerate(shot) if observation.landmarks is not None), len(shot))
    return shot[first : first + window]


def identity_key(config: Config, camera: CameraPlan, window: Sequence[FrameObservation]) -> str:
    """Key of the identity of a shot seen by a camera; `window` holds the frames that it is calibrated on."""
    moved = {key: config.landmarks.moved[key] for item in window if (key := str(item.index)) in config.landmarks.moved}
    scheme = scheme_of_faces(item.landmarks for item in window)
    return f"{identity_settings(config, camera, scheme)}{moved}"


def identity_settings(config: Config, camera: CameraPlan, scheme: LandmarkScheme) -> str:
    """Key of everything that an identity depends on besides its frames, whose landmarks are of this scheme.

    `camera` is the one that the configuration was planned with: a rig's file may change.
    """
    kept = {"system", "camera", "identity", "contour", "subsets"}
    kept |= {"deep"} if config.traits.reads("deep") else set()
    kept |= {"head"} if config.renders_character else set()
    sections = config.model_dump_json(include=kept)
    return f"{sections}{camera.of_rig}{config.point_weights(scheme)}{config.landmarks.confidence}"
