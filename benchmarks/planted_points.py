"""What a clip learns of ten landmarks that were planted wrong: their factors as a part of the others'.

Each of the ten is moved by 6 % of the outer-eye distance in all frames of the sample clip, every one another way.
Nothing but the clip's own landmarks says so: point weights are learned so that fits predict landmarks that they have not seen.
"""

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from learned_weights import CONFIG, observed_with_truth
from result import print_result

from workbench.face import load_default_head
from workbench.landmarks.scheme import outer_eye_distance
from workbench.learning import Parts, Wanted, tuned
from workbench.objectives import read_sum

WRONG = (19, 25, 29, 32, 37, 44, 49, 53, 57, 62)
"""In every part of the face but the jaw's contour, which slides on the face model anyway."""
OFFSET, SEED = 0.06, 0


def main() -> None:
    """Plant, learn and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10)
    asked = parser.parse_args()
    head = load_default_head()
    clip = planted(observed_with_truth("performance", head))
    count = len(clip.observations)
    first, second = round(0.6 * count), round(0.8 * count)
    parts = Parts(range(first), range(second, count), range(first, second))
    wanted = Wanted(read_sum("left-out-points"), parts, ("landmarks.weights",), (), asked.steps, 0)

    def tell(what, done, total, value, watched):
        print(f"{what} {done} of {total}: {value:.4g}, watched {watched}", file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory() as folder:
        found = tuned(head, CONFIG, clip, wanted, tell, Path(folder) / "learned.toml")
    factors = np.array(found.config.point_weights()) / np.array(CONFIG.point_weights())
    others = np.delete(factors, WRONG)
    details = {"factors": factors[list(WRONG)].tolist(), "others": float(others.mean()), "held out": str(found.change)}
    ratio = float(factors[list(WRONG)].mean() / others.mean())
    print_result("planted_points", ratio, "of the others' factor", "<= 0.3", "the mean of the 58 others", details)


def planted(clip):
    """The clip with its wrong landmarks."""
    angles = np.random.default_rng(SEED).uniform(0.0, 2.0 * np.pi, len(WRONG))
    moved = OFFSET * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def spoiled(observation):
        points = observation.landmarks.points.copy()
        points[list(WRONG)] += moved * outer_eye_distance(points)
        return replace(observation, landmarks=replace(observation.landmarks, points=points))

    return replace(clip, digest=f"planted {clip.digest}", observations=tuple(map(spoiled, clip.observations)))


if __name__ == "__main__":
    main()
