"""A widget that shows something at once, and makes its many parts after the cell in which it is made."""

import threading
from collections.abc import Sequence
from typing import Any

import ipywidgets as widgets

from workbench.widgets.closing import close_all_of
from workbench.widgets.kernel_comms import after_message


class LateParts(widgets.VBox):
    """Begins with the widgets of `first`; `_make_parts` makes the rest, after the cell or when a part is asked for.

    A browser shows nothing of a cell before its end, and hundreds of widgets take seconds. Subclasses call `_make`
    before they use parts whose names begin with an underscore. An error in making them is shown in their place, and
    raised again wherever a part is asked for: no cell is left that it could end.
    """

    def __init__(self, first: Sequence[widgets.Widget]) -> None:
        self._making, self._made, self._closed = threading.RLock(), False, False
        self._failure: Exception | None = None
        super().__init__(first)
        after_message(self._make_after_cell)

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
            if self._made and self._failure is None:
                self._close_parts()
            close_all_of(self)

    def _make(self) -> None:
        with self._making:
            if self._failure is not None:
                raise self._failure
            if not self._made and not self._closed:
                self._made = True
                try:
                    self._make_parts()
                except Exception as error:
                    self._failure = error
                    raise

    def _make_after_cell(self) -> None:
        try:
            self._make()
        except Exception as error:
            from workbench.widgets.status_line import StatusLine  # here: the first part is shown without it

            line = StatusLine()
            line.failed(error)
            self.children = (*self.children, line)
            raise

    def _make_parts(self) -> None:
        raise NotImplementedError

    def _close_parts(self) -> None:
        raise NotImplementedError
