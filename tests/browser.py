"""JupyterLab in a real Chromium: a server with a token, a page that runs notebooks, and what the page shows."""

import base64
import json
import os
import secrets
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from urllib.parse import urlparse

import cv2
import numpy as np

from workbench.cli.servers import PROMPT

ROOT = Path(__file__).resolve().parent.parent
CHROMIUM = os.environ.get("WORKBENCH_CHROMIUM", "/usr/bin/chromium")
FLAGS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader"),
    "--enable-unsafe-swiftshader",
]
# Of what Playwright gives a Chromium that it starts itself, whatever pages can tell.
ALONE = [
    *("--headless", "--hide-scrollbars", "--mute-audio", "--disable-dev-shm-usage", "--disable-extensions"),
    *("--disable-background-timer-throttling", "--disable-backgrounding-occluded-windows", "--disable-default-apps"),
    *("--disable-renderer-backgrounding", "--disable-hang-monitor", "--disable-ipc-flooding-protection"),
    *("--disable-popup-blocking", "--disable-breakpad", "--disable-search-engine-choice-screen"),
    *("--disable-back-forward-cache", "--disable-features=PaintHolding", "--enable-features=CDPScreenshotNewSurface"),
    "--blink-settings=primaryHoverType=2,availableHoverTypes=2,primaryPointerType=4,availablePointerTypes=4",
    *("--force-color-profile=srgb", "--password-store=basic", "--use-mock-keychain", "--remote-debugging-port=0"),
]
SIZE = {"width": 1280, "height": 1000}
OVERRIDES = {
    "@jupyterlab/apputils-extension:notification": {"checkForUpdates": False, "fetchNews": "false"},
    # Saved after two minutes, on a busy machine the notebook would be opened again with widgets of an ended kernel.
    "@jupyterlab/docmanager-extension:plugin": {"autosave": False},
}
START_S, RUN_S = 240.0, 300.0
POLLING_MS = 100
SETTLED_MS = 300
"""Time without a change after which something counts as at rest."""


BUSY_CELL = """
    import pathlib
    import time

    deadline = time.monotonic() + 300
    while not pathlib.Path("seen").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    """
"""A cell that is busy until the test has seen what it wants to see, and writes the file `seen`."""


def missing() -> str | None:
    """What this machine lacks for browser tests, None if nothing."""
    try:
        import playwright.sync_api  # noqa: F401
    except ImportError:
        return "the package playwright is not installed"
    return None if Path(CHROMIUM).is_file() else f"there is no Chromium at {CHROMIUM}"


@dataclass(frozen=True)
class LabServer:
    """A running JupyterLab, and the folder in its root that notebooks are opened from."""

    url: str
    token: str
    root: Path
    choices: Path
    """Where it keeps what a user chooses, the theme for one."""
    room: str = ""
    kept: set[str] = field(default_factory=set)
    """Sessions whose kernels outlive a test file."""

    @property
    def folder(self) -> Path:
        """Where notebooks lie and what they write."""
        return self.root / self.room

    def address(self, notebook: str) -> str:
        """The address at which a notebook is opened in a fresh workspace."""
        return f"{self.url}/lab/tree/{self.room}/{notebook}?reset&token={self.token}"

    @contextmanager
    def in_room(self, name: str) -> Iterator["LabServer"]:
        """The same server with a folder for the notebooks of one test file, which leaves nothing else behind."""
        (self.root / name).mkdir()
        try:
            yield replace(self, room=name)
        finally:
            self.end_kernels()
            shutil.rmtree(self.choices, ignore_errors=True)

    def end_kernels(self) -> None:
        """End every kernel of the server but those that are kept."""
        sessions = self._ask("GET", "sessions")
        kept = {session["kernel"]["id"] for session in sessions if session["id"] in self.kept}
        for kernel in self._ask("GET", "kernels"):
            if kernel["id"] not in kept:
                self._ask("DELETE", f"kernels/{kernel['id']}")

    def keep_kernel(self, notebook: str) -> None:
        """Give a notebook the kernel that is kept, or a new one that is kept from now on."""
        wanted = {"path": f"{self.room}/{notebook}", "name": notebook, "type": "notebook"}
        if self.kept:
            self._ask("PATCH", f"sessions/{next(iter(self.kept))}", wanted)
        else:
            self.kept.add(self._ask("POST", "sessions", wanted | {"kernel": {"name": "python3"}})["id"])

    def end_kept(self) -> None:
        """Keep no kernel."""
        while self.kept:
            self._ask("DELETE", f"sessions/{self.kept.pop()}")

    def _ask(self, method: str, what: str, content: dict | None = None):
        headers = {"Authorization": f"token {self.token}"}
        data = None if content is None else json.dumps(content).encode()
        asked = urllib.request.Request(f"{self.url}/api/{what}", data, headers, method=method)
        with urllib.request.urlopen(asked, timeout=RUN_S) as answer:
            text = answer.read()
        return json.loads(text) if text else None


