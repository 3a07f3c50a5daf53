"""Layers over the picture that are slow to draw: the fitted head, and the view of the landmark network."""

from collections.abc import Callable
from functools import partial

import numpy as np

from workbench.landmarks.network_detector import NetworkDetector, NetworkLook
from workbench.landmarks.scheme import POINT_COUNT
from workbench.pictures import HeadRenderer, gl_available
from workbench.pictures.heat import heat_layer
from workbench.session import FittedHead, TuningSession
from workbench.tracking import FrameFit
from workbench.widgets.latest import LatestWins
from workbench.widgets.overlay_view import OverlayView
from workbench.widgets.status_line import error_text
from workbench.widgets.waiting import Waiting

FIRST_S = 10.0
"""What the first picture of a layer takes, programs and networks included."""


class PictureLayers:
    """Draws the selected layers of a fit into a view, in its own thread; `waiting` says what is being drawn.

    The first picture of the face, and of the network's view, takes many seconds; fits do not wait for it. Cancelling
    it calls `switch_off` with the layer's name, and what it would have shown is dropped.
    """

    def __init__(
        self, session: TuningSession, head: FittedHead, view: OverlayView, said: Callable[[str], None],
        waiting: Waiting, switch_off: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._session, self._head, self._view, self._said = session, head, view, said
        self._waiting, self._switch_off = waiting, switch_off
        self._renderer: HeadRenderer | None = None
        self._network: NetworkDetector | None = None
        self._seen: tuple[bytes, NetworkLook] | None = None
        self._worker: LatestWins[FrameFit] = LatestWins(
            self._draw, lambda error: said(error_text(error)), "panel-layers"
        )

    def show(self, fit: FrameFit) -> None:
        """Draw the layers that are switched on in the view."""
        if self._view.layers["layer"] or self._view.layers["heat"]:
            self._worker.submit(fit)

    def wait_idle(self, timeout_s: float | int) -> bool:
        """Wait until the layers are drawn; False if that takes longer."""
        return self._worker.wait_idle(timeout_s)

    def close(self) -> None:
        """Stop the thread and the renderer."""
        self._worker.close()
        self._close_renderer()

    def _draw(self, fit: FrameFit) -> None:
        for name, what, make, set_layer in (
            ("layer", "drawing the face", self._face, self._view.set_layer),
            ("heat", "computing the network's view", self._heat, self._view.set_heat),
        ):
            if self._view.layers[name]:
                with self._waiting.during(what, cancel=partial(self._switch_off, name), expected_s=FIRST_S) as job:
                    picture = make(fit)
                if self._worker.newer():
                    return
                if not job.cancelled():
                    set_layer(picture)

    def _close_renderer(self) -> None:
        if self._renderer is not None:
            self._renderer.close()

    def _face(self, fit: FrameFit) -> np.ndarray | None:
        if not gl_available():
            self._said("The face layer needs OpenGL; the mesh works without it.")
            return None
        if self._renderer is None or self._renderer.size != fit.image_size:
            self._close_renderer()
            self._renderer = HeadRenderer(self._head.model, fit.image_size, supersampling=1.0)
        picture, mask = self._renderer.render_with_mask(
            self._head.vertices(fit), fit.camera, fit.rotation, fit.translation
        )
        return np.dstack([picture, mask])

    def _heat(self, fit: FrameFit) -> np.ndarray | None:
        frame = fit.index if len(self._session) > 1 else 0
        picture, key = self._session.picture(frame), fit.observed.tobytes()
        if not np.ptp(picture):
            self._view.message = "no picture, no heat map"
            return None
        if self._seen is None or self._seen[0] != key:
            self._network = self._network or NetworkDetector()
            self._seen = key, self._network.look(picture, fit.observed)
        return heat_layer(self._seen[1], [point for point in self._view.selection if point < POINT_COUNT])
