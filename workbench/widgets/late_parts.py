"""A widget that shows something at once, and makes its many parts after the cell in which it is made."""

import threading
from collections.abc import Sequence
from typing import Any

import ipywidgets as widgets

from workbench.widgets.kernel_comms import after_cell


class LateParts(widgets.VBox):
    """Begins with the widgets of `first`; `_make_parts` makes the rest, after the cell or when a part is asked for.

    A browser shows nothing of a cell before its end, and hundreds of widgets take seconds. Subclasses call `_make`
    before they use parts whose names begin with an underscore.
    """

    def __init__(self, first: Sequence[widgets.Widget]) -> None:
        self._making, self._made, self._closed = threading.RLock(), False, False
        super().__init__(first)
        after_cell(self._make)

    def __getattr__(self, name: str) -> Any:
        """A part that is asked for before it has been made."""
        if not name.startswith("_"):
            self._make()
        return object.__getattribute__(self, name)

    def close(self) -> None:
        """Close what has been made; closing twice is fine."""
        with self._making:
            closed, self._closed = self._closed, True
        if not closed:
            if self._made:
                self._close_parts()
            super().close()

    def _make(self) -> None:
        with self._making:
            if not self._made and not self._closed:
                self._made = True
                self._make_parts()

    def _make_parts(self) -> None:
        raise NotImplementedError

    def _close_parts(self) -> None:
        raise NotImplementedError
