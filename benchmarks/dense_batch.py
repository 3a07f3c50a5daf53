"""Fits under `dense` and under `joint`, one frame by one through Python and as batches in one program.

The bundled clip's landmarks are found once; then each frame is an independent problem, which starts from the fit of the
frame before. `batch` solves side by side (`jax.vmap`), `in turn` one after the other in one program, `in two threads`
two such programs at once. The least time of some rounds counts, all in turns.
"""

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
from result import print_result

from workbench.config import Config, preset
from workbench.face import FaceModel, in_scheme, load_default_head
from workbench.frames import FrameRange, open_frames
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.schemes import DENSE
from workbench.pipeline.picture_source import PictureSource
from workbench.runtime import ONE_THREAD
from workbench.samples import sample
from workbench.tracker import FaceTracker
from workbench.tracking.frame_solver import run_stages

ROUNDS = 5
WAYS = ("one by one", "batch", "in turn", "in two threads")


def main() -> None:
    """Print how many times as fast the best batch is under `dense`, and the milliseconds of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=96)
    asked = parser.parse_args()
    head = load_default_head()
    cases = {"joint": (head, "network"), "dense": (in_scheme(head, DENSE), "dense")}
    runs = {name: Fits(preset(name), *case, asked.frames) for name, case in cases.items()}
    for run in runs.values():
        run.timed()  # compiles
    rounds = [{name: run.timed() for name, run in runs.items()} for _ in range(ROUNDS)]
    best = {name: {way: min(each[name][way] for each in rounds) for way in WAYS} for name in runs}
    dense = best["dense"]
    value = dense["one by one"] / min(dense[way] for way in WAYS[1:])
    solve = {"dense against joint, one by one": dense["one by one"] / best["joint"]["one by one"], "goal": "<= 2.5"}
    details = {"ms a frame": best, "solve": solve, "frames": asked.frames}
    print_result("dense_batch", value, "times as fast", ">= 3", "the same fits one by one", details)


class Fits:
    """The frames of the bundled clip as independent problems of one preset."""

    def __init__(self, config: Config, head: FaceModel, detector: str, count: int):
        config = config.changed(landmarks={"detector": detector})
        frames = FrameRange(open_frames(sample("performance")), 0, count - 1)
        self._observations = list(PictureSource(frames, make_detector(detector), config).observations(0, {}, False))
        tracker = FaceTracker(head, config)
        fitted = [pair for seen in self._observations for pair in tracker.advance(seen)] + tracker.complete()
        self._fitter = tracker.fitter
        self._problems = [
            self._fitter.problem(seen, context)
            for seen, (_, context) in zip(self._observations, fitted, strict=True)
            if context.last is not None
        ]
        first, plan = self._problems[0], self._fitter.plan
        frames = jax.tree.map(lambda *leaves: np.stack(leaves), *(problem.frame for problem in self._problems))
        half = len(self._problems) // 2
        self._frames = frames
        self._halves = [jax.tree.map(lambda leaf, at=at: leaf[at], frames) for at in (slice(half), slice(half, None))]

        def solve(frame):
            stages = (first.camera, first.person, first.settings, first.program)
            return run_stages(*stages, frame, terms=plan.terms).report

        self._side_by_side = jax.jit(jax.vmap(solve), compiler_options=ONE_THREAD)
        self._in_turn = jax.jit(lambda frames: jax.lax.map(solve, frames), compiler_options=ONE_THREAD)

    def timed(self) -> dict[str, float]:
        """Milliseconds a frame of each way, NumPy in and NumPy out."""
        with ThreadPoolExecutor(2) as threads:
            ways = {
                "one by one": lambda: [self._fitter.solve(problem) for problem in self._problems],
                "batch": lambda: np.asarray(self._side_by_side(self._frames)),
                "in turn": lambda: np.asarray(self._in_turn(self._frames)),
                "in two threads": lambda: list(threads.map(self._half, self._halves)),
            }
            return {way: self._milliseconds(work) for way, work in ways.items()}

    def _half(self, frames) -> np.ndarray:
        return np.asarray(self._in_turn(frames))

    def _milliseconds(self, work: Callable[[], object]) -> float:
        began = time.perf_counter()
        work()
        return 1e3 * (time.perf_counter() - began) / len(self._problems)


if __name__ == "__main__":
    main()
