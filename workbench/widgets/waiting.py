"""What takes its time: said after a moment with how long it will take, and cancelled, while the old result is pale."""

import html
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import ipywidgets as widgets

from workbench.widgets.alarms import ALARMS
from workbench.widgets.controls import small_button

PATIENCE_S = 0.3
"""What takes no longer is not mentioned."""
OLD = "fw-old"
"""The class of a widget that shows an old result."""
SPINNER = "<span class='fw-spin' aria-hidden='true'></span>"
TELLING_S = 0.2
"""Time between two reports of how far a job is: more would make the browser fall behind."""
Work = Callable[["Job"], object]


class Job:
    """A slow job while it runs: for its thread to ask whether it was cancelled, and to say how far it is."""

    def __init__(
        self,
        what: str,
        expected_s: float | None = None,
        old: Sequence[widgets.Widget] = (),
        cancel: Callable[[], object] | None = None,
    ) -> None:
        """`expected_s`: how long such a job took the last time; `old`: widgets that show an old result until then;
        `cancel`: called when the user cancels it; None: it cannot be cancelled.
        """
        self.what, self.old, self.cancel = what, old, cancel
        self._expected_s, self._began, self._told = expected_s, time.monotonic(), 0.0
        self._done, self._total = 0, 0
        self._stopped, self.ended = threading.Event(), False
        self.changed: Callable[[], None] = lambda: None
        """Called when `text` is worth showing again."""

    def cancelled(self) -> bool:
        """Whether the user has cancelled it."""
        return self._stopped.is_set()

    def drop(self) -> None:
        """Cancel it because nobody is there to see its result."""
        self._stopped.set()

    def stop(self) -> None:
        """Cancel it. What cannot stop halfway ends as soon as it can, and its result is not shown."""
        self._stopped.set()
        if self.cancel is not None:
            self.cancel()

    def progress(self, _step: str, done: int, total: int | None) -> None:
        """Say how far it is."""
        self._done, self._total = done, total or 0
        if time.monotonic() - self._told > TELLING_S:
            self._told = time.monotonic()
            self.changed()

    @property
    def seconds(self) -> float:
        """Since it began."""
        return time.monotonic() - self._began

    @property
    def text(self) -> str:
        """What is done, and about how long it takes if that is known."""
        if self.cancelled():
            return f"stopping: {self.what} …"
        if self._done and self._total:
            left = self.seconds * (self._total - self._done) / self._done
            return f"{self.what}: {self._done} of {self._total}{left_text(left)}"
        return text_of(self.what, self._expected_s)


class Waiting(widgets.HBox):
    """A line about the latest slow job, and a button that cancels it; empty if none is running. For any thread."""

    def __init__(self, patience_s: float = PATIENCE_S) -> None:
        self._patience_s = patience_s
        self._jobs: dict[int, Job] = {}
        self._running: dict[int, Job] = {}  # of them, those that the line has told about
        self._closed = False
        self._took: dict[str, float] = {}
        self._lock, self._number = threading.RLock(), 0
        self.said = widgets.HTML()
        self.cancel = small_button("cancel", "stop this; results so far are kept")
        self.cancel.layout.display = "none"
        self.cancel.on_click(lambda _button: self.stop())
        super().__init__([self.said, self.cancel])
        self.add_class("fw-waiting")

    @contextmanager
    def during(
        self,
        what: str,
        kind: str = "",
        old: Sequence[widgets.Widget] = (),
        cancel: Callable[[], object] | None = None,
        expected_s: float | None = None,
    ) -> Iterator[Job]:
        """Say `what` is being done if it is not done soon. Jobs of a `kind` take about as long as the last one.

        `old` are the widgets that show an old result until then. With `cancel`, which is called in the user's thread,
        it can be cancelled. `expected_s`: how long such a job usually takes, until one of them has been timed.
        """
        kind = kind or what
        job = Job(what, self._took.get(kind, expected_s), old, cancel)
        job.changed = self._show
        with self._lock:
            self._number += 1
            number = self._number
            self._jobs[number] = job
            if self._closed:
                job.drop()
        alarm = ALARMS.after(self._patience_s, lambda: self._begin(number, job))
        try:
            yield job
        finally:
            alarm.cancel()
            if not job.cancelled():
                self._took[kind] = job.seconds
            self._end(number, job)

    def running(self, work: Work, what: str, expected_s: float | None = None) -> Callable[[], None]:
        """The same work on a job that can be cancelled, told about."""

        def told() -> None:
            with self.during(what, cancel=nothing, expected_s=expected_s) as job:
                work(job)

        return told

    def stop(self) -> None:
        """Cancel the job that the line is about."""
        with self._lock:
            job = self._shown
        if job is not None and job.cancel is not None:
            job.stop()
            self._show()

    def close(self) -> None:
        """Cancel every job, and tell about none any more."""
        with self._lock:
            self._closed, jobs = True, list(self._jobs.values())
        for job in jobs:
            job.drop()
        super().close()

    @property
    def _shown(self) -> Job | None:
        return next(reversed(self._running.values()), None)

    def _begin(self, number: int, job: Job) -> None:
        with self._lock:
            if job.ended or self._closed:  # while the timer went off
                return
            self._running[number] = job
            self._show()
            for widget in job.old:
                widget.add_class(OLD)

    def _end(self, number: int, job: Job) -> None:
        with self._lock:
            job.ended = True
            del self._jobs[number]
            if self._running.pop(number, None) is None or self._closed:
                return
            self._show()
            for widget in job.old:
                widget.remove_class(OLD)

    def _show(self) -> None:
        with self._lock:
            if self._closed:
                return
            job = self._shown
            self.said.value = f"{SPINNER} {html.escape(job.text)}" if job else ""
            can = job is not None and job.cancel is not None and not job.cancelled()
            self.cancel.layout.display = None if can else "none"


def nothing() -> None:
    """For jobs that ask for themselves whether they were cancelled."""


def text_of(what: str, seconds: float | None) -> str:
    """What is done, and about how long it takes if that is known."""
    if seconds is None or seconds < 1.0:
        return f"{what} …"
    return f"{what} … about {seconds:.0f} s"


def left_text(seconds: float) -> str:
    """How long it still takes, from a second on."""
    return f", {seconds:.0f} s left" if seconds >= 1.0 else ""
