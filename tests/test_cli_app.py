"""`workbench app`: a notebook as a page without code, for this machine only, and nothing from other hosts."""

import json
import os
import re
import secrets
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock, call

import nbformat
import psutil
import pytest
from traitlets import import_item

from tests import browser
from workbench.cli import servers
from workbench.samples import sample

SLIDER = """
import ipywidgets
from workbench.widgets import SessionOpener
opened = lambda session: ipywidgets.Label(f"{len(session)} frames of {session.material.inputs[0]}")
slider = ipywidgets.IntSlider(description="x")
shown = ipywidgets.Label("0")
slider.observe(lambda change: setattr(shown, "value", f"x is {change.new}"), "value")
ipywidgets.VBox([slider, shown, ipywidgets.Button(icon="undo", description="back"), SessionOpener(opened)])
"""
"""In place of the panel, what it would be of."""


@pytest.fixture(scope="module")
def notebook(tmp_path_factory):
    """The app's notebook with one slider and the chooser of material."""
    path = tmp_path_factory.mktemp("app") / servers.APP_NOTEBOOK
    texts = "# Tuning $E_\\tau$", "The [tour](02_the_workbench.ipynb) explains it."
    cells = [*map(nbformat.v4.new_markdown_cell, texts), nbformat.v4.new_code_cell(SLIDER)]
    kernel = {"name": "python3", "display_name": "Python 3"}
    nbformat.write(nbformat.v4.new_notebook(cells=cells, metadata={"kernelspec": kernel}), path)
    return path


@pytest.fixture(scope="module")
def server(notebook, tmp_path_factory):
    """The running app: its address with the token, its process, and the file of what it says on standard error."""
    pytest.importorskip("voila")
    port, token, pages = free_port(), secrets.token_hex(8), tmp_path_factory.mktemp("pages")
    servers.write_app_pages(servers.notebooks_folder(), pages)
    environment = servers.app_environment(token, pages)
    said = pages / "stderr"
    with said.open("w") as stream:
        process = subprocess.Popen(servers.app_command(notebook, port), env=environment, stderr=stream)
    try:
        wait_until(lambda: servers.answers(port) or process.poll() is not None)
        yield f"http://127.0.0.1:{port}/?token={token}", psutil.Process(process.pid), said
    finally:
        process.terminate()
        process.wait(20)


@pytest.fixture
def address(server):
    """Address of the running app, with its token."""
    return server[0]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_until(true: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_the_page_has_the_results_without_code_and_names_no_other_host(address):
    with urllib.request.urlopen(address) as answer:
        page, policy = answer.read().decode(), answer.headers["Content-Security-Policy"]
    assert "Tuning" in page
    assert "slider.observe" not in page
    assert "vnd.jupyter.widget-view" in page
    assert not re.search("(href|src)=[\"']https?:", page)
    assert "default-src 'self'" in policy


def test_the_tour_opens_as_a_page_to_read_that_names_no_other_host_and_no_notebook(address):
    with urllib.request.urlopen(address) as answer:
        (link,) = re.findall('<a [^>]*href="([^"]+)"[^>]*>tour</a>', answer.read().decode())
    with urllib.request.urlopen(urllib.parse.urljoin(address, link)) as answer:
        assert "text/html" in answer.headers["Content-Type"]
        tour = answer.read().decode()
    assert "<h1" in tour
    assert "Drag a wrong landmark to its place" in tour
    assert "<i>E</i><sub>&beta;</sub>" in tour
    assert not re.search("(href|src)=[\"'](https?:|[^\"'#]*ipynb)", tour)


def test_without_the_token_there_is_a_login_page_only(address):
    plain = address.split("?")[0]
    with urllib.request.urlopen(plain) as answer:
        assert "/login" in answer.url
        assert "Tuning" not in answer.read().decode()
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(f"{plain}voila/files/picture.png")


@pytest.mark.long
@pytest.mark.skipif(bool(browser.missing()) and os.environ.get("CI") != "true", reason=str(browser.missing()))
def test_widgets_work_a_file_is_sent_and_a_page_that_is_left_ends_its_process(server):
    from playwright.sync_api import sync_playwright

    (address, process, said), foreign, failed = server, [], []
    others = set(process.children())
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser.CHROMIUM, headless=True, args=browser.FLAGS)
        page = chromium.new_page()
        local = ("http://127.0.0.1", "ws://127.0.0.1", "data:", "blob:")
        page.on("request", lambda request: None if request.url.startswith(local) else foreign.append(request.url))
        page.on("response", lambda answer: failed.append(answer.url) if answer.status >= 400 else None)
        page.goto(address)
        page.locator(".noUi-handle").wait_for(timeout=60_000)
        page.locator(".noUi-handle").focus()
        page.keyboard.press("ArrowRight")
        page.get_by_text("x is 1").wait_for(timeout=30_000)
        assert page.evaluate(ICON) == "Font Awesome 5 Free"
        with page.expect_file_chooser() as asked:
            page.get_by_role("button", name="Upload").click()
        asked.value.set_files(sample("speech-landmarks"))
        sent = Path(page.get_by_text(re.compile("^55 frames of ")).inner_text(timeout=60_000).split(" of ")[1])
        assert sent.read_bytes() == sample("speech-landmarks").read_bytes()
        (kernel,) = set(process.children()) - others
        page.goto("about:blank")
        wait_until(lambda: not kernel.is_running())
        chromium.close()
    assert foreign == []
    assert failed == []
    assert "websocket_ping" not in said.read_text()


