"""Published checkpoints that the workbench knows, recognised by their arrays."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from workbench.errors import ModelError
from workbench.files import check_new, check_not_inputs
from workbench.networks import fan, flownet2, raft
from workbench.networks.torch_checkpoints import read_checkpoint
from workbench.networks.weights import ARCHITECTURE, Weights, named_arrays, write_weights

Published = fan.Fan | flownet2.FlowNet2 | raft.RaftSmall


def convert_checkpoint(source: str | Path, out: str | Path | None = None, overwrite: bool = False) -> Weights:
    """Check a checkpoint of 3D-FAN, FlowNet2 or torchvision's `raft_small` and write its weights as safetensors.

    PyTorch is not needed. `out` is named after the network by default. Returns what was written; its metadata names the
    network, the source and its SHA-256. Raises `InputError` for a file that cannot be read, `ModelError` for another
    network, `OutputError` where `out` is the checkpoint itself, or is there already, unless `overwrite` is set.
    """
    checkpoint = read_checkpoint(source)
    name, network_from = _network_of(checkpoint)
    target = Path(out or f"{name}.safetensors")
    check_not_inputs([target], [Path(source)])
    if not overwrite:
        check_new(target)
    network = network_from(checkpoint)
    metadata = {**checkpoint.metadata, ARCHITECTURE: name}
    if isinstance(network, fan.Fan):
        metadata["stacks"] = str(network.count)
    arrays = {key: np.asarray(array) for key, array in named_arrays(network).items()}
    write_weights(target, arrays, metadata)
    return Weights(arrays, metadata, str(target))


def architecture_of(weights: Weights) -> str | None:
    """Name of the network that weights belong to: as they say, or that of a published checkpoint; None for others."""
    if ARCHITECTURE in weights.metadata:
        return weights.metadata[ARCHITECTURE]
    name, network_from = _network_of(weights)
    try:
        network_from(weights)
    except ModelError:
        return None
    return name


def _network_of(weights: Weights) -> tuple[str, Callable[[Weights], Published]]:
    """Name of the network and what makes it of the weights; 3D-FAN unless the arrays are another's."""
    if raft.looks_like_raft(weights):
        return raft.NAME, raft.raft_from
    if flownet2.looks_like_flownet2(weights):
        return flownet2.NAME, flownet2.flownet2_from
    return fan.NAME, fan.fan_from
