"""Which tests run, and in which order: marks of whole test files, what a run leaves out, long files first.

Tests run in two processes (`JOBS`). A file stays in one of them, with what its tests share; notebooks have
kernels of their own and are handed out one by one. A long file begun last would leave all processes but one idle.
"""

import os
from importlib.util import find_spec
from pathlib import Path

NOTEBOOKS = "test_notebooks.py"
SLOW = (
    "test_panel.py",
    "test_diagnosis_frames.py",
    "test_deep_energies.py",
    NOTEBOOKS,
    "test_face_formats.py",
    "test_nothing_lost.py",
    "test_cli_diagnose.py",
    "test_cli.py",
    "test_flow.py",
    "test_light_panel.py",
    "test_rendering.py",
    "test_energies.py",
    "test_pictures.py",
    "test_rig.py",
    "test_cli_over_time.py",
    "test_cli_models.py",
    "test_fuzz.py",
    "test_live_panel.py",
    "test_session.py",
    "test_dense_landmarks.py",
    "test_session_temporal.py",
    "test_tracker.py",
    "test_documentation.py",
    "test_flow_term.py",
    "test_networks.py",
    "test_time_page.py",
    "test_panel_design.py",
    "test_infill.py",
    "test_paper_deep_energies.py",
    "test_extras.py",
    "test_track_reader.py",
    "test_front_door.py",
    "test_cli_export.py",
    "test_sweeps.py",
)
"""Files that `make test-fast` leaves out besides those in a browser, the longest first."""
BROWSER = (
    "test_browser.py",
    "test_deep_panel_browser.py",
    "test_head_views_browser.py",
    "test_live_browser.py",
    "test_panel_browser.py",
    "test_panel_design_browser.py",
    "test_plain_panel_browser.py",
    "test_time_page_browser.py",
    "test_views_2d_browser.py",
)
"""Files that need Chromium as a whole."""
LONG = (
    "test_clip_character.py",
    "test_contributing.py",
    "test_deep_dense.py",
    "test_deep_pictures.py",
    "test_deep_pipeline.py",
    "test_diagnosis_schemes.py",
    "test_filled_lids.py",
    "test_learning.py",
    "test_learning_schemes.py",
    "test_networks_flownet2.py",
    "test_rendered_flow.py",
    "test_rendering_character.py",
    "test_sweep_schemes.py",
    "test_sweep_workers.py",
    "test_through_time.py",
    "test_workers.py",
)
"""Files that take renders through networks, differentiate whole fits, run whole systems under every landmark scheme,
paint characters, or kill and restart the processes of pools and clusters; single tests elsewhere have the mark."""
TRAIN = (
    "test_contact_sheets.py",
    "test_networks_checkpoints.py",
    "test_networks_fan.py",
    "test_networks_flow.py",
    "test_training.py",
    "test_training_batches.py",
    "test_training_dense.py",
    "test_training_expressions.py",
    "test_training_flow.py",
)
"""Files that need PyTorch as a whole; single tests elsewhere have the mark themselves."""
MARKS = {"slow": SLOW, "browser": BROWSER, "long": LONG, "train": TRAIN}
LEFT_OUT = {
    "slow": "long tests (make test)",
    "browser": "tests in a browser (make test-browser)",
    "long": "renders through networks, derivatives of fits, whole runs, and processes that are killed (make test-long)",
    "notebook": "notebooks from top to bottom (make notebooks)",
    "train": "tests of training and of PyTorch's models (make test-train)",
}
"""What the marks stand for, and the command that runs it."""
CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
"""What the process may compute on when it starts; empty where a system does not tell."""


def left_out(expression: str, torch: bool) -> list[str]:
    """The marks whose tests do not run, by the expression of `pytest -m` and by whether PyTorch is installed."""
    return [mark for mark in LEFT_OUT if f"not {mark}" in expression or (mark == "train" and not torch)]


def has_torch() -> bool:
    """Whether PyTorch is installed; it is not loaded."""
    return find_spec("torch") is not None


def marks_of(path: Path) -> list[str]:
    """The marks of every test of a file."""
    return [mark for mark, files in MARKS.items() if path.name in files]


def turn(path: Path) -> int:
    """The place of a file in the order: slow ones, browsers, the rest."""
    order = (*SLOW, *BROWSER)
    return order.index(path.name) if path.name in order else len(order)


def unit(nodeid: str) -> str:
    """What one process runs without a break: a notebook, or else all tests of a file."""
    file = nodeid.split("::")[0]
    return nodeid if Path(file).name == NOTEBOOKS else file


def share(cores: list[int], process: int, processes: int) -> list[int]:
    """The cores of one of several processes; with fewer cores than processes, some share one."""
    if processes >= len(cores):
        return cores[process % len(cores) :][:1]
    return cores[process * len(cores) // processes : (process + 1) * len(cores) // processes]


def keep_to_its_cores(browser: bool) -> None:
    """Let a process of several compute on its share of the cores, or on all of them where it starts a browser."""
    name = os.environ.get("PYTEST_XDIST_WORKER")
    if name and CORES:
        mine = share(CORES, int(name.removeprefix("gw")), int(os.environ["PYTEST_XDIST_WORKER_COUNT"]))
        os.sched_setaffinity(0, CORES if browser else mine)


def in_order(config, log):
    """A scheduler of pytest-xdist that hands out units in the order in which they were collected."""
    from xdist.scheduler import LoadScopeScheduling

    class InOrder(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return unit(nodeid)

        def remove_node(self, node) -> str | None:
            """Hand out what a process that died has not run, without the test that ended it: it would end the next."""
            units = self.assigned_work.pop(node)
            ended = next((test for tests in units.values() for test, done in tests.items() if not done), None)
            if ended is None:
                return None
            for name, tests in units.items():
                tests |= {ended: True} if ended in tests else {}
                if not all(tests.values()):
                    self.workqueue[name] = tests
            for other in self.registered_collections.keys() & self.assigned_work.keys():
                self._reschedule(other)
            return ended

        def _reschedule(self, node) -> None:
            """A process runs a test when it knows the next one: hand out units until it does, or until all are out."""
            super()._reschedule(node)
            while not node.shutting_down and self._pending_of(self.assigned_work[node]) < 2:
                super()._reschedule(node)

    config.option.loadscopereorder = False
    return InOrder(config, log)
