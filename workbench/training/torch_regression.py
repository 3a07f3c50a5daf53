"""Places by regression in PyTorch, for training: the twin of `networks.regression`, and its Gaussians' likelihood."""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from workbench.landmarks.uncertainty import ellipse_radius
from workbench.networks.regression import LEAST_DEVIATION_PX, MOST_DEVIATION_PX, SMALLEST
from workbench.training.loop import kept
from workbench.training.torch_network import ConvNorm, TorchEncoder, conv_norms, take_convolutions

ROBUST = 3.0
"""Deviations beyond which an error counts linearly: a point behind a hand is no better for pulling harder."""

HALF_SQUARED = ellipse_radius(0.5) ** 2
"""Squared deviations within which half of the truth lies, if the covariances are right."""


class TorchRegression(TorchEncoder):
    """RGB in 0..1, `side` pixels wide, to the last layer's numbers."""

    def __init__(
        self, widths: tuple[int, int, int, int], blocks: int, squeezed: int, hidden: int, outputs: int, side: int
    ) -> None:
        super().__init__(widths, blocks)
        self.squeeze = ConvNorm(widths[-1], squeezed, 1)
        self.hidden = nn.Linear(squeezed * (side // SMALLEST) ** 2, hidden)
        self.head = nn.Linear(hidden, outputs)

    def forward(self, picture: Tensor) -> Tensor:
        """(n, outputs): of a point its place as a share of the side from the middle, log of the precision's diagonal,
        its corner."""
        x = self.squeeze(self.features(picture)[-1]).flatten(1)
        with torch.autocast(picture.device.type, enabled=False):
            # In half precision a coordinate of 256 pixels would be rounded to whole ones.
            return self.head(torch.relu(self.hidden(x.float())))


def regression_arrays(network: TorchRegression) -> dict[str, np.ndarray]:
    """What is kept of a trained one, by the names of `networks.regression`."""
    arrays: dict[str, Tensor] = {}
    for name, step in conv_norms(network):
        arrays[f"{name}.weight"], arrays[f"{name}.bias"] = step.folded()
    for name in ("hidden", "head"):
        layer = getattr(network, name)
        arrays[f"{name}.weight"], arrays[f"{name}.bias"] = layer.weight, layer.bias
    return kept(arrays)


def take_regression(network: TorchRegression, arrays: Mapping[str, np.ndarray], pictures: Tensor) -> None:
    """Make the network answer as these folded weights do, with normalisations that fit what `pictures` bring about."""
    with torch.no_grad():
        for name in ("hidden", "head"):
            for part in ("weight", "bias"):
                getattr(getattr(network, name), part).copy_(
                    torch.from_numpy(arrays[f"{name}.{part}"].astype(np.float32))
                )
    take_convolutions(network, arrays, pictures)


def torch_places(answers: Float[Tensor, "n k 5"], side: int) -> Float[Tensor, "n k 2"]:
    """Pixels of a crop of `side` pixels."""
    return (answers[..., :2] + 0.5) * side - 0.5


def gaussian_cost(
    answers: Float[Tensor, "n k 5"], miss: Float[Tensor, "n k 2"]
) -> tuple[Float[Tensor, "n k"], Float[Tensor, "n k"]]:
    """Negative log-likelihood of being off by `miss` pixels, linear beyond `ROBUST` deviations; and their square."""
    low, high = -np.log(MOST_DEVIATION_PX), -np.log(LEAST_DEVIATION_PX)
    first, second = (answers[..., k].clamp(low, high) for k in (2, 3))
    corner = answers[..., 4]
    whitened = torch.stack([first.exp() * miss[..., 0] + corner * miss[..., 1], second.exp() * miss[..., 1]], dim=-1)
    squared = whitened.square().sum(-1)
    robust = torch.where(squared < ROBUST**2, 0.5 * squared, ROBUST * (squared + 1e-9).sqrt() - 0.5 * ROBUST**2)
    return robust - first - second, squared
