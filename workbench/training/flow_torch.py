"""The flow network in PyTorch, for training: the twin of `networks.flow_network`, with batch normalisation."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from workbench.networks.flow_network import DECODER, MATCHED, MIDDLE, REACH, REFINED_REACH, SHARPNESS, SPREAD
from workbench.training.torch_network import ConvNorm, Residual

LEVELS = 4


class Decoder(nn.Module):
    """What changes a level's flow: three convolutions that see ever farther, and the change."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        c0, c1, c2 = DECODER
        self.c0, self.c1, self.c2 = ConvNorm(inputs, c0), ConvNorm(c0, c1, dilation=2), ConvNorm(c1, c2, dilation=4)
        self.out = nn.Conv2d(c2, 2, 3, padding=1)
        nn.init.normal_(self.out.weight, std=1e-3)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """The change of the flow, and the features that it was made of."""
        features = self.c2(self.c1(self.c0(x)))
        return self.out(features).float(), features


class TorchFlowNetwork(nn.Module):
    """Two pictures, six channels in 0..1, to flows from coarse to fine, each in its own pixels."""

    def __init__(self, widths: tuple[int, int, int, int], blocks: int) -> None:
        super().__init__()
        half, last = widths[0] // 2, DECODER[-1]
        self.stem = ConvNorm(3, half, 5, 2)
        inputs = (half, *widths[:-1])
        self.d = nn.ModuleList(ConvNorm(a, b, 3, 2) for a, b in zip(inputs, widths, strict=True))
        self.e = nn.ModuleList(nn.Sequential(*[Residual(width) for _ in range(blocks)]) for width in widths)
        self.m = nn.ModuleList(nn.Conv2d(width, MATCHED, 1) for width in widths)
        cells = (2 * REACH + 1) ** 2
        more = [2 + last] * (LEVELS - 1) + [0]
        self.g = nn.ModuleList(Decoder(cells + width + extra) for width, extra in zip(widths, more, strict=True))
        self.r = Decoder((2 * REFINED_REACH + 1) ** 2 + widths[0] + 2 + last)

    def forward(self, pair: Tensor) -> list[Tensor]:
        """Flows at a 32nd, a 16th, an eighth and twice a quarter of the size."""
        both = (torch.cat([pair[:, :3], pair[:, 3:]]) - MIDDLE) / SPREAD
        both = both.contiguous(memory_format=torch.channels_last)
        x = self.stem(both)
        contexts, matched = [], []
        for down, encode, match in zip(self.d, self.e, self.m, strict=True):
            x = encode(down(x))
            contexts.append(x[: len(pair)])
            matched.append(unit(match(x).float()).chunk(2))
        flows, features = [], None
        flow = torch.zeros_like(contexts[-1][:, :2], dtype=torch.float32)
        for level in reversed(range(LEVELS)):
            if features is not None:
                flow, features = 2 * enlarge(flow), functional.interpolate(features, scale_factor=2, mode="nearest")
            flow, features = step(self.g[level], contexts[level], *matched[level], flow, features, REACH)
            flows.append(flow)
        flow, _ = step(self.r, contexts[0], *matched[0], flow, features, REFINED_REACH)
        return [*flows, flow]


def step(decoder, context, first, second, flow, features, reach):
    """One decoder on the similarities around where the flow so far points to."""
    parts = [context]
    if features is None:
        parts.insert(0, similarities(first, second, reach))
    else:
        flow = flow.detach()
        parts.insert(0, similarities(first, warp(second, flow), reach))
        parts += [flow, features]
    change, features = decoder(torch.cat([part.to(context.dtype) for part in parts], dim=1))
    return flow + change, features


def unit(x: Tensor) -> Tensor:
    """Vectors of length √`SHARPNESS` across the channels: their products do not depend on contrast."""
    return x * torch.rsqrt((x * x).sum(1, keepdim=True) + 1e-6) * SHARPNESS**0.5


def warp(x: Tensor, flow: Tensor) -> Tensor:
    """Maps read bilinearly where the flow points to; zeros beyond the border."""
    height, width = x.shape[2:]
    rows, columns = torch.arange(height, device=x.device), torch.arange(width, device=x.device)
    along = (columns + flow[:, 0]) * (2 / (width - 1)) - 1
    down = (rows[:, None] + flow[:, 1]) * (2 / (height - 1)) - 1
    return functional.grid_sample(x, torch.stack([along, down], dim=-1), align_corners=True)


def similarities(first: Tensor, second: Tensor, reach: int) -> Tensor:
    """Products of each vector with those around its place in the second maps, row by row from the upper left."""
    number, _, height, width = first.shape
    a = first.permute(0, 2, 3, 1)
    b = functional.pad(second, (reach,) * 4).permute(0, 2, 3, 1).transpose(-1, -2).contiguous()
    rows = []
    for down in range(2 * reach + 1):
        products = torch.matmul(a, b[:, down : down + height])
        # Row i holds all products with that row; columns i to i + 2·reach are wanted, which padding brings in line.
        flat = functional.pad(products.flatten(2), (0, width))
        rows.append(flat.view(number, height, width, width + 2 * reach + 1)[..., : 2 * reach + 1])
    return torch.cat(rows, dim=-1).permute(0, 3, 1, 2)


def enlarge(x: Tensor, factor: int = 2) -> Tensor:
    """Bilinear, pixel edges kept."""
    return functional.interpolate(x, scale_factor=factor, mode="bilinear", align_corners=False)


def folded_flow_arrays(network: TorchFlowNetwork) -> dict[str, Tensor]:
    """The inference network's arrays by name, normalisation folded."""
    arrays: dict[str, Tensor] = {}

    def keep(name: str, conv: ConvNorm) -> None:
        arrays[f"{name}.weight"], arrays[f"{name}.bias"] = conv.folded()

    keep("stem", network.stem)
    for level in range(LEVELS):
        keep(f"d.{level}", network.d[level])
        for place, block in enumerate(network.e[level]):
            keep(f"e.{level}.{place}", block.conv)
        arrays[f"m.{level}.weight"], arrays[f"m.{level}.bias"] = network.m[level].weight, network.m[level].bias
    for name, decoder in [*((f"g.{k}", decoder) for k, decoder in enumerate(network.g)), ("r", network.r)]:
        for part in ("c0", "c1", "c2"):
            keep(f"{name}.{part}", getattr(decoder, part))
        arrays[f"{name}.out.weight"], arrays[f"{name}.out.bias"] = decoder.out.weight, decoder.out.bias
    return arrays
