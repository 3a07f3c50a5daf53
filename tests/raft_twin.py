"""torchvision's `raft_small` written anew in PyTorch, with the same names: the importer's oracle."""

import torch
from torch import Tensor, nn
from torch.nn import functional


def layer(inputs: int, outputs: int, kernel: int, stride: int = 1, norm: bool = False, relu: bool = True):
    parts: list[nn.Module] = [nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2)]
    if norm:
        parts.append(nn.InstanceNorm2d(outputs))
    if relu:
        parts.append(nn.ReLU())
    return nn.Sequential(*parts)


class Bottleneck(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int, norm: bool) -> None:
        super().__init__()
        inner = outputs // 4
        self.convnormrelu1 = layer(inputs, inner, 1, norm=norm)
        self.convnormrelu2 = layer(inner, inner, 3, stride, norm=norm)
        self.convnormrelu3 = layer(inner, outputs, 1, norm=norm)
        self.downsample = nn.Identity() if stride == 1 else layer(inputs, outputs, 1, stride, norm, relu=False)

    def forward(self, x: Tensor) -> Tensor:
        y = self.convnormrelu3(self.convnormrelu2(self.convnormrelu1(x)))
        return torch.relu(self.downsample(x) + y)


class Encoder(nn.Module):
    def __init__(self, outputs: int, norm: bool) -> None:
        super().__init__()
        self.convnormrelu = layer(3, 32, 7, 2, norm=norm)
        self.layer1 = nn.Sequential(Bottleneck(32, 32, 1, norm), Bottleneck(32, 32, 1, norm))
        self.layer2 = nn.Sequential(Bottleneck(32, 64, 2, norm), Bottleneck(64, 64, 1, norm))
        self.layer3 = nn.Sequential(Bottleneck(64, 96, 2, norm), Bottleneck(96, 96, 1, norm))
        self.conv = nn.Conv2d(96, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        return self.conv(self.layer3(self.layer2(self.layer1(self.convnormrelu(x)))))


class MotionEncoder(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.convcorr1 = layer(196, 96, 1)
        self.convflow1 = layer(2, 64, 7)
        self.convflow2 = layer(64, 32, 3)
        self.conv = layer(128, 80, 3)

    def forward(self, flow: Tensor, products: Tensor) -> Tensor:
        both = torch.cat([self.convcorr1(products), self.convflow2(self.convflow1(flow))], dim=1)
        return torch.cat([self.conv(both), flow], dim=1)


class Gru(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.convz, self.convr, self.convq = (nn.Conv2d(96 + 64 + 82, 96, 3, padding=1) for _ in range(3))

    def forward(self, h: Tensor, x: Tensor) -> Tensor:
        hx = torch.cat([h, x], dim=1)
        z, r = torch.sigmoid(self.convz(hx)), torch.sigmoid(self.convr(hx))
        return (1 - z) * h + z * torch.tanh(self.convq(torch.cat([r * h, x], dim=1)))


class FlowHead(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.conv1, self.conv2 = nn.Conv2d(96, 128, 3, padding=1), nn.Conv2d(128, 2, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return self.conv2(torch.relu(self.conv1(x)))


class RecurrentBlock(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.convgru1 = Gru()


class UpdateBlock(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.motion_encoder, self.recurrent_block, self.flow_head = MotionEncoder(), RecurrentBlock(), FlowHead()

    def forward(self, state: Tensor, context: Tensor, products: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
        x = torch.cat([context, self.motion_encoder(flow, products)], dim=1)
        state = self.recurrent_block.convgru1(state, x)
        return state, self.flow_head(state)


class RaftTwin(nn.Module):
    """`forward` gives the flow after each update, enlarged to the picture's size."""

    def __init__(self) -> None:
        super().__init__()
        self.feature_encoder, self.context_encoder = Encoder(128, norm=True), Encoder(160, norm=False)
        self.update_block = UpdateBlock()

    def forward(self, first: Tensor, second: Tensor, updates: int) -> list[Tensor]:
        one, two = self.feature_encoder(torch.cat([first, second])).chunk(2)
        number, channels, height, width = one.shape
        products = one.flatten(2).transpose(1, 2) @ two.flatten(2) / channels**0.5
        pyramid = [products.reshape(number * height * width, 1, height, width)]
        for _ in range(3):
            pyramid.append(functional.avg_pool2d(pyramid[-1], 2))
        state, context = self.context_encoder(first).split([96, 64], dim=1)
        state, context = torch.tanh(state), torch.relu(context)
        rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        start = torch.stack([columns, rows]).float()[None]
        flow, flows = torch.zeros_like(start), []
        for _ in range(updates):
            state, change = self.update_block(state, context, self.around(pyramid, start + flow), flow)
            flow = flow + change
            flows.append(8 * functional.interpolate(flow, scale_factor=8, mode="bilinear", align_corners=True))
        return flows

    @staticmethod
    def around(pyramid: list[Tensor], target: Tensor) -> Tensor:
        _, _, height, width = target.shape
        centre = target.permute(0, 2, 3, 1).reshape(-1, 1, 1, 2)
        reach = torch.arange(-3.0, 4.0)
        delta = torch.stack(torch.meshgrid(reach, reach, indexing="ij"), dim=-1)[None]
        found = []
        for level, products in enumerate(pyramid):
            sides = torch.tensor([products.shape[3] - 1, products.shape[2] - 1])
            grid = 2 * (centre / 2**level + delta) / sides - 1
            read = functional.grid_sample(products, grid, align_corners=True)
            found.append(read.view(1, height, width, -1))
        return torch.cat(found, dim=-1).permute(0, 3, 1, 2)
