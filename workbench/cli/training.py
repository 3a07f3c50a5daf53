"""`workbench train`: the recipes of the bundled networks."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from workbench.cli import screen
from workbench.extras import check_installed

TRAIN_HELP = """Train the networks that come with the package, from nothing but the default head.

Renders a pool of heads, trains, measures, calibrates, and writes weights with a report. Ctrl-C stops it; the same \
command goes on. A finished training is kept, unless you --overwrite it. \
Needs PyTorch: pip install "face-energy-workbench\\[train]".

[bold]Examples[/bold]

  workbench train landmarks training              hours on a CPU, minutes on a GPU

  workbench train landmarks training --quick      everything at a tiny size, to see it work

  workbench train landmarks training --start landmarks.safetensors
                                                  go on from weights that are there

  workbench train finder training                 the face finder, from the same pool

  workbench train dense training --start training/landmarks.safetensors
                                                  some 300 points with their uncertainty, on the landmark
                                                  network's encoder

  workbench train flow training                   the flow network, from pairs of its own
"""

train_app = typer.Typer(no_args_is_help=True, rich_markup_mode="rich", help=TRAIN_HELP)
Folder = Annotated[Path, typer.Argument(help="Folder for the pool, the checkpoints, the weights and the report.")]
Quick = Annotated[bool, typer.Option("--quick", help="A tiny run, to check that everything works.")]
Workers = Annotated[int, typer.Option(min=1, help="Processes that render and augment.")]
Device = Annotated[str, typer.Option(help="Where PyTorch computes: cpu or cuda.")]
Start = Annotated[
    Path | None,
    typer.Option(help="Weights to go on from, by a shorter plan; else from nothing."),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Train again, from the start; the pool is kept.")]

RESULTS = {
    "landmarks": ("landmarks.safetensors", "tables.md"),
    "finder": ("finder.safetensors",),
    "dense": ("dense.safetensors", "dense_tables.md"),
    "flow": ("flow.safetensors", "flow_tables.md"),
}
"""What each training leaves at its end. Its checkpoints are in a folder of its name."""


@train_app.command(help="Train the landmark network.")
def landmarks(
    folder: Folder,
    quick: Quick = False,
    workers: Workers = 1,
    device: Device = "cpu",
    start: Start = None,
    overwrite: Overwrite = False,
) -> None:
    """Train the landmark network."""
    check_installed("train", "torch")
    from workbench.training.recipe import FURTHER_LANDMARK_PLAN, QUICK, Recipe, train_landmark_network

    further = Recipe(plan=FURTHER_LANDMARK_PLAN, start=start) if start else Recipe()
    recipe = QUICK if quick else further
    with training_folder(folder, "landmarks", overwrite):
        screen.console.print(train_landmark_network(folder, recipe, workers, device, screen.console.print))
    screen.console.print((folder / "tables.md").read_text(encoding="utf-8"), markup=False)


@train_app.command(help="Train the face finder.")
def finder(
    folder: Folder,
    quick: Quick = False,
    workers: Workers = 1,
    device: Device = "cpu",
    start: Start = None,
    overwrite: Overwrite = False,
) -> None:
    """Train the face finder."""
    check_installed("train", "torch")
    from workbench.training.recipe import FINDER_PLAN, FURTHER_FINDER_PLAN, QUICK, Recipe, train_face_finder

    further = Recipe(plan=FURTHER_FINDER_PLAN, start=start) if start else Recipe(plan=FINDER_PLAN)
    recipe = QUICK if quick else further
    with training_folder(folder, "finder", overwrite):
        screen.console.print(train_face_finder(folder, recipe, workers, device, screen.console.print))


@train_app.command(help="Train the dense network.")
def dense(
    folder: Folder,
    quick: Quick = False,
    workers: Workers = 1,
    device: Device = "cpu",
    start: Start = None,
    overwrite: Overwrite = False,
) -> None:
    """Train the dense network."""
    check_installed("train", "torch")
    from workbench.training.recipe import DENSE_PLAN, QUICK_DENSE, Recipe, train_dense_network

    recipe = QUICK_DENSE if quick else Recipe(plan=DENSE_PLAN, start=start)
    with training_folder(folder, "dense", overwrite):
        screen.console.print(train_dense_network(folder, recipe, workers, device, screen.console.print))
    screen.console.print((folder / "dense_tables.md").read_text(encoding="utf-8"), markup=False)


@train_app.command(help="Train the flow network.")
def flow(
    folder: Folder, quick: Quick = False, workers: Workers = 1, device: Device = "cpu", overwrite: Overwrite = False
) -> None:
    """Train the flow network."""
    check_installed("train", "torch")
    from workbench.training.flow_recipe import QUICK_FLOW, FlowRecipe, train_flow_network

    recipe = QUICK_FLOW if quick else FlowRecipe()
    with training_folder(folder, "flow", overwrite):
        screen.console.print(train_flow_network(folder, recipe, workers, device, screen.console.print))
    screen.console.print((folder / "flow_tables.md").read_text(encoding="utf-8"), markup=False)


@contextmanager
def training_folder(folder: Path, name: str, overwrite: bool = False) -> Iterator[None]:
    """Keep a folder for one training, which may be an interrupted one that goes on.

    Raises `OutputError` where another one is at work, and for a finished training or files of somebody else, unless
    told to `overwrite` them.
    """
    from workbench.pipeline.output_folder import check_no_results, locked

    with locked(folder):
        begun = (folder / name).is_dir()
        there = [result for result in RESULTS[name] if (folder / result).exists()]
        if overwrite:
            shutil.rmtree(folder / name, ignore_errors=True)
        elif not begun or len(there) == len(RESULTS[name]):
            check_no_results(folder, there, "a finished training" if begun else f"a file {there[0]}" if there else "")
        yield
