"""A landmark network in bytes: less than half the time of single precision, landmarks a tenth of a pixel away.

What layers pass on is rounded to 256 steps up to the largest value that it had on training pictures
(`LandmarkNetwork.largest`), weights to 127 steps of each output's own size; products are added as whole numbers. The
operations are ONNX Runtime's own, because ONNX's keep channels apart, which costs as much time as bytes save.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.networks.encoder import MIDDLE, SPREAD
from workbench.networks.landmark_network import LandmarkNetwork, all_maps
from workbench.networks.layers import Conv
from workbench.networks.onnx_graph import ANSWER, PICTURE, RUNTIME, OnnxGraph

LARGEST_WEIGHT = 63
"""Weights are whole numbers up to this: of larger ones some processors cannot add two products in 16 bits."""
LARGEST_BYTE, LARGEST_BIAS = 255, 2**30


class Bytes(NamedTuple):
    """A layer's result (1, height, width, channels): the name of its bytes, and the number that they stand for."""

    name: str
    scale: np.float32
    zero: int = 0


class ByteGraph(OnnxGraph):
    """Nodes and weights in the order in which they are added; `largest` is used up layer by layer."""

    def __init__(self, largest: Float[AnyArray, "layers"]) -> None:
        super().__init__()
        self._scales = iter(np.asarray(largest, np.float32) / LARGEST_BYTE)

    def whole(self, *numbers: int) -> str:
        """Sizes or axes; their name."""
        return self.constant(numbers, np.int64)

    def scale_and_zero(self, x: Bytes) -> tuple[str, str]:
        """The names of both."""
        return self.constant(x.scale), self.constant(x.zero, np.uint8)

    def step(self, x: Bytes, conv: Conv) -> Bytes:
        """A convolution; what is negative becomes the byte zero."""
        weight, bias = np.asarray(conv.weight, np.float64), np.asarray(conv.bias, np.float64)
        scale = np.abs(weight).max(axis=(1, 2, 3)) / LARGEST_WEIGHT
        # Where weights vanish beside the bias, it would not fit into 32 bits.
        scale = np.maximum(scale, np.maximum(np.abs(bias) / x.scale, 1e-12) / LARGEST_BIAS)
        rounded = np.rint(weight / scale[:, None, None, None])
        weights = [self.constant(rounded, np.int8), self.constant(scale), self.constant(np.zeros(len(scale)), np.int8)]
        biases = self.constant(np.rint(bias / (scale * x.scale)), np.int32)
        margin, made = conv.dilation * (conv.weight.shape[-1] // 2), next(self._scales)
        name = self.add(
            "QLinearConv", x.name, *self.scale_and_zero(x), *weights, *self.scale_and_zero(Bytes("", made)), biases,
            domain=RUNTIME, channels_last=1, strides=[conv.stride] * 2, dilations=[conv.dilation] * 2,
            pads=[margin] * 4,
        )  # fmt: skip
        return Bytes(name, made)

    def sum(self, x: Bytes, y: Bytes) -> Bytes:
        """Both added; one may have sides of 1 where the other has more."""
        made = next(self._scales)
        of_x, of_y, of_sum = (self.scale_and_zero(each) for each in (x, y, Bytes("", made)))
        name = self.add("QLinearAdd", x.name, *of_x, y.name, *of_y, *of_sum, domain=RUNTIME)
        return Bytes(name, made)

    def residual(self, x: Bytes, *convs: Conv) -> Bytes:
        for conv in convs:
            x = self.sum(x, self.step(x, conv))
        return x

    def decoded(self, x: Bytes, passed: Bytes, up: Conv, conv: Conv) -> Bytes:
        """A decoder's level: what came from below, enlarged, and what the encoder passed."""
        below = self.step(x, up)
        height, width = (self.add("Shape", below.name, start=axis, end=axis + 1) for axis in (1, 2))
        one, two, channels = self.whole(1), self.whole(2), self.whole(conv.weight.shape[1])
        # Every pixel of the lower level is added to four of the upper one.
        fours = self.add("Concat", one, height, two, width, two, channels, axis=0)
        single = self.add("Concat", one, height, one, width, one, channels, axis=0)
        both = self.sum(
            passed._replace(name=self.add("Reshape", passed.name, fours)),
            below._replace(name=self.add("Reshape", below.name, single)),
        )
        like_passed = self.add("Shape", passed.name)
        return self.residual(both._replace(name=self.add("Reshape", both.name, like_passed)), conv)

    def answer(self, x: Bytes, head: Conv) -> None:
        """The last layer, 1×1, in single precision: (1, maps, height, width)."""
        maps, channels = head.weight.shape[:2]
        turned = self.add("Transpose", x.name, perm=[0, 3, 1, 2])
        numbers = self.add("DequantizeLinear", turned, *self.scale_and_zero(x))
        flat = self.add("Reshape", numbers, self.whole(channels, -1))
        product = self.add("MatMul", self.constant(np.asarray(head.weight)[:, :, 0, 0]), flat)
        biased = self.add("Add", product, self.constant(np.asarray(head.bias)[:, None]))
        size = self.add("Concat", self.whole(1, maps), self.add("Shape", x.name, start=1, end=3), axis=0)
        self.add("Reshape", biased, size, result=ANSWER)


def byte_heat_map_graph(network: LandmarkNetwork):
    """The network as an ONNX model, from a picture of bytes to heat maps; its `largest` are known."""
    graph, head = ByteGraph(network.largest), all_maps(network)
    x0 = graph.residual(graph.step(*_seen(network.stem)), network.e0)
    x1 = graph.residual(graph.step(x0, network.d1), *network.e1)
    x2 = graph.residual(graph.step(x1, network.d2), *network.e2)
    x3 = graph.residual(graph.step(x2, network.d3), *network.e3)
    x2 = graph.decoded(x3, x2, network.u2, network.f2)
    x1 = graph.decoded(x2, x1, network.u1, network.f1)
    graph.answer(graph.decoded(x1, x0, network.u0, network.f0), head)
    return graph.model([1, head.weight.shape[0], "h4", "w4"])


def _seen(stem: Conv) -> tuple[Bytes, Conv]:
    """The picture as the first layer takes it, and that layer."""
    unit = np.float32(1 / (LARGEST_BYTE * SPREAD))
    # A byte's zero is a whole number; the rest of the middle goes into the bias.
    zero = round(LARGEST_BYTE * MIDDLE)
    rest = (zero - LARGEST_BYTE * MIDDLE) * unit * np.asarray(stem.weight).sum(axis=(1, 2, 3))
    return Bytes(PICTURE, unit, zero), Conv(stem.weight, stem.bias + rest, stem.stride, stem.dilation)