@contextmanager
def lab_server(folder: Path, settings: Path, prompt: bool = True) -> Iterator[LabServer]:
    """JupyterLab with a token on a free port, its root in `folder`, its settings apart from the user's.

    `prompt`: it hands messages on at once, as that of `workbench lab` does.
    """
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    token = secrets.token_hex(16)
    overrides, choices = settings / "lab" / "settings", settings / "user-settings"
    overrides.mkdir(parents=True)
    (overrides / "overrides.json").write_text(json.dumps(OVERRIDES), encoding="utf-8")
    environment = {
        **{name: value for name, value in os.environ.items() if name != "MPLBACKEND"},
        "PYTHONPATH": str(ROOT),
        "JUPYTER_CONFIG_DIR": str(settings / "config"),
        "JUPYTER_DATA_DIR": str(settings / "data"),
        "JUPYTER_RUNTIME_DIR": str(settings / "runtime"),
        "JUPYTERLAB_SETTINGS_DIR": str(choices),
        "JUPYTERLAB_WORKSPACES_DIR": str(settings / "workspaces"),
    }
    command = [
        *(sys.executable, "-m", "jupyterlab", "--no-browser", "--ip=127.0.0.1", f"--port={port}"),
        *(f"--IdentityProvider.token={token}", f"--ServerApp.root_dir={folder}", "--ServerApp.port_retries=0"),
        *("--LabApp.expose_app_in_browser=True", f"--LabApp.app_settings_dir={overrides}", "--allow-root"),
        *([f"--ServerApp.kernel_websocket_connection_class={PROMPT}"] if prompt else []),
    ]
    with (settings / "server.log").open("wb") as log:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=subprocess.STDOUT)
        try:
            url = f"http://127.0.0.1:{port}"
            _wait_for(lambda: _answers(f"{url}/api"), process, "JupyterLab", settings / "server.log")
            yield LabServer(url, token, folder, choices)
        finally:
            _end(process)  # the server ends its kernels


@contextmanager
def chromium(profile: Path) -> Iterator[str]:
    """A Chromium for many pages, which outlives Playwright's connections to it: the address to connect to."""
    command = [CHROMIUM, *FLAGS, *ALONE, f"--user-data-dir={profile}", "about:blank"]
    log, port = profile / "chromium.log", profile / "DevToolsActivePort"
    with log.open("wb") as stream:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT)
        try:
            _wait_for(lambda: port.exists() and port.read_text().count("\n") > 0, process, "Chromium", log)
            yield f"http://127.0.0.1:{port.read_text().split()[0]}"
        finally:
            _end(process)
            shutil.rmtree(profile, ignore_errors=True)


def _answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=2):
            return True
    except OSError:
        return False


def _wait_for(is_up: Callable[[], bool], process: subprocess.Popen, name: str, log: Path) -> None:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and process.poll() is None:
        if is_up():
            return
        time.sleep(0.2)
    raise RuntimeError(f"{name} did not start:\n{log.read_text(errors='replace')[-2000:]}")


