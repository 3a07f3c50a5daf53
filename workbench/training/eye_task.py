"""The eye network's task: pupil and iris of a right eye, each a Gaussian in the crop, and whether it is open."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from workbench.networks.eye_network import NAME, POINTS, SIDE
from workbench.networks.regression import NUMBERS
from workbench.networks.weights import read_weights
from workbench.training.eye_pictures import CROP_EYE_PX, EyePicture, eye_picture, moved
from workbench.training.loop import Batch, Phase, TrainingPlan
from workbench.training.pool import Pool, open_pool
from workbench.training.torch_regression import (
    HALF_SQUARED,
    TorchRegression,
    gaussian_cost,
    regression_arrays,
    take_regression,
    torch_places,
)

HIDDEN, SQUEEZED = 192, 64
OPEN_WEIGHT = 0.5
"""Weight of the cross entropy of an open eye beside the likelihood of the points."""
CROPS = 30000
"""Different crops in all. Making one costs as much as a dozen of them cost the network; each is kept, and moved a
little every time."""


@dataclass(frozen=True)
class EyeTask:
    """Pupil, iris and open or shut."""

    architecture: str = NAME
    starts: tuple[str, ...] = (NAME,)

    def open(self, folder: Path, pictures: int | None) -> Pool:
        return open_pool(folder, pictures)

    def network(self, plan: TrainingPlan) -> nn.Module:
        return TorchRegression(plan.widths, plan.blocks, SQUEEZED, HIDDEN, NUMBERS * POINTS + 1, SIDE)

    def begin(self, network: TorchRegression, start: Path, pictures: Tensor) -> None:
        """Give the network what another eye network's file holds; `pictures` are some of those to come."""
        take_regression(network, read_weights(start).arrays, pictures)

    def arrays(self, network: TorchRegression) -> dict[str, np.ndarray]:
        """What is kept of a trained one."""
        return regression_arrays(network)

    def batch(self, pool: Pool, phase: Phase, rngs: list[np.random.Generator]) -> Batch:
        """Crops, points and whether the eye is open."""
        made = [moved(_numbered(pool, int(rng.integers(CROPS))), rng) for rng in rngs]
        points = np.stack([eye.points for eye in made]).astype(np.float32)
        return np.stack([eye.picture for eye in made]), (points, np.array([eye.is_open for eye in made], np.float32))

    def loss(self, answers: Float[Tensor, "n out"], targets: tuple[Tensor, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Negative log-likelihood of the true places, and the cross entropy of the open eyes."""
        points, is_open = targets
        numbers = answers[:, :-1].unflatten(1, (POINTS, NUMBERS))
        miss = points - torch_places(numbers, SIDE)
        cost, squared = gaussian_cost(numbers, miss)
        entropy = nn.functional.binary_cross_entropy_with_logits(answers[:, -1], is_open)
        loss = cost.mean() + OPEN_WEIGHT * entropy
        with torch.no_grad():
            far = 100 / CROP_EYE_PX * miss.norm(dim=-1)
            seen = is_open[:, None]
            pupil = (far[:, :1] * seen).sum() / seen.sum().clamp_min(1.0)
            right = ((answers[:, -1] > 0) == (is_open > 0.5)).float().mean()
            inside = (squared < HALF_SQUARED).float().mean()
        numbers = {"loss": loss, "pupil_percent": pupil, "open_right": right, "inside_half": inside}
        return loss, {name: value.detach() for name, value in numbers.items()}


@lru_cache(maxsize=CROPS)
def _numbered(pool: Pool, number: int) -> EyePicture:
    rng = np.random.default_rng([CROPS, number])
    return eye_picture(pool, int(rng.integers(len(pool))), int(rng.integers(2)), rng)
