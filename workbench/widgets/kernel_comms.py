"""How messages get from the browser to a widget while a cell runs, and from widgets to the browser without loss."""

import asyncio
import sys
import time
from collections.abc import Callable
from uuid import uuid4

import comm
import zmq
from zmq.utils.monitor import parse_monitor_message

UNLIMITED = 0
"""The number of messages that may wait, in ZeroMQ's words."""
LONGEST_S = 2.0
"""How long ZeroMQ's thread is waited for; it needs some 0.1 ms where it need not wait for a processor."""
TURNS = 6
"""In which a connection closes: its own end is asked to, ends, asks the socket's end, hears of it, and is gone."""
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
    events = zmq.EVENT_DISCONNECTED | zmq.EVENT_CLOSED
    told = publisher.get_monitor_socket(events, f"inproc://closed-{uuid4()}")
    try:
        for _ in range(MOST_TRIES):
            # Nothing was told of connections that began to close before: they are gone after so many turns.
            closing = [_settled(publisher, told) for _ in range(TURNS)]
            publisher.getsockopt(zmq.EVENTS)  # lets go of those that have closed
            if not any(closing) and zmq.EVENT_DISCONNECTED not in _heard(told):
                publisher.setsockopt(zmq.SNDHWM, UNLIMITED)
                return
    finally:
        publisher.disable_monitor()
        told.close()


def _settled(publisher: zmq.Socket, told: zmq.Socket) -> bool:
    """Wait until ZeroMQ's thread has done all that it was asked to. Returns whether a connection closed meanwhile.

    It works in turn: once it has closed an address that was opened for this alone, it has done what came before.
    """
    publisher.getsockopt(zmq.EVENTS)  # takes in connections that have just come, or begun to close
    publisher.bind("tcp://127.0.0.1:*")
    publisher.unbind(publisher.getsockopt(zmq.LAST_ENDPOINT))
    heard: list[int] = []
    until = time.monotonic() + LONGEST_S
    while zmq.EVENT_CLOSED not in heard and time.monotonic() < until:
        told.poll(100)
        heard += _heard(told)
    return zmq.EVENT_DISCONNECTED in heard or zmq.EVENT_CLOSED not in heard


def _heard(told: zmq.Socket) -> list[int]:
    """What a monitor has told since it was asked last."""
    events = []
    while told.getsockopt(zmq.EVENTS) & zmq.POLLIN:
        events.append(int(parse_monitor_message(told.recv_multipart())["event"]))
    return events


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


def handles_messages() -> bool:
    """Whether this is a kernel's thread for cells and messages."""
    return _own_loop() is not None


def _own_loop() -> asyncio.AbstractEventLoop | None:
    """The loop that this thread runs; None outside a kernel's threads for cells and messages."""
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None
