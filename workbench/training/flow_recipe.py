"""The recipe of the bundled flow network in one call: pairs, training, weights, measurement, report."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from workbench.files import atomic_path
from workbench.flow import DisFlow, FarnebackFlow, NetworkFlow
from workbench.networks import read_flow_network, read_weights
from workbench.training.contact_sheet import pair_samples, shown_early
from workbench.training.flow_measuring import flow_tables, measured_flow
from workbench.training.flow_pool import make_pair_pool, open_pair_pool
from workbench.training.flow_task import FlowTask
from workbench.training.loop import Phase, TrainingPlan, checked_plan, train
from workbench.training.report import curves_figure
from workbench.training.shipping import write_shipped

FLOW_PLAN = TrainingPlan(
    phases=(
        Phase(128, 3000, 12, 2e-3),
        Phase(192, 900, 8, 1e-3),
        Phase(256, 500, 5, 6e-4),
        Phase(256, 550, 5, 5e-4),
        Phase(256, 600, 5, 4e-4),
    ),
    widths=(32, 48, 64, 96),
    blocks=1,
)
PAIR_SEED, PAIR_TEST_SEED = 6, 1006
CURVES = {"loss": "loss", "face_px": "visible face, pixels"}


@dataclass(frozen=True)
class FlowRecipe:
    """Sizes of one training; the defaults made the bundled weights."""

    pairs: int = 4920
    test_pairs: int = 480
    plan: TrainingPlan = FLOW_PLAN
    evaluated: int = 300
    side: int = 256
    """Pixels of the pictures that are measured, and of the network's input there."""


QUICK_FLOW = FlowRecipe(
    pairs=120,
    test_pairs=120,
    plan=TrainingPlan(phases=(Phase(64, 20, 4, 2e-3), Phase(128, 4, 2, 1e-3)), widths=(8, 8, 12, 12), blocks=1),
    evaluated=10,
    side=128,
)
"""Everything once, in a minute or two: to see that it works."""


def train_flow_network(
    folder: Path,
    recipe: FlowRecipe = FlowRecipe(),
    workers: int = 1,
    device: str = "cpu",
    report: Callable[[str], None] = print,
) -> Path:
    """Make the flow network from nothing: `folder/flow.safetensors`, and a report beside it.

    Called again after an interruption it goes on where it stopped. Raises `InputError` where the folder belongs to
    another plan.
    """
    plan = replace(recipe.plan, pictures=recipe.pairs)
    checked_plan(FlowTask(), folder / "flow", plan, device)
    pool, test = folder / "pairs", folder / "pairs_test"
    make_pair_pool(pool, recipe.pairs, PAIR_SEED, workers, shown_early(report, pool, pair_samples))
    make_pair_pool(
        test,
        recipe.test_pairs,
        PAIR_TEST_SEED,
        workers,
        lambda done, total: report(f"rendered {done} of {total} pairs"),
    )
    raw = train(FlowTask(), pool, folder / "flow", plan, workers, device, report=report)
    path = folder / "flow.safetensors"
    write_shipped(path, read_weights(raw), recipe.plan.seed)
    report("measuring on pairs that it has not seen")
    estimators = {
        "network": NetworkFlow(read_flow_network(path), recipe.side), "DIS": DisFlow(), "Farnebäck": FarnebackFlow()
    }  # fmt: skip
    numbers = measured_flow(estimators, open_pair_pool(test, recipe.test_pairs), recipe.evaluated, recipe.side)
    with atomic_path(folder / "flow_numbers.json") as temporary:
        temporary.write_text(json.dumps(numbers, indent=1), encoding="utf-8")
    with atomic_path(folder / "flow_tables.md") as temporary:
        temporary.write_text(flow_tables(numbers), encoding="utf-8")
    with atomic_path(folder / "flow_curves.png") as temporary:
        curves_figure(folder / "flow" / "curves.csv", CURVES).savefig(temporary, dpi=100)
    return path
