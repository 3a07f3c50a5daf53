"""What the user asked to be written: fixed by the click, done in turn, and cancelled while it waits or is written."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

from workbench.config import Config
from workbench.session.material import Cancelled
from workbench.widgets.controls import small_button


@dataclass(frozen=True)
class ExportRequest:
    """A file, and the configuration that it is written from."""

    path: Path
    config: Config


Request = TypeVar("Request", bound=ExportRequest)


@dataclass(eq=False)
class _Turn(Generic[Request]):
    request: Request
    cancelled: threading.Event = field(default_factory=threading.Event)
    begun: bool = False


class ExportRequests(Generic[Request]):
    """Requests that wait or are being written: `later` is called with a job for each, which calls `write`.

    `stop` is called by the button `cancel`, which is shown as long as there is something to cancel.
    """

    def __init__(
        self,
        write: Callable[[Request, Cancelled], None],
        later: Callable[[Callable[[], None]], None],
        stop: Callable[[], object],
    ) -> None:
        self._write, self._later = write, later
        self._turns: list[_Turn[Request]] = []
        self._lock = threading.RLock()
        self.cancel = small_button("cancel", "stop; no file is written")
        self.cancel.layout.display = "none"
        self.cancel.on_click(lambda _button: stop())

    @property
    def busy(self) -> bool:
        """Whether something waits or is being written."""
        return bool(self._turns)

    def submit(self, request: Request) -> None:
        """Write it after what already waits; nothing is added where the same waits or is being written."""
        turn = _Turn(request)
        with self._lock:
            if any(other.request == request for other in self._turns):
                return
            self._turns.append(turn)
            self._show()
        self._later(lambda: self._take(turn))

    def drop(self) -> list[Request]:
        """Cancel all. Returns those that were still waiting; what is being written stops as soon as it can."""
        with self._lock:
            turns, self._turns = self._turns, []
            for turn in turns:
                turn.cancelled.set()
            self._show()
        return [turn.request for turn in turns if not turn.begun]

    def _take(self, turn: _Turn[Request]) -> None:
        with self._lock:
            if turn.cancelled.is_set():
                return
            turn.begun = True
        try:
            self._write(turn.request, turn.cancelled.is_set)
        finally:
            with self._lock:
                self._turns = [other for other in self._turns if other is not turn]
                self._show()

    def _show(self) -> None:
        self.cancel.layout.display = None if self._turns else "none"
