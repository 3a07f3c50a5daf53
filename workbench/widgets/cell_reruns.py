"""A cell that is run again replaces its panels: those that its earlier runs made are closed.

A panel that nobody sees any more would go on: its threads fit on every change of its session, and a live panel keeps
the camera. Cells are known by the number that JupyterLab gives them; of front ends that tell none, nothing is closed.
"""

import sys
import threading
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
    """Close the panels that earlier runs of this cell made; a later run will close this one.

    In a thread of its own, because a panel whose threads are at work takes seconds to close.
    """
    now = current_run()
    if now is None:
        return
    earlier = [made for made, run in list(MADE.items()) if run.cell == now.cell and run.run != now.run]
    MADE[panel] = now
    for made in earlier:
        del MADE[made]
    if earlier:
        threading.Thread(target=_close, args=(earlier,), name="close-earlier", daemon=True).start()


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


def _close(panels: list[widgets.Widget]) -> None:
    for panel in panels:
        panel.close()
