"""Calls after a while, all from one thread: a thread for each call takes as long to start as a third of a fit."""

import heapq
import itertools
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

Call = Callable[[], object]


@dataclass(order=True)
class Alarm:
    """A call and its time. It is compared by time, and calls of the same time come in the order of their requests."""

    due: float
    number: int
    call: Call | None = field(compare=False)
    """None once it has been called or cancelled."""

    def cancel(self) -> None:
        """Do not call; nothing happens if it has been called."""
        self.call = None


class Alarms:
    """A thread that makes calls at their time. It starts with the first request and ends with the process.

    What is requested while an earlier alarm is set wakes nobody: one that is cancelled costs no turn of another thread.
    """

    def __init__(self) -> None:
        self._set: list[Alarm] = []
        self._changed = threading.Condition()
        self._numbers = itertools.count()
        self._thread: threading.Thread | None = None

    def after(self, seconds: float, call: Call) -> Alarm:
        """Make a call after some time, from the thread of all alarms: it must be short. A failure is logged."""
        with self._changed:
            alarm = Alarm(time.monotonic() + seconds, next(self._numbers), call)
            heapq.heappush(self._set, alarm)
            if self._thread is None:
                self._thread = threading.Thread(target=self._serve, name="alarms", daemon=True)
                self._thread.start()
            elif self._set[0] is alarm:
                self._changed.notify()
        return alarm

    def _serve(self) -> None:
        while True:
            call = self._next().call
            try:
                if call is not None:
                    call()
            except Exception:
                logging.getLogger(__name__).exception("an alarm's call failed")

    def _next(self) -> Alarm:
        """The next alarm, at its time."""
        with self._changed:
            while not self._set or (left := self._set[0].due - time.monotonic()) > 0.0:
                self._changed.wait(left if self._set else None)
            return heapq.heappop(self._set)


ALARMS = Alarms()
