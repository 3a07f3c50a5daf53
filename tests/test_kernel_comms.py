"""A widget in a real kernel with a subshell, as JupyterLab uses it: what it hears while a cell runs."""

import asyncio
import queue
import subprocess
import sys
import time

import pytest
from jupyter_client.blocking.client import BlockingKernelClient
from jupyter_client.manager import start_new_kernel

from workbench.errors import InputError
from workbench.widgets.kernel_comms import after_message
from workbench.widgets.late_parts import LateParts

WIDGET = """
import threading
import ipywidgets
import workbench.widgets

heard = []
widget = ipywidgets.IntText()
widget.observe(lambda change: heard.append(threading.current_thread()), "value")
"""
CHANGED_BY_CELL = "widget.description = 'changed by a cell'"
CHANGED_BY_THREAD = """
changing = threading.Thread(target=setattr, args=(widget, "description", "changed by a thread"))
changing.start()
changing.join()
"""
BUSY = """
import time
{change}
print("busy")
deadline = time.monotonic() + 20
while not heard and time.monotonic() < deadline:
    pass
elsewhere = [thread is not threading.main_thread() for thread in heard]
heard.clear()
print("heard", elsewhere)
"""
COMING_AND_GOING = """
import random, threading, time
import zmq
from workbench.widgets.kernel_comms import UNLIMITED, keep_unlimited

publisher = zmq.Context().socket(zmq.XPUB)
address = f"tcp://127.0.0.1:{publisher.bind_to_random_port('tcp://127.0.0.1')}"
until = time.monotonic() + 3.0

def come_and_go(seed):
    context, pause = zmq.Context(), random.Random(seed)
    while time.monotonic() < until:
        page = context.socket(zmq.SUB)
        page.linger = 0
        page.connect(address)
        page.subscribe(b"")
        time.sleep(pause.uniform(0.005, 0.06))
        page.close()
        time.sleep(pause.uniform(0.0, 0.03))

pages = [threading.Thread(target=come_and_go, args=(seed,)) for seed in range(3)]
for page in pages:
    page.start()
lifted = 0
while time.monotonic() < until:
    keep_unlimited(publisher)
    publisher.send(b"x")
    lifted += publisher.getsockopt(zmq.SNDHWM) == UNLIMITED
print(lifted)
"""
PANEL = """
from workbench.widgets import LightPanel

def shown(light):
    return numpy.zeros((8, 8, 3))

before = weakref.ref(panel) if panel else lambda: None
panel = LightPanel(shown)
kept = kept or [LightPanel(shown)]
"""
WHICH = """
deadline = time.monotonic() + {wait_s}
while before() is not None and before().comm is not None and time.monotonic() < deadline:
    time.sleep(0.01)
print("panel", before() is None or before().comm is None, panel.comm is not None, kept[0].comm is not None)
"""
LONGEST_S = 60.0
MANY = 20000
"""Messages: far more than ZeroMQ keeps by itself, and the buffers of a connection hold."""


@pytest.fixture(scope="module")
def kernel():
    manager, talk = start_new_kernel(kernel_name="python3")
    try:
        yield talk
    finally:
        talk.stop_channels()
        manager.shutdown_kernel(now=True)


@pytest.fixture(scope="module")
def subshell(kernel):
    request = kernel.session.msg("create_subshell_request", {})
    kernel.control_channel.send(request)
    reply = kernel.get_control_msg(timeout=LONGEST_S)
    while reply["parent_header"]["msg_id"] != request["header"]["msg_id"]:
        reply = kernel.get_control_msg(timeout=LONGEST_S)
    return reply["content"]["subshell_id"]


@pytest.fixture(scope="module")
def widget(kernel):
    """The name by which the browser knows the widget."""
    kernel.execute(WIDGET)
    kernel.execute("print('id', widget.model_id)")
    return printed(kernel, "id").split()[1]


def printed(kernel, start):
    """The next whole line that begins so; a line may come in several messages."""
    deadline, text = time.monotonic() + LONGEST_S, ""
    while time.monotonic() < deadline:
        try:
            message = kernel.get_iopub_msg(timeout=1.0)
        except queue.Empty:
            continue
        assert message["msg_type"] != "error", message["content"]["traceback"]
        if message["msg_type"] == "stream":
            text += message["content"]["text"]
            *lines, text = text.split("\n")
            for line in lines:
                if line.startswith(start):
                    return line
    raise AssertionError(f"no line printed that begins with {start!r}")


