"""An item of the papers in a notebook: what the paper says, and what was found here, piece by piece."""

from pathlib import Path
from typing import Any

from workbench.extras import needs
from workbench.frames import read_picture
from workbench.plots import markdown_table
from workbench.reproduction.items import choose
from workbench.reproduction.study import results, run

with needs("lab"):
    from IPython.display import Image, Markdown

LARGEST_PX = (720, 460)
"""Width and height up to which a figure fits on a screen with its caption."""


def shown(name: str, folder: str | Path, *, quick: bool = True, left_out: bool = False) -> tuple[Any, ...]:
    """Remake one item in a folder, or take it from there, and return its text, tables and figures for `display`.

    `left_out`: only what the paper says, and the command that makes it. Raises `InputError` for an unknown item.
    """
    (item,) = choose([name])
    printed = f"**The paper:** {item.printed}"
    if left_out:
        return (Markdown(f"{printed}\n\nLeft out here, since it takes long. `workbench reproduce {name}` makes it."),)
    run([item], folder, quick=quick)
    found = {each.name: content for each, content in results(folder)}[name]
    tables = (Markdown(markdown_table(table["header"], table["rows"])) for table in found["tables"])
    figures = (
        part
        for figure in found["figures"]
        for part in (Markdown(f"*{figure['caption']}*"), _on_a_screen(Path(folder) / name / figure["file"]))
    )
    notes = Markdown("\n\n".join(found["notes"]))
    return Markdown(f"{printed}\n\n**Here:** {found['data']}"), *tables, *figures, notes


def _on_a_screen(file: Path) -> Any:
    height, width = read_picture(file).shape[:2]
    scale = min(1.0, LARGEST_PX[0] / width, LARGEST_PX[1] / height)
    return Image(file, width=round(scale * width), height=round(scale * height))
