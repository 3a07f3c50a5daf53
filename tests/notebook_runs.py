"""Notebooks run from top to bottom in a kernel of their own: what comes out, what it costs, how long the page is."""

import asyncio
import re
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import nbformat
import zmq
from nbclient import NotebookClient
from nbconvert import HTMLExporter
from nbformat import NotebookNode

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
TIMEOUT_S = 300
SCREEN_PX = (1300, 650)
"""Width and height that JupyterLab leaves to a notebook in a window of 1366 × 768 pixels."""
WIDGET_VIEW = "application/vnd.jupyter.widget-view+json"
WIDGET_PX = {"TuningPanel": 638, "SessionOpener": 690, "LivePanel": 560, "FitPlayground": 560, "AvatarPlayer": 360}
"""Heights of widgets in that window by the beginning of their `repr`; of any other, `OTHER_WIDGET_PX`."""
OTHER_WIDGET_PX = 300


@dataclass(frozen=True)
class NotebookRun:
    """A notebook with its outputs, and the seconds of its kernel: by the clock, and of the processor."""

    notebook: NotebookNode
    wall_s: float
    processor_s: float

    @property
    def outputs(self) -> list[NotebookNode]:
        """The outputs of all cells in order."""
        return [output for cell in self.notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def run_notebook(path: Path, folder: Path) -> NotebookRun:
    """Run a notebook in `folder`; its file stays as it is. Raises `CellExecutionError` where a cell fails."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook, timeout=TIMEOUT_S, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    )
    began, spent = time.perf_counter(), _children_s()
    asyncio.run(_executed(client))
    return NotebookRun(notebook, time.perf_counter() - began, _children_s() - spent)


def _children_s() -> float:
    """Processor seconds of processes that this one has waited for, kernels with their own children among them."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


async def _executed(client: NotebookClient) -> None:
    """Run the notebook, asking the client's sockets each second whether something came.

    On a busy machine pyzmq's edge-triggered wake-up was seen to miss a reply that had arrived, and the client waited
    for ever; asking makes it look.
    """

    async def ask():
        while True:
            await asyncio.sleep(1)
            if client.kc is not None:
                for channel in (client.kc.shell_channel, client.kc.iopub_channel):
                    channel.socket.get(zmq.EVENTS)

    asking = asyncio.ensure_future(ask())
    try:
        await client.async_execute()
    finally:
        asking.cancel()


@contextmanager
def ruler() -> Iterator["Ruler"]:
    """A browser that measures notebooks, without network."""
    from playwright.sync_api import sync_playwright

    from tests import browser

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=browser.CHROMIUM, args=browser.FLAGS)
        try:
            page = running.new_page(viewport={"width": SCREEN_PX[0], "height": SCREEN_PX[1]}, offline=True)
            yield Ruler(page)
        finally:
            running.close()


class Ruler:
    """Lays notebooks out as JupyterLab shows them at first and measures them."""

    def __init__(self, page) -> None:
        self.page = page

    def screens(self, notebook: NotebookNode) -> float:
        """How many screens a notebook with outputs is long, in a window of 1366 × 768 pixels.

        Folded cells are a line high; for widgets, whose views need a kernel, there is empty space.
        """
        self.page.set_content(page_of(as_first_seen(notebook)), wait_until="load")
        return self.page.evaluate("() => document.querySelector('main').scrollHeight") / SCREEN_PX[1]


def page_of(notebook: NotebookNode) -> str:
    """The notebook as one page of HTML, without scripts."""
    exporter = HTMLExporter(template_name="lab", exclude_anchor_links=True)
    whole, _ = exporter.from_notebook_node(notebook)
    return re.sub(r"<script\b.*?</script>", "", whole, flags=re.S)


def as_first_seen(notebook: NotebookNode) -> NotebookNode:
    """The notebook with what is folded away as a line, and space where its widgets are."""
    seen = nbformat.from_dict(notebook)
    for cell in seen.cells:
        if cell.cell_type != "code":
            continue
        folded = cell.metadata.get("jupyter", {})
        if folded.get("source_hidden"):
            cell.source = "…"
        cell.outputs = [] if folded.get("outputs_hidden") else [_with_space(output) for output in cell.outputs]
        cell.metadata = NotebookNode()
    seen.metadata.pop("widgets", None)
    return seen


def _with_space(output: NotebookNode) -> NotebookNode:
    if WIDGET_VIEW not in output.get("data", {}):
        return output
    name = output["data"].get("text/plain", "").partition("(")[0]
    space = f'<div style="height: {WIDGET_PX.get(name, OTHER_WIDGET_PX)}px"></div>'
    return nbformat.v4.new_output("display_data", {"text/html": space})
