"""The landmark network in PyTorch, for training: the twin of `networks.landmark_network`, with batch normalisation."""

from collections.abc import Iterator, Mapping

import numpy as np
import torch
from torch import Tensor, nn

RIGHT_AND_LEFT_EYE = (36, 42)
"""First of the six points around each."""


class ConvNorm(nn.Module):
    """Convolution, batch normalisation, ReLU."""

    def __init__(
        self, channels_in: int, channels_out: int, kernel: int = 3, stride: int = 1, dilation: int = 1
    ) -> None:
        super().__init__()
        margin = dilation * (kernel // 2)
        self.conv = nn.Conv2d(channels_in, channels_out, kernel, stride, margin, dilation, bias=False)
        self.norm = nn.BatchNorm2d(channels_out, momentum=0.05)

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(self.norm(self.conv(x)))

    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight and bias of the one convolution that does the same as convolution and normalisation."""
        factor = self.norm.weight / torch.sqrt(self.norm.running_var + self.norm.eps)
        return self.conv.weight * factor[:, None, None, None], self.norm.bias - self.norm.running_mean * factor


class Residual(nn.Module):
    """x + ReLU(conv(x))."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = ConvNorm(channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv(x)


class TorchEncoder(nn.Module):
    """RGB in 0..1 to features at a quarter of its size, an eighth, a sixteenth and a 32nd."""

    def __init__(self, widths: tuple[int, int, int, int], blocks: int) -> None:
        super().__init__()
        c0, c1, c2, c3 = widths
        self.stem = ConvNorm(3, c0, 7, 4)
        self.e0 = Residual(c0)
        self.d1, self.e1 = ConvNorm(c0, c1, 3, 2), nn.Sequential(Residual(c1), Residual(c1))
        self.d2, self.e2 = ConvNorm(c1, c2, 3, 2), nn.Sequential(Residual(c2), Residual(c2))
        self.d3, self.e3 = ConvNorm(c2, c3, 3, 2), nn.Sequential(*[Residual(c3) for _ in range(blocks)])

    def features(self, picture: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The four levels, the largest first."""
        x0 = self.e0(self.stem((picture - 0.5) / 0.25))
        x1 = self.e1(self.d1(x0))
        x2 = self.e2(self.d2(x1))
        return x0, x1, x2, self.e3(self.d3(x2))


class TorchLandmarkNetwork(TorchEncoder):
    """RGB in 0..1 to maps of a quarter of its size."""

    def __init__(self, widths: tuple[int, int, int, int], blocks: int, outputs: int) -> None:
        super().__init__(widths, blocks)
        c0, c1, c2, c3 = widths
        self.u2, self.f2 = ConvNorm(c3, c2, 1), Residual(c2)
        self.u1, self.f1 = ConvNorm(c2, c1, 1), Residual(c1)
        self.u0, self.f0 = ConvNorm(c1, c0, 1), Residual(c0)
        self.head = nn.Conv2d(c0, outputs, 1)

    def forward(self, picture: Tensor) -> Tensor:
        """Maps of a quarter of the picture's size."""
        x0, x1, x2, x3 = self.features(picture)
        x2 = self.f2(x2 + _twice(self.u2(x3)))
        x1 = self.f1(x1 + _twice(self.u1(x2)))
        x0 = self.f0(x0 + _twice(self.u0(x1)))
        return self.head(x0)


def conv_norms(network: TorchEncoder) -> Iterator[tuple[str, ConvNorm]]:
    """The normalised convolutions, each with the name of its folded one in a weights file."""
    for name, part in network.named_children():
        if isinstance(part, ConvNorm):
            yield name, part
        elif isinstance(part, Residual):
            yield name, part.conv
        elif isinstance(part, nn.Sequential):
            yield from ((f"{name}.{place}", block.conv) for place, block in enumerate(part))


def go_on_from(
    network: TorchLandmarkNetwork, arrays: Mapping[str, np.ndarray], pictures: Tensor, output_scale: float
) -> None:
    """Make the network answer as these folded weights do, with normalisations that fit what `pictures` bring about.

    Where the weights know no pupils and the network does, these begin as the mean of the points around them.
    """
    with torch.no_grad():
        for part, own in (("weight", network.head.weight), ("bias", network.head.bias)):
            rows = _tensor(arrays[f"head.{part}"])
            if len(rows) < len(own):
                around = torch.stack([rows[start : start + 6].mean(0) for start in RIGHT_AND_LEFT_EYE])
                known = f"pupils.{part}"
                rows = torch.cat([rows, _tensor(arrays[known]) if known in arrays else around])
            own.copy_(rows / output_scale)
    take_convolutions(network, arrays, pictures)


def take_convolutions(network: TorchEncoder, arrays: Mapping[str, np.ndarray], pictures: Tensor) -> None:
    """Give the network those of its convolutions that these folded weights name, and each the normalisation that
    leaves its answers on `pictures` as they were."""
    sides = {}
    steps = {name: step for name, step in conv_norms(network) if f"{name}.weight" in arrays}
    with torch.no_grad():
        for name, step in steps.items():
            step.conv.weight.copy_(_tensor(arrays[f"{name}.weight"]))
            step.norm.bias.copy_(_tensor(arrays[f"{name}.bias"]))
            step.norm.running_var.fill_(1.0 - step.norm.eps)
            step.conv.register_forward_hook(_keeper(sides, name))
        network.train(False)
        network(pictures)
        network.train()
        for name, step in steps.items():
            step.conv._forward_hooks.clear()
            mean, variance = sides[name]
            step.norm.running_mean.copy_(mean)
            step.norm.running_var.copy_(variance)
            step.norm.weight.copy_(torch.sqrt(variance + step.norm.eps))
            step.norm.bias.copy_(_tensor(arrays[f"{name}.bias"]) + mean)


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.asarray(array, np.float32))


def _keeper(sides: dict[str, tuple[Tensor, Tensor]], name: str):
    def keep(_module, _inputs, output: Tensor) -> None:
        sides[name] = output.mean((0, 2, 3)), output.var((0, 2, 3))

    return keep


def _twice(x: Tensor) -> Tensor:
    return nn.functional.interpolate(x, scale_factor=2, mode="nearest")
