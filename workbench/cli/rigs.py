"""`workbench rig`: calibrated rigs of several cameras shown, checked against landmarks, converted."""

from itertools import chain, repeat
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.markup import escape

import workbench
from workbench.cli import screen
from workbench.errors import InputError
from workbench.files import atomic_path, check_new, check_not_inputs

GROUP_HELP = """Rigs of several calibrated cameras: what is in a file, and whether landmarks agree with it.

[bold]Examples[/bold]

  workbench rig convert left.yml right.yml         OpenCV's files as one rig.toml

  workbench rig show rig.toml --picture rig.png    what it holds, drawn

  workbench rig check rig.toml left.csv right.csv  do landmarks agree with it?
"""

SHOW_HELP = """Print a rig: lenses, baselines, angles, where the axes meet, and what seems wrong.

FILES is a rig.toml, or what OpenCV's calibration wrote (.yml, .json, .xml): intrinsics and extrinsics of a pair, or \
one file for each camera, the reference first.

[bold]Examples[/bold]

  workbench rig show rig.toml --picture rig.png

  workbench rig show intrinsics.yml extrinsics.yml --unit cm --size 1280x720
"""

CHECK_HELP = """Compare the landmarks of synchronised clips with a rig, frame by frame, without a face model.

LANDMARKS is a file for each view, in the rig's order, as [bold]workbench landmarks[/bold] writes it. Reports how \
far the 51 inner landmarks are from their epipolar lines and from their triangulated points, which view is off (with \
three or more), and whether another order, inverted poses or a shift in time by some frames would fit better.

Exit code 0: nothing stands out; 1: something does; 2: the files cannot be compared.

[bold]Example[/bold]

  workbench rig check rig.toml left.csv right.csv
"""

CONVERT_HELP = """Write a rig as rig.toml; the first view is the reference.

[bold]Example[/bold]

  workbench rig convert left.yml right.yml --unit m --out rig.toml
"""

FilesArgument = Annotated[list[Path], typer.Argument(help="rig.toml, or OpenCV's file or files.")]
UnitOption = Annotated[str | None, typer.Option(help="Unit of an OpenCV file's lengths: mm (default), cm or m.")]
SizeOption = Annotated[str | None, typer.Option(help="Picture size if an OpenCV file has none, for example 1280x720.")]

rig_app = typer.Typer(no_args_is_help=True, rich_markup_mode="rich", help=GROUP_HELP)


@rig_app.command(help=SHOW_HELP)
def show(
    files: FilesArgument,
    unit: UnitOption = None,
    size: SizeOption = None,
    picture: Annotated[Path | None, typer.Option(help="Draw plan and side view to this .png.")] = None,
) -> None:
    """Print a rig and draw it."""
    if picture is not None and picture.suffix.lower() != ".png":
        raise InputError(f"The rig is drawn as .png, got {picture}; name another file.")
    rig = workbench.geometry.read_rig(files, unit, _image_size(size))
    _print_report(workbench.geometry.rig_report(rig))
    if picture is not None:
        check_not_inputs([picture], files)
        _draw(rig, picture)
        screen.console.print(f"wrote {escape(str(picture))}", soft_wrap=True)


@rig_app.command(help=CHECK_HELP)
def check(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="rig.toml, or one OpenCV file.")],
    landmarks: Annotated[list[Path], typer.Argument(help="A landmark file for each view, in the rig's order.")],
    unit: UnitOption = None,
    size: SizeOption = None,
) -> None:
    """Compare landmarks with a rig."""
    placed = workbench.geometry.read_rig(rig, unit, _image_size(size))
    sizes = chain((view.image_size for view in placed.views), repeat(None))  # too many files are told by the check
    clips = [workbench.read_landmark_file(path, size) for path, size in zip(landmarks, sizes, strict=False)]
    found = workbench.landmarks.epipolar.check_rig(placed, clips)
    _print_check(found)
    if found.warnings:
        raise typer.Exit(1)


@rig_app.command(help=CONVERT_HELP)
def convert(
    files: FilesArgument,
    unit: UnitOption = None,
    size: SizeOption = None,
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("rig.toml"),
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")] = False,
) -> None:
    """Write a rig as rig.toml."""
    rig = workbench.geometry.read_rig(files, unit, _image_size(size))
    check_not_inputs([out], files)
    if not overwrite:
        check_new(out)
    workbench.geometry.write_rig(rig, out)
    _print_report(workbench.geometry.rig_report(rig))
    screen.console.print(f"wrote {escape(str(out))}", soft_wrap=True)


