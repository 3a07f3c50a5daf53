"""What a panel does in the browser's page itself: drags, resets, movable borders, folded pages, keys and labels."""

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import anywidget
import traitlets

from workbench.errors import InputError
from workbench.export.suffixes import pictures_folder
from workbench.widgets.browser_program import browser_program, style_text

ACTIONS = (
    *("play", "back", "forth", "next", "previous", "in", "out", "fill", "view", "why", "keep", "export"),
    *("undo", "redo"),
)  # fmt: skip
"""Actions that keys request of a panel; the browser does others itself. See `panel/help.js`."""

LARGEST_MB = 200
"""Largest file that goes from the browser to Python, or back, in one message."""


class PanelPage(anywidget.AnyWidget):
    """A widget without a picture of its own, anywhere in a box of class fw-panel.

    `drag` numbers the latest drag of any slider in the page, 0 after a key or another click, so that a slow drag is one
    undo step. Values throttled by the browser arrive after the mouse is released, so the end of a drag is unknown: it
    lasts until the next one begins.
    """

    _esm = browser_program("panel/view.js")
    _css = style_text("panel/view.css")

    drag = traitlets.Int(0).tag(sync=True)
    has_keys = traitlets.Bool(False, help="whether the panel has keys").tag(sync=True)

    def __init__(self, keys: bool = False) -> None:
        self._reset: Callable[[str], None] = lambda path: None
        self._act: Callable[[str], None] = lambda action: None
        super().__init__(has_keys=keys)
        self.on_msg(self._on_message)

    def on_reset(self, callback: Callable[[str], None]) -> None:
        """Call `callback(path)` when the user sets a knob back."""
        self._reset = callback

    def on_key(self, callback: Callable[[str], None]) -> None:
        """Call `callback(action)`, one of `ACTIONS`, when the user presses its key."""
        self._act = callback

    def download(self, path: Path) -> None:
        """Hand a file, or a folder as a ZIP archive, to the browser to save. Raises `InputError` if it is too large."""
        name, content = packed(path)
        self.send({"kind": "download", "name": name}, [content])

    def _on_message(self, _widget: object, content: object, _buffers: object) -> None:
        if not isinstance(content, dict) or not isinstance(content.get("what"), str):
            return
        if content.get("kind") == "reset":
            self._reset(content["what"])
        elif content.get("kind") == "key" and content["what"] in ACTIONS:
            self._act(content["what"])


def packed(path: Path) -> tuple[str, bytes]:
    """Name and content of what is downloaded; a stage comes with the folder of its pictures, in an archive.

    Raises `InputError` for what is missing or too large.
    """
    if not path.exists():
        raise InputError(f"{path} is no longer there; write it again.")
    pictures = pictures_folder(path)
    if path.is_file() and pictures.is_dir():
        with tempfile.TemporaryDirectory() as folder:
            together = Path(folder, path.stem)
            shutil.copytree(pictures, together / pictures.name)
            shutil.copy2(path, together)
            return packed(together)
    if path.is_file():
        return path.name, _content(path)
    with tempfile.TemporaryDirectory() as folder:
        return f"{path.name}.zip", _content(Path(shutil.make_archive(str(Path(folder, "packed")), "zip", path)))


def _content(path: Path) -> bytes:
    megabytes = path.stat().st_size / 1e6
    if megabytes > LARGEST_MB:
        raise InputError(
            f"{path} is {megabytes:.0f} MB; downloads are limited to {LARGEST_MB} MB. Copy the file itself."
        )
    return path.read_bytes()
