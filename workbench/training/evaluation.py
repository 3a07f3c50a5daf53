"""How good a landmark network is: error, closed eyes, open mouths and confidence on renders that it has not seen."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.stats import spearmanr

from workbench.landmarks.scheme import GROUPS, outer_eye_distance
from workbench.landmarks.schemes import DensePoints
from workbench.training.augment import Hardness, TrainingPicture, augmented
from workbench.training.pool import Pool

CLEAN = Hardness(framing=1.0, damage=0.0, occlusion=0.0)
"""As a detector would frame a face, in a good picture."""
CONFIDENT_PERCENT = 5.0
"""A landmark counts as found within this many percent of the outer-eye distance."""
KNOTS_AT = (0.0, 1 / 600, 1 / 200, 1 / 100, 1 / 50, 1 / 25, *(k / 12 for k in range(1, 13)))
"""Shares of all landmarks between which a calibration has a knot each: close together where the network is least sure,
because a wall is told from a hidden point there."""
LEAST_MASS_STEP = 1e-4

Network = Callable[[UInt8[np.ndarray, "s s 3"]], tuple[Float[np.ndarray, "68 2"], Float[np.ndarray, "68"]]]
"""A crop to points in its pixels, and the probability mass around each."""


@dataclass(frozen=True, eq=False)
class Found:
    """Where a network said that points of many pictures are, and the truth."""

    points: Float[np.ndarray, "n k 2"]
    truth: Float[np.ndarray, "n k 2"]
    angles_deg: Float[np.ndarray, "n 3"]

    @property
    def errors_percent(self) -> Float[np.ndarray, "n k"]:
        """Distances in percent of the outer-eye distance in the picture (which shrinks as the head turns)."""
        return 100 * np.linalg.norm(self.points - self.truth, axis=-1) / outer_eye_distance(self.truth)[:, None]


FoundKind = TypeVar("FoundKind", bound=Found)


@dataclass(frozen=True, eq=False)
class Answers(Found):
    """What a landmark network said of many pictures, and the truth."""

    mass: Float[np.ndarray, "n 68"]
    """Probability around each of the 68 points."""


def answers_of(
    network: Network, pool: Pool, count: int, side: int, hardness: Hardness = CLEAN, seed: int = 0
) -> Answers:
    """The network's answers on `count` augmented pictures of the pool, the same for the same seed."""
    rows = []
    for made, angles in unseen_pictures(pool, count, side, hardness, seed):
        points, mass = network(made.picture)
        rows.append((points, made.landmarks, angles, mass))
    return Answers(*columns(rows))


def unseen_pictures(
    pool: Pool, count: int, side: int, hardness: Hardness, seed: int, dense: DensePoints | None = None
) -> Iterator[tuple[TrainingPicture, Float[np.ndarray, "3"]]]:
    """Those with a face of `count` augmented pictures, each with yaw, pitch and roll in degrees."""
    for place in range(count):
        rng = np.random.default_rng([seed, place])
        index = int(rng.integers(len(pool)))
        made = augmented(pool, index, rng, side, hardness, dense)
        if made.is_face:
            yield made, pool.angles(index)


