"""How messages get from the browser to a widget while a cell runs, and from widgets to the browser without loss."""

import asyncio
import sys
import time
from collections.abc import Callable
from uuid import uuid4

import comm
import zmq

UNLIMITED = 0
"""The number of messages that may wait, in ZeroMQ's words."""
SETTLED_S = 0.02
"""After which both ends of a connection that closes are gone; ZeroMQ's threads need some 0.1 ms."""
MOST_TRIES = 50
"""While connections close all the time."""


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


def lose_no_messages() -> None:
    """Let the kernel's messages to each page that is open wait, however many, until the server takes them.

    For what sends many: ZeroMQ drops what is more than 1,000 messages ahead, without a word. A panel is 1,600: beside
    a busy server parts of it were missing ("widget model not found"), or the cell never ended in the browser. Does
    nothing outside a kernel.
    """
    kernelbase = sys.modules.get("ipykernel.kernelbase")
    if kernelbase is None or not kernelbase.Kernel.initialized():
        return
    publishing = getattr(kernelbase.Kernel.instance(), "iopub_thread", None)
    if publishing is not None:
        # In the thread that the socket belongs to, before whatever is sent from now on.
        publishing.schedule(lambda: keep_unlimited(publishing.socket))


def keep_unlimited(publisher: zmq.Socket) -> None:
    """Lift the limit of waiting messages for the connections that a bound socket has.

    ZeroMQ 4.3 tells both ends of each connection, and the process ends where one has lost its other end, as it has for
    a moment when it closes. So this waits until none is closing: ZeroMQ says that one does before it begins.
    """
    told = publisher.get_monitor_socket(zmq.EVENT_DISCONNECTED, f"inproc://closed-{uuid4()}")
    try:
        for _ in range(MOST_TRIES):
            publisher.getsockopt(zmq.EVENTS)  # takes in connections that have just come, or begun to close
            time.sleep(SETTLED_S)
            publisher.getsockopt(zmq.EVENTS)  # lets go of those that have closed
            if not _some_closed(told):
                publisher.setsockopt(zmq.SNDHWM, UNLIMITED)
                return
    finally:
        publisher.disable_monitor()
        told.close()


def _some_closed(told: zmq.Socket) -> bool:
    """Whether connections have closed since this was asked last."""
    closed = False
    while told.getsockopt(zmq.EVENTS) & zmq.POLLIN:
        told.recv_multipart()
        closed = True
    return closed


def after_message(work: Callable[[], object], seconds: float = 0.0) -> None:
    """Do some work in this thread once it is done with its message (a cell, say), or some seconds from now.

    At once in a thread that handles no message. Without `seconds`, the work comes before the next message.
    """
    loop = _own_loop()
    if loop is None:
        work()
    elif seconds:
        loop.call_later(seconds, work)
    else:
        loop.call_soon(work)


def _own_loop() -> asyncio.AbstractEventLoop | None:
    """The loop that this thread runs; None outside a kernel's threads for cells and messages."""
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None
