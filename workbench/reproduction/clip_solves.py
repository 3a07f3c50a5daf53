"""Deep Energies on frames of the bundled clip, with the truth of each beside its solution.

Items that look at the same frame under the same configuration solve it once, as long as they are made by one process.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Float, UInt8

from workbench.config import Config, preset
from workbench.face import FaceModel, load_default_head, principal_expressions
from workbench.planning import plan_of
from workbench.rendering import Appearance
from workbench.reproduction.rendered_clip import (
    FOV_DEG,
    NEUTRAL_FRAME,
    clip_landmarks,
    clip_pictures,
    clip_truth,
    errors_of_pose_and_jaw,
)
from workbench.reproduction.study import NETWORK, Study
from workbench.tracking import FrameContext, FrameFit, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_solution import DeepSolution
from workbench.tracking.deep_target import energy_network, photo_landmarks

QUANTITIES = ("rotation, °", "across, mm", "depth, mm", "jaw, °")
QUICK_NOTE = "A quick run leaves out what takes the derivative through the network: it takes long to compile."
START_MM = 800.0
"""Distance of the frontal start; the head is 640 mm away."""


@dataclass(frozen=True)
class ClipSolves:
    """Solutions by frame, and the fitter that found them."""

    fitter: DeepFitter
    solutions: Mapping[int, DeepSolution]

    def errors(self) -> Float[np.ndarray, "frames 4"]:
        """Errors of the results: `QUANTITIES`."""
        return np.array([errors_of_pose_and_jaw(each.parameters, k) for k, each in self.solutions.items()])

    @property
    def seconds(self) -> float:
        """Mean seconds per frame, without the slowest of several, which compiles."""
        taken = sorted(sum(each.seconds) for each in self.solutions.values())
        return float(np.mean(taken[:-1] or taken))

    def by_stage(self, frame: int) -> Float[np.ndarray, "stages 4"]:
        """Errors of the start and of what each stage left."""
        solution = self.solutions[frame]
        steps = (solution.start, *(result.parameters for result in solution.results))
        return np.array([errors_of_pose_and_jaw(step, frame) for step in steps])


@cache
def observed(frame: int) -> FrameObservation:
    """A frame as the network sees it, in a crop around the stored landmarks."""
    return seen_in(clip_pictures((frame,))[frame], frame)


def seen_in(picture: UInt8[np.ndarray, "480 640 3"], frame: int) -> FrameObservation:
    """The same in another picture of this frame."""
    seen = photo_landmarks(energy_network(NETWORK), picture, clip_landmarks()[frame])
    return FrameObservation(frame, seen, seen.image_size, picture=picture)


class ClipSolver:
    """Solves frames of the default head under several configurations, from one appearance."""

    def __init__(self) -> None:
        self._solved: dict[tuple[str, int], DeepSolution] = {}

    @cached_property
    def _appearance(self) -> Appearance | None:
        """Of the neutral frame under the preset deep, whatever is solved."""
        return _fitter(_with_camera(preset("deep"))).appearance([observed(NEUTRAL_FRAME)], clip_truth().identity)

    def solve(
        self,
        config: Config,
        frames: Sequence[int],
        study: Study,
        label: str,
        observe: Callable[[int], FrameObservation] = observed,
    ) -> ClipSolves:
        """The frames, each on its own, with the clip's camera and its person's identity.

        What was solved before, and as `observed`, is not solved again: its seconds are those of the first time.
        """
        config = _with_camera(config)
        fitter, settings, solutions = _fitter(config), config.model_dump_json(), {}
        context = FrameContext(0, clip_truth().identity, None, None, self._appearance)
        for done, frame in enumerate(frames):
            study.progress(label, done, len(frames))
            known = self._solved.get((settings, frame)) if observe is observed else None
            solutions[frame] = known or fitter.solve(fitter.problem(observe(frame), context))
            if observe is observed:
                self._solved[settings, frame] = solutions[frame]
        return ClipSolves(fitter, solutions)


@cache
def clip_solver() -> ClipSolver:
    """The one whose solutions items share."""
    return ClipSolver()


@cache
def parallel_fit(name: str, frame: int) -> FrameFit:
    """A frame under a preset of Appendix C.2: ten components each of shape and expression, no lens known."""
    fitter = _parallel_fitter(name)
    return fitter.fit(observed(frame), FrameContext(0, fitter.mean_identity(), None, None))[0]


@cache
def parallel_head() -> FaceModel:
    """The default head with ten principal components of its own expressions."""
    return principal_expressions(load_default_head())


@cache
def _parallel_fitter(name: str) -> DeepFitter:
    return DeepFitter(parallel_head(), plan_of(preset(name).changed(camera={"fov_deg": FOV_DEG})))


def _fitter(config: Config) -> DeepFitter:
    return DeepFitter(load_default_head(), plan_of(config))


def _with_camera(config: Config) -> Config:
    """With what of a frame is known."""
    return config.changed(
        camera={"matrix": clip_truth().camera_matrix.tolist()},
        identity={"calibrate": False},
        deep={"distance_mm": START_MM, "network": NETWORK},
    )
