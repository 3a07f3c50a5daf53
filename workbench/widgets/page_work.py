"""The long work of a page: in a thread of its own, with a bar and a stop, and the rest of the panel goes first."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic

import ipywidgets as widgets

from workbench.widgets.controls import small_button
from workbench.widgets.latest import Request
from workbench.widgets.status_line import StatusLine
from workbench.widgets.stoppable import Stoppable

GIVE_WAY_S = 2.0
"""Longest wait for what the rest of the panel computes, between two parts of the work."""


class PageWork(Generic[Request]):
    """Runs `work(request)`, the latest request alone; the bar `progress` tells of it, and the button `stop` ends what
    was asked for by `ask`; what is only submitted is not worth a stop.

    `give_way` waits up to some seconds until the panel's own work is done. Errors are said in `said`, and `stopped`
    once the work has stopped.
    """

    def __init__(
        self,
        work: Callable[[Request], None],
        said: StatusLine,
        give_way: Callable[[float], object],
        name: str,
        stop_tip: str,
        stopped: str = "",
    ) -> None:
        self._work, self._said, self._give_way, self._stopped = work, said, give_way, stopped
        self.stop = small_button("stop", stop_tip)
        self._worker: Stoppable[Request | None] = Stoppable(self._serve, said.failed, name, self.stop, None)
        self.ask, self.submit = self._worker.ask, self._worker.submit
        self.wait_idle, self.close = self._worker.wait_idle, self._worker.close
        self.progress = widgets.IntProgress(0, max=1, layout=widgets.Layout(width="100%", height="6px", margin="2px 0"))
        self.progress.layout.visibility = "hidden"
        self.running = False
        """Whether work runs that is `shown`: it was asked for, and would be lost."""

    def stopping(self) -> bool:
        """For use inside `work`, between two of its parts: the panel gets its turn first."""
        self._give_way(GIVE_WAY_S)
        return self._worker.newer()

    @contextmanager
    def shown(self, total: int = 1) -> Iterator[None]:
        """Show the bar meanwhile."""
        self.progress.max, self.progress.value, self.progress.layout.visibility = total, 0, "visible"
        self.running = True
        try:
            yield
        finally:
            self.progress.layout.visibility, self.running = "hidden", False

    def _serve(self, request: Request | None) -> None:
        if request is not None:
            self._work(request)
        elif self._stopped:
            self._said.say(self._stopped)
