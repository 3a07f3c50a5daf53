"""Shared set-up: one compilation cache for the whole run and its subprocesses, shared models."""

import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests import selection, type_checks
from tests.fuzzing import Tally
from tests.memory import let_go_of_programs

# Set before anything imports JAX; notebooks' kernels inherit it.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).resolve().parent.parent / ".cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
# What tests run once or twice takes longer to compile than to run: without XLA's newer way of making kernels, and
# without LLVM's optimisations.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0")
os.environ.setdefault("MPLBACKEND", "agg")
# Before NumPy and JAX make a thread a core: with two processes their threads wait for one another most of the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
selection.keep_to_its_cores(browser=False)
type_checks.install()
# PyTorch's builds for CUDA load triton, whose LLVM crashes in a process that has drawn with a software GL's.
sys.modules.setdefault("triton", None)

# Hypothesis draws the same examples on every machine; compiled functions make the first call slow.
settings.register_profile("workbench", derandomize=True, deadline=None, max_examples=40)
settings.load_profile("workbench")

TALLY = pytest.StashKey[Tally]()
FUZZ_INPUTS = 2500
"""Damaged files of a usual run, over all readers."""


def pytest_addoption(parser):
    parser.addoption("--fuzz-inputs", type=int, default=None, help=f"damaged files to try, {FUZZ_INPUTS} by default")


def pytest_configure(config):
    config.stash[TALLY] = Tally(config.getoption("--fuzz-inputs") or FUZZ_INPUTS)


def pytest_ignore_collect(collection_path, config):
    """A file that is left out as a whole is not even imported."""
    absent = selection.left_out(config.option.markexpr, selection.has_torch())
    return True if set(absent) & set(selection.marks_of(collection_path)) else None


def pytest_itemcollected(item):
    for mark in selection.marks_of(item.path):
        item.add_marker(mark)


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: selection.turn(item.path))


def pytest_collection_finish():
    # Modules and tests stay to the end: looking through them for garbage takes half a second each time.
    gc.freeze()


def pytest_runtest_setup(item):
    type_checks.begin_test()
    # Chromium, server and kernel of a browser test are processes of their own.
    selection.keep_to_its_cores(browser=item.get_closest_marker("browser") is not None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """A browser test that fails says what page and kernel were doing."""
    report = yield
    if report.when == "call" and report.failed and item.get_closest_marker("browser") is not None:
        from tests.browser import LabPage

        pages = (value for value in item.funcargs.values() if isinstance(value, LabPage))
        report.sections += [("page and kernel", page.state()) for page in pages]
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item, nextitem):
    result = yield
    if nextitem is None or nextitem.path != item.path:
        let_go_of_programs()
    return result


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    return selection.in_order(config, log)


def pytest_terminal_summary(terminalreporter, config):
    """What was left out, and the verdicts of a long run."""
    for mark in selection.left_out(config.option.markexpr, selection.has_torch()):
        terminalreporter.write_line(f"Left out: {selection.LEFT_OUT[mark]}")
    if config.getoption("--fuzz-inputs") and config.stash[TALLY].counts:
        terminalreporter.section("damaged files")
        terminalreporter.write_line(config.stash[TALLY].table())


@pytest.fixture(scope="session")
def fuzz_tally(pytestconfig) -> Tally:
    """Counts what readers make of damaged files."""
    return pytestconfig.stash[TALLY]


@pytest.fixture(scope="session")
def head():
    """The default head with FACE IT!'s 44 blendshapes."""
    from workbench.face import load_default_head

    return load_default_head()


@pytest.fixture(scope="session")
def film_maker(head):
    """Makes small films whose every parameter is known."""
    from tests.films import FilmMaker

    return FilmMaker(head)


@pytest.fixture(scope="session")
def screenshots(tmp_path_factory) -> Path:
    """Folder for pictures of the browser tests; WORKBENCH_SCREENSHOTS keeps them."""
    kept = os.environ.get("WORKBENCH_SCREENSHOTS")
    return Path(kept) if kept else tmp_path_factory.mktemp("screenshots")


@pytest.fixture(scope="session")
def lab_server(tmp_path_factory):
    """One JupyterLab for all browser tests of a process."""
    from tests import browser

    assert not browser.missing(), browser.missing()
    folder, settings = tmp_path_factory.mktemp("notebooks"), tmp_path_factory.mktemp("jupyter")
    with browser.lab_server(folder, settings) as running:
        yield running


@pytest.fixture(scope="session")
def chromium(tmp_path_factory) -> Iterator[str]:
    """One Chromium for all browser tests of a process: its address."""
    from tests import browser

    assert not browser.missing(), browser.missing()
    with browser.chromium(tmp_path_factory.mktemp("profile")) as address:
        yield address


@pytest.fixture(scope="module")
def server(lab_server, request):
    """The shared JupyterLab with a folder for the notebooks of this file."""
    with lab_server.in_room(request.path.stem) as room:
        yield room


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """Run a command line in an empty folder: (exit code, standard output, standard error)."""
    from workbench import cli
    from workbench.cli import screen

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(screen, "console", screen.Console(width=200, highlight=False))
    monkeypatch.setattr(screen, "errors", screen.Console(width=200, stderr=True, highlight=False))

    def call(*arguments: str):
        monkeypatch.setattr(sys, "argv", ["workbench", *arguments])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        out, err = capsys.readouterr()
        return stop.value.code or 0, out, err

    return call
