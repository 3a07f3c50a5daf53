"""`workbench weights`: weights of networks converted and described."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

import workbench
from workbench.cli import screen

GROUP_HELP = """Convert published network weights to safetensors, and show what a weights file holds.

[bold]Examples[/bold]

  workbench weights convert 3DFAN4-7835d9f11d.pth.tar

  workbench weights show fan.safetensors
"""

CONVERT_HELP = """Convert a published checkpoint of 3D-FAN (face landmarks), FlowNet2 or RAFT (optical flow), once.

FILE is a state dict (.pth, .pth.tar) or a TorchScript archive (.zip, .pt) as published for the package \
face-alignment, NVIDIA's FlowNet2_checkpoint.pth.tar, or torchvision's raft_small. It is read as data: nothing in it \
is run, and PyTorch is not needed. The weights keep their licences; FlowNet2's are for research only. \
3D-FAN and 2D-FAN have the same layers: only the name tells which one you have.

[bold]Examples[/bold]

  workbench weights convert 3DFAN4-7835d9f11d.pth.tar --out models/fan.safetensors

  workbench weights convert FlowNet2_checkpoint.pth.tar

  workbench weights convert raft_small_C_T_V2-01064c6d.pth
"""

SHOW_HELP = """Show which network a weights file belongs to, and where it comes from.

[bold]Example[/bold]

  workbench weights show fan.safetensors
"""

weights_app = typer.Typer(no_args_is_help=True, rich_markup_mode="rich", help=GROUP_HELP)


@weights_app.command(help=CONVERT_HELP)
def convert(
    file: Annotated[Path, typer.Argument(help="Checkpoint as published.")],
    out: Annotated[
        Path | None, typer.Option(help="File to write; named after the network by default: fan.safetensors, ...")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")] = False,
) -> None:
    """Convert a published checkpoint to safetensors."""
    written = workbench.networks.convert_checkpoint(file, out, overwrite)
    _tell(written.origin, written.metadata, written.arrays)


@weights_app.command(help=SHOW_HELP)
def show(file: Annotated[Path, typer.Argument(help="Weights file, converted or as published.")]) -> None:
    """Tell what a weights file holds."""
    weights = workbench.networks.read_checkpoint(file)
    known = workbench.networks.architecture_of(weights) or "none that the workbench knows"
    _tell(weights.origin, {**weights.metadata, "architecture": known}, weights.arrays)


def _tell(name: str, metadata: dict, arrays: dict) -> None:
    table = screen.table("", "")
    table.show_header = False
    numbers = sum(array.size for array in arrays.values())
    rows = {"file": name, "arrays": f"{len(arrays)} with {numbers:,} numbers"}
    for key, value in (*rows.items(), *sorted(metadata.items())):
        table.add_row(f"[bold]{escape(key)}[/bold]", escape(value))
    screen.console.print(table)
