"""What each refinement does to FACE IT!'s fits of noisy landmarks: trembling and error against the truth.

People talk (`moving_people.py`); the landmarks are the true ones with a detector's noise, another one in every frame.
Trembling is the second difference of the landmarks' error, so that the true motion does not count as such; the plain
second difference stands beside it. The lag of averaging is its error on the frames about a mouth that snaps shut.
"""

import argparse
import time
from functools import partial

import numpy as np
from moving_people import EVENT, MovingPeople, config, landmark_error, talking_at, weights_at
from result import print_result

from workbench.planning import plan_of
from workbench.tracking import FrameFit
from workbench.tracking.flow_fitter import FlowFitter
from workbench.tracking.moments import Moment
from workbench.tracking.reestimation import Reestimator
from workbench.tracking.refinement import refined

METHODS = {
    "averaging": {"method": "averaging"},
    "averaging, 2 sweeps": {"method": "averaging", "sweeps": 2},
    "self": {"method": "self"},
    "plate": {"method": "plate"},
    "plate, 3 sweeps": {"method": "plate", "sweeps": 3},
    "plate, 3 Gauss-Seidel": {"method": "plate", "sweeps": 3, "order": "gauss-seidel"},
    "hybrid": {"method": "hybrid"},
    "hybrid, 2 sweeps": {"method": "hybrid", "sweeps": 2},
}
FRAMES = 30


def main() -> None:
    """Print the ratio of hybrid's trembling to that of the single fits, with the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--people", type=int, default=3)
    parser.add_argument("--noise", type=float, default=1.0, help="of the landmarks, percent of the eye distance")
    options = parser.parse_args()
    made = MovingPeople()
    fitters = {name: FlowFitter(made.head, plan_of(config().changed(refinement=how))) for name, how in METHODS.items()}
    anew = Reestimator(made.head, plan_of(config()))
    rows: dict[str, list[dict[str, float]]] = {}
    for seed in range(options.people):
        film = made.film(seed, talking_at, FRAMES)
        snap = made.film(seed, partial(weights_at, "mouth"))
        rng = np.random.default_rng(seed)
        raw = [made.detected(fit, options.noise, rng) for fit in film.truth]
        rows.setdefault("single fits", []).append(measured(raw, film.truth))
        for name, fitter in fitters.items():
            began = time.perf_counter()
            fits = work(fitter, raw, film.pictures)
            row = measured(fits, film.truth) | {"seconds_a_frame": (time.perf_counter() - began) / FRAMES}
            about = slice(EVENT - 1, EVENT + 3)
            snapped = work(fitter, snap.truth, snap.pictures)[about]
            row["lag"] = float(
                np.mean([landmark_error(*pair) for pair in zip(snapped, snap.truth[about], strict=True)])
            )
            rows.setdefault(name, []).append(row)
            if name == "hybrid":
                stream = [Moment(fit, (picture,)) for fit, picture in zip(fits, film.pictures, strict=True)]
                again = [moment.fit for moment in anew.stream(stream)]
                rows.setdefault("hybrid, expression anew", []).append(measured(again, film.truth))
    made.close()
    table = {
        name: {key: float(np.mean([row[key] for row in found])) for key in found[0]} for name, found in rows.items()
    }
    single, hybrid = table["single fits"], table["hybrid"]
    details = {"people": options.people, "noise_percent": options.noise, "table": table}
    details["error_ratio"] = hybrid["error"] / single["error"]
    print_result("refinement", hybrid["trembling"] / single["trembling"], "ratio", "<= 0.4", "the single fits", details)


def work(fitter: FlowFitter, fits: list[FrameFit], pictures) -> list[FrameFit]:
    """The fits after a fitter's method."""
    stream = [Moment(fit, (picture,)) for fit, picture in zip(fits, pictures, strict=True)]
    return [moment.fit for moment in refined(fitter, stream)]


def measured(fits: list[FrameFit], truth: list[FrameFit]) -> dict[str, float]:
    """Error, trembling and plain second difference in percent of the eye distance; error of the rotation, degrees."""
    points, true = (np.stack([fit.projected for fit in side]) for side in (fits, truth))
    eyes = np.linalg.norm(true[:, 45] - true[:, 36], axis=1).mean() / 100.0
    turned = np.stack([fit.rotation for fit in fits]) - np.stack([fit.rotation for fit in truth])
    inner = slice(2, -2)
    return {
        "error": float(np.mean([landmark_error(*pair) for pair in zip(fits, truth, strict=True)][inner])),
        "trembling": second_difference(points - true) / eyes,
        "second_difference": second_difference(points) / eyes,
        "true_second_difference": second_difference(true) / eyes,
        "rotation_deg": float(np.degrees(np.linalg.norm(turned[inner], axis=1)).mean()),
    }


def second_difference(points: np.ndarray) -> float:
    """Mean length of the second difference over time, ends left out."""
    return float(np.linalg.norm(points[2:] - 2.0 * points[1:-1] + points[:-2], axis=2)[1:-1].mean())


if __name__ == "__main__":
    main()
