"""Either system over a stream of landmarks: calibration of each shot, and one frame after the other."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.config import Config
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters
from workbench.geometry import Camera
from workbench.landmarks.scheme import outer_eye_distance
from workbench.rendering import Appearance
from workbench.tracking.fitter import (
    Continuation,
    FrameContext,
    FrameObservation,
    StageTrace,
    corrected,
)
from workbench.tracking.records import FrameFit
from workbench.tracking.systems import Fitter, configured, make_fitter

JUMP = 0.5
"""Mean landmark motion between frames, in outer-eye distances, that restarts the pose."""


class FaceTracker:
    """Landmarks in, fits out. `push` may hold frames back until the identity of their shot is calibrated."""

    def __init__(self, model: FaceModel, config: Config, stills: bool = False):
        """`stills`: every frame is its own shot, no term links it to another."""
        self.model = model
        self.stills = stills
        self._fitter = make_fitter(model, config)
        self._shot = -1
        self._pending: list[FrameObservation] = []
        self._start_shot()

    @property
    def config(self) -> Config:
        """The configuration of the next frame."""
        return self._fitter.config

    def warm_up(self, image_size: tuple[int, int]) -> None:
        """Compile (or load from the cache) all that a run needs, so that its first frames are as fast as the others."""
        self._fitter.warm_up(image_size)
        if self._fitter.calibrates:
            self._fitter.calibrate([self._fitter.neutral_observation(image_size)], self._calibration_frames())

    def configure(self, config: Config) -> None:
        """Use another configuration from the next frame on."""
        self._fitter = configured(self._fitter, config)

    def push(self, observation: FrameObservation) -> list[FrameFit]:
        """Take the next frame; return the fits that are ready, in order."""
        return [fit for fit, _ in self.advance(observation)]

    def advance(self, observation: FrameObservation) -> list[tuple[FrameFit, FrameContext]]:
        """As `push`, each fit with the context that it was fitted in."""
        return [self._fit(*pair) for pair in self.prepare(observation)]

    def prepare(self, observation: FrameObservation) -> Iterator[tuple[FrameObservation, FrameContext]]:
        """Take the next frame; yield the frames that can be fitted, each with its context, without fitting them.

        Only where frames are independent (`Fitter.links_frames`) may they be fitted elsewhere, and in any order.
        """
        observation = corrected(observation, self.config)
        if (observation.cut or self.stills) and (self._pending or self._seen):
            yield from self.prepare_rest()
            self._start_shot()
        self._seen = True
        self._pending.append(observation)
        if self._identity is None and self._faces_pending():
            if len(self._pending) < (1 if self.stills else self.config.identity.window):
                return
            self._calibrate(self._pending)
        yield from self._flush()

    def fit_prepared(self, observation: FrameObservation, context: FrameContext) -> FrameFit:
        """The fit of a prepared frame; where frames are linked, of the next one."""
        return self._fit(observation, context)[0]

    @property
    def fitter(self) -> Fitter:
        """What fits the frames."""
        return self._fitter

    def finish(self) -> list[FrameFit]:
        """Fits of the frames still held back: the shot has ended."""
        return [fit for fit, _ in self.complete()]

    def complete(self) -> list[tuple[FrameFit, FrameContext]]:
        """As `finish`, each fit with its context."""
        return [self._fit(*pair) for pair in self.prepare_rest()]

    def prepare_rest(self) -> Iterator[tuple[FrameObservation, FrameContext]]:
        """As `prepare`, for the frames still held back."""
        if self._identity is None and self._faces_pending():
            self._calibrate(self._pending)
        yield from self._flush()

    def explain(self, observation: FrameObservation) -> tuple[FrameFit, tuple[StageTrace, ...]]:
        """Fit one frame as the next `push` would, with every iteration kept; the tracker itself does not move.

        The identity is the calibrated one if the shot has it, else (and for stills) calibrated on this frame alone.
        Raises `InputError` for a frame without landmarks.
        """
        observation = corrected(observation, self.config)
        if observation.landmarks is None:
            raise InputError(f"Frame {observation.index} has no landmarks; explain a frame with a face.")
        identity, starts, appearance = self._identity, self._starts, self._appearance
        if (self.stills or identity is None) and self._fitter.calibrates:
            identity, starts, appearance = self._fitter.calibrate([observation], self._calibration_frames())
        last = None if self.stills else self._continuing(observation)
        context = FrameContext(self._shot, identity, starts.get(observation.index), last, appearance)
        return self._fitter.explain(observation, context)

    def resume(self, context: FrameContext) -> None:
        """Go on as if the next frame were the one of this context."""
        self._pending = []
        self._shot, self._identity, self._last, self._seen = context.shot, context.identity, context.last, True
        self._appearance = context.appearance

    def fit_all(self, observations: Iterable[FrameObservation]) -> Iterator[FrameFit]:
        """`push` for each observation, then `finish`."""
        for observation in observations:
            yield from self.push(observation)
        yield from self.finish()

    def state(self) -> dict[str, np.ndarray] | None:
        """Everything the next frame depends on, as plain arrays; None while frames are held back."""
        if self._pending:
            return None
        arrays = {"shot": np.array(self._shot), "seen": np.array(self._seen)}
        if self._identity is not None:
            arrays["identity"] = self._identity
        if self._appearance is not None:
            arrays |= {f"appearance_{name}": np.asarray(value) for name, value in vars(self._appearance).items()}
        if self._last is not None:
            arrays |= {f"parameters_{k}": np.asarray(value) for k, value in enumerate(self._last.parameters)}
            arrays |= {"pose": np.asarray(self._last.pose), "last_pose": np.asarray(self._last.last_pose)}
            arrays |= {"frames": np.array(self._last.frames), "points": self._last.points}
        return arrays

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Go on from a `state`."""
        self._start_shot()
        self._shot, self._seen = int(arrays["shot"]), bool(arrays["seen"])
        if "identity" in arrays:
            self._identity = arrays["identity"]
        if "appearance_albedo" in arrays:
            parts = {field.name: arrays[f"appearance_{field.name}"] for field in fields(Appearance)}
            self._appearance = Appearance(**{**parts, "residual": float(parts["residual"])})
        self.continue_from(arrays)

    def continue_from(self, arrays: dict[str, np.ndarray]) -> None:
        """Link the next frame to the last one of a `state`, whatever shot and identity are by now."""
        if "pose" in arrays:
            parameters = FaceParameters(*(jnp.asarray(arrays[f"parameters_{k}"]) for k in range(4)))
            self._last = Continuation(
                parameters,
                jnp.asarray(arrays["pose"]),
                jnp.asarray(arrays["last_pose"]),
                int(arrays["frames"]),
                arrays["points"],
            )

    def camera(self, image_size: tuple[int, int]) -> Camera:
        """The camera used for pictures of this size."""
        return self._fitter.camera(image_size)

    def _start_shot(self) -> None:
        self._shot += 1
        self._seen = False
        self._last: Continuation | None = None
        self._starts: dict[int, FaceParameters] = {}
        self._identity: np.ndarray | None = None
        self._appearance: Appearance | None = None
        if not self._fitter.calibrates:
            self._identity = self._fitter.mean_identity()

    def _faces_pending(self) -> bool:
        return any(observation.landmarks is not None for observation in self._pending)

    def _flush(self) -> Iterator[tuple[FrameObservation, FrameContext]]:
        pending, self._pending = self._pending, []
        for observation in pending:
            # Made one at a time: a context holds what the frame before left.
            yield observation, self._context(observation)

    def _calibration_frames(self) -> int:
        return 1 if self.stills else self.config.identity.frames

    def _calibrate(self, observations: list[FrameObservation]) -> None:
        calibrated = self._fitter.calibrate(observations, self._calibration_frames())
        self._identity, self._starts, self._appearance = calibrated

    def _context(self, observation: FrameObservation) -> FrameContext:
        last = None if observation.landmarks is None else self._continuing(observation)
        # A shot without any face has no identity, and no fit that would need one.
        identity = self._fitter.mean_identity() if self._identity is None else self._identity
        return FrameContext(self._shot, identity, self._starts.get(observation.index), last, self._appearance)

    def _fit(self, observation: FrameObservation, context: FrameContext) -> tuple[FrameFit, FrameContext]:
        fit, self._last = self._fitter.fit(observation, context)
        return fit, context

    def _continuing(self, observation: FrameObservation) -> Continuation | None:
        if self._last is None or jumped(self._last.points, observation.landmarks.points):
            return None
        return self._last


def calibration_window(shot: Sequence[FrameObservation], window: int) -> Sequence[FrameObservation]:
    """The frames of a shot that the tracker looks at for its identity: `window` from the first face on."""
    first = next((k for k, observation in enumerate(shot) if observation.landmarks is not None), len(shot))
    return shot[first : first + window]


def jumped(before: Float[np.ndarray, "68 2"], now: Float[np.ndarray, "68 2"]) -> bool:
    """Whether the landmarks moved so far between two frames that the pose starts afresh."""
    return bool(np.linalg.norm(now - before, axis=1).mean() > JUMP * outer_eye_distance(before))
