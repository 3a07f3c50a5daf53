"""The browser's part of a live panel: its camera, the picture with landmarks, and the avatar."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import anywidget
import numpy as np
import traitlets
from jaxtyping import Float, Float32

from workbench.face import DressedHead, FaceModel
from workbench.geometry import rotation_matrix
from workbench.landmarks.scheme import POLYLINES
from workbench.pictures.head_picture import portrait_view
from workbench.session.live_frame import LIVE_SIZE, Deliver, LiveFrame, Trouble
from workbench.tracking import FrameFit
from workbench.widgets.browser_program import browser_program, style_text
from workbench.widgets.head_mesh import surface_message
from workbench.widgets.overlay_view import color_table

LOOKS = ("head", "camera", "expression")
PIVOT_MM = (0.0, 40.0, 80.0)
"""Pivot of the head in the view "head": the middle of the skull base, head frame."""
TIMES_KEPT = 300
MARK_COLUMNS = 6
NUMBERS_BEFORE_WEIGHTS = 16
TROUBLES = {
    "denied": "The browser may not use the camera; allow it in the address bar (camera symbol), then start.",
    "absent": "The browser found no camera; plug one in, or use the kernel's camera, then start.",
    "busy": "The browser cannot open the camera because another program uses it; close that program, then start.",
    "ended": "The camera was unplugged or switched off; plug it in again, then start.",
    "insecure": "Browsers allow cameras only on pages from localhost or https; open JupyterLab that way, "
    "or use the kernel's camera.",
    "silent": "The kernel did not answer for a minute, so the camera was switched off; start it again.",
    "failed": "The browser could not open the camera ({detail}); try another browser or the kernel's camera.",
}
"""Problems that a browser can report, each as one sentence for the user."""

LOST_S = 2.0
"""Time without a frame after which another page may take the camera."""
LOST_FRAMES = 60
"""Number of pictures skipped while waiting for a confirmation that may never come, as after closing a page."""


@dataclass(frozen=True)
class Shown:
    """A frame that a browser has drawn."""

    number: int
    milliseconds: float
    """Time since the browser grabbed it or, for the kernel's camera, since it arrived in the browser."""


