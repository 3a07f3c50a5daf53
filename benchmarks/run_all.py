"""Run most benchmarks in turn, each in its own process, and print a table. Fails only if one of them crashed.

`benchmarks/README.md` says which it leaves out.
"""

import json
import subprocess
import sys
from pathlib import Path

from result import meets
from rich.console import Console
from rich.table import Table

BENCHMARKS = (
    *(
        "solve_time",
        "video_rate",
        "video_rate_peers",
        "memory",
        "compile_time",
        "import_time",
        "head_pose",
        "panel_opening",
        "panel_latency",
        "live",
        "diagnosis",
    ),
    "panel_scale",
    *("rendering", "rendering_gradient", "rendering_peers", "appearance", "landmark_network", "landmark_photos"),
    *("dense_landmarks", "dense_batch", "expression_priors", "gaze", "jitter"),
    *("blinks", "deep_energies", "deep_characters", "deep_bundled_clips"),
    *("flow", "infill", "refinement", "temporal_memory", "stills", "characters_drawn"),
    *("sweep_rate", "sweep_scaling", "cluster_plan", "accelerator"),
)


def main() -> int:
    """Print the table; 1 if a benchmark crashed, else 0, whether or not the goals are met."""
    console = Console()
    table = Table("benchmark", "value", "against", "goal", "")
    crashed = False
    for name in BENCHMARKS:
        with console.status(name):
            program = Path(__file__).parent / f"{name}.py"
            done = subprocess.run([sys.executable, program], capture_output=True, text=True)
        if done.returncode:
            crashed = True
            console.print(done.stderr.strip(), style="red", markup=False)
            table.add_row(name, "–", "", "", "[red]crashed")
            continue
        line = done.stdout.strip().splitlines()[-1]
        console.print(line, markup=False, highlight=False, soft_wrap=True)
        table.add_row(*row_of(json.loads(line)))
    console.print(table)
    return int(crashed)


def row_of(result: dict) -> tuple[str, str, str, str, str]:
    """The cells of one result."""
    goal = result["goal"]
    if result["value"] is None:
        verdict, value = f"[yellow]skipped: {result['details']['skipped']}", "–"
    else:
        value = f"{result['value']:g} {result['unit']}"
        verdict = "" if goal is None else "[green]ok" if meets(result["value"], goal) else "[red]missed"
    return result["name"], value, result["against"], goal or "–", verdict


if __name__ == "__main__":
    sys.exit(main())
