"""Seconds and screens of every notebook: its kernel's time by the clock and of the processor, and the page's length."""

import argparse
import os
import sys
import tempfile
from pathlib import Path

from result import print_result

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tests.notebook_runs import NOTEBOOKS, ROOT, ruler, run_notebook

AGAINST = "the notebook that takes longest, second of two runs with one compilation cache"


def main() -> None:
    """Run notebooks twice and print a line for each; a result for the slowest."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("numbers", nargs="*", help="of the notebooks to run, such as 05; all by default")
    parser.add_argument("--once", action="store_true", help="once, where programs are compiled already")
    parser.add_argument("--out", type=Path, help="folder for the notebooks with their outputs")
    given = parser.parse_args()
    chosen = [path for path in NOTEBOOKS if not given.numbers or path.stem[:2] in given.numbers]
    os.environ["PYTHONPATH"] = str(ROOT)
    os.environ.pop("MPLBACKEND", None)
    found = {}
    for path in chosen:
        for _ in range(1 if given.once else 2):
            with tempfile.TemporaryDirectory() as folder:
                run = run_notebook(path, Path(folder))
        with ruler() as measure:
            screens = measure.screens(run.notebook)
        found[path.stem] = {"wall_s": run.wall_s, "processor_s": run.processor_s, "screens": screens}
        print(
            f"{path.stem}: {run.wall_s:.0f} s, {run.processor_s:.0f} s of processor, {screens:.1f} screens", flush=True
        )
        if given.out:
            given.out.mkdir(parents=True, exist_ok=True)
            import nbformat

            nbformat.write(run.notebook, given.out / path.name)
    slowest = max(each["wall_s"] for each in found.values())
    print_result("notebooks", slowest, "s", "<= 60", AGAINST, found)


if __name__ == "__main__":
    main()