def _end(process: subprocess.Popen) -> None:
    process.terminate()
    try:
        process.wait(timeout=20)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def wait_until(look: Callable[[], bool], what: str, timeout_s: float = RUN_S, pause: Callable[[], None] | None = None):
    """Look again and again until it is so. Raises `AssertionError` that says `what` did not happen in time."""
    deadline = time.monotonic() + timeout_s
    while not look():
        assert time.monotonic() < deadline, f"{what}: not within {timeout_s:.0f} s"
        (pause or (lambda: time.sleep(0.1)))()


class LabPage:
    """One browser page on a server, with everything that went wrong in it."""

    def __init__(self, page, server: LabServer):
        self.page, self.server = page, server
        # By the clock, not in animation frames: there JupyterLab may have taken the cell out of the page for a moment.
        page.wait_for_function = partial(page.wait_for_function, polling=POLLING_MS)
        self.page_errors: list[str] = []
        self.console_errors: list[str] = []
        self.foreign_requests: list[str] = []
        page.on("pageerror", lambda error: self.page_errors.append(str(error)[:300]))
        page.on("console", self._on_console)
        page.on("request", self._on_request)

    def open(self, notebook: str) -> None:
        """Open a notebook and wait for its kernel."""
        self.page.goto(self.server.address(notebook))
        self.page.wait_for_function(_KERNEL_IDLE, timeout=1000 * START_S)

    def run_all(self) -> None:
        """Run every cell and wait until the last one is done."""
        self.page.evaluate("() => { window.ran = window.jupyterapp.commands.execute('notebook:run-all-cells'); }")
        self.page.evaluate("() => window.ran", None)
        self.page.wait_for_function(_KERNEL_IDLE, timeout=1000 * RUN_S)

    def run_cell(self, index: int, wait: bool = True) -> None:
        """Run one cell; without `wait` the answer comes while it still runs."""
        self.page.evaluate(
            """(index) => {
              window.jupyterapp.shell.currentWidget.content.activeCellIndex = index;
              window.ran = false;
              window.jupyterapp.commands.execute('notebook:run-cell').then(() => { window.ran = true; });
            }""",
            index,
        )
        if wait:
            self.page.wait_for_function("() => window.ran")

    def ask_kernel(self, code: str) -> float:
        """Milliseconds until the kernel has run some code that no cell shows."""
        return self.page.evaluate(_ASK, code)

    def tidy_kernel(self) -> None:
        """Leave nothing in the kernel but what is imported and compiled; one that does not answer is ended."""
        if "answered" in self.page.evaluate(_ANSWERS):
            self.ask_kernel(_TIDY)
        else:
            self.server.end_kept()

    def kernel_value(self, expression: str) -> str:
        """The `repr` of an expression in the kernel, through a file beside the notebook."""
        file = self.server.folder / "kernel-value"
        self.ask_kernel(f"open({str(file)!r}, 'w').write(repr({expression}))")
        return file.read_text()

    def wait_drawn(self) -> None:
        """Wait until the browser has drawn what came before: views draw in the next animation frame."""
        self.page.evaluate(
            "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done))))"
        )

    def wait_at_rest(self, selector: str) -> None:
        """Wait until the last element of this kind has stopped moving on the screen."""
        self.page.wait_for_function(_AT_REST, arg=[selector, SETTLED_MS])

    def outputs(self) -> list[dict]:
        """Output type, MIME types and text of every output of every code cell."""
        return self.page.evaluate(_OUTPUTS)

    def wrong_outputs(self) -> list[dict]:
        """Those of `outputs` that are an error, or were written to the standard error stream."""
        return [output for output in self.outputs() if output["type"] == "error" or output["name"] == "stderr"]

    def execution_counts(self) -> list[int | None]:
        """Execution count of every code cell; None for one that did not run."""
        return self.page.evaluate(_COUNTS)

    def slider(self, label: str):
        """The handle of the ipywidgets slider with this description, scrolled into view."""
        row = self.page.locator(".widget-slider").filter(has=self.page.get_by_text(label, exact=True)).first
        row.scroll_into_view_if_needed()
        return row.locator(".noUi-handle").first

    def picture(self, selector: str) -> np.ndarray:
        """The decoded pixels (h, w, 3) of an image element: what the widget shows, not what surrounds it."""
        return decoded(self.page.locator(selector).first.evaluate(_IMAGE_BYTES), cv2.IMREAD_COLOR)

    def pixels(self, selector: str, side: int = 200) -> np.ndarray:
        """What a canvas shows, RGB (side, side, 3), reduced to a square; needs `KEEP_PIXELS`."""
        encoded = self.page.evaluate("([s, side]) => window.pngOfCanvas(s, side)", [selector, side])
        return decoded(encoded, cv2.IMREAD_COLOR)[..., ::-1].astype(int)

    def state(self) -> str:
        """What a test that failed leaves behind: whether page, connection and kernel still answer, and its threads.

        Asked for with little patience, because whatever is asked may be what is stuck.
        """
        asked = {"page": _VISIBLE, "draws": _DRAWS, "kernel": _KERNEL_STATE, "answers": _ANSWERS}
        told = [f"{name}: {_told(lambda code=code: self.page.evaluate(code))}" for name, code in asked.items()]
        told += [f"threads of the kernel:\n{_told(lambda: self.kernel_threads())}"]
        told += [f"errors: {self.page_errors} {self.console_errors}"]
        return "\n".join(told)

    def kernel_threads(self) -> str:
        """Where each thread of the kernel is; a kernel that does not answer is asked nothing."""
        if "answered" not in self.page.evaluate(_ANSWERS):
            return "not asked"
        file = self.server.folder / "kernel-threads"
        self.ask_kernel(
            f"import faulthandler\nwith open({str(file)!r}, 'w') as told: faulthandler.dump_traceback(told, True)"
        )
        return file.read_text()

    def screenshots(self, folder: Path, stem: str) -> list[Path]:
        """The notebook from top to bottom, one file a screen."""
        folder.mkdir(parents=True, exist_ok=True)
        made, bottom = [], False
        self.page.evaluate(_SCROLL_TO, 0)
        while not bottom:
            self.page.wait_for_timeout(700)
            made.append(folder / f"{stem}-{len(made):02d}.png")
            self.page.locator(".jp-NotebookPanel:not(.lm-mod-hidden)").first.screenshot(path=made[-1])
            bottom = self.page.evaluate(_SCROLL_ON)
        return made

    def _on_request(self, request) -> None:
        address = urlparse(request.url)
        if address.scheme in ("http", "https", "ws", "wss") and address.hostname not in ("127.0.0.1", "localhost"):
            self.foreign_requests.append(request.url[:200])

    def _on_console(self, message) -> None:
        if message.type == "error":
            self.console_errors.append(message.text[:300])


