"""Networks whose weights stay as they are, for detectors: no derivatives, and half the processor time of JAX.

The same layers as in `LandmarkNetwork.__call__`, written as an ONNX graph that ONNX Runtime runs, in single precision
or in bytes (`frozen_bytes.py`). Where a derivative is needed, as in Deep Energies, the network itself runs.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt8
from onnx import TensorProto

from workbench.networks.dense_network import SIDE, DenseNetwork
from workbench.networks.encoder import MIDDLE, SPREAD, Encoder
from workbench.networks.eye_network import EyeNetwork, EyePlaces, eye_places
from workbench.networks.frozen_bytes import byte_heat_map_graph
from workbench.networks.landmark_network import LandmarkNetwork, all_maps
from workbench.networks.layers import Conv
from workbench.networks.onnx_graph import ANSWER, PICTURE, OnnxGraph, runner, session_of
from workbench.networks.regression import Linear, Places, Regression, places_of


class FrozenNetwork:
    """A landmark network, or another of its kind, as ONNX Runtime runs it; may be called from several threads."""

    def __init__(self, network: LandmarkNetwork) -> None:
        model = _heat_map_graph(network) if network.largest is None else byte_heat_map_graph(network)
        self._run = runner(model)

    def __call__(self, picture: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "n h4 w4"]:
        """Heat maps of a quarter of the picture's size, which are `network(picture / 255)` up to rounding.

        In bytes, where `network.largest` is known, landmarks are a tenth of a pixel from the network's in the median.
        Where the network knows pupils, the maps of the person's right and left one follow the others.
        Height and width are multiples of 32 pixels.
        """
        return self._run(picture)


class FrozenDenseNetwork:
    """A dense network as ONNX Runtime runs it; may be called from several threads."""

    def __init__(self, network: DenseNetwork) -> None:
        self._answer = _regression(network)

    def __call__(self, picture: UInt8[np.ndarray, "256 256 3"]) -> Places:
        """Points in the picture's pixels and their whitening: `network(picture / 255)` up to rounding."""
        numbers, factor = self._answer(picture)
        return places_of(numbers, SIDE, factor)


class FrozenEyeNetwork:
    """An eye network as ONNX Runtime runs it; may be called from several threads."""

    def __init__(self, network: EyeNetwork) -> None:
        self._answer = _regression(network)

    def __call__(self, picture: UInt8[np.ndarray, "64 64 3"]) -> EyePlaces:
        """Pupil and iris of a right eye, and whether it is open: `network(picture / 255)` up to rounding."""
        return eye_places(*self._answer(picture))


def _regression(network: Regression) -> Callable[[UInt8[np.ndarray, "s s 3"]], tuple[np.ndarray, np.ndarray | None]]:
    """A picture to the last layer's numbers, with the factors of their deviations."""
    run, factor = runner(_regression_graph(network)), network.deviation_factor
    factor = None if factor is None else np.asarray(factor, np.float64)
    return lambda picture: (run(picture).astype(np.float64), factor)


class _Graph(OnnxGraph):
    """In single precision; `passed` names what each layer passes to the next."""

    def __init__(self) -> None:
        super().__init__()
        self.passed: list[str] = []

    def conv(self, x: str, conv: Conv, result: str | None = None) -> str:
        margin = conv.dilation * (conv.weight.shape[-1] // 2)
        weights = [self.constant(conv.weight), self.constant(conv.bias)]
        sizes = {"strides": [conv.stride] * 2, "dilations": [conv.dilation] * 2, "pads": [margin] * 4}
        return self.add("Conv", x, *weights, result=result, **sizes)

    def step(self, x: str, conv: Conv) -> str:
        return self.pass_on(self.add("Relu", self.conv(x, conv)))

    def pass_on(self, x: str) -> str:
        self.passed.append(x)
        return x

    def residual(self, x: str, *convs: Conv) -> str:
        for conv in convs:
            x = self.pass_on(self.add("Add", x, self.step(x, conv)))
        return x

    def enlarged(self, x: str) -> str:
        way = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
        return self.add("Resize", x, "", self.constant([1, 1, 2, 2]), **way)

    def linear(self, x: str, layer: Linear, result: str | None = None) -> str:
        return self.add("Gemm", x, self.constant(layer.weight), self.constant(layer.bias), result=result, transB=1)

    def features(self, encoder: Encoder) -> tuple[str, str, str, str]:
        """The levels of an encoder, the largest first, of the picture."""
        # Turned as bytes and divided within the stem's weights: a pass over the whole picture takes as long as a layer.
        channels = self.add("Cast", self.add("Transpose", PICTURE, perm=[0, 3, 1, 2]), to=TensorProto.FLOAT)
        x = self.add("Sub", channels, self.constant(255 * MIDDLE))
        stem = replace(encoder.stem, weight=encoder.stem.weight / (255 * SPREAD))
        x0 = self.residual(self.step(x, stem), encoder.e0)
        x1 = self.residual(self.step(x0, encoder.d1), *encoder.e1)
        x2 = self.residual(self.step(x1, encoder.d2), *encoder.e2)
        return x0, x1, x2, self.residual(self.step(x2, encoder.d3), *encoder.e3)

    def decoded(self, x: str, passed: str, up: Conv, conv: Conv) -> str:
        """A decoder's level: what came from below, enlarged, and what the encoder passed."""
        return self.residual(self.pass_on(self.add("Add", passed, self.enlarged(self.step(x, up)))), conv)


def largest_passed(
    network: LandmarkNetwork, pictures: Iterable[UInt8[np.ndarray, "h w 3"]]
) -> Float[np.ndarray, "layers"]:
    """The largest number that each layer passes on in any of these pictures, for `LandmarkNetwork.largest`."""
    graph = _heat_maps(network)
    session = session_of(graph.model(_answer_shape(network), *graph.passed))
    found = (session.run(graph.passed, {PICTURE: picture[None]}) for picture in pictures)
    return np.max([[numbers.max() for numbers in passed] for passed in found], axis=0)


def _heat_map_graph(network: LandmarkNetwork):
    """The network as an ONNX model, from a picture of bytes to heat maps."""
    return _heat_maps(network).model(_answer_shape(network))


def _heat_maps(network: LandmarkNetwork) -> _Graph:
    graph = _Graph()
    x0, x1, x2, x3 = graph.features(network)
    x2 = graph.decoded(x3, x2, network.u2, network.f2)
    x1 = graph.decoded(x2, x1, network.u1, network.f1)
    x0 = graph.decoded(x1, x0, network.u0, network.f0)
    graph.conv(x0, all_maps(network), result=ANSWER)
    return graph


def _answer_shape(network: LandmarkNetwork) -> list[int | str]:
    return [1, all_maps(network).weight.shape[0], "h4", "w4"]


def _regression_graph(network: Regression):
    """The network as an ONNX model, from a picture of bytes to the numbers of the points."""
    graph = _Graph()
    x = graph.add("Flatten", graph.step(graph.features(network)[-1], network.squeeze))
    x = graph.add("Relu", graph.linear(x, network.hidden))
    graph.linear(x, network.head, result=ANSWER)
    return graph.model([1, network.head.bias.shape[0]])