ICON = """() => getComputedStyle(document.querySelector("button i"), "::before").fontFamily.replaceAll('"', "")"""


@pytest.mark.parametrize("ended_by", [signal.SIGINT, signal.SIGTERM])
def test_the_command_tells_its_address_and_ends_with_its_server(ended_by, notebook):
    pytest.importorskip("voila")
    port = free_port()
    code = (
        # Where the tests run in the background, Ctrl-C is ignored, and programs that they start inherit that.
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from pathlib import Path; from workbench import cli; from workbench.cli import servers; "
        f"servers.notebooks_folder = lambda: Path({str(notebook.parent)!r}); cli.main()"
    )
    command = [sys.executable, "-u", "-c", code, "app", "--no-browser", "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        told = process.stdout.readline()
        assert re.fullmatch(rf"The workbench app runs at http://127\.0\.0\.1:{port}/\?token=\w{{48}}\n", told)
        assert servers.answers(port)
        process.send_signal(ended_by)
        assert process.wait(30) == 0
        assert not servers.answers(port)
    finally:
        process.kill()
        process.stdout.close()
        process.wait()


def test_a_probe_that_reaches_itself_is_no_server(monkeypatch):
    """A socket that is given the port that it asks at is connected to itself (TCP's simultaneous open)."""

    class GivenThatPort(socket.socket):
        def connect_ex(self, address):
            self.bind(address)
            return super().connect_ex(address)

    port = free_port()
    monkeypatch.setattr(servers.socket, "socket", GivenThatPort)
    with GivenThatPort() as probe:
        assert probe.connect_ex((servers.LOCALHOST, port)) == 0
    assert not servers.answers(free_port())


def test_the_app_is_for_this_machine_and_its_token_is_on_no_command_line(notebook, monkeypatch):
    settings = json.loads((servers.APP_PAGE / "voila.json").read_text())
    assert settings["Voila"]["ip"] == "127.0.0.1"
    assert settings["Voila"]["auto_token"] is True
    monkeypatch.setenv("JUPYTER_PATH", "/elsewhere")
    environment = servers.app_environment("secret")
    assert environment["JUPYTER_TOKEN"] == "secret"
    assert environment["JUPYTER_PATH"].split(os.pathsep) == [str(servers.APP_PAGE), "/elsewhere"]
    assert not any("secret" in word for word in servers.app_command(notebook, 8866))


@pytest.mark.parametrize("command", ["lab", "app"])
def test_a_port_that_no_machine_has_is_refused_in_words(run, command):
    for port, end in (("0", "1"), ("99999", "65535")):
        code, _, err = run(command, "--no-browser", "--port", port)
        assert code == 2
        assert re.search(rf"--port.*equal to {end}\b|range 1<=x<=65535", " ".join(err.split()))


def test_the_last_ports_are_tried_too(run, monkeypatch):
    pytest.importorskip("jupyterlab")
    said = []
    monkeypatch.setattr(servers, "answers", lambda port: said.append(port) or True)
    monkeypatch.setattr(servers, "serve", lambda *given: 0)
    assert run("lab", "--no-browser", "--port", "65534")[0] == 0
    assert said == [65534, 65535]


def test_both_servers_hand_a_kernels_messages_on_at_once(notebook, run, monkeypatch):
    channels = pytest.importorskip("jupyter_server.services.kernels.connection.channels")
    said = [servers.app_command(notebook, 8866)]
    monkeypatch.setattr(servers, "serve", lambda command, *_: said.append(command) or 0)
    assert run("lab", "--no-browser")[0] == 0
    for app, command in zip(("Voila", "ServerApp"), said, strict=True):
        assert f"--{app}.kernel_websocket_connection_class={servers.PROMPT}" in command

    from jupyter_server.services.kernels.websocket import KernelWebsocketHandler  # here: it comes with the extra lab

    prompt, handler = import_item(servers.PROMPT), Mock(KernelWebsocketHandler)
    monkeypatch.setattr(channels.ZMQChannelsWebsocketConnection, "connect", lambda connection: "connected")
    assert prompt(websocket_handler=handler).connect() == "connected"
    assert handler.method_calls == [call.set_nodelay(True)]


def test_a_browser_is_opened_with_the_token_where_there_is_one(notebook, run, monkeypatch):
    pytest.importorskip("voila")
    opened = []
    monkeypatch.setattr(servers, "notebooks_folder", lambda: notebook.parent)
    monkeypatch.setattr(servers, "serve", lambda command, environment, is_up, ready: ready() or 0)
    monkeypatch.setattr(servers, "_has_browser", lambda: True)
    monkeypatch.setattr(servers.webbrowser, "open", opened.append)
    out = run("app", "--port", str(free_port()))[1]
    assert len(opened) == 1
    assert f"runs at {opened[0]}\n" in out
    assert "token=" in opened[0]
    run("app", "--no-browser", "--port", str(free_port()))
    assert len(opened) == 1


def test_lab_starts_without_warnings_and_does_not_ask_about_news_unless_the_user_wants_them(run, monkeypatch, tmp_path):
    pytest.importorskip("jupyterlab")
    told, port = [], free_port()
    chosen, plugin = tmp_path / "user-settings", "@jupyterlab/apputils-extension"
    monkeypatch.setenv("JUPYTERLAB_SETTINGS_DIR", str(chosen))
    monkeypatch.setenv("JUPYTER_CONFIG_DIR", str(tmp_path / "config"))

    def settings(token):
        asked = urllib.request.Request(f"http://127.0.0.1:{port}/lab/api/settings/{plugin}:notification")
        asked.add_header("Authorization", f"token {token}")
        with urllib.request.urlopen(asked) as answer:
            found = json.load(answer)
        return found["schema"]["properties"]["fetchNews"]["default"], found["settings"].get("fetchNews")

    def served(command, environment, is_up, ready):
        assert environment["JUPYTER_TOKEN"] not in " ".join(command)
        process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
        try:
            wait_until(lambda: is_up() or process.poll() is not None)
            told.append(settings(environment["JUPYTER_TOKEN"]))
            (chosen / plugin).mkdir(parents=True)
            (chosen / plugin / "notification.jupyterlab-settings").write_text('{"fetchNews": "true"}')
            told.append(settings(environment["JUPYTER_TOKEN"]))
        finally:
            process.terminate()
            told.append(process.communicate(timeout=20)[1])
        return 0

    monkeypatch.setattr(servers, "serve", served)
    assert run("lab", "--no-browser", "--port", str(port))[0] == 0
    assert told[:2] == [("false", None), ("false", "true")]
    assert "Warning" not in told[2]


def test_without_voila_the_install_command_is_told(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "voila", None)
    code, _, err = run("app")
    assert code == 2
    assert 'pip install "face-energy-workbench[app]"' in err


def test_a_missing_notebook_is_named(run, monkeypatch, tmp_path):
    pytest.importorskip("voila")
    monkeypatch.setattr(servers, "notebooks_folder", lambda: tmp_path)
    code, _, err = run("app")
    assert code == 2
    assert "10_workbench_app.ipynb does not exist" in err


def test_a_port_in_use_is_named(notebook, run, monkeypatch):
    pytest.importorskip("voila")
    monkeypatch.setattr(servers, "notebooks_folder", lambda: notebook.parent)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        code, _, err = run("app", "--port", str(port))
    assert code == 2
    assert f"Port {port} is taken by another program" in err
