"""Benchmarks that take seconds run as `make bench` runs them; what they find is not judged here."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
import run_all

BENCHMARKS = Path(run_all.__file__).parent


@pytest.mark.long
@pytest.mark.parametrize("command", ["solve_time", "dense_batch --frames 12", "head_pose", "import_time"])
def test_a_benchmark_ends_with_one_line_of_its_result(command):
    name, *arguments = command.split()
    done = subprocess.run([sys.executable, BENCHMARKS / f"{name}.py", *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    line = json.loads(done.stdout.splitlines()[-1])
    assert set(line) == {"name", "value", "unit", "goal", "against", "details"}
    assert line["name"] == name
    assert line["value"] is not None or line["details"]["skipped"]


def test_make_bench_names_benchmarks_that_are_there():
    assert len(set(run_all.BENCHMARKS)) == len(run_all.BENCHMARKS)
    assert [name for name in run_all.BENCHMARKS if not (BENCHMARKS / f"{name}.py").is_file()] == []
