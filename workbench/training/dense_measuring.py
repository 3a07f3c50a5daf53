"""How good a dense network is: errors by part of the face, and how much of the truth its ellipses hold."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from workbench.landmarks.schemes import DensePoints
from workbench.landmarks.uncertainty import ellipse_radius
from workbench.networks.dense_network import SIDE
from workbench.networks.regression import Places
from workbench.training.augment import MIRRORED, Hardness
from workbench.training.evaluation import Found, columns, unseen_pictures
from workbench.training.pool import Pool

ELLIPSES = (0.5, 0.8, 0.95)
"""Shares of the truth that an ellipse should hold."""

Look = Callable[[UInt8[np.ndarray, "256 256 3"]], Places]


@dataclass(frozen=True, eq=False)
class DenseAnswers(Found):
    """What a dense network said of many pictures, and the truth."""

    whitening: Float[np.ndarray, "n k 2 2"]

    @property
    def deviations(self) -> Float[np.ndarray, "n k"]:
        """Distances in units of the network's own uncertainty."""
        return deviations(self.whitening, self.truth - self.points)


def dense_answers(
    look: Look, pool: Pool, dense: DensePoints, count: int, hardness: Hardness, seed: int = 0
) -> DenseAnswers:
    """The network's answers on `count` augmented pictures of the pool, the same for the same seed."""
    rows = []
    for made, angles in unseen_pictures(pool, count, SIDE, hardness, seed, dense):
        places = look(made.picture)
        rows.append((places.points, (*made.points, *made.dense), angles, places.whitening))
    return DenseAnswers(*columns(rows))


def deviations(whitening: Float[np.ndarray, "n k 2 2"], miss: Float[np.ndarray, "n k 2"]) -> Float[np.ndarray, "n k"]:
    """Lengths of errors in units of their uncertainty."""
    return np.linalg.norm(np.einsum("nkij,nkj->nki", whitening, miss), axis=-1)


def deviation_factor(found: Float[np.ndarray, "n k"], share: float = 0.8) -> Float[np.ndarray, "k"]:
    """By how much each point's deviations are to be multiplied for its ellipses to hold this share of the truth.

    `found`: distances from the truth in units of the claimed uncertainty.
    """
    return np.quantile(found, share, axis=0) / ellipse_radius(share)


def even_factor(kinds: Sequence[Float[np.ndarray, "n k"]]) -> Float[np.ndarray, "k"]:
    """As `deviation_factor`, for all of `ELLIPSES` in several kinds of pictures: the largest error of a share inside is
    as small as it can be."""
    factors = np.geomspace(0.7, 1.4, 71)[:, None] * deviation_factor(np.concatenate(kinds))
    worst = np.zeros_like(factors)
    for found in kinds:
        for share in ELLIPSES:
            held = [(found < factor * ellipse_radius(share)).mean(axis=0) for factor in factors]
            worst = np.maximum(worst, np.abs(np.array(held) - share))
    return np.take_along_axis(factors, worst.argmin(axis=0)[None], axis=0)[0]


def measured_dense(clean: DenseAnswers, damaged: DenseAnswers, dense: DensePoints) -> dict[str, Mapping[str, float]]:
    """The tables of the model card: errors in percent by part of the face, and the shares inside the ellipses."""
    groups = {"68 landmarks, without the jaw": range(17, 68), "pupils": range(68, len(MIRRORED))}
    for name in dict.fromkeys(dense.parts):
        groups[f"dense, {name}"] = [len(MIRRORED) + k for k, group in enumerate(dense.parts) if group == name]
    tables: dict[str, Mapping[str, float]] = {}
    for name, which in groups.items():
        row = {}
        for kind, answers in (("clean", clean), ("damaged", damaged)):
            front = np.abs(answers.angles_deg[:, 0]) < 45
            for side, chosen in (("", front), (", turned", ~front)):
                row[f"{kind}{side}"] = float(answers.errors_percent[chosen][:, list(which)].mean())
            for share in ELLIPSES:
                row[f"{kind}, inside {share:.0%}"] = float(
                    (answers.deviations[:, list(which)] < ellipse_radius(share)).mean()
                )
        tables[name] = row
    return tables
