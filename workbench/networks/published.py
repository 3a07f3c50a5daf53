"""Published checkpoints that the workbench knows, recognised by their arrays."""

from collections.abc import Callable
from pathlib import Path

from workbench.files import check_not_inputs
from workbench.networks import fan, flownet2, raft
from workbench.networks.torch_checkpoints import read_checkpoint
from workbench.networks.weights import Weights


def convert_checkpoint(source: str | Path, out: str | Path | None = None) -> Weights:
    """Check a checkpoint of 3D-FAN, FlowNet2 or torchvision's `raft_small` and write its weights as safetensors.

    `out` is named after the network by default. Returns what was written; its metadata names the network, the source
    and its SHA-256. Raises `InputError` for a file that cannot be read, `ModelError` for another network,
    `OutputError` where `out` is the checkpoint itself.
    """
    name, convert = _network_of(read_checkpoint(source))
    target = Path(out or f"{name}.safetensors")
    check_not_inputs([target], [Path(source)])
    return convert(source, target)


def _network_of(weights: Weights) -> tuple[str, Callable[[str | Path, str | Path], Weights]]:
    """Name and converter of the network; 3D-FAN's unless the arrays are another's."""
    if raft.looks_like_raft(weights):
        return raft.NAME, raft.convert_raft
    if flownet2.looks_like_flownet2(weights):
        return flownet2.NAME, flownet2.convert_flownet2
    return fan.NAME, fan.convert_fan