class LiveView(anywidget.AnyWidget):
    """Camera in, drawings out. The kernel sends numbers only: pose, weights and landmarks of each frame.

    The browser holds the morph targets, and every frame until its fit arrives. Only one browser page at a time has the
    camera: the first to answer the request. Methods may be called from any thread.
    """

    _esm = browser_program("live/view.js")
    _css = style_text("live/view.css")

    running = traitlets.Bool(False).tag(sync=True)
    mirror = traitlets.Bool(True, help="show everything mirrored").tag(sync=True)
    looking = traitlets.Enum(LOOKS, "head").tag(sync=True)
    height_px = traitlets.Int(340, min=120).tag(sync=True)
    message = traitlets.Unicode("", help="message over the picture").tag(sync=True)
    alert = traitlets.Bool(False, help="whether the message reports a problem").tag(sync=True)
    _scheme = traitlets.Dict().tag(sync=True)
    _mesh = traitlets.Dict().tag(sync=True)
    _person = traitlets.Dict().tag(sync=True)

    def __init__(self, model: FaceModel, height_px: int = 340, dressed: DressedHead | None = None) -> None:
        self._model, self._dressed = model, dressed
        self._lock = threading.RLock()
        self._pages: set[str] = set()
        self._page: str | None = None
        self._unseen: int | None = None
        self._heard = time.monotonic()
        self._on_frame: Deliver | None = None
        self._on_trouble: Trouble | None = None
        self._on_left: Callable[[], None] | None = None
        self.times: deque[Shown] = deque(maxlen=TIMES_KEPT)
        """The latest frames that were drawn."""
        super().__init__(
            height_px=height_px,
            _scheme={"lines": [list(line) for line in POLYLINES], "colors": color_table().tobytes()},
            _mesh=mesh_message(model, dressed),
            _person=person_message(model, np.zeros(len(model.identity_deltas)), dressed),
        )
        self.on_msg(self._on_message)

    def __repr__(self) -> str:
        return f"LiveView({self._model.name!r}, {'running' if self.running else 'stopped'})"

    @property
    def pages(self) -> int:
        """Number of browser pages that show the view."""
        return len(self._pages)

    @property
    def silence_s(self) -> float:
        """Seconds since the last message from a page with the view; pages send one every ten. 0 before the first."""
        return time.monotonic() - self._heard if self._pages else 0.0

    def set_person(self, identity: Float[np.ndarray, "i"]) -> None:
        """Show the avatar with this face shape."""
        self._person = person_message(self._model, identity, self._dressed)

    def open_camera(self, deliver: Deliver, trouble: Trouble) -> None:
        """Ask the pages that show the view for their camera; the first to answer is used."""
        with self._lock:
            self._on_frame, self._on_trouble, self._page = deliver, trouble, None
        self.send({"kind": "call"})

    def close_camera(self) -> None:
        """Release the camera."""
        with self._lock:
            self._on_frame = self._on_trouble = self._page = None
        self.send({"kind": "close"})

    def skip(self, number: int) -> None:
        """Tell the page that this frame will not be fitted and that it may send the next one."""
        self.send({"kind": "skip", "number": number})

    def on_left(self, callback: Callable[[], None]) -> None:
        """Call `callback()` when no page shows the view any longer."""
        self._on_left = callback

    def show(self, fit: FrameFit, frame: LiveFrame, milliseconds: float | int, with_picture: bool) -> bool:
        """Send a fit to be drawn, with its picture if the browser does not have it.

        A picture is sent only after the previous one has been drawn; returns False if this one was skipped for that.
        """
        if with_picture:
            with self._lock:
                if self._unseen is not None and frame.number - self._unseen < LOST_FRAMES:
                    return False
                self._unseen = frame.number
        numbers = pack_fit(fit)
        content = {
            "kind": "fit",
            "number": frame.number,
            "found": fit.found,
            "size": list(fit.image_size),
            "error": round(fit.errors[0], 3) if fit.found else None,
            "angles": [round(float(angle), 1) for angle in fit.angles_deg] if fit.found else None,
            "ms": round(float(milliseconds), 2),
        }
        self.send(content, [numbers.tobytes(), *([frame.jpeg] if with_picture else [])])
        return True

    def forget_unseen(self) -> None:
        """Stop waiting for the confirmation of an earlier picture."""
        with self._lock:
            self._unseen = None

    def _on_message(self, _widget: object, content: object, buffers: object) -> None:
        if not isinstance(content, dict) or not isinstance(content.get("page"), str):
            return
        kind, page, before, self._heard = content.get("kind"), content["page"], self._heard, time.monotonic()
        if kind == "here":
            self._on_here(page, self._heard - before)
        elif kind == "beat":
            self._on_beat(page, content.get("closed") is True)
        elif kind == "left":
            self._on_page_left(page)
        elif kind == "shown":
            self._on_shown(content)
        elif kind == "frame" and page == self._page:
            self._on_shown(content.get("shown"))
            self._take_frame(content, buffers)
        elif kind == "trouble" and page in (self._page, None) and self._on_trouble is not None:
            sentence = TROUBLES.get(content.get("why"), TROUBLES["failed"])
            self._on_trouble(sentence.format(detail=str(content.get("detail", ""))[:120]))

    def _on_here(self, page: str, silence_s: float) -> None:
        with self._lock:
            self._pages.add(page)
            # A reloaded page does not announce that it leaves.
            wanted = self._on_frame is not None and (self._page in (None, page) or silence_s > LOST_S)
            if wanted:
                self._page = page
        if wanted:
            self._open_on(page)

    def _on_beat(self, page: str, closed: bool) -> None:
        """A page lives; if its camera should be on and is not, as after a broken connection, ask for it again."""
        with self._lock:
            self._pages.add(page)
            wanted = self._on_frame is not None and (self._page is None or (self._page == page and closed))
            if wanted:
                self._page = page
        if wanted:
            self._open_on(page)

    def _open_on(self, page: str) -> None:
        self.send({"kind": "open", "page": page, "size": list(LIVE_SIZE)})

    def _on_page_left(self, page: str) -> None:
        with self._lock:
            self._pages.discard(page)
            gone = not self._pages
            if self._page == page:
                self._page = None
        if gone and self._on_left is not None:
            self._on_left()

    def _on_shown(self, content: object) -> None:
        if not isinstance(content, dict):
            return
        number, milliseconds = content.get("number"), content.get("ms")
        if type(number) is not int or not isinstance(milliseconds, int | float):
            return
        with self._lock:
            if self._unseen is not None and number >= self._unseen:
                self._unseen = None
        self.times.append(Shown(number, float(milliseconds)))

    def _take_frame(self, content: dict, buffers: object) -> None:
        number, time_ms, deliver = content.get("number"), content.get("time"), self._on_frame
        if deliver is None or type(number) is not int or not isinstance(time_ms, int | float) or not buffers:
            return
        deliver(LiveFrame(number, 1e-3 * time_ms, jpeg=bytes(buffers[0])))


