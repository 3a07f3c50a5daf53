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

    `say` is called with a text when a request begins to wait, and with "" when it ends by an error of `write` or
    `later`, which passes. `stop` is called by the button `cancel`, which is shown until the last request has ended.
    """

    def __init__(
        self,
        write: Callable[[Request, Cancelled], None],
        later: Callable[[Callable[[], None]], None],
        say: Callable[[str], None],
        stop: Callable[[], object],
    ) -> None:
        self._write, self._later, self._say = write, later, say
        self._turns: list[_Turn[Request]] = []
        self._lock = threading.RLock()
        self.cancel = small_button("cancel", "stop, unless the file is just being completed")
        self.cancel.layout.display = "none"
        self.cancel.on_click(lambda _button: stop())

    @property
    def busy(self) -> bool:
        """Whether something waits or is being written."""
        return bool(self._turns)

    def submit(self, request: Request) -> None:
        """Write it after what already waits; nothing is added where the last request for its file is the same."""
        turn = _Turn(request)
        with self._lock:
            if self._last(request.path) == request:
                return
            self._turns.append(turn)
            self._show()
            self._say(f"waiting to write {request.path.name} …")  # before it can begin and say more
        try:
            self._later(lambda: self._take(turn))
        except Exception:
            self._end(turn)
            self._say("")
            raise

    def drop(self) -> list[Request]:
        """Cancel all. Returns those that were still waiting; what is being written stays until it can stop."""
        with self._lock:
            waiting = [turn.request for turn in self._turns if not turn.begun]
            for turn in self._turns:
                turn.cancelled.set()
            self._turns = [turn for turn in self._turns if turn.begun]
            self._show()
        return waiting

    def _last(self, path: Path) -> Request | None:
        """The last request for a file, unless it was cancelled."""
        turns = [turn for turn in self._turns if turn.request.path == path and not turn.cancelled.is_set()]
        return turns[-1].request if turns else None

    def _take(self, turn: _Turn[Request]) -> None:
        with self._lock:
            if turn.cancelled.is_set():
                return
            turn.begun = True
        try:
            self._write(turn.request, turn.cancelled.is_set)
        except Exception:
            if not turn.cancelled.is_set():  # what was said of the cancelled ones stays
                self._say("")
            raise
        finally:
            self._end(turn)

    def _end(self, turn: _Turn[Request]) -> None:
        with self._lock:
            self._turns = [other for other in self._turns if other is not turn]
            self._show()

    def _show(self) -> None:
        self.cancel.layout.display = None if self._turns else "none"
        self.cancel.disabled = all(turn.cancelled.is_set() for turn in self._turns)
