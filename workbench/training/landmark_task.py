"""The landmark network's task: what a batch is, what is minimised, and which weights are kept."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from workbench.networks.landmark_network import NAME
from workbench.training.augment import augmented
from workbench.training.loop import Batch, MapsTask, Phase
from workbench.training.pool import Pool

BETA = 50.0
"""The soft-argmax factor that the heat maps are trained for (Deep Energies Eq. 3)."""
STRIDE = 4
COORDINATE_WEIGHT = 0.25
"""Weight of the soft-argmax' error in heat-map pixels beside the cross entropy."""
JAW_WEIGHT = 0.5
"""Weight of the jaw's contour, whose points slide along an edge."""


@dataclass(frozen=True)
class LandmarkTask(MapsTask):
    """68 heat maps: softmax of a map is the distribution of its landmark."""

    architecture: str = NAME
    outputs: int = 68
    output_scale: float = 1 / BETA
    """The kept heat maps are the trained logits over β, so that the soft-argmax of Deep Energies reads them."""

    def batch(self, pool: Pool, phase: Phase, rngs: list[np.random.Generator]) -> Batch:
        """Pictures, landmarks and whether there is a face."""
        pictures = np.empty((len(rngs), phase.input_side, phase.input_side, 3), np.uint8)
        landmarks = np.empty((len(rngs), 68, 2), np.float32)
        is_face = np.empty(len(rngs), np.float32)
        for place, rng in enumerate(rngs):
            made = augmented(pool, int(rng.integers(len(pool))), rng, phase.input_side)
            pictures[place], landmarks[place], is_face[place] = made.picture, made.landmarks, made.is_face
        return pictures, (landmarks, is_face)

    def loss(self, maps: Float[Tensor, "n 68 h w"], targets: tuple[Tensor, Tensor]) -> tuple[Tensor, dict[str, float]]:
        """Cross entropy and coordinate loss of the logits, and what the curves show."""
        landmarks, is_face = targets
        return loss_of(maps, (landmarks + 0.5) / STRIDE - 0.5, is_face)


def target_distribution(points: Float[Tensor, "n k 2"], side: int) -> Float[Tensor, "n k cells"]:
    """Where each landmark is, as probabilities over the heat map's pixels; zero rows for points outside of it.

    A landmark is shared out over the four pixels around it, so that their mean place is the landmark: a soft-argmax
    over 3×3 pixels then reads it without a bias, which a Gaussian of one pixel has (up to a quarter of a pixel).
    """
    at = torch.arange(side, dtype=torch.float32, device=points.device)
    across, down = ((1 - (at - points[..., axis, None]).abs()).clamp_min(0) for axis in (0, 1))
    cells = (down[..., :, None] * across[..., None, :]).flatten(2)
    inside = ((points > 0) & (points < side - 1)).all(-1)
    return inside[..., None] * cells


def local_soft_argmax(logits: Float[Tensor, "n 68 h w"]) -> Float[Tensor, "n 68 2"]:
    """Deep Energies Eq. 3 on 50·H: the mean place in the 3×3 patch around the maximum, in heat-map pixels."""
    side = logits.shape[-1]
    best = logits.detach().flatten(2).argmax(-1)
    row, column = best // side, best % side
    reach = torch.arange(-1, 2, device=logits.device)
    rows = (row[..., None] + reach)[..., :, None].expand(*row.shape, 3, 3).flatten(2)
    columns = (column[..., None] + reach)[..., None, :].expand(*row.shape, 3, 3).flatten(2)
    within = (rows >= 0) & (rows < side) & (columns >= 0) & (columns < side)
    cells = rows.clamp(0, side - 1) * side + columns.clamp(0, side - 1)
    local = logits.flatten(2).gather(2, cells).masked_fill(~within, -torch.inf)
    share = torch.softmax(local, dim=-1)
    return (share[..., None] * torch.stack([columns, rows], dim=-1)).sum(2)


def loss_of(
    logits: Float[Tensor, "n 68 h w"], points: Float[Tensor, "n 68 2"], is_face: Float[Tensor, "n"]
) -> tuple[Tensor, dict[str, float]]:
    """Cross entropy to the landmark's distribution (an even one where there is no face) and the soft-argmax' error."""
    side = logits.shape[-1]
    target = target_distribution(points, side)
    known = (target.sum(-1) > 0).float()
    face = is_face[:, None]
    even = torch.full_like(target, 1.0 / side**2)
    target = face[..., None] * target + (1 - face[..., None]) * even
    weight = torch.ones(68, device=logits.device)
    weight[:17] = JAW_WEIGHT
    weight = weight * torch.where(face > 0, known, torch.full_like(known, 0.3))
    entropy = -(target * torch.log_softmax(logits.flatten(2), dim=-1)).sum(-1)
    distance = torch.linalg.vector_norm(local_soft_argmax(logits) - points, dim=-1)
    near = ((distance.detach() < 3.0) * known * face).float()
    coordinate = (
        near * weight * functional.smooth_l1_loss(distance, torch.zeros_like(distance), reduction="none", beta=0.5)
    )
    count = weight.sum().clamp_min(1.0)
    loss = ((weight * entropy).sum() + COORDINATE_WEIGHT * coordinate.sum()) / count
    with torch.no_grad():
        inner = (known * face)[:, 17:]
        size = (points[:, 45] - points[:, 36]).norm(dim=-1).clamp_min(1e-3)[:, None]
        error = 100 * (distance[:, 17:] / size * inner).sum() / inner.sum().clamp_min(1.0)
    return loss, {"loss": float(loss.detach()), "inner_percent": float(error)}
