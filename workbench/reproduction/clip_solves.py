"""Deep Energies on frames of the bundled clip, with the truth of each beside its solution."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, UInt8

from workbench.config import Config
from workbench.face import FaceModel
from workbench.landmarks.network_detector import bundled_landmark_network
from workbench.planning import plan_of
from workbench.rendering import Appearance
from workbench.reproduction.rendered_clip import (
    NEUTRAL_FRAME,
    clip_landmarks,
    clip_pictures,
    clip_truth,
    errors_of_pose_and_jaw,
)
from workbench.reproduction.study import Study
from workbench.tracking import FrameContext, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_solution import DeepSolution
from workbench.tracking.deep_target import photo_landmarks

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
    seen = photo_landmarks(bundled_landmark_network(), picture, clip_landmarks()[frame])
    return FrameObservation(frame, seen, seen.image_size, picture=picture)


class ClipSolver:
    """Solves frames under several configurations, from one appearance."""

    def __init__(self, head: FaceModel):
        self._head = head
        self._appearance: Appearance | None = None

    def solve(
        self,
        config: Config,
        frames: Sequence[int],
        study: Study,
        label: str,
        observe: Callable[[int], FrameObservation] = observed,
    ) -> ClipSolves:
        """The frames, each on its own, with the clip's camera and its person's identity."""
        config = config.changed(
            camera={"matrix": clip_truth().camera_matrix.tolist()},
            identity={"calibrate": False},
            deep={"distance_mm": START_MM},
        )
        fitter, identity = DeepFitter(self._head, plan_of(config)), clip_truth().identity
        if self._appearance is None:
            self._appearance = fitter.appearance([observed(NEUTRAL_FRAME)], identity)
        context, solutions = FrameContext(0, identity, None, None, self._appearance), {}
        for done, frame in enumerate(frames):
            study.progress(label, done, len(frames))
            solutions[frame] = fitter.solve(fitter.problem(observe(frame), context))
        return ClipSolves(fitter, solutions)
