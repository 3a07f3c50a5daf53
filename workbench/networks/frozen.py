"""Networks whose weights stay as they are, for detectors: no derivatives, and half the processor time of JAX.

The same layers as in `LandmarkNetwork.__call__`, written as an ONNX graph that ONNX Runtime runs. Where a derivative is
needed, as in Deep Energies, the network itself runs.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import onnxruntime
from jaxtyping import Float, UInt8
from onnx import TensorProto, helper, numpy_helper

from workbench.networks.landmark_network import MIDDLE, SPREAD, LandmarkNetwork
from workbench.networks.layers import Conv

OPSET, IR_VERSION = 17, 8
"""Of the graph: old enough for every ONNX Runtime that is allowed."""
THREADS = 1
"""The look at one frame overlaps with decoding and solving others; more threads would wait for one another."""
PICTURE, HEAT_MAPS = "picture", "heat_maps"


class FrozenNetwork:
    """A landmark network, or another of its kind, as ONNX Runtime runs it; may be called from several threads."""

    def __init__(self, network: LandmarkNetwork) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = THREADS
        graph = _graph_of(network).SerializeToString()
        self._session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])

    def __call__(self, picture: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "n h4 w4"]:
        """Heat maps of a quarter of the picture's size, which are `network(picture / 255)` up to rounding.

        Where the network knows pupils, the maps of the person's right and left one follow the others.
        Height and width are multiples of 32 pixels.
        """
        return self._session.run([HEAT_MAPS], {PICTURE: picture[None]})[0][0]


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

    def decoded(self, x: str, passed: str, up: Conv, conv: Conv) -> str:
        """A decoder's level: what came from below, enlarged, and what the encoder passed."""
        return self.residual(self.add("Add", passed, self.enlarged(self.step(x, up))), conv)


def _graph_of(network: LandmarkNetwork):
    """The network as an ONNX model, from a picture of bytes to heat maps."""
    graph = _Graph()
    channels = graph.add("Transpose", graph.add("Cast", PICTURE, to=TensorProto.FLOAT), perm=[0, 3, 1, 2])
    x = graph.add("Div", graph.add("Sub", channels, graph.constant(255 * MIDDLE)), graph.constant(255 * SPREAD))
    x0 = graph.residual(graph.step(x, network.stem), network.e0)
    x1 = graph.residual(graph.step(x0, network.d1), *network.e1)
    x2 = graph.residual(graph.step(x1, network.d2), *network.e2)
    x3 = graph.residual(graph.step(x2, network.d3), *network.e3)
    x2 = graph.decoded(x3, x2, network.u2, network.f2)
    x1 = graph.decoded(x2, x1, network.u1, network.f1)
    x0 = graph.decoded(x1, x0, network.u0, network.f0)
    head = _all_maps(network)
    graph.conv(x0, head, result=HEAT_MAPS)
    picture = helper.make_tensor_value_info(PICTURE, TensorProto.UINT8, [1, "height", "width", 3])
    maps = helper.make_tensor_value_info(HEAT_MAPS, TensorProto.FLOAT, [1, head.weight.shape[0], "h4", "w4"])
    made = helper.make_graph(graph.nodes, "heat_maps", [picture], [maps], graph.weights)
    return helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)


def _all_maps(network: LandmarkNetwork) -> Conv:
    """The landmarks' heat maps and the pupils' as one convolution."""
    if network.pupils is None:
        return network.head
    parts = ((network.head.weight, network.pupils.weight), (network.head.bias, network.pupils.bias))
    weight, bias = (jnp.concatenate(both) for both in parts)
    return replace(network.head, weight=weight, bias=bias)
