"""FACE IT! solve per frame against Ceres: same clip, same energies, ρ = ε = 15, 68 points and 43 shapes."""

import hashlib
import json
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from result import print_result
from synthetic_clip import Clip, synthetic_clip

from workbench.config import Config, preset
from workbench.face import FaceParameters, landmark_model
from workbench.planning import plan_of
from workbench.runtime import SMALL_ARRAYS, cache_folder
from workbench.tracker import FaceTracker
from workbench.tracking import FrameFit
from workbench.tracking.face_it_solution import solve_settings, stage_program
from workbench.tracking.frame_solver import FrameInput, solve_frame
from workbench.tracking.initial_pose import initial_pose

ROUNDS = 7
AGREEMENT = 0.01
"""Largest relative difference of the two reprojection errors: beyond it the two did not do the same work."""
SOURCE = Path(__file__).parent / "ceres" / "face_it.cpp"
MISSING = ("No such file or directory", "cannot find -l")
"""What g++ says when Ceres, Eigen or glog is not installed."""


class Run(NamedTuple):
    """One pass over the clip."""

    frame_ms: float
    """Median."""
    pose_iterations: float
    """Mean."""
    expression_iterations: float
    rmse_px: float
    """Mean over the frames of the root mean square landmark distance."""


class SkippedError(Exception):
    """This benchmark cannot run here."""


def face_it_config() -> Config:
    """The preset `face-it` with its two stages only: both programs start from one initial pose."""
    config = preset("face-it")
    return config.changed(stages=[stage.model_dump() for stage in config.stages if stage.when == "always"])


def build_ceres_program() -> Path:
    """Compile `face_it.cpp` unless this very source was compiled here before. Raises `SkippedError` without Ceres."""
    key = hashlib.sha256(SOURCE.read_bytes() + platform.node().encode()).hexdigest()[:16]
    program = cache_folder() / "benchmarks" / f"face_it-{key}"
    if program.exists():
        return program
    program.parent.mkdir(parents=True, exist_ok=True)
    temporary = program.with_suffix(".part")
    command = ["g++", "-std=c++17", "-O3", "-march=native", "-isystem", "/usr/include/eigen3", str(SOURCE)]
    try:
        done = subprocess.run([*command, "-lceres", "-lglog", "-o", str(temporary)], capture_output=True, text=True)
    except FileNotFoundError as error:
        raise SkippedError("there is no g++; install g++ and libceres-dev") from error
    if done.returncode and any(text in done.stderr for text in MISSING):
        raise SkippedError("Ceres is not installed; install libceres-dev")
    if done.returncode:
        raise RuntimeError(f"{SOURCE} does not compile:\n{done.stderr}")
    temporary.replace(program)
    return program


def write_clip(clip: Clip, config: Config, path: Path) -> None:
    """The clip, the model and the settings as the numbers that `face_it.cpp` reads, in its order."""
    pose_stage, expression_stage = config.stages
    weights, constants = config.weights, config.constants
    header = [
        *(68, len(clip.shapes), len(clip.points)),
        *(pose_stage.limit, expression_stage.limit, config.solver.tolerance),
        *(weights.tau, weights.beta, weights.sigma),
        *(constants.a, constants.b, constants.c, constants.rotation_mm),
        *(*clip.camera.focal_px, *clip.camera.principal_point_px),
        *np.concatenate(initial_pose(clip.camera, clip.neutral, clip.points[0])),
    ]
    with path.open("w") as stream:
        for numbers in (header, clip.neutral, clip.shapes, clip.points):
            np.savetxt(stream, np.ravel(numbers), fmt="%.17g")


def run_ceres(program: Path, clip_file: Path) -> Run:
    """The whole clip in Ceres."""
    done = subprocess.run([program, clip_file], check=True, capture_output=True, text=True)
    return Run(**{name: value for name, value in json.loads(done.stdout).items() if name in Run._fields})


def run_tracker(clip: Clip, config: Config) -> tuple[Run, list[FrameFit]]:
    """The whole clip frame by frame; the time is the tracker's own, from NumPy landmarks to NumPy results."""
    tracker = FaceTracker(clip.head, config)
    fits = [fit for index in range(len(clip.points)) for fit in tracker.push(clip.observation(index))]
    milliseconds = float(np.median([fit.milliseconds[2] for fit in fits]))
    iterations = np.mean([fit.iterations for fit in fits], axis=0)
    return Run(milliseconds, *map(float, iterations), rmse_px(np.stack([fit.projected for fit in fits]), clip)), fits


def rmse_px(projected: Float[np.ndarray, "n 68 2"], clip: Clip) -> float:
    """Mean over the frames of the root mean square landmark distance, pixels."""
    squared = np.sum((projected - clip.points[-len(projected) :]) ** 2, axis=2)
    return float(np.mean(np.sqrt(squared.mean(1))))


