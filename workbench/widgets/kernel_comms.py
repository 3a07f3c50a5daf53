"""How messages from the browser reach a widget in the kernel while a cell runs."""

import sys

import comm


def answer_while_cells_run() -> None:
    """Let the messages of widgets made from now on be handled where the browser sends them, beside a cell that runs.

    JupyterLab sends them to a thread of their own, a subshell. ipykernel 7.4 sends them back to the thread from which
    the widget was last changed: after a change by a cell, or by a thread while a cell runs, they wait for the cell.
    Does nothing outside a kernel and in kernels that have no such rule.
    """
    kernel_comm = sys.modules.get("ipykernel.comm.comm")
    if kernel_comm is None or not hasattr(kernel_comm.BaseComm, "_reply_subshell_for"):
        return

    class AsAddressed(kernel_comm.BaseComm):
        def _reply_subshell_for(self, data: object, default: str | None) -> str | None:
            return default

    comm.create_comm = AsAddressed
