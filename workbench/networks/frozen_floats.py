"""A network in single precision, as ONNX's own operations compute it: its answers up to rounding."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt8
from onnx import TensorProto

from workbench.networks.encoder import MIDDLE, SPREAD
from workbench.networks.landmark_network import LandmarkNetwork
from workbench.networks.layers import Conv
from workbench.networks.network_graph import NetworkGraph
from workbench.networks.onnx_graph import ANSWER, PICTURE, session_of
from workbench.networks.regression import Linear, Regression

NOT_CUT_OFF = 0.75
"""Share of the pictures in which a network in bytes cuts off nothing that a layer passes on."""


class FloatGraph(NetworkGraph[str]):
    """Results (1, channels, height, width) are known by their names; the largest number of each can be told."""

    def __init__(self, tell_largest: bool = False) -> None:
        super().__init__()
        self._tell_largest = tell_largest

    def seen(self, stem: Conv) -> tuple[str, Conv]:
        # Turned as bytes and divided within the stem's weights: a pass over the whole picture takes as long as a layer.
        channels = self.add("Cast", self.add("Transpose", PICTURE, perm=[0, 3, 1, 2]), to=TensorProto.FLOAT)
        return self.add("Sub", channels, self.constant(255 * MIDDLE)), replace(
            stem, weight=stem.weight / (255 * SPREAD)
        )

    def step(self, x: str, conv: Conv) -> str:
        return self._passed(self.add("Relu", self._conv(x, conv)))

    def sum(self, x: str, y: str) -> str:
        return self._passed(self.add("Add", x, y))

    def sum_with_enlarged(self, x: str, below: str) -> str:
        way = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
        return self.sum(x, self.add("Resize", below, "", self.constant([1, 1, 2, 2]), **way))

    def maps(self, x: str, head: Conv) -> None:
        self._conv(x, head, ANSWER)

    def numbers(self, x: str, squeeze: Conv, hidden: Linear, head: Linear) -> None:
        squeezed = self.add("Flatten", self.add("Relu", self._conv(x, squeeze)))
        inner = self.add("Relu", self._linear(squeezed, hidden))
        self._linear(inner, head, ANSWER)

    def _conv(self, x: str, conv: Conv, result: str | None = None) -> str:
        margin = conv.dilation * (conv.weight.shape[-1] // 2)
        weights = [self.constant(conv.weight), self.constant(conv.bias)]
        sizes = {"strides": [conv.stride] * 2, "dilations": [conv.dilation] * 2, "pads": [margin] * 4}
        return self.add("Conv", x, *weights, result=result, **sizes)

    def _linear(self, x: str, layer: Linear, result: str | None = None) -> str:
        return self.add("Gemm", x, self.constant(layer.weight), self.constant(layer.bias), result=result, transB=1)

    def _passed(self, x: str) -> str:
        if self._tell_largest:
            self.told.append(self.add("ReduceMax", x, keepdims=0))
        return x


def largest_passed(
    network: LandmarkNetwork | Regression, pictures: Iterable[UInt8[np.ndarray, "h w 3"]]
) -> Float[np.ndarray, "layers"]:
    """The largest number that each layer passes on in three of four of these pictures, for the network's `largest`.

    The few larger ones are cut off: a scale that spares them rounds all others more coarsely.
    """
    graph = FloatGraph(tell_largest=True)
    model = graph.regression(network) if isinstance(network, Regression) else graph.heat_maps(network)
    session = session_of(model)
    passed = [session.run(graph.told, {PICTURE: picture[None]}) for picture in pictures]
    return np.quantile(passed, NOT_CUT_OFF, axis=0)
