"""The landmark network's task: what a batch is, what is minimised, and which weights are kept."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from workbench.networks.landmark_network import LANDMARKS, NAME
from workbench.networks.soft_argmax import BETA
from workbench.training.augment import augmented
from workbench.training.loop import Batch, MapsTask, Phase
from workbench.training.pool import Pool

STRIDE = 4
COORDINATE_WEIGHT = 1.0
"""Weight of the soft-argmax' error in heat-map pixels beside the cross entropy."""
JAW_WEIGHT, EYE_WEIGHT, PUPIL_WEIGHT = 0.5, 1.4, 0.5
"""Weights of the jaw's contour, whose points slide along an edge, of the lids, and of pupils, which lids hide."""
OPENING_WEIGHT = 2.0
"""Weight of the error of eyes' and lips' openings in heat-map pixels: two lids that are both off show no opening."""
OPENINGS = ((37, 41), (38, 40), (43, 47), (44, 46), (61, 67), (62, 66), (63, 65))
"""Points that face each other across an eye or the lips."""
LIDS = slice(36, 48)
POINTS = 70
"""The 68 landmarks and two pupils."""


@dataclass(frozen=True)
class LandmarkTask(MapsTask):
    """70 heat maps: softmax of a map is the distribution of its landmark or pupil."""

    architecture: str = NAME
    outputs: int = POINTS
    output_scale: float = 1 / BETA
    """The kept heat maps are the trained logits over β, so that the soft-argmax of Deep Energies reads them."""
    dense: None = None

    def arrays(self, network: nn.Module) -> dict[str, np.ndarray]:
        """As of all networks of this kind, with the pupils' maps apart from the landmarks'."""
        arrays = super().arrays(network)
        for part in ("weight", "bias"):
            arrays[f"pupils.{part}"] = arrays[f"head.{part}"][LANDMARKS:].copy()
            arrays[f"head.{part}"] = arrays[f"head.{part}"][:LANDMARKS].copy()
        return arrays

    def batch(self, pool: Pool, phase: Phase, rngs: list[np.random.Generator]) -> Batch:
        """Pictures, points and whether there is a face."""
        pictures = np.empty((len(rngs), phase.input_side, phase.input_side, 3), np.uint8)
        points = np.empty((len(rngs), POINTS, 2), np.float32)
        is_face = np.empty(len(rngs), np.float32)
        for place, rng in enumerate(rngs):
            made = augmented(pool, int(rng.integers(len(pool))), rng, phase.input_side)
            pictures[place], points[place], is_face[place] = made.picture, made.points, made.is_face
        return pictures, (points, is_face)

    def loss(self, maps: Float[Tensor, "n 70 h w"], targets: tuple[Tensor, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Cross entropy and coordinate loss of the logits, and what the curves show."""
        points, is_face = targets
        return loss_of(maps, (points + 0.5) / STRIDE - 0.5, is_face)


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


@cache
def openings(device: torch.device) -> tuple[Int[Tensor, "k"], Int[Tensor, "k"]]:
    """`OPENINGS` as indices: the upper points and the lower ones."""
    return tuple(torch.tensor(side, device=device) for side in zip(*OPENINGS, strict=True))


def local_soft_argmax(logits: Float[Tensor, "n k h w"]) -> Float[Tensor, "n k 2"]:
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
    logits: Float[Tensor, "n 70 h w"], points: Float[Tensor, "n 70 2"], is_face: Float[Tensor, "n"]
) -> tuple[Tensor, dict[str, Tensor]]:
    """Cross entropy to the points' distributions (even ones where there is no face), and the soft-argmax' errors."""
    side = logits.shape[-1]
    target = target_distribution(points, side)
    known = (target.sum(-1) > 0).float()
    face = is_face[:, None]
    even = torch.full_like(target, 1.0 / side**2)
    target = face[..., None] * target + (1 - face[..., None]) * even
    weight = torch.ones(POINTS, device=logits.device)
    weight[:17], weight[LIDS], weight[68:] = JAW_WEIGHT, EYE_WEIGHT, PUPIL_WEIGHT
    weight = weight * torch.where(face > 0, known, torch.full_like(known, 0.3))
    entropy = -(target * torch.log_softmax(logits.flatten(2), dim=-1)).sum(-1)
    read = local_soft_argmax(logits)
    distance = torch.linalg.vector_norm(read - points, dim=-1)
    near = ((distance.detach() < 3.0) * known * face).float()
    coordinate = (
        near * weight * functional.smooth_l1_loss(distance, torch.zeros_like(distance), reduction="none", beta=0.5)
    )
    count = weight.sum().clamp_min(1.0)
    upper, lower = openings(logits.device)
    across = (read[:, lower] - read[:, upper]) - (points[:, lower] - points[:, upper])
    opening = near[:, upper] * near[:, lower] * across.abs().sum(-1)
    loss = (weight * entropy).sum() + COORDINATE_WEIGHT * coordinate.sum() + OPENING_WEIGHT * opening.sum()
    loss = loss / count
    with torch.no_grad():
        inner = (known * face)[:, 17:68]
        size = (points[:, 45] - points[:, 36]).norm(dim=-1).clamp_min(1e-3)[:, None]
        error = 100 * (distance[:, 17:68] / size * inner).sum() / inner.sum().clamp_min(1.0)
    return loss, {"loss": loss.detach(), "inner_percent": error}
