"""`workbench train`: the recipes of the bundled networks."""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from workbench.cli import screen
from workbench.extras import check_installed
from workbench.files import check_not_inputs, writing
from workbench.training import PLAN_FILE

TRAIN_HELP = """Train the networks that come with the package, from nothing but the default head.

Renders a pool of heads, trains, measures, calibrates, and writes weights with a report. Ctrl-C stops it; \
run the command again, without --overwrite, to continue. A finished training is kept, unless you --overwrite it. \
Needs PyTorch: pip install "face-energy-workbench\\[train]".

[bold]Examples[/bold]

  workbench train landmarks training              hours on a CPU, minutes on a GPU

  workbench train landmarks training --quick      everything at a tiny size, to see it work

  workbench train landmarks training --start landmarks.safetensors
                                                  start from existing weights

  workbench train finder training                 the face finder, from the same pool

  workbench train dense training --start training/landmarks.safetensors
                                                  377 points with their uncertainty, on the landmark
                                                  network's encoder

  workbench train gain training                   how to correct the bundled dense network's points by the
                                                  bundled landmark network's; repeat when either changes

  workbench train eyes training                   pupils, irises and lids, from crops of single eyes

  workbench train flow training                   the flow network, from pairs of its own

  workbench train expressions training            which blendshapes act together (the prior E_usual), from
                                                  random expressions and the tracks in training/tracks
"""
Network = StrEnum("Network", ["landmarks", "finder", "dense", "gain", "eyes", "flow", "expressions"])
Device = StrEnum("Device", ["cpu", "cuda"])
RESULTS: Mapping[str, tuple[str, ...]] = {
    Network.landmarks: ("landmarks.safetensors", "tables.md"),
    Network.finder: ("finder.safetensors",),
    Network.dense: ("dense.safetensors", "dense_tables.md"),
    Network.gain: ("dense_gain.safetensors", "dense_gain_tables.md"),
    Network.eyes: ("eyes.safetensors", "eyes_tables.md"),
    Network.flow: ("flow.safetensors", "flow_tables.md"),
    Network.expressions: ("expressions.safetensors", "expressions_tables.md"),
}
"""What each training leaves at its end, tables last. Its checkpoints are in a folder of its name."""
WITHOUT_CHECKPOINTS = (Network.gain, Network.expressions)
"""Learned in one go; if it is interrupted, it starts over."""


def train(
    network: Annotated[Network, typer.Argument(help="What to train.")],
    folder: Annotated[Path, typer.Argument(help="Folder for the pool, the checkpoints, the weights and the report.")],
    quick: Annotated[bool, typer.Option("--quick", help="A tiny run, to check that everything works.")] = False,
    workers: Annotated[int, typer.Option(min=1, help="Processes that render and augment.")] = 1,
    device: Annotated[Device, typer.Option(help="Where PyTorch computes.")] = Device.cpu,
    start: Annotated[
        Path | None, typer.Option(help="Weights to start from; without it, training starts from scratch.")
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="Train again; old checkpoints and weights are deleted, the pool is kept."),
    ] = False,
) -> None:
    """Train one of the bundled networks."""
    check_installed("train", "torch")
    from workbench.training.trainings import TRAININGS

    training = TRAININGS[network]
    recipe = training.recipe(quick, start, device)
    training.check(recipe, device)
    with training_folder(folder, network, overwrite, start):
        screen.console.print(training.make(folder, recipe, workers, device, screen.console.print))
    for tables in (folder / name for name in RESULTS[network] if name.endswith(".md")):
        screen.console.print(tables.read_text(encoding="utf-8"), markup=False)


@contextmanager
def training_folder(folder: Path, network: str, overwrite: bool = False, start: Path | None = None) -> Iterator[None]:
    """Keep a folder for one training, which may be an interrupted one that goes on.

    To `overwrite` one removes its checkpoints and results, so that the new one can be interrupted, too. Raises
    `OutputError` where `start`, the weights to start from, would be overwritten, where another training is at work,
    and for a finished one or files of somebody else, unless told to `overwrite` them.
    """
    from workbench.pipeline.output_folder import check_no_results, locked

    checkpoints, results = folder / network, RESULTS[network]
    if start is not None:
        written = checkpoints.iterdir() if checkpoints.is_dir() else ()
        check_not_inputs([*(folder / result for result in results), *written], [start])
    with locked(folder):
        begun = (checkpoints / PLAN_FILE).is_file()
        there = [result for result in results if (folder / result).exists()]
        own = begun or (network in WITHOUT_CHECKPOINTS and results[0] in there)
        if overwrite:
            with writing(folder):
                if begun:
                    shutil.rmtree(checkpoints)
                for result in there:
                    (folder / result).unlink()
        elif there and not (own and len(there) < len(results)):
            check_no_results(folder, there, "a finished training" if own else f"a file {there[0]}")
        yield
