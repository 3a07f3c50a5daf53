"""Deep Energies on photos whose truth is known (`deep_scenes.py`): does it converge, how exactly, how long it takes.

Tables: `convergence` from a frontal start, `energies` (network against preselected points), `networks` (the bundled
ones), `jaw` stages, `derivatives`, `stereo` against one camera, `orthographic` (Appendix C.2). Each prints its own
line.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from deep_scenes import (
    ANGLE_DEG,
    FOV_DEG,
    NETWORK,
    OFFSET_PX,
    START_MM,
    STEREO_DEG,
    DeepScenes,
    DeepTruth,
    make_rig,
    rotation_as_seen,
    rotation_error_deg,
)
from result import print_result

from workbench.config import Config, preset
from workbench.face import FaceParameters, in_scheme, load_default_head
from workbench.geometry import write_rig
from workbench.planning import plan_of
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_solution import DeepSolution
from workbench.tracking.deep_target import BUNDLED, energy_network, network_scheme, photo_landmarks

CONVERGED_DEG, CONVERGED_DEPTH = 3.0, 0.05
"""A frame has converged within these errors of rotation and, as a share, of depth."""
FIRST_SEED = 1000
WIDE_OPEN_DEG = (18.0, 26.0)
SINGLE = ("heat-maps", "landmarks")
"""The networks that `NETWORK` is the mean of."""
Row = dict[str, Any]


class Bench:
    """Solves of the same frames under different configurations."""

    def __init__(self, frames: int, log: Callable[[str], None], apart_deg: float = STEREO_DEG, network: str = NETWORK):
        self.frames, self.log, self.apart_deg, self.network = frames, log, apart_deg, network
        self.scenes = DeepScenes(load_default_head())
        self._made: dict[tuple, DeepTruth] = {}

    def truths(self, count: int, **how) -> Iterator[DeepTruth]:
        """The first frames, made once."""
        for seed in range(FIRST_SEED, FIRST_SEED + count):
            key = (seed, *how.items())
            if key not in self._made:
                self._made[key] = self.scenes.frame(seed, **how)
            yield self._made[key]

    def solve(self, config: Config, count: int, name: str, views: int = 1, identity: bool = True, **how) -> list[Row]:
        """A row of errors for every frame; frames without a detection have `found` False."""
        scheme, rows = network_scheme(config.deep.network), []
        fitter = DeepFitter(in_scheme(self.scenes.head, scheme), plan_of(config, scheme))
        for k, truth in enumerate(self.truths(count, **how)):
            if truth.landmarks[0] is None:
                rows.append({"found": False})
                continue
            observation = truth.observation(k, views)
            if config.deep.network != NETWORK:
                seen = photo_landmarks(energy_network(config.deep.network), truth.pictures[0], truth.landmarks[0])
                observation = replace(observation, landmarks=seen)
            context = truth.context(None if identity else fitter.mean_identity())
            if not rows:
                fitter.solve(fitter.problem(observation, context))  # compiles
            began = time.process_time()
            solution = fitter.solve(fitter.problem(observation, context))
            row = _row(solution, truth, self.scenes.head.expression_names)
            row["processor_seconds"] = time.process_time() - began
            row["failure"] = fitter.record(solution).failure
            rows.append(row)
            self.log(f"{name} {k}: {_short(row)}")
        return rows


def convergence(bench: Bench) -> None:
    """From a frontal start 25° and 40 px away."""
    rows = bench.solve(_config(), bench.frames, "convergence")
    found = [row for row in rows if row["found"]]
    converged = [row for row in found if row["rotation_deg"] < CONVERGED_DEG and row["depth"] < CONVERGED_DEPTH]
    print_result(
        "deep_energies_convergence",
        value=100.0 * len(converged) / len(rows),
        unit="% of frames",
        goal=">= 95",
        against=f"truth {ANGLE_DEG:g}° and {OFFSET_PX:g} px from the start, within {CONVERGED_DEG:g}° and 5 % of depth",
        details={
            "frames": len(rows),
            "not_detected": len(rows) - len(found),
            "rotation_deg_mean": _mean(found, "rotation_deg"),
            "rotation_deg_median": _median(found, "rotation_deg"),
            "rotation_deg_worst": max(row["rotation_deg"] for row in found),
            "depth_percent_mean": 100.0 * _mean(found, "depth"),
            "translation_mm_mean": _mean(found, "translation_mm"),
            "marked_failed": sum(bool(row["failure"]) for row in found),
            "marked_failed_of_converged": sum(bool(row["failure"]) for row in converged),
            **_timing(found),
        },
    )


def energies(bench: Bench) -> None:
    """The same frames by what the network sees in the render, by preselected points, and by both."""
    tables = {
        energy: bench.solve(_config(deep={"energy": energy}), bench.frames, energy)
        for energy in ("deep", "points", "mixed")
    }
    deep, points = ([row for row in tables[energy] if row["found"]] for energy in ("deep", "points"))
    print_result(
        "deep_energies_against_points",
        value=_mean(deep, "rotation_deg") / _mean(points, "rotation_deg"),
        unit="× the rotation error",
        goal="<= 1.0",
        against="preselected points on the same frames",
        details={energy: _accuracy(rows) for energy, rows in tables.items()} | {"frames": bench.frames},
    )


def networks(bench: Bench) -> None:
    """The same frames with each of the bundled networks as N."""
    tables = {name: bench.solve(_config(deep={"network": name}), bench.frames, name) for name in BUNDLED}
    both = {name: [row for row in rows if row["found"]] for name, rows in tables.items()}
    print_result(
        "deep_energies_networks",
        value=_mean(both[NETWORK], "rotation_deg") / min(_mean(both[one], "rotation_deg") for one in SINGLE),
        unit="× the rotation error",
        goal="<= 1.0",
        against="the better of the networks that it is made of, on the same frames",
        details={name: _accuracy(rows) | _timing(rows, stages=False) for name, rows in both.items()}
        | {"frames": bench.frames},
    )


def jaw(bench: Bench) -> None:
    """The jaw's angle, and the rigid pose before and after the jaw stages, with the mouth wide open."""
    config = _config(deep={"network": bench.network})
    rows = [row for row in bench.solve(config, bench.frames, "jaw", jaw_deg=WIDE_OPEN_DEG) if row["found"]]
    errors = np.abs([row["jaw_deg"] for row in rows])
    print_result(
        "deep_energies_jaw",
        value=float(np.median(errors)),
        unit="° of the jaw's angle, median",
        goal="<= 2.0",
        against=f"mouths open by {WIDE_OPEN_DEG[0]:g} to {WIDE_OPEN_DEG[1]:g}°",
        details={
            "frames": len(rows),
            "within_2_deg": float(np.mean(errors <= 2.0)),
            "signed_mean_deg": _mean(rows, "jaw_deg"),
            "rotation_deg_before_jaw_stages": float(np.mean([row["stages"]["rigid, all"][0] for row in rows])),
            "rotation_deg_after": _mean(rows, "rotation_deg"),
            "depth_percent_before": 100.0 * float(np.mean([row["stages"]["rigid, all"][1] for row in rows])),
            "depth_percent_after": 100.0 * _mean(rows, "depth"),
            "repaired": float(np.mean([row["rotation_deg"] < row["stages"]["rigid, all"][0] for row in rows])),
        },
    )


