"""`workbench lab` and `workbench app`: the notebooks in a browser, with and without their code."""

import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import webbrowser
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated

import typer

import workbench
from workbench.cli import screen
from workbench.cli.tour_page import write_tour_page
from workbench.errors import InputError, OutputError
from workbench.extras import check_installed
from workbench.files import atomic_path, make_folder
from workbench.reading import reason_of

PACKAGE = Path(workbench.__file__).resolve().parent
APP_NOTEBOOK = "10_workbench_app.ipynb"
TOUR_NOTEBOOK = "02_the_workbench.ipynb"
TOUR_PAGE = Path("nbconvert", "templates", "workbench", "static", "tour.html")
"""Where Voilà looks for files of the app's template, below a folder of `JUPYTER_PATH`; the template links to it."""
APP_PAGE = Path(__file__).resolve().parent / "app_page"
"""Voilà's settings (voila.json) and the page's template.

This machine only, a token, and neither files of the folder nor anything from other hosts (the Content-Security-Policy,
whatever a later Voilà links to). Tornado logs errors only: it would warn about the times of Jupyter's pings, which must
not be shorter, or connections would drop. Without `disable_check_xsrf` a page that is left could not end its Python
process: Voilà sends no token with that request. Its origin is checked all the same. Processes whose page vanished end
after ten minutes.
"""
LAB_SETTINGS = Path(__file__).resolve().parent / "lab_settings"
"""A default below what the user chose in JupyterLab: it does not ask over the first notebook whether to fetch news."""
LOCALHOST = "127.0.0.1"
PROMPT = "workbench.widgets.prompt_channels.PromptChannels"
"""How both servers hand a kernel's messages to the browser: at once. By name, because only they import it."""
PORTS_TRIED = 50
LAST_PORT = 65_535

APP_HELP = """Tune in the browser without seeing code: the workbench as an app, served by Voilà on this machine only.

Each page has its own Python process; reloading the page restarts it. Ctrl-C ends the server. \
Voilà is an extra: pip install "face-energy-workbench\\[app]".

[bold]Examples[/bold]

  workbench app                            open the app in a browser

  workbench app --port 9000 --no-browser   print the address only
"""


