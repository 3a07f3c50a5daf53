"""The picture while its clip is opened: the first frame at once, then frames with their detections as they come."""

import time
from pathlib import Path

import ipywidgets as widgets

from workbench.errors import WorkbenchError
from workbench.frames import open_frames
from workbench.pictures.overlay import draw_landmarks
from workbench.session.material import PictureStore
from workbench.tracking import FrameObservation
from workbench.widgets.playground import jpeg

EVERY_S = 0.5
"""Time between two pictures: decoding and drawing them must not slow the detector down."""


class DetectionPreview(widgets.Image):
    """Hidden until `begin`, and again after `end`. Landmark files have no picture, so that nothing is shown."""

    def __init__(self) -> None:
        layout = widgets.Layout(display="none", max_height="60vh", max_width="100%", object_fit="contain")
        super().__init__(format="jpeg", layout=layout)
        self._pictures: PictureStore | None = None
        self._due = 0.0

    def begin(self, path: Path) -> None:
        """Show the first frame of a photo, a clip or a folder."""
        self.end()
        try:
            self._pictures = PictureStore(open_frames(path), [])
            self.value = jpeg(self._pictures[0])
        except (WorkbenchError, IndexError):
            self._pictures = None
            return
        self.layout.display, self._due = None, time.monotonic() + EVERY_S

    def see(self, observation: FrameObservation) -> None:
        """Show a frame with its landmarks, unless the last one has only just been shown."""
        if self._pictures is None or time.monotonic() < self._due:
            return
        self.value = jpeg(draw_landmarks(self._pictures[observation.index], observation.landmarks))
        self._due = time.monotonic() + EVERY_S

    def end(self) -> None:
        """Hide it."""
        self._pictures, self.layout.display, self.value = None, "none", b""