def derivatives(bench: Bench) -> None:
    """Where the derivative of the seen landmarks comes from: the price and the gain."""
    count = min(bench.frames, 10)
    tables = {
        way: bench.solve(_config(deep={"derivative": way}), count, way) for way in ("broyden", "forward", "differences")
    }
    details = {way: _accuracy(rows) | _timing(rows, stages=False) for way, rows in tables.items()}
    print_result(
        "deep_energies_derivatives",
        value=details["broyden"]["seconds_a_frame"] / details["forward"]["seconds_a_frame"],
        unit="× the time of a frame",
        goal=None,
        against="exact derivatives by forward mode",
        details=details | {"frames": count},
    )


def stereo(bench: Bench) -> None:
    """Two cameras (30° apart unless asked otherwise) against the first of them."""
    angles = (0.0, bench.apart_deg)
    with tempfile.TemporaryDirectory() as folder:
        rig = Path(folder) / "rig.toml"
        write_rig(make_rig(angles), rig)
        two = bench.solve(_config(camera={"rig": str(rig)}), bench.frames, "stereo", views=2, views_deg=angles)
    one = bench.solve(_config(), bench.frames, "mono", views_deg=angles)
    pairs = [pair for pair in zip(one, two, strict=True) if pair[0]["found"]]
    one, two = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    print_result(
        "deep_energies_stereo",
        value=_mean(two, "translation_mm") / _mean(one, "translation_mm"),
        unit="× the translation error",
        goal="<= 0.333",
        against="one camera",
        details={
            "two": _accuracy(two),
            "one": _accuracy(one),
            "frames": len(one),
            "apart_deg": bench.apart_deg,
            "seen_by_both": sum(None not in truth.landmarks for truth in bench.truths(bench.frames, views_deg=angles)),
        },
    )


def orthographic(bench: Bench) -> None:
    """Appendix C.2: no perspective, mean face, 10 + 10 components, on perspective photos."""
    parallel = preset("deep-parallel").changed(camera={"fov_deg": FOV_DEG}, deep={"distance_mm": START_MM})
    rows = bench.solve(parallel, bench.frames, "deep-parallel", identity=False)
    same = _config(identity={"calibrate": False})
    perspective = bench.solve(same, bench.frames, "perspective, mean face", identity=False)
    known = bench.solve(_config(), bench.frames, "perspective, own face")
    found = [row for row in rows if row["found"]]
    print_result(
        "deep_energies_orthographic",
        value=_mean(found, "rotation_as_seen_deg"),
        unit="° of the rotation as seen along the ray to the head",
        goal=None,
        against="truth of perspective photos",
        details={
            "frames": len(rows),
            "ran": sum(bool(np.isfinite(row["rotation_deg"])) for row in found),
            "parallel": _accuracy(rows),
            "perspective_mean_face": _accuracy(perspective),
            "perspective_own_face": _accuracy(known),
        },
    )


