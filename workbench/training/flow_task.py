"""The flow network's task: what a batch of pairs is, what is minimised, and which weights are kept."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from workbench.networks.flow_network import NAME, STRIDE
from workbench.training.flow_augment import augmented_pair
from workbench.training.flow_pool import PairPool, open_pair_pool
from workbench.training.flow_torch import TorchFlowNetwork, enlarge, folded_flow_arrays
from workbench.training.loop import Batch, Phase, TrainingPlan, kept

LEVEL_FACTORS = (32, 16, 8, 4)
"""Pixels of a picture across one of each level's, from coarse to fine."""
LEVEL_WEIGHTS = (0.06, 0.08, 0.12, 0.24)
"""Of their errors beside the error of the final flow."""
EXPONENT, SOFTENING_PX = 0.7, 0.05
"""The cost of an error of e pixels is about e^0.7: what cannot be matched should not rule what can."""
HIDDEN_WEIGHT, FACE_WEIGHT = 0.25, 2.0


@dataclass(frozen=True)
class FlowTask:
    """Flow from the first to the second picture."""

    architecture: str = NAME

    def open(self, folder: Path, pictures: int | None) -> PairPool:
        """The pool that batches are made of."""
        return open_pair_pool(folder, pictures)

    def network(self, plan: TrainingPlan) -> nn.Module:
        """An untrained one."""
        return TorchFlowNetwork(plan.widths, plan.blocks)

    def arrays(self, network: nn.Module) -> dict[str, np.ndarray]:
        """What is kept of a trained one."""
        return kept(folded_flow_arrays(network))

    def batch(self, pool: PairPool, phase: Phase, rngs: list[np.random.Generator]) -> Batch:
        """Pairs (six channels), true flow, weights of the pixels, and where the faces are."""
        side = phase.input_side
        pictures = np.empty((len(rngs), side, side, 6), np.uint8)
        flow = np.empty((len(rngs), side, side, 2), np.float32)
        weight, face = (np.empty((len(rngs), side, side), np.float32) for _ in range(2))
        for place, rng in enumerate(rngs):
            pair = augmented_pair(pool, int(rng.integers(len(pool))), rng, side)
            pictures[place] = np.concatenate([pair.first, pair.second], axis=-1)
            flow[place], face[place] = pair.flow, pair.face & pair.visible & pair.known
            seen = np.where(pair.visible, 1.0, HIDDEN_WEIGHT)
            weight[place] = pair.known * seen * np.where(pair.face, FACE_WEIGHT, 1.0)
        return pictures, (flow, weight, face)

    def loss(self, flows: list[Tensor], targets: tuple[Tensor, ...]) -> tuple[Tensor, dict[str, Tensor]]:
        """The final flow's error and those of all levels, in pixels of the picture."""
        flow, weight, face = targets
        truth, weight = flow.permute(0, 3, 1, 2), weight[:, None]
        final = STRIDE * enlarge(flows[-1], STRIDE)
        loss = cost(final, truth, weight)
        for estimate, factor, share in zip(flows, LEVEL_FACTORS, LEVEL_WEIGHTS, strict=False):
            pooled = functional.avg_pool2d(weight, factor)
            mean = functional.avg_pool2d(truth * weight, factor) / pooled.clamp_min(1e-6)
            loss = loss + share * cost(factor * estimate, mean, pooled)
        with torch.no_grad():
            error = torch.linalg.vector_norm(final - truth, dim=1)
            numbers = {
                "loss": loss.detach(),
                "all_px": (error * weight[:, 0]).sum() / weight.sum().clamp_min(1.0),
                "face_px": (error * face).sum() / face.sum().clamp_min(1.0),
            }
        return loss, numbers


def cost(flow: Float[Tensor, "n 2 h w"], truth: Float[Tensor, "n 2 h w"], weight: Float[Tensor, "n 1 h w"]) -> Tensor:
    """Weighted mean of (|error|² + ε²)^(q/2)."""
    squared = ((flow - truth) ** 2).sum(1, keepdim=True) + SOFTENING_PX**2
    return (weight * squared ** (EXPONENT / 2)).sum() / weight.sum().clamp_min(1e-3)
