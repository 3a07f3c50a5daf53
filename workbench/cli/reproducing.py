"""`workbench reproduce`: the papers' figures, tables and experiments, remade."""

from pathlib import Path
from typing import Annotated

import typer

import workbench
from workbench.cli import screen

REPRODUCE_HELP = """Remake figures and tables of the papers on one page, next to the printed numbers.

[bold]Examples[/bold]

  workbench reproduce --list                           what there is

  workbench reproduce --quick                          everything, on a small part of the data

  workbench reproduce head-pose --boston uniform-light   Table 1 on the real set

  workbench reproduce other-meshes --meshes meshes     with what 3DDFA, PRNet or VRN made of the pictures
"""


def reproduce(
    names: Annotated[list[str] | None, typer.Argument(metavar="[ITEM]...", help="Items (default: all).")] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("reproduced"),
    quick: Annotated[bool, typer.Option("--quick", help="On a small part of the data, to see it work.")] = False,
    listing: Annotated[bool, typer.Option("--list", help="Name the items and stop.")] = False,
    boston: Annotated[Path | None, typer.Option(help="Folder with Boston University's set, for head-pose.")] = None,
    poses: Annotated[list[Path] | None, typer.Option(help="CSV with another program's poses on that set.")] = None,
    meshes: Annotated[Path | None, typer.Option(help="Folder with other programs' meshes, for other-meshes.")] = None,
    clip: Annotated[Path | None, typer.Option(help="A video of a face, for clip-through-time.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Remake what has been made already.")] = False,
) -> None:
    """Remake figures and tables of the papers on one page, next to the printed numbers."""
    items = workbench.reproduction.choose(names or [])
    if listing:
        table = screen.table("item", "paper", "place", "what", whole=("item", "paper", "place"))
        for item in items:
            table.add_row(item.name, item.paper, item.place, item.title)
        screen.console.print(table)
        return
    data = {"boston": boston, "poses": poses or (), "meshes": meshes, "clip": clip}
    workbench.reproduction.check_data(items, **data)
    given = [path for path in (boston, meshes, clip, *(poses or [])) if path is not None]
    workbench.pipeline.check_inputs_kept(out, given)
    for item in items:
        with screen.progress_bar() as progress:
            ((_, fresh),) = workbench.reproduction.run(
                [item], out, quick=quick, overwrite=overwrite, progress=progress, **data
            )
        state = "" if fresh else " (made before; --overwrite remakes it)"
        screen.console.print(
            f"{item.name}: {item.paper} {item.place}, {item.title}{state}", markup=False, soft_wrap=True
        )
        # After every item: a run that is stopped leaves a page of what there is.
        page = workbench.reproduction.write_page(out)
    screen.console.print(f"Open {page}", markup=False, soft_wrap=True)
