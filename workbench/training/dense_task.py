"""The dense network's task: each point a Gaussian in the picture, with a covariance of its own (Wood et al. 2022)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from workbench.landmarks.schemes import DENSE_POINTS, DensePoints
from workbench.networks import landmark_network
from workbench.networks.dense_network import NAME, SIDE
from workbench.networks.regression import NUMBERS
from workbench.networks.weights import read_weights
from workbench.training.augment import augmented
from workbench.training.landmark_task import POINTS, openings
from workbench.training.loop import Batch, Phase, TrainingPlan
from workbench.training.pool import Pool, open_pool
from workbench.training.torch_network import take_convolutions
from workbench.training.torch_regression import (
    HALF_SQUARED,
    TorchRegression,
    gaussian_cost,
    regression_arrays,
    take_regression,
    torch_places,
)

HIDDEN, SQUEEZED = 512, 64
OPENING_WEIGHT = 0.1


@dataclass(frozen=True)
class DenseTask:
    """68 landmarks, two pupils and the dense points, by regression."""

    architecture: str = NAME
    starts: tuple[str, ...] = (NAME, landmark_network.NAME)
    dense: DensePoints = DENSE_POINTS

    def open(self, folder: Path, pictures: int | None) -> Pool:
        return open_pool(folder, pictures)

    def network(self, plan: TrainingPlan) -> nn.Module:
        return TorchRegression(plan.widths, plan.blocks, SQUEEZED, HIDDEN, NUMBERS * (POINTS + len(DENSE_POINTS)), SIDE)

    def begin(self, network: TorchRegression, start: Path, pictures: Tensor) -> None:
        """Give the network a dense network's weights, or a landmark network's encoder, for `pictures` like these."""
        weights = read_weights(start)
        take = take_regression if weights.architecture == NAME else take_convolutions
        take(network, weights.arrays, pictures)

    def arrays(self, network: TorchRegression) -> dict[str, np.ndarray]:
        """What is kept of a trained one."""
        return regression_arrays(network)

    def batch(self, pool: Pool, phase: Phase, rngs: list[np.random.Generator]) -> Batch:
        """Pictures, points and whether there is a face."""
        pictures = np.empty((len(rngs), SIDE, SIDE, 3), np.uint8)
        points = np.empty((len(rngs), POINTS + len(DENSE_POINTS), 2), np.float32)
        is_face = np.empty(len(rngs), np.float32)
        for place, rng in enumerate(rngs):
            made = augmented(pool, int(rng.integers(len(pool))), rng, SIDE, dense=DENSE_POINTS)
            pictures[place], points[place], is_face[place] = made.picture, (*made.points, *made.dense), made.is_face
        return pictures, (points, is_face)

    def loss(self, answers: Float[Tensor, "n k5"], targets: tuple[Tensor, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        points, is_face = targets
        return loss_of(answers.unflatten(1, (-1, NUMBERS)), points, is_face)


def loss_of(answers, points, is_face) -> tuple[Tensor, dict[str, Tensor]]:
    """Negative log-likelihood of the true places, those far outside of their covariance counted linearly."""
    read = torch_places(answers, SIDE)
    cost, squared = gaussian_cost(answers, points - read)
    face = is_face[:, None]
    likely = (face * cost).sum() / (face.sum() * points.shape[1])
    upper, lower = openings(read.device)
    across = ((read[:, lower] - read[:, upper]) - (points[:, lower] - points[:, upper])).abs().sum(-1)
    loss = likely + OPENING_WEIGHT * (face * across).sum() / (face.sum() * across.shape[1])
    with torch.no_grad():
        far = (points - read).norm(dim=-1)
        size = (points[:, 45] - points[:, 36]).norm(dim=-1).clamp_min(1e-3)[:, None]
        share = 100 * far / size * face
        inner = share[:, 17:68].sum() / (51 * face.sum())
        dense = share[:, 70:].sum() / ((points.shape[1] - 70) * face.sum())
        inside = ((squared < HALF_SQUARED) * face).sum() / (face.sum() * points.shape[1])
    numbers = {"loss": loss, "inner_percent": inner, "dense_percent": dense, "inside_half": inside}
    return loss, {name: value.detach() for name, value in numbers.items()}
