"""A cell that is run again replaces its panels: those that its earlier runs made, and no variable holds, are closed.

A panel that nobody sees any more would go on: its threads fit on every change of its session, and a live panel keeps
the camera. Cells are known by the number that JupyterLab gives them; of front ends that tell none, nothing is closed.
"""

import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import ipywidgets as widgets

from workbench.widgets.kernel_comms import handles_messages


@dataclass(frozen=True)
class CellRun:
    """One run of a cell."""

    cell: str
    run: str
    """The number of the message that asked for it."""


MADE: WeakKeyDictionary[widgets.Widget, CellRun] = WeakKeyDictionary()
"""The run that made each panel."""


def replace_earlier(panel: widgets.Widget) -> None:
    """Once the cell has run, close the panels that its earlier runs made; a later run will close this one.

    Panels that a variable holds by then stay: the cell has kept them on purpose.
    """
    now = current_run()
    if now is None:
        return
    arranged = now in list(MADE.values())
    MADE[panel] = now
    if not arranged:
        _after_the_cell(lambda: _close_earlier(now))


def current_run() -> CellRun | None:
    """The run of a cell that is going on in this thread; None outside a cell, or if the front end does not name it."""
    message = _message() if handles_messages() else {}
    if message.get("header", {}).get("msg_type") != "execute_request":
        return None
    cell = message.get("metadata", {}).get("cellId")
    return CellRun(cell, message["header"]["msg_id"]) if cell else None


def _message() -> dict[str, Any]:
    """The message that the kernel is handling; empty outside a kernel."""
    kernelbase = sys.modules.get("ipykernel.kernelbase")
    if kernelbase is None or not kernelbase.Kernel.initialized():
        return {}
    return kernelbase.Kernel.instance().get_parent("shell") or {}


def _shell() -> Any:
    """IPython's shell; None outside of it."""
    ipython = sys.modules.get("IPython")
    return None if ipython is None else ipython.get_ipython()


def _after_the_cell(work: Callable[[], None]) -> None:
    """Do some work once the running cell has ended; at once where no shell runs it."""
    shell = _shell()
    if shell is None:
        work()
        return

    def once() -> None:
        shell.events.unregister("post_execute", once)
        work()

    shell.events.register("post_execute", once)


def _close_earlier(now: CellRun) -> None:
    """In a thread of its own, because a panel whose threads are at work takes seconds to close."""
    kept = [id(panel) for panel in _held_by_variables()]
    made = list(MADE.items())
    earlier = [panel for panel, run in made if run.cell == now.cell and run.run != now.run and id(panel) not in kept]
    for panel in earlier:
        del MADE[panel]
    if earlier:
        threading.Thread(target=_close, args=(earlier,), name="close-earlier", daemon=True).start()


def _held_by_variables() -> list[object]:
    """What the user's variables hold, by themselves or in a list, tuple, set or dictionary; not IPython's own ones."""
    shell = _shell()
    if shell is None:
        return []
    variables = list(shell.user_ns.items())
    held = [value for name, value in variables if not (name.startswith("_") or name in shell.user_ns_hidden)]
    for value in list(held):
        if isinstance(value, list | tuple | set):
            held += value
        elif isinstance(value, dict):
            held += value.values()
    return held


def _close(panels: list[widgets.Widget]) -> None:
    for panel in panels:
        panel.close()
