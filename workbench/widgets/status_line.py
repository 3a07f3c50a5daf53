"""One line of status and error messages."""

import html
import re
from collections.abc import Callable

import ipywidgets as widgets

from workbench.errors import StoppedError, WorkbenchError
from workbench.tracking import FrameFit
from workbench.tracking.failures import why_failed

SLOW_MS = 1500.0
"""A solve under FACE IT! that took longer was compiled; its time says nothing."""
WRONG = "color:var(--jp-error-color1, #b3261e)"


def error_text(error: Exception) -> str:
    """The message of an error: ours are complete sentences, others are prefixed with their type."""
    return str(error) if isinstance(error, WorkbenchError) else f"{type(error).__name__}: {error}"


class StatusLine(widgets.HTML):
    """A line of text in the page's font or, with `tag` "code", in a monospaced one; may be set from any thread."""

    def __init__(self, tag: str = "span", **options: object) -> None:
        self._tag = tag
        super().__init__(**options)

    def say(self, text: str, wrong: bool = False) -> None:
        """Show a text; `wrong`: in red."""
        self.value = f"<{self._tag} style='{WRONG if wrong else ''}'>{html.escape(text)}</{self._tag}>"

    def tell(self, said: str) -> None:
        """Show a text of HTML."""
        self.value = f"<span title='{html.escape(re.sub('<[^>]*>', '', said), quote=True)}'>{said}</span>"

    def show_fit(self, fit: FrameFit, frames: int, after: bool = False, flag: str = "") -> None:
        """Show how good a fit is; see `status_of`."""
        self.tell(status_of(fit, frames, after, flag))

    def failed(self, error: Exception) -> None:
        """Show an error, for example from a thread that cannot raise it to a caller; what was cancelled is none."""
        self.say(error_text(error), wrong=not isinstance(error, StoppedError))

    def guarded(self, act: Callable[..., object], *arguments: object) -> bool:
        """Run an action requested by the user; False if it is refused, and the line shows why."""
        try:
            act(*arguments)
        except WorkbenchError as error:
            self.failed(error)
            return False
        return True


class LineAbout(StatusLine):
    """A line about what `about` returns: whatever was said last stays until that changes, however often it is shown.

    A panel catches up with a drag in its own time; what was said of the new settings meanwhile must not go.
    """

    def __init__(self, about: Callable[[], object]) -> None:
        self._about = about
        self._said_of: object | None = None
        super().__init__()
        self.observe(self._on_said, "value")

    def show(self, said: str) -> None:
        """Show a text of HTML, if what the line is about has changed."""
        if self._said_of is None or self._said_of != self._about():
            self.value = said

    def forget(self) -> None:
        """Let the next text that is shown replace what was said."""
        self._said_of = None

    def _on_said(self, _change: object) -> None:
        self._said_of = self._about()


def status_of(fit: FrameFit, frames: int, after: bool = False, flag: str = "") -> str:
    """Error, pose and time of a fit in words, as HTML; `after`: it was infilled or refined; `flag`: why its frame was
    flagged, if it was.
    """
    where = [f"frame {fit.index}/{frames - 1}"] if frames > 1 else []
    if not fit.found:
        return " · ".join([*where, "no face"])
    yaw, pitch, roll = fit.angles_deg
    angles = f"yaw {degrees(yaw)} · pitch {degrees(pitch)} · roll {degrees(roll)}"
    if fit.source == "filled":
        return " · ".join([*where, "filled from its neighbours", angles])
    pixels, inner, every = fit.errors
    error = [f"error <b>{every:.1f} %</b> of the eye distance"] if fit.seen else ["not seen in this view"]
    more = [f"<span style='opacity:.7'>{pixels:.2f} px, without the jaw line {inner:.1f} %</span>"] if fit.seen else []
    took = fit.milliseconds[2]
    time = [f"{took:.0f} ms" if took < SLOW_MS else f"{took / 1000:.1f} s"]
    why = why_failed(fit)
    failed = [f"<span style='{WRONG}'>failed: {html.escape(why)}</span>"] if why else []
    flagged = [f"<b>flagged</b>: {html.escape(flag)}"] if flag and not after else []
    return " · ".join([*where, *(["after"] if after else []), *failed, *flagged, *error, angles, *time, *more])


def degrees(angle: float) -> str:
    """A whole number of degrees with a true minus, without a sign at zero."""
    return f"{angle:.0f}°".replace("-0°", "0°").replace("-", "−")