TABLES = {
    "convergence": convergence,
    "energies": energies,
    "networks": networks,
    "jaw": jaw,
    "derivatives": derivatives,
    "stereo": stereo,
    "orthographic": orthographic,
}


def main() -> None:
    """Print the tables."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--frames", type=int, default=12)
    arguments.add_argument("--only", choices=[*TABLES, "all"], action="append", help="default: convergence")
    arguments.add_argument("--verbose", action="store_true", help="every frame's errors, on stderr")
    arguments.add_argument("--apart", type=float, default=STEREO_DEG, help="stereo: angle between the cameras, degrees")
    arguments.add_argument("--network", choices=[*BUNDLED], default=NETWORK, help="jaw: what looks at the mouth")
    options = arguments.parse_args()
    log = (lambda line: print(line, file=sys.stderr, flush=True)) if options.verbose else lambda _: None
    bench = Bench(options.frames, log, options.apart, options.network)
    asked = options.only or ["convergence"]
    for name in TABLES if "all" in asked else asked:
        TABLES[name](bench)


def _config(**changes: dict[str, Any]) -> Config:
    camera = {"fov_deg": FOV_DEG, **changes.pop("camera", {})}
    deep = {"distance_mm": START_MM, "start": "frontal", **changes.pop("deep", {})}
    return preset("deep").changed(camera=camera, deep=deep, **changes)


def _row(solution: DeepSolution, truth: DeepTruth, names: tuple[str, ...]) -> Row:
    found, true = solution.parameters, truth.parameters
    stages = zip(solution.stages, solution.results, solution.seconds, strict=True)
    after, seconds = {}, {}
    for stage, result, spent in stages:
        parameters = result.parameters
        after[stage.name] = (
            rotation_error_deg(parameters.rotation, true.rotation),
            _depth_error(parameters, true),
            _jaw_error_deg(parameters, true),
        )
        seconds[stage.name] = spent
    mouth = [k for k, name in enumerate(names) if name.startswith("mouth")]
    weights = np.asarray(found.expression)[mouth] - np.asarray(true.expression)[mouth]
    return {
        "found": True,
        "rotation_deg": rotation_error_deg(found.rotation, true.rotation),
        "rotation_as_seen_deg": rotation_error_deg(found.rotation, rotation_as_seen(true)),
        "translation_mm": float(np.linalg.norm(np.asarray(found.translation) - np.asarray(true.translation))),
        "depth": _depth_error(found, true),
        "jaw_deg": _jaw_error_deg(found, true),
        "weights_rms": float(np.sqrt(np.mean(weights**2))),
        "evaluations": sum(result.evaluations for result in solution.results),
        "stages": after,
        "seconds": seconds,
    }


def _depth_error(found: FaceParameters, true: FaceParameters) -> float:
    return abs(float(found.translation[2]) / float(true.translation[2]) - 1.0)


def _jaw_error_deg(found: FaceParameters, true: FaceParameters) -> float:
    return float(np.degrees(float(found.jaw[0] - true.jaw[0])))


def _mean(rows: list[Row], key: str) -> float:
    return float(np.mean([row[key] for row in rows]))


def _median(rows: list[Row], key: str) -> float:
    return float(np.median([row[key] for row in rows]))


def _accuracy(rows: list[Row]) -> dict[str, float]:
    found = [row for row in rows if row["found"]]
    return {
        "rotation_deg_mean": _mean(found, "rotation_deg"),
        "rotation_deg_median": _median(found, "rotation_deg"),
        "translation_mm_mean": _mean(found, "translation_mm"),
        "depth_percent_mean": 100.0 * _mean(found, "depth"),
        "jaw_deg_mean": float(np.mean(np.abs([row["jaw_deg"] for row in found]))),
        "weights_rms_mean": _mean(found, "weights_rms"),
    }


def _timing(rows: list[Row], stages: bool = True) -> dict[str, Any]:
    found = [row for row in rows if row["found"]]
    spent = {name: float(np.mean([row["seconds"][name] for row in found])) for name in found[0]["seconds"]}
    whole = {
        "seconds_a_frame": sum(spent.values()),
        "processor_seconds_a_frame": _mean(found, "processor_seconds"),
        "evaluations_a_frame": _mean(found, "evaluations"),
    }
    return whole | ({"seconds_by_stage": spent} if stages else {})


def _short(row: Row) -> str:
    stages = " ".join(
        f"{name}:{turn:.1f}/{100 * depth:.1f}/{opened:+.0f}" for name, (turn, depth, opened) in row["stages"].items()
    )
    return (
        f"rotation {row['rotation_deg']:.2f} translation {row['translation_mm']:.1f} depth {100 * row['depth']:.1f}%"
        f" jaw {row['jaw_deg']:+.1f} weights {row['weights_rms']:.3f} seconds {sum(row['seconds'].values()):.1f}"
        f" [{row['failure']}] | {stages}"
    )


if __name__ == "__main__":
    main()
