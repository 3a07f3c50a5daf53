"""Latest wins: one worker thread and at most one waiting request, replaced by any newer one."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Request = TypeVar("Request")


class LatestWins(Generic[Request]):
    """Runs `work(request)` in its own thread; of requests that arrive while it runs only the latest is kept.

    A widget's callback submits a request and returns at once, so that slow fits neither queue up nor block the kernel.
    Exceptions from `work` go to `failed` and do not end the thread.
    """

    def __init__(
        self, work: Callable[[Request], None], failed: Callable[[Exception], None], name: str = "latest-wins"
    ) -> None:
        self._work, self._failed = work, failed
        self._changed = threading.Condition()
        self._waiting: list[Request] = []
        self._busy = self._closed = False
        self.started = 0
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._thread.start()

    def submit(self, request: Request) -> None:
        """Request `work(request)`; replaces a request that is still waiting."""
        with self._changed:
            self._waiting = [request]
            self._changed.notify_all()

    @property
    def waiting(self) -> int:
        """Number of waiting requests: 0 or 1."""
        return len(self._waiting)

    def newer(self) -> bool:
        """Whether a newer request is waiting, so that long work may stop."""
        return bool(self._waiting) or self._closed

    def wait_newer(self, timeout_s: float | int) -> bool:
        """For use inside `work`: wait for a newer request; False if none arrives in time."""
        with self._changed:
            return self._changed.wait_for(self.newer, timeout_s)

    def wait_idle(self, timeout_s: float | int = 30.0) -> bool:
        """Wait until nothing is waiting or running; False if that takes longer."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._waiting and not self._busy, timeout_s)

    def close(self) -> None:
        """End the thread after the current work; closing twice is fine."""
        with self._changed:
            self._closed, self._waiting = True, []
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=10)

    def _serve(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                request, self._busy = self._waiting.pop(), True
                self.started += 1
            try:
                self._work(request)
            except Exception as error:
                self._failed(error)
