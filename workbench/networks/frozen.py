"""Networks whose weights stay as they are, for detectors: no derivatives, and half the processor time of JAX.

ONNX Runtime runs the network's layers (`network_graph.py`) in single precision (`frozen_floats.py`) or, where `largest`
is known, in bytes (`frozen_bytes.py`). Where a derivative is needed, as in Deep Energies, the network itself runs.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, UInt8

from workbench.networks.dense_network import SIDE, DenseNetwork
from workbench.networks.eye_network import EyeNetwork, EyePlaces, eye_places
from workbench.networks.frozen_bytes import ByteGraph
from workbench.networks.frozen_floats import FloatGraph
from workbench.networks.landmark_network import LandmarkNetwork
from workbench.networks.onnx_graph import runner
from workbench.networks.regression import Places, Regression, places_of


class FrozenNetwork:
    """A landmark network, or another of its kind, as ONNX Runtime runs it; may be called from several threads."""

    def __init__(self, network: LandmarkNetwork) -> None:
        self._run = runner(_graph(network).heat_maps(network))

    def __call__(self, picture: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "n h4 w4"]:
        """Heat maps of a quarter of the picture's size, which are `network(picture / 255)` up to rounding.

        In bytes, where `network.largest` is known, landmarks are a fifth of a pixel from the network's in the median.
        Where the network knows pupils, the maps of the person's right and left one follow the others.
        Height and width are multiples of 32 pixels.
        """
        return self._run(picture)


class FrozenDenseNetwork:
    """A dense network as ONNX Runtime runs it; may be called from several threads."""

    def __init__(self, network: DenseNetwork) -> None:
        self._answer = _regression(network)

    def __call__(self, picture: UInt8[np.ndarray, "256 256 3"]) -> Places:
        """Points in the picture's pixels and their whitening: `network(picture / 255)` up to rounding.

        In bytes, where `network.largest` is known, points are a third of a pixel from the network's in the median.
        """
        numbers, factor = self._answer(picture)
        return places_of(numbers, SIDE, factor)


class FrozenEyeNetwork:
    """An eye network as ONNX Runtime runs it; may be called from several threads."""

    def __init__(self, network: EyeNetwork) -> None:
        self._answer = _regression(network)

    def __call__(self, picture: UInt8[np.ndarray, "64 64 3"]) -> EyePlaces:
        """Pupil and iris of a right eye, and whether it is open: `network(picture / 255)` up to rounding."""
        return eye_places(*self._answer(picture))


def _graph(network: LandmarkNetwork | Regression) -> FloatGraph | ByteGraph:
    return FloatGraph() if network.largest is None else ByteGraph(network.largest)


def _regression(network: Regression) -> Callable[[UInt8[np.ndarray, "s s 3"]], tuple[np.ndarray, np.ndarray | None]]:
    """A picture to the last layer's numbers, with the factors of their deviations."""
    run, factor = runner(_graph(network).regression(network)), network.deviation_factor
    factor = None if factor is None else np.asarray(factor, np.float64)
    return lambda picture: (run(picture).astype(np.float64), factor)