def _told(ask: Callable[[], object]) -> object:
    try:
        return ask()
    except Exception as error:  # what is asked of a page that is stuck can fail in any way
        return f"{type(error).__name__}: {str(error)[:200]}"


def decoded(address: str, flags: int) -> np.ndarray:
    """The pixels of a picture in a data: address, as OpenCV orders them."""
    return cv2.imdecode(np.frombuffer(base64.b64decode(address.split(",")[1]), np.uint8), flags)


@contextmanager
def lab_page(server: LabServer, profile: Path, flags: Sequence[str] = ()) -> Iterator[LabPage]:
    """A page of a fresh Chromium with its own profile, and flags besides the usual ones, on a server."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            str(profile), executable_path=CHROMIUM, headless=True, args=[*FLAGS, *flags], viewport=SIZE
        )
        context.set_default_timeout(1000 * RUN_S)
        try:
            yield LabPage(context.pages[0], server)
        finally:
            context.close()
            shutil.rmtree(profile, ignore_errors=True)


@contextmanager
def lab_tab(server: LabServer, address: str, notebook: str = "") -> Iterator[LabPage]:
    """A page of a Chromium that runs already (`chromium`): JupyterLab's programs are there from the page before.

    A `notebook` that is named is opened with the kernel that is kept: what it needs is imported and compiled.
    """
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        # Its only page: input to any other waits until that is in front.
        page = playwright.chromium.connect_over_cdp(address, timeout=1000 * RUN_S).contexts[0].pages[0]
        page.set_default_timeout(1000 * RUN_S)
        page.set_viewport_size(SIZE)
        lab = LabPage(page, server)
        try:
            with kept_kernel(lab, notebook) if notebook else nullcontext():
                yield lab
        finally:
            page.goto("about:blank")


@contextmanager
def kept_kernel(page: LabPage, notebook: str) -> Iterator[None]:
    """Let a page open a notebook with the kernel that is kept, and leave nothing in it."""
    page.server.keep_kernel(notebook)
    try:
        yield
    finally:
        page.tidy_kernel()


_KERNEL_IDLE = """() => {
  const panel = window.jupyterapp && window.jupyterapp.shell.currentWidget;
  const session = panel && panel.sessionContext && panel.sessionContext.session;
  return Boolean(session && session.kernel && session.kernel.status === 'idle');
}"""
_AT_REST = """([selector, pause]) => new Promise((resolve) => {
  let last = "", since = performance.now();
  const look = () => {
    const box = [...document.querySelectorAll(selector)].at(-1)?.getBoundingClientRect();
    const now = JSON.stringify(box), time = performance.now();
    if (!box || now !== last) [last, since] = [now, time];
    if (time - since >= pause) resolve(true);
    else requestAnimationFrame(look);
  };
  look();
})"""
_OUTPUTS = """() => {
  const found = [], cells = window.jupyterapp.shell.currentWidget.content.model.cells;
  for (let k = 0; k < cells.length; k++) {
    const outputs = cells.get(k).outputs;
    for (let j = 0; outputs && j < outputs.length; j++) {
      const output = outputs.get(j).toJSON();
      found.push({cell: k, type: output.output_type, name: output.name || '', mime: Object.keys(output.data || {}),
                  text: [output.ename, output.evalue, output.text].filter(Boolean).join(' ').slice(0, 20000)});
    }
  }
  return found;
}"""
_ASK = """async (code) => {
  const kernel = window.jupyterapp.shell.currentWidget.sessionContext.session.kernel, start = performance.now();
  const future = kernel.requestExecute({code, store_history: false});
  // "Idle" follows the answer. Once it never came, and the page would have waited for ever.
  const answered = new Promise((done) => { future.onReply = () => setTimeout(done, 5000); });
  await Promise.race([future.done, answered]);
  return performance.now() - start;
}"""
_TIDY = """
import ipywidgets
ipywidgets.Widget.close_all()
get_ipython().reset(new_session=False)
"""
_VISIBLE = "() => document.visibilityState"
_WITHIN = """const within = (asked, word) => Promise.race([
  asked.then(() => word), new Promise((done) => setTimeout(() => done('nothing within 5 s'), 5000))]);"""
_DRAWS = f"() => {{ {_WITHIN} return within(new Promise((done) => requestAnimationFrame(done)), 'a frame'); }}"
_ANSWERS = f"() => {{ {_WITHIN} return within(({_ASK})('None'), 'answered'); }}"
_KERNEL_STATE = """() => {
  const kernel = window.jupyterapp.shell.currentWidget.sessionContext.session.kernel;
  return `${kernel.status}, ${kernel.connectionStatus}`;
}"""
_COUNTS = """() => {
  const found = [], cells = window.jupyterapp.shell.currentWidget.content.model.cells;
  for (let k = 0; k < cells.length; k++) {
    if (cells.get(k).type === 'code') found.push(cells.get(k).executionCount);
  }
  return found;
}"""
_IMAGE_BYTES = """async (element) => {
  const reader = new FileReader(), picture = await (await fetch(element.src)).blob();
  return new Promise((done) => { reader.onload = () => done(reader.result); reader.readAsDataURL(picture); });
}"""
_SCROLLER = """
  const panel = window.jupyterapp.shell.currentWidget.node;
  const box = panel.querySelector('.jp-WindowedPanel-outer') || panel.querySelector('.jp-Notebook');
