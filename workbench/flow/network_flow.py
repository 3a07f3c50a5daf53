"""Flow by a network: the one estimator that photos and renders can both go through, differentiable in the pictures."""

from pathlib import Path
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float32

from workbench.arrays import AnyArray
from workbench.errors import ConfigError, InputError, ModelError
from workbench.flow.estimators import DisFlow, FarnebackFlow, FlowEstimator, Picture, as_floats, check_pair
from workbench.networks import flow_network, flownet2, raft
from workbench.networks.flow_network import read_flow_network
from workbench.networks.torch_checkpoints import read_checkpoint
from workbench.networks.weights import Weights

SIDE, LARGEST_SIDE = 256, 2048
"""Pixels that the longer side of a picture is brought to; Deep Energies (Sec. 6) has 512."""
WEIGHTS_SUFFIXES = (".safetensors", ".pth", ".pth.tar", ".pt")
BUNDLED = Path(__file__).parent.parent / "networks" / "bundled" / "flow.safetensors"
"""The workbench's own flow network."""


@runtime_checkable
class FlowModel(Protocol):
    """Two pictures (channels first, RGB in 0..1) to their flow in pixels (channels first)."""

    @property
    def multiple(self) -> int: ...

    @property
    def smallest_side(self) -> int: ...

    def __call__(self, first: Float[Array, "3 h w"], second: Float[Array, "3 h w"]) -> Float[Array, "2 h w"]: ...


class NetworkFlow:
    """Resize, network, and the flow brought back to the pictures' size: N of Deep Energies Sec. 6."""

    def __init__(self, network: FlowModel, side: int = SIDE, name: str = "network") -> None:
        """`side`: what the longer side is brought to. Raises `InputError` for one that the network cannot see."""
        if not network.smallest_side <= side <= LARGEST_SIDE:
            raise InputError(
                f"the flow network's side should be {network.smallest_side} to {LARGEST_SIDE} pixels, got {side}"
            )
        self.network, self.side, self._name = network, side, name
        # The network is an argument: as a constant of the program, FlowNet2 takes four times as long to compile.
        self._compiled = eqx.filter_jit(flow_between)

    @property
    def name(self) -> str:
        """As in configurations and tables."""
        return self._name

    def __call__(self, first: Picture, second: Picture) -> Float32[np.ndarray, "h w 2"]:
        """As in `FlowEstimator`. Compiles once for each size of pictures."""
        check_pair(first, second)
        return np.asarray(self._compiled(self.network, as_floats(first), as_floats(second), self.side))

    def traced(self, first: Float[AnyArray, "h w 3"], second: Float[AnyArray, "h w 3"]) -> Float[Array, "h w 2"]:
        """The same for pictures in 0..1 under a JAX transformation; differentiable in both, in float32."""
        return flow_between(self.network, first, second, self.side)


def flow_between(
    network: FlowModel, first: Float[AnyArray, "h w 3"], second: Float[AnyArray, "h w 3"], side: int
) -> Float[Array, "h w 2"]:
    """What a network sees between two pictures in 0..1, their longer side brought to `side`; pixels of the pictures."""
    height, width = first.shape[:2]
    seen_height, seen_width = seen_size(network, height, width, side)
    seen = [
        jnp.moveaxis(_resized(jnp.asarray(picture, jnp.float32), seen_height, seen_width), -1, 0)
        for picture in (first, second)
    ]
    flow = _resized(jnp.moveaxis(network(*seen), 0, -1), height, width)
    return flow * jnp.asarray([width / seen_width, height / seen_height], jnp.float32)


def seen_size(network: FlowModel, height: int, width: int, side: int) -> tuple[int, int]:
    """Height and width that a network sees: the longer one near `side`, both multiples of what it needs."""
    scale = side / max(height, width)
    step = network.multiple
    high, wide = (max(network.smallest_side, step * round(length * scale / step)) for length in (height, width))
    return high, wide


def bundled_flow(side: int = SIDE) -> NetworkFlow:
    """The workbench's own flow network."""
    return NetworkFlow(read_flow_network(BUNDLED), side)


def read_flow(path: str | Path, side: int = SIDE) -> NetworkFlow:
    """A flow network from a file: the workbench's own, FlowNet2 or torchvision's `raft_small`, converted or not.

    Raises `InputError` for a file that cannot be read, `ModelError` for weights of another network.
    """
    return NetworkFlow(_network_of(read_checkpoint(path)), side, Path(path).stem)


def flow_estimator(name: str, side: int = SIDE) -> FlowEstimator:
    """The estimator of a configuration: network, dis, farneback, or the path of a network's weights.

    Raises `ConfigError` for another name, and as `read_flow` does.
    """
    if name == "network":
        return bundled_flow(side)
    if name == "dis":
        return DisFlow()
    if name == "farneback":
        return FarnebackFlow()
    if name.endswith(WEIGHTS_SUFFIXES):
        return read_flow(name, side)
    raise ConfigError(
        f"flow estimators are network, dis, farneback or a weights file ({', '.join(WEIGHTS_SUFFIXES)}), got {name!r}"
    )


def _network_of(weights: Weights) -> FlowModel:
    """The network that metadata or the names of arrays identify."""
    if weights.architecture == flow_network.NAME:
        return flow_network.flow_network_from(weights)
    if weights.architecture == flownet2.NAME or flownet2.looks_like_flownet2(weights):
        return flownet2.flownet2_from(weights)
    if weights.architecture == raft.NAME or raft.looks_like_raft(weights):
        return raft.raft_from(weights)
    raise ModelError(
        f"{weights.origin} should hold a flow network, got {weights.architecture or 'an unknown one'}: supply "
        "the workbench's own, NVIDIA's FlowNet2_checkpoint.pth.tar or torchvision's raft_small, converted or not"
    )


def _resized(field: Float[Array, "h w c"], height: int, width: int) -> Float[Array, "h2 w2 c"]:
    """Bilinear, averaging where it shrinks; pixel edges are kept."""
    if field.shape[:2] == (height, width):
        return field
    return jax.image.resize(field, (height, width, field.shape[2]), "linear")
