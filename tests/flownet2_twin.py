"""FlowNet2 as NVIDIA's flownet2-pytorch has it, written anew in PyTorch with the same names: the importer's oracle."""

import torch
from torch import Tensor, nn
from torch.nn import functional


def conv(inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2), nn.LeakyReLU(0.1))


def deconv(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.ConvTranspose2d(inputs, outputs, 4, 2, 1), nn.LeakyReLU(0.1))


def between(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, 1, 1))


def flow_of(inputs: int) -> nn.Conv2d:
    return nn.Conv2d(inputs, 2, 3, 1, 1)


def doubling(bias: bool = True) -> nn.ConvTranspose2d:
    return nn.ConvTranspose2d(2, 2, 4, 2, 1, bias=bias)


class Coarse(nn.Module):
    """What FlowNetC, S and SD share: levels 4 to 6, and the decoder without its flows."""

    def __init__(self, w: int) -> None:
        super().__init__()
        self.conv4, self.conv4_1 = conv(4 * w, 8 * w, stride=2), conv(8 * w, 8 * w)
        self.conv5, self.conv5_1 = conv(8 * w, 8 * w, stride=2), conv(8 * w, 8 * w)
        self.conv6, self.conv6_1 = conv(8 * w, 16 * w, stride=2), conv(16 * w, 16 * w)
        self.deconv5, self.deconv4 = deconv(16 * w, 8 * w), deconv(16 * w + 2, 4 * w)
        self.deconv3, self.deconv2 = deconv(12 * w + 2, 2 * w), deconv(6 * w + 2, w)

    def finest(self, two: Tensor, three: Tensor) -> Tensor:
        """The flow at a quarter of the size, from the encoder's maps at levels 2 and 3."""
        four = self.conv4_1(self.conv4(three))
        five = self.conv5_1(self.conv5(four))
        x = self.conv6_1(self.conv6(five))
        flow = self.predict_flow6(x)
        x = torch.cat([five, self.deconv5(x), self.upsampled_flow6_to_5(flow)], dim=1)
        flow = self.predict_flow5(self.seen(5, x))
        x = torch.cat([four, self.deconv4(x), self.upsampled_flow5_to_4(flow)], dim=1)
        flow = self.predict_flow4(self.seen(4, x))
        x = torch.cat([three, self.deconv3(x), self.upsampled_flow4_to_3(flow)], dim=1)
        flow = self.predict_flow3(self.seen(3, x))
        x = torch.cat([two, self.deconv2(x), self.upsampled_flow3_to_2(flow)], dim=1)
        return self.predict_flow2(self.seen(2, x))

    def seen(self, level: int, x: Tensor) -> Tensor:
        return x

    def add_flows(self, w: int, bias: bool) -> None:
        self.predict_flow6, self.predict_flow5 = flow_of(16 * w), flow_of(16 * w + 2)
        self.predict_flow4, self.predict_flow3 = flow_of(12 * w + 2), flow_of(6 * w + 2)
        self.predict_flow2 = flow_of(3 * w + 2)
        self.upsampled_flow6_to_5, self.upsampled_flow5_to_4 = doubling(bias), doubling(bias)
        self.upsampled_flow4_to_3, self.upsampled_flow3_to_2 = doubling(bias), doubling(bias)