"""
_SCROLL_TO = f"(top) => {{ {_SCROLLER} box.scrollTop = top; }}"
_SCROLL_ON = f"""() => {{ {_SCROLLER}
  const before = box.scrollTop;
  box.scrollTop = before + box.clientHeight - 60;
  return box.scrollTop <= before + 1;
}}"""
# WebGL forgets its picture after showing it; this keeps it for reading. Add it as an init script before `open`.
KEEP_PIXELS = """(() => {
  const original = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    const kept = /webgl/.test(kind) ? Object.assign({}, options, { preserveDrawingBuffer: true }) : options;
    return original.call(this, kind, kept);
  };
  const small = document.createElement("canvas");
  small.width = small.height = 100;
  const context = original.call(small, "2d", { willReadFrequently: true });
  window.readCanvas = (selector, side) => {
    const canvas = document.querySelector(selector);
    if (!canvas) return null;
    small.width = small.height = side;
    context.fillStyle = getComputedStyle(canvas.parentElement).backgroundColor; // it may show through
    context.fillRect(0, 0, side, side);
    context.drawImage(canvas, 0, 0, side, side);
    return context.getImageData(0, 0, side, side).data;
  };
  window.pngOfCanvas = (selector, side) => {
    window.readCanvas(selector, side);
    return small.toDataURL("image/png");
  };
  window.sumCanvas = (selector) => {
    const data = window.readCanvas(selector, 240);
    let sum = 0;
    for (const value of data) sum = (sum * 31 + value) | 0;
    return sum;
  };
  const drawn = new WeakMap(), draws = (selector) => drawn.get(document.querySelector(selector)) ?? 0;
  const drawing = ["clearRect", "fillRect", "fill", "stroke", "drawImage", "putImageData", "clear", "drawArrays",
    "drawElements", "drawArraysInstanced", "drawElementsInstanced"];
  for (const kind of [CanvasRenderingContext2D, WebGLRenderingContext, WebGL2RenderingContext]) {
    for (const name of drawing.filter((each) => each in kind.prototype)) {
      const draw = kind.prototype[name];
      kind.prototype[name] = function (...given) {
        drawn.set(this.canvas, (drawn.get(this.canvas) ?? 0) + 1);
        return draw.apply(this, given);
      };
    }
  }
  window.timeToPixels = (handle, key, selectors) => new Promise((resolve) => {
    const canvases = selectors.map((selector) => (
      { selector, before: window.sumCanvas(selector), draws: draws(selector), changed: false }
    ));
    let start = 0;
    // Reading pixels back holds up the page, so only what has been drawn on is read, after the frame that drew it.
    const look = () => {
      const now = performance.now();
      for (const canvas of canvases.filter((each) => !each.changed && draws(each.selector) !== each.draws)) {
        canvas.draws = draws(canvas.selector);
        canvas.changed = window.sumCanvas(canvas.selector) !== canvas.before;
      }
      if (canvases.every((each) => each.changed)) resolve(now - start);
      else if (now - start > 5000) resolve(null);
      else afterFrame(look);
    };
    const afterFrame = (then) => requestAnimationFrame(() => setTimeout(then));
    const press = () => {
      start = performance.now();
      handle.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
      afterFrame(look);
    };
    // Anywhere in a frame: at its same place each time, all answers would come in one frame, or all in the next.
    setTimeout(press, 50 * Math.random());
  });
})();"""