def pack_fit(fit: FrameFit) -> Float32[np.ndarray, "n"]:
    """Rotation (row by row), translation, focal lengths, principal point, weights, and one row per landmark.

    A landmark's row is observed x, y; model x, y; distance, px; confidence. All NaN without a face.
    """
    camera = fit.camera
    rotation = np.asarray(rotation_matrix(np.asarray(fit.rotation, float))) if fit.found else np.full((3, 3), np.nan)
    marks = np.column_stack([fit.observed, fit.projected, fit.residuals_px, fit.confidence])
    parts = (rotation, fit.translation, camera.focal_px, camera.principal_point_px, fit.expression, marks)
    return np.concatenate([np.ravel(np.asarray(part, float)) for part in parts]).astype("<f4")


def mesh_message(model: FaceModel, dressed: DressedHead | None = None) -> dict[str, object]:
    """The static data: the surface, morph targets in 16 bits, and the portrait's camera."""
    steps = np.maximum(np.abs(model.expression_deltas).max(axis=(1, 2)), 1e-9) / 32767.0
    deltas = np.rint(model.expression_deltas / steps[:, None, None])
    camera, translation = portrait_view(model, (1000, 1000))
    return {
        **surface_message(model, dressed),
        "shapes": len(model.expression_names),
        "names": list(model.expression_names),
        "deltas": np.ascontiguousarray(deltas, "<i2").tobytes(),
        "steps": steps.tolist(),
        "focal": float(camera.focal_px[0]) / 1000.0,
        "translation": translation.tolist(),
        "pivot": list(PIVOT_MM),
    }


def person_message(
    model: FaceModel, identity: Float[np.ndarray, "i"], dressed: DressedHead | None = None
) -> dict[str, object]:
    """What depends on the identity: the neutral face, and the scale of each morph target and of a character's parts."""
    personal = model.personal(identity)
    largest = np.maximum(np.abs(model.expression_deltas).max(axis=(1, 2)), 1e-9)
    factors = np.abs(personal.expression_deltas).max(axis=(1, 2)) / largest
    return {
        "neutral": np.ascontiguousarray(personal.neutral, "<f4").tobytes(),
        "factors": factors.tolist(),
        "growth": [] if dressed is None else dressed.growth(personal.neutral).tolist(),
    }


class BrowserCamera:
    """The camera of the browser that shows a `LiveView`: a `FrameSource`; the kernel may be on another machine."""

    name = "browser's camera"
    mirrored = in_browser = True

    def __init__(self, view: LiveView) -> None:
        self._view = view

    def start(self, deliver: Deliver, trouble: Trouble) -> None:
        """See `FrameSource.start`; a browser that shows the view later is asked at that time."""
        self._view.open_camera(deliver, trouble)

    def skipped(self, frame: LiveFrame) -> None:
        """See `FrameSource.skipped`."""
        self._view.skip(frame.number)

    def stop(self) -> None:
        """See `FrameSource.stop`."""
        self._view.close_camera()
