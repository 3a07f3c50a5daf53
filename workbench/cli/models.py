"""`workbench model`: face models described and checked by a picture."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

import workbench
from workbench.cli import screen
from workbench.files import check_not_inputs

GROUP_HELP = """Face models from other sources: FLAME, Basel, GNM Head, ICT-FaceKit, glTF, OBJ folders.

[bold]Examples[/bold]

  workbench model show generic_model.pkl

  workbench model show avatar.glb --picture check.png
"""

SHOW_HELP = """Show what a face model holds, and draw it with its 68 landmarks.

PATH is a FLAME file (.pkl, .npz), a Basel Face Model (.h5, .mat), GNM Head (.npz), a glTF with morph targets (.glb, \
.gltf), a folder of OBJ files, or ICT-FaceKit's folder. Nothing in a .pkl is executed.

[bold]Example[/bold]

  workbench model show generic_model.pkl --picture check.png
"""
LANDMARKS_HELP = "landmarks.toml, or for FLAME a published embedding; else the model's own, or fitted."
UNIT_HELP = "Unit of the file (m, dm, cm, mm, um), for heads that are not of human size."

model_app = typer.Typer(no_args_is_help=True, rich_markup_mode="rich", help=GROUP_HELP)


@model_app.callback()
def group() -> None:
    """Keeps `show` a command of its own."""


@model_app.command(help=SHOW_HELP)
def show(
    path: Annotated[Path, typer.Argument(help="File or folder of the model.")],
    picture: Annotated[Path | None, typer.Option(help="Picture to write: front, side, landmarks.")] = None,
    landmarks: Annotated[Path | None, typer.Option(help=LANDMARKS_HELP)] = None,
    unit: Annotated[str | None, typer.Option(help=UNIT_HELP)] = None,
    identity: Annotated[int, typer.Option(min=0, help="Identity components to keep.")] = 50,
    expressions: Annotated[int, typer.Option(min=0, help="Expression components to keep.")] = 50,
) -> None:
    """Show what a face model holds."""
    if picture is not None:
        check_not_inputs([picture], [path, *([] if landmarks is None else [landmarks])])
    model = workbench.load_face_model(path, landmarks=landmarks, unit=unit, identity=identity, expressions=expressions)
    table = screen.table("", "")
    table.show_header = False
    for key, value in _rows(model):
        table.add_row(f"[bold]{key}[/bold]", escape(value))
    screen.console.print(table)
    if picture is not None:
        workbench.frames.write_picture(picture, workbench.pictures.model_check_picture(model))
        screen.console.print(f"{escape(str(picture))}  [dim]check that every point is where it should be[/dim]")


def _rows(model) -> list[tuple[str, str]]:
    named, others = _shapes(model)
    points = model.landmarks.of(model.neutral)
    width = float(abs(points[45, 0] - points[36, 0]))
    contour = f"68, jaw contour for {len(model.contour_yaw_deg)} yaws" if len(model.contour_yaw_deg) else "68"
    rows = [
        ("name", model.name),
        ("vertices", f"{len(model.neutral):,}"),
        ("triangles", f"{len(model.triangles):,}"),
        ("shapes", f"{len(model.expression_names)}: {named} with ARKit's names, {others} others"),
        ("names", ", ".join(model.expression_names)),
        ("identity", f"{len(model.identity_deltas)} components"),
        ("joints", ", ".join(model.joints) or "none"),
        *([("jaw", _jaw(model))] if "jaw" in model.joints else []),
        ("landmarks", contour),
        ("size", f"outer eye corners {width:.0f} mm apart"),
    ]
    return rows + [("note", note) for note in model.notes]


def _jaw(model) -> str:
    unit = model.jaw_unit
    return (
        f"{unit.open_deg:.1f}° open, {unit.sideways_mm:.1f} mm sideways, {unit.forward_mm:.1f} mm forward at weight 1"
    )


def _shapes(model) -> tuple[int, int]:
    named = sum(workbench.face.arkit_name(name) == name for name in model.expression_names)
    return named, len(model.expression_names) - named
