"""What a panel does in the browser's page itself: drags, resets, movable borders, folded pages, keys and labels."""

from collections.abc import Callable

import anywidget
import traitlets

from workbench.widgets.browser_program import BROWSER, browser_program

ACTIONS = (
    *("play", "back", "forth", "next", "previous", "in", "out", "view", "why", "keep", "export", "undo", "redo"),
)  # fmt: skip
"""Actions that keys request of a panel; the browser does others itself. See `panel/help.js`."""


class PanelPage(anywidget.AnyWidget):
    """A widget without a picture of its own, anywhere in a box of class fw-panel.

    `drag` numbers the latest drag of any slider in the page, 0 after a key or another click, so that a slow drag is one
    undo step. Values throttled by the browser arrive after the mouse is released, so the end of a drag is unknown: it
    lasts until the next one begins.
    """

    _esm = browser_program("panel/view.js")
    _css = BROWSER / "panel" / "view.css"

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

    def _on_message(self, _widget: object, content: object, _buffers: object) -> None:
        if not isinstance(content, dict) or not isinstance(content.get("what"), str):
            return
        if content.get("kind") == "reset":
            self._reset(content["what"])
        elif content.get("kind") == "key" and content["what"] in ACTIONS:
            self._act(content["what"])
