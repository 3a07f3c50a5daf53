"""The dense network's task: each point a Gaussian in the picture, with a covariance of its own (Wood et al. 2022)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from workbench.landmarks.schemes import DENSE_POINTS
from workbench.networks.weights import read_weights
from workbench.training.augment import augmented
from workbench.training.landmark_task import OPENINGS, POINTS
from workbench.training.loop import Batch, Phase, TrainingPlan, kept
from workbench.training.pool import Pool, open_pool
from workbench.training.torch_network import ConvNorm, TorchEncoder, conv_norms, take_convolutions

NAME = "face-energy-dense-1"
SIDE = 256
HIDDEN, SQUEEZED = 512, 64
LEAST_DEVIATION_PX, MOST_DEVIATION_PX = 0.15, 60.0
ROBUST = 3.0
"""Deviations beyond which an error counts linearly: a point behind a hand is no better for pulling harder."""
OPENING_WEIGHT = 0.1


class TorchDenseNetwork(TorchEncoder):
    """RGB in 0..1, 256 pixels wide, to five numbers a point: x, y, and the Cholesky factor of the precision."""

    def __init__(self, widths: tuple[int, int, int, int], blocks: int, points: int) -> None:
        super().__init__(widths, blocks)
        self.points = points
        self.squeeze = ConvNorm(widths[-1], SQUEEZED, 1)
        self.hidden = nn.Linear(SQUEEZED * (SIDE // 32) ** 2, HIDDEN)
        self.head = nn.Linear(HIDDEN, 5 * points)

    def forward(self, picture: Tensor) -> Tensor:
        """(n, points, 5): place as a share of the side from the middle, log of the precision's diagonal, its corner."""
        x = self.squeeze(self.features(picture)[-1]).flatten(1)
        with torch.autocast(picture.device.type, enabled=False):
            # In half precision a coordinate of 256 pixels would be rounded to whole ones.
            return self.head(torch.relu(self.hidden(x.float()))).unflatten(1, (self.points, 5))


@dataclass(frozen=True)
class DenseTask:
    """68 landmarks, two pupils and the dense points, by regression."""

    architecture: str = NAME

    def open(self, folder) -> Pool:
        return open_pool(folder)

    def network(self, plan: TrainingPlan) -> nn.Module:
        return TorchDenseNetwork(plan.widths, plan.blocks, POINTS + len(DENSE_POINTS))

    def begin(self, network: TorchDenseNetwork, start: Path, pictures: Tensor) -> None:
        """Give the network the encoder of a landmark network's file; `pictures` are some of those to come."""
        take_convolutions(network, read_weights(start).arrays, pictures)

    def arrays(self, network: TorchDenseNetwork) -> dict[str, np.ndarray]:
        """What is kept of a trained one."""
        arrays: dict[str, Tensor] = {}
        for name, step in conv_norms(network):
            arrays[f"{name}.weight"], arrays[f"{name}.bias"] = step.folded()
        for name in ("hidden", "head"):
            layer = getattr(network, name)
            arrays[f"{name}.weight"], arrays[f"{name}.bias"] = layer.weight, layer.bias
        return kept(arrays)

    def batch(self, pool: Pool, phase: Phase, rngs: list[np.random.Generator]) -> Batch:
        """Pictures, points and whether there is a face."""
        pictures = np.empty((len(rngs), SIDE, SIDE, 3), np.uint8)
        points = np.empty((len(rngs), POINTS + len(DENSE_POINTS), 2), np.float32)
        is_face = np.empty(len(rngs), np.float32)
        for place, rng in enumerate(rngs):
            made = augmented(pool, int(rng.integers(len(pool))), rng, SIDE, dense=DENSE_POINTS)
            pictures[place], points[place], is_face[place] = made.picture, (*made.points, *made.dense), made.is_face
        return pictures, (points, is_face)

    def loss(self, answers: Float[Tensor, "n k 5"], targets: tuple[Tensor, Tensor]) -> tuple[Tensor, dict[str, float]]:
        points, is_face = targets
        return loss_of(answers, points, is_face)


def places_of(answers: Float[Tensor, "n k 5"]) -> Float[Tensor, "n k 2"]:
    """Pixels of the crop."""
    return (answers[..., :2] + 0.5) * SIDE - 0.5


def loss_of(answers, points, is_face) -> tuple[Tensor, dict[str, float]]:
    """Negative log-likelihood of the true places, those far outside of their covariance counted linearly."""
    read = places_of(answers)
    miss = points - read
    low, high = -np.log(MOST_DEVIATION_PX), -np.log(LEAST_DEVIATION_PX)
    first, second = (answers[..., k].clamp(low, high) for k in (2, 3))
    corner = answers[..., 4]
    whitened = torch.stack([first.exp() * miss[..., 0] + corner * miss[..., 1], second.exp() * miss[..., 1]], dim=-1)
    squared = whitened.square().sum(-1)
    robust = torch.where(squared < ROBUST**2, 0.5 * squared, ROBUST * (squared + 1e-9).sqrt() - 0.5 * ROBUST**2)
    face = is_face[:, None]
    likely = (face * (robust - first - second)).sum() / (face.sum() * points.shape[1])
    upper, lower = (list(side) for side in zip(*OPENINGS, strict=True))
    across = ((read[:, lower] - read[:, upper]) - (points[:, lower] - points[:, upper])).abs().sum(-1)
    loss = likely + OPENING_WEIGHT * (face * across).sum() / (face.sum() * across.shape[1])
    with torch.no_grad():
        far = miss.norm(dim=-1)
        size = (points[:, 45] - points[:, 36]).norm(dim=-1).clamp_min(1e-3)[:, None]
        share = 100 * far / size * face
        inner = share[:, 17:68].sum() / (51 * face.sum())
        dense = share[:, 70:].sum() / ((points.shape[1] - 70) * face.sum())
        inside = ((squared < 1.386) * face).sum() / (face.sum() * points.shape[1])
    numbers = {"loss": loss, "inner_percent": inner, "dense_percent": dense, "inside_half": inside}
    return loss, {name: float(value.detach()) for name, value in numbers.items()}
