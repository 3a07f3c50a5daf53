"""Networks whose weights stay as they are, for detectors: no derivatives, and half the processor time of JAX.

The same layers as in `LandmarkNetwork.__call__`, written as an ONNX graph that ONNX Runtime runs. Where a derivative is
needed, as in Deep Energies, the network itself runs.
"""

from collections.abc import Callable
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import onnxruntime
from jaxtyping import Float, UInt8
from onnx import TensorProto, helper, numpy_helper

from workbench.networks.dense_network import SIDE, DenseNetwork
from workbench.networks.encoder import MIDDLE, SPREAD, Encoder
from workbench.networks.eye_network import EyeNetwork, EyePlaces, eye_places
from workbench.networks.landmark_network import LandmarkNetwork
from workbench.networks.layers import Conv
from workbench.networks.regression import Linear, Places, Regression, places_of

OPSET, IR_VERSION = 17, 8
"""Of the graph: old enough for every ONNX Runtime that is allowed."""
THREADS = 1
"""The look at one frame overlaps with decoding and solving others; more threads would wait for one another."""
PICTURE, ANSWER = "picture", "answer"


class FrozenNetwork:
    """A landmark network, or another of its kind, as ONNX Runtime runs it; may be called from several threads."""

    def __init__(self, network: LandmarkNetwork) -> None:
        self._run = _runner(_heat_map_graph(network))

    def __call__(self, picture: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "n h4 w4"]:
        """Heat maps of a quarter of the picture's size, which are `network(picture / 255)` up to rounding.

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
    run, factor = _runner(_regression_graph(network)), network.deviation_factor
    factor = None if factor is None else np.asarray(factor, np.float64)
    return lambda picture: (run(picture).astype(np.float64), factor)


def _runner(model) -> Callable[[UInt8[np.ndarray, "h w 3"]], np.ndarray]:
    """A model of one picture as a function."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = THREADS
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    return lambda picture: session.run([ANSWER], {PICTURE: picture[None]})[0][0]


class _Graph:
    """Nodes and weights in the order in which they are added, each known by the name of its result."""

    def __init__(self) -> None:
        self.nodes, self.weights = [], []

    def add(self, operation: str, *inputs: str, result: str | None = None, **attributes) -> str:
        """One operation; the name of its result."""
        name = result or f"{operation}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operation, list(inputs), [name], **attributes))
        return name

    def constant(self, values) -> str:
        """An array in single precision; its name."""
        name = f"weight_{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.asarray(values, np.float32), name))
        return name

    def conv(self, x: str, conv: Conv, result: str | None = None) -> str:
        margin = conv.dilation * (conv.weight.shape[-1] // 2)
        weights = [self.constant(conv.weight), self.constant(conv.bias)]
        sizes = {"strides": [conv.stride] * 2, "dilations": [conv.dilation] * 2, "pads": [margin] * 4}
        return self.add("Conv", x, *weights, result=result, **sizes)

    def step(self, x: str, conv: Conv) -> str:
        return self.add("Relu", self.conv(x, conv))

    def residual(self, x: str, *convs: Conv) -> str:
        for conv in convs:
            x = self.add("Add", x, self.step(x, conv))
        return x

    def enlarged(self, x: str) -> str:
        way = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
        return self.add("Resize", x, "", self.constant([1, 1, 2, 2]), **way)

    def linear(self, x: str, layer: Linear, result: str | None = None) -> str:
        return self.add("Gemm", x, self.constant(layer.weight), self.constant(layer.bias), result=result, transB=1)

    def features(self, encoder: Encoder) -> tuple[str, str, str, str]:
        """The levels of an encoder, the largest first, of the picture."""
        channels = self.add("Transpose", self.add("Cast", PICTURE, to=TensorProto.FLOAT), perm=[0, 3, 1, 2])
        x = self.add("Div", self.add("Sub", channels, self.constant(255 * MIDDLE)), self.constant(255 * SPREAD))
        x0 = self.residual(self.step(x, encoder.stem), encoder.e0)
        x1 = self.residual(self.step(x0, encoder.d1), *encoder.e1)
        x2 = self.residual(self.step(x1, encoder.d2), *encoder.e2)
        return x0, x1, x2, self.residual(self.step(x2, encoder.d3), *encoder.e3)

    def model(self, answer_shape: list[int | str]):
        """The whole, from a picture of bytes to the answer."""
        picture = helper.make_tensor_value_info(PICTURE, TensorProto.UINT8, [1, "height", "width", 3])
        answer = helper.make_tensor_value_info(ANSWER, TensorProto.FLOAT, answer_shape)
        made = helper.make_graph(self.nodes, "network", [picture], [answer], self.weights)
        return helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)

    def decoded(self, x: str, passed: str, up: Conv, conv: Conv) -> str:
        """A decoder's level: what came from below, enlarged, and what the encoder passed."""
        return self.residual(self.add("Add", passed, self.enlarged(self.step(x, up))), conv)


def _heat_map_graph(network: LandmarkNetwork):
    """The network as an ONNX model, from a picture of bytes to heat maps."""
    graph = _Graph()
    x0, x1, x2, x3 = graph.features(network)
    x2 = graph.decoded(x3, x2, network.u2, network.f2)
    x1 = graph.decoded(x2, x1, network.u1, network.f1)
    x0 = graph.decoded(x1, x0, network.u0, network.f0)
    head = _all_maps(network)
    graph.conv(x0, head, result=ANSWER)
    return graph.model([1, head.weight.shape[0], "h4", "w4"])


def _regression_graph(network: Regression):
    """The network as an ONNX model, from a picture of bytes to the numbers of the points."""
    graph = _Graph()
    x = graph.add("Flatten", graph.step(graph.features(network)[-1], network.squeeze))
    x = graph.add("Relu", graph.linear(x, network.hidden))
    graph.linear(x, network.head, result=ANSWER)
    return graph.model([1, network.head.bias.shape[0]])


def _all_maps(network: LandmarkNetwork) -> Conv:
    """The landmarks' heat maps and the pupils' as one convolution."""
    if network.pupils is None:
        return network.head
    parts = ((network.head.weight, network.pupils.weight), (network.head.bias, network.pupils.bias))
    weight, bias = (jnp.concatenate(both) for both in parts)
    return replace(network.head, weight=weight, bias=bias)