@pytest.mark.parametrize("change", ["", CHANGED_BY_CELL, CHANGED_BY_THREAD], ids=["left alone", "cell", "thread"])
def test_a_widget_hears_the_browser_while_a_cell_runs(kernel, subshell, widget, change, request):
    kernel.execute(BUSY.format(change=change))
    printed(kernel, "busy")
    value = 1 + len(request.node.name)
    message = kernel.session.msg(
        "comm_msg", {"comm_id": widget, "data": {"method": "update", "state": {"value": value}, "buffer_paths": []}}
    )
    message["header"]["subshell_id"] = subshell
    kernel.shell_channel.send(message)
    assert printed(kernel, "heard") == "heard [True]"


@pytest.mark.parametrize(
    ("metadata", "closed", "wait_s"), [({"cellId": "a"}, True, 30), ({}, False, 0.3)], ids=["JupyterLab", "no cell"]
)
def test_a_rerun_of_a_cell_replaces_its_panel_where_the_front_end_names_the_cell(
    kernel, widget, metadata, closed, wait_s
):
    kernel.execute("import time, weakref\nimport numpy\npanel = kept = None")
    content = {"code": PANEL, "silent": False, "store_history": True, "user_expressions": {}, "allow_stdin": False}
    for told in ("panel True True True", f"panel {closed} True True"):
        kernel.shell_channel.send(kernel.session.msg("execute_request", content, metadata=metadata))
        kernel.execute(WHICH.format(wait_s=wait_s))
        assert printed(kernel, "panel") == told


@pytest.fixture(params=["page of before", "page opened later"])
def listener(request, kernel, widget):
    """What hears the kernel: connected before the widget was made, or since."""
    if request.param == "page of before":
        yield kernel
        return
    later = BlockingKernelClient()
    later.load_connection_info(kernel.get_connection_info())
    later.start_channels(shell=False, stdin=False, hb=False, control=False)
    while True:  # until it hears something it may not be connected
        kernel.execute("print('hello')")
        try:
            later.get_iopub_msg(timeout=1.0)
            break
        except queue.Empty:
            continue
    yield later
    later.stop_channels()


@pytest.mark.long
def test_nothing_is_lost_while_the_server_does_not_listen(kernel, widget, listener):
    """Neither are the parts of a panel, which come all at once."""
    kernel.execute("workbench.widgets.kernel_comms.lose_no_messages()")  # as panels do
    kernel.execute(f"for number in range({MANY}):\n    widget.send({{'number': number, 'padding': 'x' * 500}})")
    kernel.execute("print('all sent')")
    time.sleep(2.0)  # a server that is busy
    numbers, deadline = [], time.monotonic() + LONGEST_S
    while time.monotonic() < deadline:
        message = listener.get_iopub_msg(timeout=LONGEST_S)
        if message["msg_type"] == "comm_msg" and "number" in message["content"]["data"].get("content", {}):
            numbers.append(message["content"]["data"]["content"]["number"])
        if message["msg_type"] == "stream" and "all sent" in message["content"]["text"]:
            break
    assert numbers == list(range(MANY))


def test_the_limit_is_lifted_while_pages_come_and_go():
    """In a process of its own: where an end of a connection that closes is told of it, ZeroMQ ends the process."""
    ended = subprocess.run([sys.executable, "-c", COMING_AND_GOING], capture_output=True, text=True, timeout=LONGEST_S)
    assert ended.returncode == 0, ended.stderr
    assert int(ended.stdout) > 10


def test_what_comes_after_a_cell_waits_for_its_end_and_outside_of_one_for_nothing():
    done = []

    async def cell():
        after_message(lambda: done.append("after"))
        done.append("cell")

    async def two_cells():
        await cell()
        await asyncio.sleep(0)
        done.append("next cell")

    asyncio.run(two_cells())
    after_message(lambda: done.append("at once"))
    assert done == ["cell", "after", "next cell", "at once"]


def test_what_comes_some_time_after_a_message_waits_for_it_and_outside_of_one_for_nothing():
    done = []

    async def message():
        after_message(lambda: done.append("later"), 0.02)
        done.append("message")
        await asyncio.sleep(0.2)

    asyncio.run(message())
    after_message(lambda: done.append("at once"), 30.0)
    assert done == ["message", "later", "at once"]


class Broken(LateParts):
    """Its parts cannot be made."""

    def _make_parts(self) -> None:
        raise InputError("no parts today")


def test_parts_that_cannot_be_made_say_why_in_their_place_and_again_where_one_is_asked_for():
    logged = []

    async def cell():
        asyncio.get_running_loop().set_exception_handler(lambda _loop, context: logged.append(context["exception"]))
        made = Broken([])
        assert made.children == ()
        await asyncio.sleep(0)
        return made

    broken = asyncio.run(cell())
    (told,) = broken.children
    assert "no parts today" in told.value
    assert [str(error) for error in logged] == ["no parts today"]
    for _ in range(2):
        with pytest.raises(InputError, match="no parts today"):
            broken.transport  # noqa: B018
    broken.close()
