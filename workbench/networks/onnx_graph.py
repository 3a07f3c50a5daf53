"""An ONNX graph as it is written: nodes and weights in their order, from a picture of bytes to an answer."""

from collections.abc import Callable

import numpy as np
import onnxruntime
from jaxtyping import UInt8
from onnx import TensorProto, helper, numpy_helper

OPSET, IR_VERSION = 17, 8
"""Of the graph: old enough for every ONNX Runtime that is allowed."""
RUNTIME, RUNTIME_OPSET = "com.microsoft", 1
"""ONNX Runtime's own operations."""
THREADS = 1
"""The look at one frame overlaps with decoding and solving others; more threads would wait for one another."""
PICTURE, ANSWER = "picture", "answer"


class OnnxGraph:
    """Nodes and weights in the order in which they are added, each known by the name of its result."""

    def __init__(self) -> None:
        self.nodes, self.weights = [], []
        self.told: list[str] = []
        """Results that are given out beside the answer."""

    def add(self, operation: str, *inputs: str, result: str | None = None, domain: str = "", **attributes) -> str:
        """One operation; the name of its result."""
        name = result or f"{operation}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operation, list(inputs), [name], domain=domain, **attributes))
        return name

    def constant(self, values, dtype: type = np.float32) -> str:
        """An array; its name."""
        name = f"weight_{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.asarray(values, dtype), name))
        return name

    def model(self, answer_shape: list[int | str]):
        """The whole, from a picture of bytes to the answer and to what is `told`."""
        picture = helper.make_tensor_value_info(PICTURE, TensorProto.UINT8, [1, "height", "width", 3])
        shapes = {ANSWER: answer_shape} | dict.fromkeys(self.told)
        results = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in shapes.items()]
        made = helper.make_graph(self.nodes, "network", [picture], results, self.weights)
        opsets = [helper.make_opsetid("", OPSET), helper.make_opsetid(RUNTIME, RUNTIME_OPSET)]
        return helper.make_model(made, opset_imports=opsets, ir_version=IR_VERSION)


def session_of(model) -> onnxruntime.InferenceSession:
    """A model, ready to run in the thread that asks."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = THREADS
    return onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])


def runner(model) -> Callable[[UInt8[np.ndarray, "h w 3"]], np.ndarray]:
    """A model of one picture as a function."""
    session = session_of(model)
    return lambda picture: session.run([ANSWER], {PICTURE: picture[None]})[0][0]
