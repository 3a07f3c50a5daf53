"""How the workbench's own networks hang together, whatever numbers their layers pass on; see `frozen.py`.

The same layers as in `LandmarkNetwork.__call__` and `Regression.numbers`, as nodes of an ONNX graph.
"""

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

from workbench.networks.encoder import Encoder
from workbench.networks.landmark_network import LandmarkNetwork, all_maps
from workbench.networks.layers import Conv
from workbench.networks.onnx_graph import OnnxGraph
from workbench.networks.regression import Linear, Regression

Passed = TypeVar("Passed")
"""What layers pass on: a name, or a name and what its numbers mean."""


class NetworkGraph(OnnxGraph, ABC, Generic[Passed]):
    """Nodes and weights in the order in which they are added; subclasses say what a layer does."""

    @abstractmethod
    def seen(self, stem: Conv) -> tuple[Passed, Conv]:
        """The picture as the first layer takes it, and that layer."""

    @abstractmethod
    def step(self, x: Passed, conv: Conv) -> Passed:
        """A convolution, and zero for what is negative."""

    @abstractmethod
    def sum(self, x: Passed, y: Passed) -> Passed:
        """Both added."""

    @abstractmethod
    def sum_with_enlarged(self, x: Passed, below: Passed) -> Passed:
        """`x`, and at each of its pixels the one of `below`, of half the size, that covers it."""

    @abstractmethod
    def maps(self, x: Passed, head: Conv) -> None:
        """The answer by a last convolution, 1×1: (1, maps, height, width)."""

    @abstractmethod
    def numbers(self, x: Passed, squeeze: Conv, hidden: Linear, head: Linear) -> None:
        """The answer by a convolution, 1×1, and two fully connected layers: (1, numbers)."""

    def heat_maps(self, network: LandmarkNetwork):
        """The network as an ONNX model, from a picture of bytes to heat maps."""
        head = all_maps(network)
        x0, x1, x2, x3 = self._features(network)
        x2 = self._decoded(x3, x2, network.u2, network.f2)
        x1 = self._decoded(x2, x1, network.u1, network.f1)
        self.maps(self._decoded(x1, x0, network.u0, network.f0), head)
        return self.model([1, head.weight.shape[0], "h4", "w4"])

    def regression(self, network: Regression):
        """The network as an ONNX model, from a picture of bytes to the last layer's numbers."""
        self.numbers(self._features(network)[-1], network.squeeze, network.hidden, network.head)
        return self.model([1, network.head.bias.shape[0]])

    def _features(self, encoder: Encoder) -> tuple[Passed, Passed, Passed, Passed]:
        x0 = self._residual(self.step(*self.seen(encoder.stem)), encoder.e0)
        x1 = self._residual(self.step(x0, encoder.d1), *encoder.e1)
        x2 = self._residual(self.step(x1, encoder.d2), *encoder.e2)
        return x0, x1, x2, self._residual(self.step(x2, encoder.d3), *encoder.e3)

    def _decoded(self, x: Passed, passed: Passed, up: Conv, conv: Conv) -> Passed:
        return self._residual(self.sum_with_enlarged(passed, self.step(x, up)), conv)

    def _residual(self, x: Passed, *convs: Conv) -> Passed:
        for conv in convs:
            x = self.sum(x, self.step(x, conv))
        return x
