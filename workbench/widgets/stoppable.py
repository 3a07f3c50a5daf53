"""Latest wins, with a button that stops the work and can be pressed only while there is any."""

from collections.abc import Callable

import ipywidgets as widgets

from workbench.widgets.latest import LatestWins, Request


class Stoppable(LatestWins[Request]):
    """Enables `button` from `ask` until the end of what was asked for; what is submitted besides leaves it as it is.

    The button submits `stop`, the request that takes the place of the others.
    """

    def __init__(
        self,
        work: Callable[[Request], None],
        failed: Callable[[Exception], None],
        name: str,
        button: widgets.Button,
        stop: Request,
    ) -> None:
        self._stopped_work, self._button = work, button
        self._asked: Request | None = None
        button.disabled = True
        button.on_click(lambda _button: self.submit(stop))
        super().__init__(self._until_done, failed, name)

    def ask(self, request: Request) -> None:
        """Submit a request that the button stops."""
        self._asked, self._button.disabled = request, False
        self.submit(request)

    def _until_done(self, request: Request) -> None:
        if request is self._asked:  # earlier work may just have ended, and disabled it
            self._button.disabled = False
        try:
            self._stopped_work(request)
        finally:
            self._button.disabled = not self.waiting
