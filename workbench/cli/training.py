"""`workbench train`: the recipes of the bundled networks."""

import importlib.util
from pathlib import Path
from typing import Annotated

import typer

from workbench.cli import screen
from workbench.errors import MissingDependencyError

TRAIN_HELP = """Train the networks that come with the package, from nothing but the default head.

Renders a pool of heads, trains, measures, calibrates, and writes weights with a report. Ctrl-C stops it; the same \
command goes on. Needs PyTorch: pip install "face-energy-workbench\\[train]".

[bold]Examples[/bold]

  workbench train landmarks training              hours on a CPU, minutes on a GPU

  workbench train landmarks training --quick      all of it in small, to see it work

  workbench train finder training                 the face finder, from the same pool

  workbench train flow training                   the flow network, from pairs of its own
"""

train_app = typer.Typer(no_args_is_help=True, rich_markup_mode="rich", help=TRAIN_HELP)
Folder = Annotated[Path, typer.Argument(help="Folder for the pool, the checkpoints, the weights and the report.")]
Quick = Annotated[bool, typer.Option("--quick", help="A tiny training, to see that it works.")]
Workers = Annotated[int, typer.Option(min=1, help="Processes that render and augment.")]
Device = Annotated[str, typer.Option(help="Where PyTorch computes: cpu or cuda.")]


@train_app.command(help="Train the landmark network.")
def landmarks(folder: Folder, quick: Quick = False, workers: Workers = 1, device: Device = "cpu") -> None:
    """Train the landmark network."""
    _check_torch()
    from workbench.training.recipe import QUICK, Recipe, train_landmark_network

    recipe = QUICK if quick else Recipe()
    screen.console.print(train_landmark_network(folder, recipe, workers, device, screen.console.print))
    screen.console.print((folder / "tables.md").read_text(encoding="utf-8"), markup=False)


@train_app.command(help="Train the face finder.")
def finder(folder: Folder, quick: Quick = False, workers: Workers = 1, device: Device = "cpu") -> None:
    """Train the face finder."""
    _check_torch()
    from workbench.training.recipe import FINDER_PLAN, QUICK, Recipe, train_face_finder

    recipe = QUICK if quick else Recipe(plan=FINDER_PLAN)
    screen.console.print(train_face_finder(folder, recipe, workers, device, screen.console.print))


@train_app.command(help="Train the flow network.")
def flow(folder: Folder, quick: Quick = False, workers: Workers = 1, device: Device = "cpu") -> None:
    """Train the flow network."""
    _check_torch()
    from workbench.training.flow_recipe import QUICK_FLOW, FlowRecipe, train_flow_network

    recipe = QUICK_FLOW if quick else FlowRecipe()
    screen.console.print(train_flow_network(folder, recipe, workers, device, screen.console.print))
    screen.console.print((folder / "flow_tables.md").read_text(encoding="utf-8"), markup=False)


def _check_torch() -> None:
    if importlib.util.find_spec("torch") is None:
        raise MissingDependencyError('training needs PyTorch: pip install "face-energy-workbench[train]"')
