"""A network in bytes: less than half the time of single precision, points a fraction of a pixel away.

What layers pass on is rounded to 256 steps up to the largest value that it had on most training pictures (the network's
`largest`), weights to 127 steps of each output's own size; products are added as whole numbers. The operations are ONNX
Runtime's own, because ONNX's keep channels apart, which costs as much time as bytes save.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.networks.encoder import MIDDLE, SPREAD
from workbench.networks.layers import Conv
from workbench.networks.network_graph import NetworkGraph
from workbench.networks.onnx_graph import ANSWER, PICTURE, RUNTIME
from workbench.networks.regression import Linear

LARGEST_WEIGHT = 63
"""Weights are whole numbers up to this: of larger ones some processors cannot add two products in 16 bits."""
LARGEST_BYTE, LARGEST_BIAS = 255, 2**30


class Bytes(NamedTuple):
    """A layer's result (1, height, width, channels): the name of its bytes, and the number that they stand for."""

    name: str
    scale: np.float32
    zero: int = 0


class ByteGraph(NetworkGraph[Bytes]):
    """Results (1, height, width, channels); `largest` is used up layer by layer."""

    def __init__(self, largest: Float[AnyArray, "layers"]) -> None:
        super().__init__()
        self._scales = iter(np.asarray(largest, np.float32) / LARGEST_BYTE)

    def seen(self, stem: Conv) -> tuple[Bytes, Conv]:
        unit = np.float32(1 / (LARGEST_BYTE * SPREAD))
        # A byte's zero is a whole number; the rest of the middle goes into the bias.
        zero = round(LARGEST_BYTE * MIDDLE)
        rest = (zero - LARGEST_BYTE * MIDDLE) * unit * np.asarray(stem.weight).sum(axis=(1, 2, 3))
        return Bytes(PICTURE, unit, zero), Conv(stem.weight, stem.bias + rest, stem.stride, stem.dilation)

    def step(self, x: Bytes, conv: Conv) -> Bytes:
        weight, bias = np.asarray(conv.weight, np.float64), np.asarray(conv.bias, np.float64)
        scale = np.abs(weight).max(axis=(1, 2, 3)) / LARGEST_WEIGHT
        # Where weights vanish beside the bias, it would not fit into 32 bits.
        scale = np.maximum(scale, np.maximum(np.abs(bias) / x.scale, 1e-12) / LARGEST_BIAS)
        rounded = np.rint(weight / scale[:, None, None, None])
        weights = [self.constant(rounded, np.int8), self.constant(scale), self.constant(np.zeros(len(scale)), np.int8)]
        biases = self.constant(np.rint(bias / (scale * x.scale)), np.int32)
        margin, made = conv.dilation * (conv.weight.shape[-1] // 2), next(self._scales)
        name = self.add(
            "QLinearConv", x.name, *self._scale_and_zero(x), *weights, *self._scale_and_zero(Bytes("", made)), biases,
            domain=RUNTIME, channels_last=1, strides=[conv.stride] * 2, dilations=[conv.dilation] * 2,
            pads=[margin] * 4,
        )  # fmt: skip
        return Bytes(name, made)

    def sum(self, x: Bytes, y: Bytes) -> Bytes:
        made = next(self._scales)
        of_x, of_y, of_sum = (self._scale_and_zero(each) for each in (x, y, Bytes("", made)))
        name = self.add("QLinearAdd", x.name, *of_x, y.name, *of_y, *of_sum, domain=RUNTIME)
        return Bytes(name, made)

    def sum_with_enlarged(self, x: Bytes, below: Bytes) -> Bytes:
        height, width = (self.add("Shape", below.name, start=axis, end=axis + 1) for axis in (1, 2))
        one, two, channels = self._whole(1), self._whole(2), self.add("Shape", below.name, start=3, end=4)
        # Every pixel of the lower level is added to four of the upper one.
        fours = self.add("Concat", one, height, two, width, two, channels, axis=0)
        single = self.add("Concat", one, height, one, width, one, channels, axis=0)
        both = self.sum(
            x._replace(name=self.add("Reshape", x.name, fours)),
            below._replace(name=self.add("Reshape", below.name, single)),
        )
        return both._replace(name=self.add("Reshape", both.name, self.add("Shape", x.name)))

    def maps(self, x: Bytes, head: Conv) -> None:
        """In single precision."""
        size = self.add("Concat", self._whole(1, len(head.bias)), self.add("Shape", x.name, start=1, end=3), axis=0)
        self.add("Reshape", self._mixed(x, head), size, result=ANSWER)

    def numbers(self, x: Bytes, squeeze: Conv, hidden: Linear, head: Linear) -> None:
        """In single precision but for the hidden layer, most of whose time goes into reading its weights."""
        squeezed = self.add("Reshape", self.add("Relu", self._mixed(x, squeeze)), self._whole(1, -1))
        inner = self.add("Relu", self._of_floats(squeezed, hidden))
        self.add("Gemm", inner, self.constant(head.weight), self.constant(head.bias), result=ANSWER, transB=1)

    def _mixed(self, x: Bytes, conv: Conv) -> str:
        """A convolution, 1×1, in single precision: (channels, pixels)."""
        turned = self.add("Transpose", x.name, perm=[0, 3, 1, 2])
        numbers = self.add("DequantizeLinear", turned, *self._scale_and_zero(x))
        flat = self.add("Reshape", numbers, self._whole(conv.weight.shape[1], -1))
        product = self.add("MatMul", self.constant(np.asarray(conv.weight)[:, :, 0, 0]), flat)
        return self.add("Add", product, self.constant(np.asarray(conv.bias)[:, None]))

    def _of_floats(self, x: str, layer: Linear) -> str:
        """A fully connected layer of numbers in single precision, which become bytes up to their own largest."""
        scale = np.maximum(np.abs(layer.weight).max(axis=1), 1e-12) / LARGEST_WEIGHT
        rounded = self.constant(np.rint(layer.weight / scale[:, None]).T, np.int8)
        zero = self.constant(np.zeros(len(scale)), np.int8)
        inputs = x, rounded, self.constant(scale), zero, self.constant(layer.bias)
        return self.add("DynamicQuantizeMatMul", *inputs, domain=RUNTIME)

    def _scale_and_zero(self, x: Bytes) -> tuple[str, str]:
        return self.constant(x.scale), self.constant(x.zero, np.uint8)

    def _whole(self, *numbers: int) -> str:
        """Sizes or axes; their name."""
        return self.constant(numbers, np.int64)