def _image_size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    parts = text.lower().replace("×", "x").split("x")
    if len(parts) != 2 or not all(part.isdigit() and int(part) > 0 for part in parts):
        raise InputError(f"A picture size is width and height in pixels, for example 1280x720; got {text!r}.")
    return int(parts[0]), int(parts[1])


def _draw(rig: "workbench.geometry.Rig", path: Path) -> None:
    with atomic_path(path) as temporary:
        workbench.pictures.rig_figure(rig).savefig(temporary)


def _print_report(report: "workbench.geometry.RigReport") -> None:
    lenses = ("focal, px", "field of view", "centre off by, px", "distortion, px")
    table = screen.table("view", "picture", *lenses, right=lenses, whole=("picture",))
    for view in report.views:
        table.add_row(escape(view.name), *_lens_cells(view))
    screen.console.print(table)
    screen.console.print("[dim]distortion: by how much it moves the worst corner[/dim]")
    if len(report.views) > 1:
        places = ("baseline", "angle", "roll", "axes meet", "closest approach")
        table = screen.table("view", *places, right=places)
        for view in report.views[1:]:
            table.add_row(escape(view.name), *_place_cells(view))
        screen.console.print()
        screen.console.print(table)
        screen.console.print(f"[dim]against {escape(report.views[0].name)}, the reference[/dim]")
    _print_warnings(report.warnings)


def _lens_cells(view: "workbench.geometry.ViewReport") -> list[str]:
    (fx, fy), (width, height) = view.focal_px, view.image_size
    off_x, off_y = view.principal_offset_px
    focal = f"{fx:.1f}" if abs(fx - fy) < 0.05 else f"{fx:.1f}, {fy:.1f}"
    moved = "folded" if np.isnan(view.corner_distortion_px) else f"{view.corner_distortion_px:.1f}"
    fov = " × ".join("folded" if np.isnan(degrees) else f"{degrees:.1f}°" for degrees in view.fov_deg)
    return [f"{width}×{height}", focal, fov, f"{off_x:+.1f}, {off_y:+.1f}", moved]


def _place_cells(view: "workbench.geometry.ViewReport") -> list[str]:
    placed = [f"{view.baseline_mm:.1f} mm", f"{view.angle_deg:.1f}°", f"{view.roll_deg:+.1f}°"]
    if np.isinf(view.meeting_mm):
        return [*placed, "nowhere", ""]
    return [*placed, f"{view.meeting_mm:.0f} mm away", f"{view.gap_mm:.1f} mm"]


def _print_check(found: "workbench.landmarks.epipolar.RigCheck") -> None:
    numbers = ("frames", "median", "95 %", "of the eye distance", "best offset")
    table = screen.table("epipolar distance", *numbers, right=numbers)
    for pair in found.pairs:
        offset = "unknown" if pair.offset is None else "none" if pair.offset == 0 else f"{pair.offset:+d} frames"
        distances = (f"{pair.median_px:.2f} px", f"{pair.p95_px:.2f} px", f"{pair.median_percent:.1f} %")
        table.add_row(escape(" - ".join(pair.views)), str(pair.frames), *distances, offset)
    screen.console.print(table)
    screen.console.print()
    numbers = ("frames", "median", "95 %", *(("the others without it",) if len(found.views) > 2 else ()))
    table = screen.table("reprojection", *numbers, right=numbers)
    for view in found.views:
        others = [f"{view.others_px:.2f} px"] if len(found.views) > 2 else []
        table.add_row(escape(view.name), str(view.frames), f"{view.median_px:.2f} px", f"{view.p95_px:.2f} px", *others)
    screen.console.print(table)
    screen.console.print(f"outer eye corners: {found.eye_distance_mm:.1f} mm apart")
    _print_warnings(found.warnings)
    if found.warnings and len(found.views) == 2:
        screen.console.print("[dim]two views cannot tell which of them is off[/dim]")
    if not found.warnings:
        screen.console.print("nothing stands out")


def _print_warnings(warnings: tuple[str, ...]) -> None:
    for warning in warnings:
        screen.console.print(f"[yellow]warning:[/yellow] {escape(warning)}", soft_wrap=True)