class Batch:
    """The frames of a clip as independent problems, each started from the fit of the frame before it.

    `spread` turns the solve of one frame into that of all: `jax.vmap` side by side, `in_turn` one after the other.
    """

    def __init__(self, clip: Clip, fits: list[FrameFit], config: Config, spread: Callable):
        program = stage_program(plan_of(config), start=False)
        model = landmark_model(clip.head).personal(np.zeros(len(clip.head.identity_deltas)))
        settings = solve_settings(plan_of(config))
        camera, model = jax.tree.map(jnp.asarray, (clip.camera, model))
        self._clip = clip
        self._frames = _stacked_inputs(fits)
        # Compiler options belong to the outermost program.
        solve = solve_frame.__wrapped__
        spread_out = spread(lambda frame: solve(camera, model, settings, program, frame))
        self._solve = jax.jit(spread_out, compiler_options=SMALL_ARRAYS)

    def run(self) -> tuple[float, float]:
        """Milliseconds per frame, NumPy in and NumPy report out, and the reprojection error."""
        began = time.perf_counter()
        solution = self._solve(self._frames)
        np.asarray(solution.report)
        milliseconds = 1e3 * (time.perf_counter() - began) / len(solution.report)
        return milliseconds, rmse_px(np.asarray(solution.projected), self._clip)


def in_turn(solve: Callable) -> Callable:
    """One frame after the other within one program: no Python between them, and no frame waits for the slowest."""
    return lambda frames: jax.lax.map(solve, frames)


def _stacked_inputs(fits: list[FrameFit]) -> FrameInput:
    pose = np.stack([np.concatenate([fit.rotation, fit.translation]) for fit in fits])
    expression = np.stack([fit.expression for fit in fits])
    measured = np.stack([np.column_stack([fit.observed, fit.confidence]) for fit in fits])
    last = slice(1, -1)
    start = FaceParameters(pose[last, :3], pose[last, 3:], expression[last], *[np.zeros((len(fits) - 2, 0))] * 3)
    return FrameInput(measured[2:], pose[last], pose[:-2], np.ones(len(fits) - 2), start)


SPREADS = {"batch": jax.vmap, "batch_in_turn": in_turn}
"""What a batch is called in the details, and how it runs."""


def main() -> None:
    """Interleave the programs over the same clip and print medians of the rounds."""
    clip, config = synthetic_clip(), face_it_config()
    fits = run_tracker(clip, config)[1]
    batches = {name: Batch(clip, fits, config, spread) for name, spread in SPREADS.items()}
    errors_px = {f"{name}_rmse_px": batch.run()[1] for name, batch in batches.items()}
    details = {"frames": len(clip.points), "points": 68, "shapes": len(clip.shapes)}
    against = "Ceres 2.1 in C++, analytic Jacobians, one thread"
    ceres_runs, our_runs, batch_ms = [], [], {name: [] for name in batches}
    with tempfile.TemporaryDirectory() as folder:
        clip_file = Path(folder) / "clip.txt"
        write_clip(clip, config, clip_file)
        try:
            program = build_ceres_program()
        except SkippedError as reason:
            ours = run_tracker(clip, config)[0]
            details |= {"skipped": str(reason), "ours_frame_ms": ours.frame_ms}
            details |= {f"{name}_ms": batch.run()[0] for name, batch in batches.items()}
            return print_result("solve_time", None, "ratio", "<= 1.0", against, details)
        for _ in range(ROUNDS):
            ceres_runs.append(run_ceres(program, clip_file))
            our_runs.append(run_tracker(clip, config)[0])
            for name, batch in batches.items():
                batch_ms[name].append(batch.run()[0])
    ceres, ours = median_run(ceres_runs), median_run(our_runs)
    ratios = [our.frame_ms / other.frame_ms for our, other in zip(our_runs, ceres_runs, strict=True)]
    if abs(ours.rmse_px / ceres.rmse_px - 1.0) > AGREEMENT:
        sys.exit(f"The errors differ: {ours.rmse_px:.4f} px here, {ceres.rmse_px:.4f} px in Ceres; no comparison.")
    details |= {f"ours_{name}": value for name, value in ours._asdict().items()}
    details |= {f"ceres_{name}": value for name, value in ceres._asdict().items()}
    details |= errors_px | {"ratio_lowest": min(ratios), "ratio_highest": max(ratios)}
    for name, milliseconds in batch_ms.items():
        against_ceres = [each / other.frame_ms for each, other in zip(milliseconds, ceres_runs, strict=True)]
        details |= {f"{name}_ms": float(np.median(milliseconds)), f"{name}_ratio": float(np.median(against_ceres))}
    details["batch_goal"] = "<= 0.4"
    print_result("solve_time", float(np.median(ratios)), "ratio", "<= 1.0", against, details)


def median_run(runs: list[Run]) -> Run:
    """The median of each number."""
    return Run(*map(float, np.median(runs, axis=0)))


if __name__ == "__main__":
    main()
