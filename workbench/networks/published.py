"""Published checkpoints that the workbench knows, recognised by their arrays."""

from pathlib import Path

from workbench.files import check_not_inputs
from workbench.networks import fan, raft
from workbench.networks.torch_checkpoints import read_checkpoint
from workbench.networks.weights import Weights


def convert_checkpoint(source: str | Path, out: str | Path | None = None) -> Weights:
    """Check a checkpoint of 3D-FAN or of torchvision's `raft_small` and write its weights as safetensors.

    `out` is named after the network by default. Returns what was written; its metadata names the network, the source
    and its SHA-256. Raises `InputError` for a file that cannot be read, `ModelError` for another network,
    `OutputError` where `out` is the checkpoint itself.
    """
    kind = raft if raft.looks_like_raft(read_checkpoint(source)) else fan
    convert = raft.convert_raft if kind is raft else fan.convert_fan
    target = Path(out or f"{kind.NAME}.safetensors")
    check_not_inputs([target], [Path(source)])
    return convert(source, target)
