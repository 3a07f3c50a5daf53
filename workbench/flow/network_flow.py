"""Flow by a network: the one estimator that photos and renders can both go through, differentiable in the pictures."""

from pathlib import Path
from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float32

from workbench.arrays import AnyArray
from workbench.errors import ConfigError, InputError
from workbench.flow.estimators import DisFlow, FarnebackFlow, FlowEstimator, Picture, as_floats, check_pair
from workbench.networks.flow_network import NAME, flow_network_from, read_flow_network
from workbench.networks.raft import raft_from
from workbench.networks.torch_checkpoints import read_checkpoint

SIDE, LARGEST_SIDE = 256, 2048
"""Pixels that the longer side of a picture is brought to; Deep Energies (Sec. 6) has 512."""
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
        self._compiled = jax.jit(self.traced)

    @property
    def name(self) -> str:
        """As in configurations and tables."""
        return self._name

    def __call__(self, first: Picture, second: Picture) -> Float32[np.ndarray, "h w 2"]:
        """As in `FlowEstimator`. Compiles once for each size of pictures."""
        check_pair(first, second)
        return np.asarray(self._compiled(as_floats(first), as_floats(second)))

    def traced(self, first: Float[AnyArray, "h w 3"], second: Float[AnyArray, "h w 3"]) -> Float[Array, "h w 2"]:
        """The same for pictures in 0..1 under a JAX transformation; differentiable in both, in float32."""
        height, width = first.shape[:2]
        seen_height, seen_width = self.seen_size(height, width)
        seen = [
            jnp.moveaxis(_resized(jnp.asarray(picture, jnp.float32), seen_height, seen_width), -1, 0)
            for picture in (first, second)
        ]
        flow = _resized(jnp.moveaxis(self.network(*seen), 0, -1), height, width)
        return flow * jnp.asarray([width / seen_width, height / seen_height], jnp.float32)

    def seen_size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width that the network sees: the longer one near `side`, both multiples of what it needs."""
        scale = self.side / max(height, width)
        step = self.network.multiple
        high, wide = (
            max(self.network.smallest_side, step * round(length * scale / step)) for length in (height, width)
        )
        return high, wide


def bundled_flow(side: int = SIDE) -> NetworkFlow:
    """The workbench's own flow network."""
    return NetworkFlow(read_flow_network(BUNDLED), side)


def read_flow(path: str | Path, side: int = SIDE) -> NetworkFlow:
    """A flow network from a file: the workbench's architecture, or torchvision's `raft_small`, converted or not.

    Raises `InputError` for a file that cannot be read, `ModelError` for weights of another network.
    """
    weights = read_checkpoint(path)
    network = flow_network_from(weights) if weights.architecture == NAME else raft_from(weights)
    return NetworkFlow(network, side, Path(path).stem)


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
    if Path(name).suffix in (".safetensors", ".pth", ".pt"):
        return read_flow(name, side)
    raise ConfigError(
        f"flow estimators are network, dis, farneback or a weights file (.safetensors, .pth), got {name!r}"
    )


def _resized(field: Float[Array, "h w c"], height: int, width: int) -> Float[Array, "h2 w2 c"]:
    """Bilinear, averaging where it shrinks; pixel edges are kept."""
    if field.shape[:2] == (height, width):
        return field
    return jax.image.resize(field, (height, width, field.shape[2]), "linear")
