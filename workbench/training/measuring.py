"""The figures of the model card: a weights file measured on a pool of renders. PyTorch is not needed."""

from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.landmarks.lids import OPENING_READ, lid_openings
from workbench.networks import LandmarkNetwork, patch_mass, read_landmark_network, soft_argmax
from workbench.training.augment import TRAINING
from workbench.training.evaluation import (
    CONFIDENT_PERCENT,
    Answers,
    answers_of,
    error_table,
    eye_aspect,
    mouth_opening,
    rank_correlation,
    reliability,
)
from workbench.training.pool import Pool


def measured(path: Path, pool: Pool, count: int, side: int) -> dict:
    """The figures of the model card for a weights file, on clean and on damaged pictures of a pool."""
    network = read_landmark_network(path)
    look = looker(network)
    numbers: dict = {"side": side, "pictures": count, "confident_percent": CONFIDENT_PERCENT}
    numbers["clean"] = error_table(answers := answers_of(look, pool, count, side))
    numbers |= _openings(answers)
    numbers["lids"] = lids_of(answers).tolist()
    damaged = answers_of(look, pool, count, side, TRAINING)
    numbers["damaged"] = error_table(damaged)
    numbers["rank_correlation"] = rank_correlation(damaged)
    confidence = np.asarray(network.calibration(jnp.asarray(damaged.mass[:, 17:].ravel(), jnp.float32)))
    found = (damaged.errors_percent[:, 17:] < CONFIDENT_PERCENT).ravel()
    numbers["reliability"] = reliability(confidence, found).tolist()
    return numbers


def looker(network: LandmarkNetwork):
    """A network as a function of a crop: points in its pixels, and the probability mass around each."""

    @jax.jit
    def answer(crop):
        maps = network(jnp.moveaxis(crop, -1, 0).astype(jnp.float32) / 255)
        stride = crop.shape[0] / maps.shape[-1]
        return (soft_argmax(maps) + 0.5) * stride - 0.5, patch_mass(maps)

    return lambda crop: tuple(np.asarray(part) for part in answer(crop))


def _openings(answers: Answers) -> dict[str, float]:
    """Closed eyes and open mouths, on heads that are turned less than 45°."""
    front = np.abs(answers.angles_deg[:, 0]) < 45
    eyes_true, eyes = eye_aspect(answers.truth)[front], eye_aspect(answers.points)[front]
    mouth_true, mouth = mouth_opening(answers.truth)[front], mouth_opening(answers.points)[front]
    closed, opened, wide = eyes_true < 0.1, eyes_true > 0.25, mouth_true > 0.2
    return {
        "eye_aspect_closed": _mean(eyes[closed]),
        "eye_aspect_closed_true": _mean(eyes_true[closed]),
        "eye_aspect_open": _mean(eyes[opened]),
        "eye_aspect_open_true": _mean(eyes_true[opened]),
        "mouth_opening_error": _mean(np.abs(mouth - mouth_true)[wide]) / _mean(mouth_true[wide]),
        "mouth_opening_bias": _mean((mouth - mouth_true)[wide]) / _mean(mouth_true[wide]),
    }


def lids_of(answers: Answers, readings: Sequence[float] = OPENING_READ) -> Float[np.ndarray, "k 3"]:
    """Of narrow eyes: their opening as read, the median of the true ones, and the number of eyes; in widths of the eye.

    A reading stands for those up to half the way to its neighbours. Heads are turned less than 45°.
    """
    front = np.abs(answers.angles_deg[:, 0]) < 45
    read, true = (
        np.concatenate([lid_openings(points) for points in part[front]]) for part in (answers.points, answers.truth)
    )
    middles = (np.array(readings[1:]) + readings[:-1]) / 2
    place = np.searchsorted([*middles, 2 * readings[-1] - middles[-1]], read)
    rows = [(reading, true[place == k]) for k, reading in enumerate(readings)]
    return np.array([(reading, np.median(eyes) if len(eyes) else np.nan, len(eyes)) for reading, eyes in rows])


def _mean(values) -> float:
    return float(values.mean()) if values.size else float("nan")