class FlowNetC(Coarse):
    def __init__(self, w: int) -> None:
        super().__init__(w)
        self.conv1, self.conv2 = conv(3, w, 7, 2), conv(w, 2 * w, 5, 2)
        self.conv3, self.conv_redir = conv(2 * w, 4 * w, 5, 2), conv(4 * w, w // 2, 1)
        self.conv3_1 = conv(w // 2 + 441, 4 * w)
        self.add_flows(w, bias=True)

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        two = self.conv2(self.conv1(first))
        one, other = self.conv3(two), self.conv3(self.conv2(self.conv1(second)))
        costs = functional.leaky_relu(correlation(one, other), 0.1)
        return self.finest(two, self.conv3_1(torch.cat([self.conv_redir(one), costs], dim=1)))


class FlowNetS(Coarse):
    def __init__(self, w: int) -> None:
        super().__init__(w)
        self.conv1, self.conv2 = conv(12, w, 7, 2), conv(w, 2 * w, 5, 2)
        self.conv3, self.conv3_1 = conv(2 * w, 4 * w, 5, 2), conv(4 * w, 4 * w)
        self.add_flows(w, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        two = self.conv2(self.conv1(x))
        return self.finest(two, self.conv3_1(self.conv3(two)))


class FlowNetSD(Coarse):
    def __init__(self, w: int) -> None:
        super().__init__(w)
        self.conv0 = conv(6, w)
        self.conv1, self.conv1_1 = conv(w, w, stride=2), conv(w, 2 * w)
        self.conv2, self.conv2_1 = conv(2 * w, 2 * w, stride=2), conv(2 * w, 2 * w)
        self.conv3, self.conv3_1 = conv(2 * w, 4 * w, stride=2), conv(4 * w, 4 * w)
        self.inter_conv5, self.inter_conv4 = between(16 * w + 2, 8 * w), between(12 * w + 2, 4 * w)
        self.inter_conv3, self.inter_conv2 = between(6 * w + 2, 2 * w), between(3 * w + 2, w)
        self.predict_flow6, self.predict_flow5 = flow_of(16 * w), flow_of(8 * w)
        self.predict_flow4, self.predict_flow3, self.predict_flow2 = flow_of(4 * w), flow_of(2 * w), flow_of(w)
        self.upsampled_flow6_to_5, self.upsampled_flow5_to_4 = doubling(), doubling()
        self.upsampled_flow4_to_3, self.upsampled_flow3_to_2 = doubling(), doubling()

    def seen(self, level: int, x: Tensor) -> Tensor:
        return getattr(self, f"inter_conv{level}")(x)

    def forward(self, x: Tensor) -> Tensor:
        two = self.conv2_1(self.conv2(self.conv1_1(self.conv1(self.conv0(x)))))
        return self.finest(two, self.conv3_1(self.conv3(two)))


class FlowNetFusion(nn.Module):
    def __init__(self, w: int) -> None:
        super().__init__()
        self.conv0 = conv(11, w)
        self.conv1, self.conv1_1 = conv(w, w, stride=2), conv(w, 2 * w)
        self.conv2, self.conv2_1 = conv(2 * w, 2 * w, stride=2), conv(2 * w, 2 * w)
        self.deconv1, self.deconv0 = deconv(2 * w, w // 2), deconv(2 * w + w // 2 + 2, w // 4)
        self.inter_conv1 = between(2 * w + w // 2 + 2, w // 2)
        self.inter_conv0 = between(w + w // 4 + 2, w // 4)
        self.predict_flow2, self.predict_flow1, self.predict_flow0 = flow_of(2 * w), flow_of(w // 2), flow_of(w // 4)
        self.upsampled_flow2_to_1, self.upsampled_flow1_to_0 = doubling(), doubling()

    def forward(self, x: Tensor) -> Tensor:
        full = self.conv0(x)
        half = self.conv1_1(self.conv1(full))
        x = self.conv2_1(self.conv2(half))
        flow = self.predict_flow2(x)
        x = torch.cat([half, self.deconv1(x), self.upsampled_flow2_to_1(flow)], dim=1)
        flow = self.predict_flow1(self.inter_conv1(x))
        x = torch.cat([full, self.deconv0(x), self.upsampled_flow1_to_0(flow)], dim=1)
        return self.predict_flow0(self.inter_conv0(x))


class FlowNet2Twin(nn.Module):
    """`forward` takes two pictures in 0..255 and gives what each part says, at their size."""

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        self.flownetc, self.flownets_1, self.flownets_2 = FlowNetC(width), FlowNetS(width), FlowNetS(width)
        self.flownets_d, self.flownetfusion = FlowNetSD(width), FlowNetFusion(width)

    def forward(self, first: Tensor, second: Tensor) -> dict[str, Tensor]:
        both = torch.stack([first, second], dim=2)
        mean = both.flatten(2).mean(dim=2)[:, :, None, None]
        first, second = (first - mean) / 255, (second - mean) / 255
        flows = {"flownetc": smoothly(20 * self.flownetc(first, second))}
        corrected = self.flownets_1(self.beside(first, second, flows["flownetc"]))
        flows["flownets_1"] = smoothly(20 * corrected)
        corrected = self.flownets_2(self.beside(first, second, flows["flownets_1"]))
        flows["flownets_2"] = functional.interpolate(20 * corrected, scale_factor=4, mode="nearest")
        small = self.flownets_d(torch.cat([first, second], dim=1)) / 20
        flows["flownets_d"] = functional.interpolate(small, scale_factor=4, mode="nearest")
        two = [flows["flownets_d"], flows["flownets_2"]]
        errors = [norm(first - warp(second, flow)) for flow in two]
        flows["flownetfusion"] = self.flownetfusion(torch.cat([first, *two, *map(norm, two), *errors], dim=1))
        return flows

    @staticmethod
    def beside(first: Tensor, second: Tensor, flow: Tensor) -> Tensor:
        there = warp(second, flow)
        return torch.cat([first, second, there, flow / 20, norm(first - there)], dim=1)


def smoothly(flow: Tensor) -> Tensor:
    return functional.interpolate(flow, scale_factor=4, mode="bilinear", align_corners=False)


def norm(x: Tensor) -> Tensor:
    return x.norm(dim=1, keepdim=True)


def correlation(first: Tensor, second: Tensor) -> Tensor:
    height, width = first.shape[2:]
    padded = functional.pad(second, [20, 20, 20, 20])
    places = [(down, right) for down in range(0, 41, 2) for right in range(0, 41, 2)]
    shifted = [padded[:, :, down : down + height, right : right + width] for down, right in places]
    return torch.stack([(first * there).mean(dim=1) for there in shifted], dim=1)


def warp(picture: Tensor, flow: Tensor) -> Tensor:
    height, width = picture.shape[2:]
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    x = 2 * (columns + flow[:, 0]) / (width - 1) - 1
    y = 2 * (rows + flow[:, 1]) / (height - 1) - 1
    return functional.grid_sample(picture, torch.stack([x, y], dim=-1), padding_mode="border", align_corners=True)
