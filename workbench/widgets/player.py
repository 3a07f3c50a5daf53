"""A track played by a head in the notebook: the performer's own, or a character that it was retargeted to."""

import html
import threading

import cv2
import ipywidgets as widgets
import numpy as np

from workbench.errors import InputError
from workbench.export.clip import check_model
from workbench.face import DressedHead, FaceModel
from workbench.frames import RATE_OF_IMAGES, Frames
from workbench.pictures.overlay import draw_overlay
from workbench.session import FittedHead
from workbench.session.material import PictureStore
from workbench.tracking import Track
from workbench.widgets.cell_reruns import replace_earlier
from workbench.widgets.closing import close_all_of
from workbench.widgets.head_backends import make_head_view
from workbench.widgets.latest import LatestWins
from workbench.widgets.playground import jpeg

VIEWS = {"expression alone": "front", "as the camera sees it": "camera", "turn with the mouse": "free"}
HEIGHT_PX = 360


class AvatarPlayer(widgets.VBox):
    """Play, stop and a slider over the frames; the head can be turned with the mouse while it plays.

    The browser keeps the time; a kernel that cannot keep up skips frames instead of lagging behind. With `pictures`,
    the input with its fit is shown next to the head; `dressed` shows the default head as a character. In
    JupyterLab, a rerun of the cell that made it closes it. Raises `InputError` for a model other than the track's and
    for a track without frames.
    """

    def __init__(
        self,
        track: Track,
        model: FaceModel,
        pictures: Frames | None = None,
        height_px: int = HEIGHT_PX,
        backend: str = "auto",
        dressed: DressedHead | None = None,
    ) -> None:
        self._worker = self.view = None
        check_model(track, model)
        if not len(track):
            raise InputError("The track has no frames, so there is nothing to play; track the input first.")
        self._track, self._head, self._height = track, FittedHead(model), height_px
        self._lock = threading.RLock()
        self._store = (
            None if pictures is None else PictureStore(pictures, [tuple(s) for s in track.image_size.tolist()])
        )
        self.view = make_head_view(model, (height_px, height_px), backend, dressed)
        last = len(track) - 1
        rate = float(track.meta.get("rate") or RATE_OF_IMAGES)
        self.play = widgets.Play(min=0, max=last, interval=max(1, round(1000.0 / rate)), show_repeat=True)
        self.slider = widgets.IntSlider(min=0, max=last, readout=False, layout=widgets.Layout(flex="1"))
        self.looking = widgets.Dropdown(options=VIEWS, layout=widgets.Layout(width="180px"))
        self.status = widgets.HTML()
        self.image = widgets.Image(format="jpeg", layout=widgets.Layout(height=f"{height_px}px", max_width="60%"))
        self._link = widgets.jslink((self.play, "value"), (self.slider, "value"))
        self._worker = LatestWins(self._show, self._failed, name="avatar-player")
        self.slider.observe(lambda change: self._worker.submit(change["new"]), "value")
        self.looking.observe(lambda change: self.view.set_view(change["new"]), "value")
        shown = [self.view.widget] if self._store is None else [self.image, self.view.widget]
        controls = widgets.HBox([self.play, self.slider, self.looking], layout=widgets.Layout(max_width="900px"))
        super().__init__([widgets.HBox(shown, layout=widgets.Layout(max_width="100%")), controls, self.status])
        self._show(0)
        replace_earlier(self)

    def __repr__(self) -> str:
        return f"AvatarPlayer({len(self._track)} frames, {self._head.model.name!r})"

    def wait_idle(self, timeout_s: float | int = 30.0) -> bool:
        """Wait until the latest frame is shown; False if that takes longer."""
        return self._worker.wait_idle(timeout_s)

    def close(self) -> None:
        """Stop playing and free the view."""
        for part in (self._worker, self.view):
            if part is not None:
                part.close()
        close_all_of(self)

    def _show(self, position: int) -> None:
        with self._lock:
            fit = self._track[position]
            if self._store is not None:
                self.image.value = jpeg(_low(draw_overlay(self._store[fit.index], fit), self._height))
            if fit.found:
                self.view.set_pose(fit.rotation, fit.translation, fit.camera, fit.image_size)
                self.view.set_vertices(self._head.vertices(fit), self._head.personal(fit.identity).neutral)
            angles = (
                "no face" if not fit.found else "yaw {:+.0f}°, pitch {:+.0f}°, roll {:+.0f}°".format(*fit.angles_deg)
            )
            self.status.value = f"<code>frame {fit.index} &nbsp; {angles}</code>"

    def _failed(self, error: Exception) -> None:
        # A thread cannot raise to a caller.
        self.status.value = f"<b style='color:#b3261e'>{html.escape(str(error))}</b>"


def _low(picture: np.ndarray, height: int) -> np.ndarray:
    """The picture reduced to this height; unchanged if it is lower."""
    scale = height / picture.shape[0]
    if scale >= 1.0:
        return picture
    return cv2.resize(picture, (max(1, round(picture.shape[1] * scale)), height), interpolation=cv2.INTER_AREA)
