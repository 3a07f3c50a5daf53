"""How the dense network's errors go with its differences from the heat maps: least squares on unseen renders."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float

from workbench.landmarks.scheme import MIRROR
from workbench.landmarks.schemes import DensePoints
from workbench.networks.dense_gain import MOST_PX, NAME, DenseGain, differences
from workbench.networks.landmark_network import LANDMARKS
from workbench.networks.regression import Places
from workbench.networks.weights import ARCHITECTURE, write_weights
from workbench.training.dense_measuring import DenseAnswers, even_factor
from workbench.training.evaluation import Answers, joined
from workbench.training.shipping import NOTES

NOISE_PX2 = 10.0
"""Variance of what differs by chance, square pixels of 256: it keeps the gain small (ridge regression)."""


LookedAt = tuple[DenseAnswers, Answers]
"""Both networks' answers on the same pictures."""


def fitted_gain(sets: Sequence[Sequence[LookedAt]], points: DensePoints) -> DenseGain:
    """The gain for all of these answers: each set on other people, in the same kinds of pictures. Of the points,
    `points` are the last.

    What is left of the deviations is measured on each set with the gain of the others.
    """
    left = []
    for held_out in sets:
        gain = _least_squares(chain.from_iterable(each for each in sets if each is not held_out), points)
        unscaled = DenseGain(gain, np.ones(len(points)))
        left.append([corrected_answers(unscaled, *looks).deviations[:, -len(points) :] for looks in held_out])
    kinds = [np.concatenate(kind) for kind in zip(*left, strict=True)]
    return DenseGain(_least_squares(chain.from_iterable(sets), points), even_factor(kinds))


def _least_squares(sets: Iterable[LookedAt], points: DensePoints) -> Float[np.ndarray, "moves differences"]:
    """Mirrored pictures count as well: the gain of a mirrored face is the mirrored gain."""
    dense, heat_maps = (joined(part) for part in zip(*sets, strict=True))
    apart = differences(dense.points, heat_maps.points)
    missed = np.clip((dense.truth - dense.points)[:, -len(points) :], -MOST_PX, MOST_PX).reshape(len(apart), -1)
    apart = np.concatenate([apart, _mirrored(apart, np.array(MIRROR))])
    missed = np.concatenate([missed, _mirrored(missed, np.array(points.mirror))])
    normal = apart.T @ apart + NOISE_PX2 * len(apart) * np.eye(2 * LANDMARKS)
    return np.linalg.solve(normal, apart.T @ missed).T


def corrected_answers(gain: DenseGain, dense: DenseAnswers, heat_maps: Answers) -> DenseAnswers:
    """The dense network's answers as the detector corrects them."""
    places = [
        gain.corrected(Places(points, whitening), landmarks)
        for points, whitening, landmarks in zip(dense.points, dense.whitening, heat_maps.points, strict=True)
    ]
    points, whitening = (np.stack(part) for part in zip(*places, strict=True))
    return replace(dense, points=points, whitening=whitening)


def write_dense_gain(path: Path, gain: DenseGain) -> None:
    """Write what `read_dense_gain` reads, the gain in half precision."""
    arrays = {"gain": gain.gain.astype(np.float16), "deviation_factor": gain.deviation_factor.astype(np.float32)}
    write_weights(path, arrays, {ARCHITECTURE: NAME, **NOTES})


def _mirrored(columns: Float[np.ndarray, "n xy"], order: np.ndarray) -> Float[np.ndarray, "n xy"]:
    places = columns.reshape(len(columns), -1, 2)[:, order]
    return (places * [-1.0, 1.0]).reshape(len(columns), -1)