def lab(
    port: Annotated[int, typer.Option(min=1, max=LAST_PORT, help="Port of the server.")] = 8888,
    browser: Annotated[bool, typer.Option(help="Open a browser window.")] = True,
) -> None:
    """Open JupyterLab on the first notebook; prints its address. Ctrl-C ends it."""
    check_installed("lab", "jupyterlab", "ipywidgets", "anywidget")
    folder = working_copies(notebooks_folder())
    page = sorted(folder.glob("*.ipynb"))[0].name
    ports = range(port, min(port + PORTS_TRIED, LAST_PORT + 1))
    port = next((free for free in ports if not answers(free)), port)
    command = [sys.executable, "-m", "workbench.cli.lab_server", f"--notebook-dir={folder}", f"--port={port}"]
    # Its many lines on starting have several addresses and hide the one to open; what goes wrong is still printed.
    command += [
        f"--LabApp.default_url=/lab/tree/{page}",
        "--no-browser",
        "--ServerApp.port_retries=0",
        f"--ServerApp.kernel_websocket_connection_class={PROMPT}",
        "--Application.log_level=ERROR",
    ]
    # Jupyter refuses to start as root, which is who one is in a container.
    command += ["--allow-root"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    token = secrets.token_hex(24)
    address = f"http://{LOCALHOST}:{port}/lab/tree/{page}?token={token}"
    ready = _teller("JupyterLab", address, browser)
    raise typer.Exit(serve(command, lab_environment(token), lambda: answers(port), ready))


def serve_app(
    port: Annotated[int, typer.Option(min=1, max=LAST_PORT, help="Port of the server.")] = 8866,
    browser: Annotated[bool, typer.Option(help="Open a browser window.")] = True,
) -> None:
    """Serve the app's notebook through Voilà; prints its address."""
    check_installed("app", "voila", "ipywidgets", "anywidget")
    notebook = working_copies(notebooks_folder()) / APP_NOTEBOOK
    if not notebook.is_file():
        raise InputError(f"The app's notebook {notebook} does not exist; install the workbench again.")
    if answers(port):
        raise InputError(f"Port {port} is taken by another program; choose another one with --port.")
    token = secrets.token_hex(24)
    address = f"http://{LOCALHOST}:{port}/?token={token}"
    ready = _teller("The workbench app", address, browser)
    with tempfile.TemporaryDirectory(prefix="workbench-app-") as pages:
        write_app_pages(notebook.parent, Path(pages))
        environment = app_environment(token, Path(pages))
        raise typer.Exit(serve(app_command(notebook, port), environment, lambda: answers(port), ready))


def _teller(name: str, address: str, browser: bool) -> Callable[[], None]:
    """What prints a server's address, and opens it where there is a browser."""

    def ready() -> None:
        screen.console.print(f"{name} runs at [bold]{address}[/bold]\nCtrl-C ends it.", soft_wrap=True)
        if browser and _has_browser():
            webbrowser.open(address)

    return ready


def lab_environment(token: str) -> dict[str, str]:
    """Environment of JupyterLab. The token goes here because command lines can be read by every user."""
    paths = [*filter(None, [os.environ.get("JUPYTER_CONFIG_PATH")]), str(LAB_SETTINGS)]
    return {**os.environ, "JUPYTER_TOKEN": token, "JUPYTER_CONFIG_PATH": os.pathsep.join(paths)}


def app_command(notebook: Path, port: int) -> list[str]:
    """The command that serves a notebook as the app; its other settings are in `APP_PAGE`."""
    settings = [f"--Voila.config_file_paths={APP_PAGE}", f"--Voila.kernel_websocket_connection_class={PROMPT}"]
    return [sys.executable, "-m", "voila", str(notebook), f"--port={port}", *settings]


def write_app_pages(notebooks: Path, folder: Path) -> None:
    """Write the pages that the app links to, for `app_environment`: the tour as a page to read."""
    if (notebooks / TOUR_NOTEBOOK).is_file():
        (folder / TOUR_PAGE).parent.mkdir(parents=True)
        write_tour_page(notebooks / TOUR_NOTEBOOK, folder / TOUR_PAGE)


def app_environment(token: str, pages: Path | None = None) -> dict[str, str]:
    """Environment of `app_command`; `pages`: the folder of `write_app_pages`.

    The token goes here because command lines can be read by every user.
    """
    paths = [str(APP_PAGE), *([] if pages is None else [str(pages)]), *filter(None, [os.environ.get("JUPYTER_PATH")])]
    return {**os.environ, "JUPYTER_TOKEN": token, "JUPYTER_PATH": os.pathsep.join(paths)}


def serve(
    command: list[str],
    environment: Mapping[str, str] | None = None,
    is_up: Callable[[], bool] | None = None,
    ready: Callable[[], None] | None = None,
) -> int:
    """Run a server until it ends or is ended; its exit code. Calls `ready` as soon as it `is_up`."""
    server = subprocess.Popen(command, env=environment)
    before = signal.signal(signal.SIGTERM, lambda *_: server.terminate())
    try:
        if is_up is not None and ready is not None:
            while server.poll() is None and not is_up():
                time.sleep(0.1)
            if server.poll() is None:
                ready()
        return server.wait()
    except KeyboardInterrupt:
        server.terminate()  # servers end their kernels then
        server.wait()
        return 0
    finally:
        signal.signal(signal.SIGTERM, before)


def notebooks_folder() -> Path:
    """Folder of the notebooks: beside the package in a checkout, inside it in an installed wheel."""
    folders = (PACKAGE / "notebooks", PACKAGE.parent / "notebooks")
    return next((folder for folder in folders if any(folder.glob("*.ipynb"))), Path.cwd())


def working_copies(folder: Path, package: Path = PACKAGE) -> Path:
    """The notebooks of a checkout as they are; those of an installed package copied to ./workbench_notebooks.

    JupyterLab saves what it runs, and an installed package is no place for that. Notebooks that are already there
    stay as the user left them.
    """
    if not folder.is_relative_to(package):
        return folder
    copies = Path.cwd() / "workbench_notebooks"
    try:
        make_folder(copies)
        for notebook in folder.glob("*.ipynb"):
            if not (copies / notebook.name).exists():
                with atomic_path(copies / notebook.name) as temporary:
                    temporary.write_bytes(notebook.read_bytes())
    except OutputError as error:
        remedy = "start it in a folder that can be written to and has room for them"
        reason = reason_of(error.__cause__ or error)
        raise OutputError(f"The notebooks cannot be copied to {copies} ({reason}); {remedy}.") from error
    return copies


def answers(port: int) -> bool:
    """Whether something on this machine listens at a port."""
    with socket.socket() as probe:
        if probe.connect_ex((LOCALHOST, port)) != 0:
            return False
        # Asked at a port that nobody has taken, TCP may give the probe that very port, and it answers itself.
        return probe.getsockname() != probe.getpeername()


def _has_browser() -> bool:
    names = ("chromium", "google-chrome", "firefox", "xdg-open", "open", "explorer.exe")
    return any(shutil.which(name) for name in names)
