"""Messages over the picture of a live view: instructions, status and errors."""

import time
from collections.abc import Callable

from workbench.errors import WorkbenchError
from workbench.session.live import LiveSession
from workbench.session.live_frame import FrameSource
from workbench.widgets.live_view import LiveView
from workbench.widgets.status_line import error_text

WELCOME = "Press start. Pictures go from the browser to the kernel and nowhere else."
WELCOME_KERNEL = "Press start. Pictures of {name} go from the kernel to this page and nowhere else."
STOPPED = "Stopped; the camera is off."
READYING = "Getting ready …"
NEUTRAL = "Look into the camera with a neutral face: mouth closed, brows at rest …"
ALERT_S = 8.0
"""An error is shown over a running picture for this time."""


def welcome(source: FrameSource) -> str:
    """What to do first, and where the pictures of a source go."""
    return WELCOME if source.in_browser else WELCOME_KERNEL.format(name=source.name)


class LiveMessages:
    """One message at a time over a view; may be set from any thread."""

    def __init__(self, view: LiveView) -> None:
        self._view, self._since = view, 0.0

    def say(self, text: str, wrong: bool = False) -> None:
        """Show a message; an empty one removes it."""
        self._since = time.monotonic()
        with self._view.hold_sync():
            self._view.message, self._view.alert = text, wrong

    def failed(self, error: Exception) -> None:
        """Show an error, for example from a thread that cannot raise it to a caller."""
        self.say(error_text(error), wrong=True)

    def guarded(self, act: Callable[..., object], *arguments: object) -> None:
        """Run an action requested by the user; if it is refused or cannot be written, show why."""
        try:
            act(*arguments)
        except WorkbenchError as error:
            self.failed(error)
        except OSError as error:
            self.say(f"Writing failed ({error}); choose another folder.", wrong=True)

    def waited(self, session: LiveSession) -> None:
        """Remove the message if the user no longer has to wait, or has had time to read what went wrong."""
        over = self._view.message == READYING or (self._view.message == NEUTRAL and session.gathering is None)
        if over or (self._view.alert and time.monotonic() - self._since > ALERT_S):
            self.say("")
