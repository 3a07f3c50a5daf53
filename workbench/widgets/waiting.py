"""What takes its time: said after a moment, with how long it took the last time, while the old result is pale."""

import html
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import ipywidgets as widgets

PATIENCE_S = 0.3
"""What takes no longer is not mentioned."""
OLD = "fw-old"
"""The class of a widget that shows an old result."""
SPINNER = "<span class='fw-spin' aria-hidden='true'></span>"


class Waiting(widgets.HTML):
    """A line about the latest slow job that is running, empty if there is none. For any thread."""

    def __init__(self, patience_s: float = PATIENCE_S) -> None:
        self._patience_s = patience_s
        self._running: dict[int, tuple[str, Sequence[widgets.Widget]]] = {}
        self._took: dict[str, float] = {}
        self._lock, self._number = threading.RLock(), 0
        super().__init__()
        self.add_class("fw-waiting")

    @contextmanager
    def during(self, what: str, kind: str = "", old: Sequence[widgets.Widget] = ()) -> Iterator[None]:
        """Say `what` is being done if it is not done soon. Jobs of a `kind` take about as long as the last one.

        `old` are the widgets that show an old result until then.
        """
        kind = kind or what
        with self._lock:
            self._number += 1
            number = self._number
        timer = threading.Timer(self._patience_s, self._begin, (number, text_of(what, self._took.get(kind)), old))
        timer.daemon = True
        began = time.monotonic()
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            self._took[kind] = time.monotonic() - began
            self._end(number)

    def running(self, work: Callable[..., None], what: str) -> Callable[..., None]:
        """The same work, told about."""

        def told(*arguments: object) -> None:
            with self.during(what):
                work(*arguments)

        return told

    def _begin(self, number: int, text: str, old: Sequence[widgets.Widget]) -> None:
        with self._lock:
            self._running[number] = text, old
            self._show()
            for widget in old:
                widget.add_class(OLD)

    def _end(self, number: int) -> None:
        with self._lock:
            ended = self._running.pop(number, None)
            if ended is None:
                return
            self._show()
            for widget in ended[1]:
                widget.remove_class(OLD)

    def _show(self) -> None:
        texts = [text for text, _ in self._running.values()]
        self.value = f"{SPINNER} {html.escape(texts[-1])}" if texts else ""


def text_of(what: str, seconds: float | None) -> str:
    """What is done, and about how long it takes if that is known."""
    if seconds is None or seconds < 1.0:
        return f"{what} …"
    return f"{what} … about {seconds:.0f} s"
