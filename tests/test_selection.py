"""Which tests a run takes and leaves out, and how they are handed to several processes."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import selection

ROOT = Path(__file__).resolve().parent.parent
FILES = [*selection.SLOW, *selection.BROWSER, *selection.LONG, *selection.TRAIN]


def collected(*options: str) -> subprocess.CompletedProcess:
    """What pytest finds in this file with these options."""
    command = [sys.executable, "-m", "pytest", "--override-ini=addopts=", "--collect-only", "-q", *options, __file__]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


@pytest.mark.parametrize("name", FILES)
def test_the_tables_name_files_that_exist(name):
    assert (ROOT / "tests" / name).is_file()


def test_a_file_is_in_one_table_only():
    assert len(FILES) == len(set(FILES))


def test_every_file_that_cannot_be_imported_without_pytorch_has_the_mark():
    # Skins are painted, and a training's folder is known, without PyTorch.
    harmless = r"from workbench\.training(\.skin| import PLAN_FILE)"
    needs = re.compile(rf"^(import torch|from torch|torch = |(?!{harmless})from workbench\.training)", re.M)
    found = {path.name for path in (ROOT / "tests").glob("test_*.py") if needs.search(path.read_text("utf-8"))}
    assert found == set(selection.TRAIN)


@pytest.mark.parametrize(
    ("expression", "torch", "marks"),
    [
        ("", True, []),
        ("", False, ["train"]),
        ("not train", True, ["train"]),
        ("not train and not notebook", True, ["notebook", "train"]),
        ("not train and not notebook and not long", True, ["long", "notebook", "train"]),
        ("not train and not slow and not browser", True, ["slow", "browser", "train"]),
        ("browser", True, []),
        ("train", True, []),
    ],
)
def test_a_run_leaves_out_what_its_expression_says_and_what_needs_an_absent_pytorch(expression, torch, marks):
    assert selection.left_out(expression, torch) == marks


def test_a_run_says_in_a_line_each_what_it_left_out():
    lines = collected("-m", "not train and not notebook").stdout.splitlines()
    assert [line for line in lines if line.startswith("Left out")] == [
        "Left out: notebooks from top to bottom (make notebooks)",
        "Left out: tests of training and of PyTorch's models (make test-train)",
    ]


def test_a_file_stays_in_one_process_and_notebooks_are_handed_out_one_by_one():
    notebook = f"tests/{selection.NOTEBOOKS}::test_a_notebook_runs"
    assert selection.unit("tests/test_panel.py::test_a[1]") == selection.unit("tests/test_panel.py::TestB::test_c")
    assert selection.unit(f"{notebook}[00]") != selection.unit(f"{notebook}[01]")


def test_slow_files_come_first_then_browsers():
    names = ["test_arrays.py", selection.BROWSER[0], selection.SLOW[1], selection.SLOW[0]]
    paths = sorted(map(Path, names), key=selection.turn)
    assert [path.name for path in paths] == names[::-1]


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_programs_that_make_starts_keep_what_python_compiled_where_a_container_says_not_to():
    command = ["make", "--silent", "--eval", "told: ; @env", "told"]
    told = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}, capture_output=True, text=True
    )
    assert "PATH=" in told.stdout
    assert "PYTHONDONTWRITEBYTECODE" not in told.stdout


@pytest.mark.parametrize(("cores", "processes"), [(2, 2), (8, 3), (5, 2), (3, 3)])
def test_processes_share_the_cores_between_them(cores, processes):
    shares = [selection.share(list(range(cores)), k, processes) for k in range(processes)]
    assert sorted(core for share in shares for core in share) == list(range(cores))
    assert min(map(len, shares)) >= cores // processes


def test_with_fewer_cores_than_processes_each_has_one():
    assert [selection.share([4, 6], k, 3) for k in range(3)] == [[4], [6], [4]]


def test_a_test_that_hangs_ends_with_the_stack_of_every_thread_in_one_process_or_several(tmp_path):
    pytest.importorskip("xdist")
    (tmp_path / "test_hang.py").write_text("import time\ndef test_hangs():\n    time.sleep(60)\n")
    for processes in ("0", "1"):
        command = [*(sys.executable, "-m", "pytest", f"--rootdir={tmp_path}", "-p", "no:cacheprovider")]
        command += ["-o", "faulthandler_timeout=1", "-o", "faulthandler_exit_on_timeout=true", "-n", processes]
        done = subprocess.run([*command, str(tmp_path)], cwd=tmp_path, capture_output=True, text=True, timeout=50)
        assert done.returncode != 0
        assert "in test_hangs" in done.stdout + done.stderr


def test_a_process_that_dies_costs_one_test_and_the_run_ends(tmp_path):
    (tmp_path / "conftest.py").write_text(
        "from tests import selection\n\n\n"
        "def pytest_xdist_make_scheduler(config, log):\n    return selection.in_order(config, log)\n"
    )
    tests = ("def test_before(): pass", "def test_dies(): os._exit(1)", "def test_after(): pass")
    (tmp_path / "test_first.py").write_text("\n".join(["import os", *tests]))
    for name in ("second", "third", "fourth"):
        (tmp_path / f"test_{name}.py").write_text(f"def test_{name}(): pass\n")
    options = ("-q", "-n2", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), str(tmp_path))
    run = subprocess.run(
        [sys.executable, "-m", "pytest", *options],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert "test_first.py::test_dies - worker" in run.stdout
    assert "1 failed, 5 passed" in run.stdout
