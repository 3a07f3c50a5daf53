"""The status of a live session, in a line updated a few times per second."""

import time

import ipywidgets as widgets

from workbench.session.live import LiveSession

STATUS_S = 0.25
SHAPES = {
    "mean face": "average",
    "first second": "from the first second",
    "neutral face": "from the neutral face",
}
SHAPE_TIP = "how wide the face is, how far apart its eyes are; measured once, and anew by the button neutral face"


class LiveStatus(widgets.HTML):
    """The face shape, the progress of a calibration, and the length of a recording."""

    def __init__(self) -> None:
        self._written = 0.0
        super().__init__(layout=widgets.Layout(min_width="0", flex="1 1 0", overflow="hidden"))
        self.add_class("fw-status")

    def write(self, text: str) -> None:
        """Show a text, HTML."""
        self._written = time.monotonic()
        self.value = f"<code>{text}</code>"

    def tell(self, session: LiveSession) -> None:
        """Update the status, unless it was updated a moment ago."""
        if time.monotonic() - self._written < STATUS_S:
            return
        gathering, recording = session.gathering, session.recording
        words = [f"<span title='{SHAPE_TIP}'>face shape: {SHAPES[session.calibrated]}</span>"]
        if gathering is not None:
            words = [f"neutral face: {gathering[0]} of {gathering[1]} frames"]
        if recording is not None:
            words.append(f"<b>● {recording[1]:.1f} s, {recording[0]} frames</b>")
        self.write(" &nbsp; ".join(words))