def joined(parts: Sequence[FoundKind]) -> FoundKind:
    """The answers on several sets of pictures as one."""
    names = [field.name for field in fields(parts[0])]
    return replace(parts[0], **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def columns(rows: Sequence[tuple]) -> Iterator[Float[np.ndarray, "n ..."]]:
    """An array of each column of these rows."""
    return (np.asarray(part, np.float64) for part in zip(*rows, strict=True))


def error_table(answers: Answers) -> dict[str, dict[str, float]]:
    """Mean, median and 90th percentile of the error in percent, by range of yaw (either way) and by group."""
    errors, yaw = answers.errors_percent, np.abs(answers.angles_deg[:, 0])
    inner = errors[:, 17:]
    rows = {}
    for low, high in ((0, 15), (15, 30), (30, 45), (45, 90)):
        rows[f"inner 51, yaw {low}–{high}°"] = _spread(inner[(yaw >= low) & (yaw < high)])
    rows["inner 51, yaw below 45°"] = _spread(inner[yaw < 45])
    for group in ("jaw", "brows", "nose", "eyes", "mouth"):
        rows[f"{group}, yaw below 45°"] = _spread(errors[yaw < 45][:, list(GROUPS[group])])
    return rows


def calibration_of(
    answers: Answers, percent: float = CONFIDENT_PERCENT
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Probability mass to confidence: how often a landmark with that mass lies within `percent`, never falling.

    The masses ascend strictly within 0..1, however many landmarks have the same.
    """
    mass, found = answers.mass[:, 17:].ravel(), (answers.errors_percent[:, 17:] < percent).ravel()
    edges = np.quantile(mass, KNOTS_AT)
    knots, shares, weights = [], [], []
    for low, high in pairwise(edges):
        inside = (mass >= low) & (mass <= high)
        if not inside.any():  # few answers
            continue
        knots.append(mass[inside].mean())
        shares.append(found[inside].mean())
        weights.append(inside.sum())
    place = np.arange(len(knots))
    knots = np.maximum.accumulate(np.asarray(knots) + LEAST_MASS_STEP * place)
    knots = np.minimum(knots, 1 - LEAST_MASS_STEP * place[::-1])
    return knots, _never_falling(np.asarray(shares), np.asarray(weights, float))


def reliability(
    confidence: Float[np.ndarray, "n"], found: Bool[np.ndarray, "n"], bins: int = 10
) -> Float[np.ndarray, "bins 3"]:
    """Mean confidence, share found and number of landmarks, by tenth of the confidence."""
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    rows = [
        (confidence[place == k].mean(), found[place == k].mean(), (place == k).sum())
        for k in range(bins)
        if (place == k).any()
    ]
    return np.asarray(rows, float)


def rank_correlation(answers: Answers) -> float:
    """Spearman's correlation of confidence and accuracy (minus the error) over the inner landmarks."""
    return float(spearmanr(answers.mass[:, 17:].ravel(), -answers.errors_percent[:, 17:].ravel()).statistic)


def eye_aspect(points: Float[np.ndarray, "*n 68 2"]) -> Float[np.ndarray, "*n"]:
    """Opening of the eyes: the lids' distance over the corners', mean of both eyes and of their two pairs of points."""
    ratios = []
    for start in (36, 42):
        eye = points[..., start : start + 6, :]
        width = np.linalg.norm(eye[..., 0, :] - eye[..., 3, :], axis=-1)
        opened = sum(np.linalg.norm(eye[..., a, :] - eye[..., b, :], axis=-1) for a, b in ((1, 5), (2, 4)))
        ratios.append(opened / (2 * width))
    return np.asarray(np.mean(ratios, axis=0))


def mouth_opening(points: Float[np.ndarray, "*n 68 2"]) -> Float[np.ndarray, "*n"]:
    """Opening of the inner lips at their middle over the outer-eye distance."""
    opened = np.linalg.norm(points[..., 66, :] - points[..., 62, :], axis=-1)
    return np.asarray(opened / np.linalg.norm(points[..., 45, :] - points[..., 36, :], axis=-1))


def _spread(errors) -> dict[str, float]:
    if errors.size == 0:
        return {"mean": float("nan"), "median": float("nan"), "p90": float("nan")}
    return {"mean": float(errors.mean()), "median": float(np.median(errors)), "p90": float(np.quantile(errors, 0.9))}


def _never_falling(values, weights):
    """The nearest sequence that never falls (pool adjacent violators)."""
    blocks: list[list[float]] = []
    for value, weight in zip(values, weights, strict=True):
        blocks.append([value, weight, 1])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            last, before = blocks.pop(), blocks.pop()
            total = before[1] + last[1]
            blocks.append([(before[0] * before[1] + last[0] * last[1]) / total, total, before[2] + last[2]])
    return np.concatenate([np.full(int(size), value) for value, _, size in blocks])
