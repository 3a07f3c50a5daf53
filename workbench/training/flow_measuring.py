"""How good flow estimators are on pairs that no training has seen. PyTorch is not needed."""

from collections.abc import Mapping
from time import perf_counter

import numpy as np

from workbench.flow import FlowEstimator, end_point_errors
from workbench.training.flow_augment import CLEAN, TRAINING, PairHardness, augmented_pair
from workbench.training.flow_pool import PairPool

KINDS: Mapping[str, PairHardness] = {"clean": CLEAN, "damaged": TRAINING}
"""Sharp renders before a moving ground; and all that the training does to them."""
LEAST_FACE = 400
"""Pixels of visible face below which a pair is left out."""
SLOW_PX, FAST_PX = 3.0, 10.0
"""Mean lengths of the face's flow that part slow, middling and fast pairs (pictures of 256 pixels)."""


def measured_flow(
    estimators: Mapping[str, FlowEstimator], pool: PairPool, count: int, side: int, seed: int = 0
) -> dict[str, dict[str, dict[str, float]]]:
    """End-point errors by kind of pair and estimator, pixels of `side` × `side` pictures, the same pairs for all.

    Means over pairs of each pair's mean over the visible pixels of the face; `slow` to `fast` by how far it moves;
    `head` counts everything that is known and visible; `milliseconds` is the least time of one call.
    """
    tables: dict[str, dict[str, dict[str, float]]] = {}
    for kind, hardness in KINDS.items():
        rows = {name: [] for name in estimators}
        speed, fastest = [], dict.fromkeys(estimators, np.inf)
        for place in range(count):
            rng = np.random.default_rng([seed, place])
            pair = augmented_pair(pool, int(rng.integers(len(pool))), rng, side, hardness)
            counted = pair.known & pair.visible
            face = counted & pair.face
            if face.sum() < LEAST_FACE:
                continue
            speed.append(float(np.linalg.norm(pair.flow[face], axis=-1).mean()))
            for name, estimator in estimators.items():
                began = perf_counter()
                flow = estimator(pair.first, pair.second)
                fastest[name] = min(fastest[name], perf_counter() - began)
                errors = end_point_errors(flow, pair.flow)
                rows[name].append((errors[face].mean(), np.median(errors[face]), errors[counted].mean()))
        tables[kind] = {
            name: _summary(np.asarray(errors), np.asarray(speed)) | {"milliseconds": 1e3 * fastest[name]}
            for name, errors in rows.items()
        }
    return tables


def flow_tables(numbers: Mapping[str, Mapping[str, Mapping[str, float]]]) -> str:
    """The errors as Markdown."""
    columns = ("face", "median", "slow", "middling", "fast", "everything")
    lines = [f"| pixels | {' | '.join(columns)} |", "|" + "---|" * (len(columns) + 1)]
    for kind, rows in numbers.items():
        for name, row in rows.items():
            lines.append(f"| {kind}: {name} | " + " | ".join(f"{row[column]:.2f}" for column in columns) + " |")
    return "\n".join(lines) + "\n"


def _summary(errors, speed) -> dict[str, float]:
    means = errors[:, 0]
    groups = {"slow": speed < SLOW_PX, "middling": (speed >= SLOW_PX) & (speed < FAST_PX), "fast": speed >= FAST_PX}
    return {
        "face": float(means.mean()),
        "median": float(np.median(errors[:, 1])),
        **{name: float(means[where].mean()) if where.any() else float("nan") for name, where in groups.items()},
        "everything": float(errors[:, 2].mean()),
        "pairs": float(len(means)),
    }
