"""How good an eye network is: errors, whether what it finds follows what moves, and how much its ellipses hold."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from workbench.landmarks.uncertainty import ellipse_radius
from workbench.networks.eye_network import EyePlaces
from workbench.training.augment import Hardness
from workbench.training.dense_measuring import ELLIPSES, deviations
from workbench.training.evaluation import columns
from workbench.training.eye_pictures import CROP_EYE_PX, eye_picture
from workbench.training.pool import Pool

Look = Callable[[UInt8[np.ndarray, "64 64 3"]], EyePlaces]


@dataclass(frozen=True, eq=False)
class EyeAnswers:
    """What an eye network said of many crops, and the truth."""

    points: Float[np.ndarray, "n 9 2"]
    whitening: Float[np.ndarray, "n 9 2 2"]
    openness: Float[np.ndarray, "n"]
    """How likely the eye is open, it said."""
    truth: Float[np.ndarray, "n 9 2"]
    is_open: Float[np.ndarray, "n"]
    glasses: Float[np.ndarray, "n"]
    yaw_deg: Float[np.ndarray, "n"]

    @property
    def errors_percent(self) -> Float[np.ndarray, "n 9"]:
        """Distances in percent of a frontal eye's width."""
        return 100 * np.linalg.norm(self.points - self.truth, axis=-1) / CROP_EYE_PX

    @property
    def deviations(self) -> Float[np.ndarray, "n 9"]:
        """Distances in units of the network's own uncertainty."""
        return deviations(self.whitening, self.truth - self.points)

    def slope(self, chosen: Bool[np.ndarray, "n"]) -> float:
        """Of the pupils found over the true ones, across the crop: 1 where what is found follows what moves."""
        true, found = (places[chosen, 0, 0] - places[chosen, 0, 0].mean() for places in (self.truth, self.points))
        return float((true * found).sum() / (true * true).sum())


def eye_answers(look: Look, pool: Pool, count: int, hardness: Hardness, seed: int = 0) -> EyeAnswers:
    """The network's answers on `count` crops of the pool's eyes, the same for the same seed."""
    rows = []
    for place in range(count):
        rng = np.random.default_rng([seed, place])
        index, eye = int(rng.integers(len(pool))), int(rng.integers(2))
        made = eye_picture(pool, index, eye, rng, hardness)
        seen = look(made.picture)
        yaw = float(pool.angles(index)[0])
        rows.append((*seen, made.points, made.is_open, pool.glasses(index), yaw))
    return EyeAnswers(*columns(rows))


def measured_eyes(clean: EyeAnswers, damaged: EyeAnswers) -> dict[str, Mapping[str, float]]:
    """The tables of the model card: of open eyes that look no more than 45° away, with and without glasses.

    Whether an eye is open is told of all of them.
    """
    tables: dict[str, Mapping[str, float]] = {}
    for kind, answers in (("clean", clean), ("damaged", damaged)):
        front = (answers.is_open > 0.5) & (np.abs(answers.yaw_deg) < 45.0)
        for name, chosen in (("without glasses", answers.glasses < 0.5), ("with glasses", answers.glasses > 0.5)):
            seen = front & chosen
            errors = answers.errors_percent[seen]
            tables[f"{kind}, {name}"] = {
                "pupil: mean": float(errors[:, 0].mean()),
                "median": float(np.median(errors[:, 0])),
                "iris: mean": float(errors[:, 1:].mean()),
                "slope": answers.slope(seen),
                **{f"inside {share:.0%}": _held(answers, seen, share) for share in ELLIPSES},
                "open or shut: right": float(((answers.openness > 0.5) == (answers.is_open > 0.5))[chosen].mean()),
            }
    return tables


def _held(answers: EyeAnswers, chosen: Bool[np.ndarray, "n"], share: float) -> float:
    return float((answers.deviations[chosen] < ellipse_radius(share)).mean())
