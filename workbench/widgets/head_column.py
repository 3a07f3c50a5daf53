"""The 3D head with its controls for colouring, viewpoint and comparison."""

import html
from collections.abc import Callable
from functools import partial

import ipywidgets as widgets
import numpy as np

from workbench.errors import WorkbenchError
from workbench.face import posed_vertices
from workbench.pictures.overlay import residual_colors
from workbench.session import FittedHead, TuningSession
from workbench.session.tuned_config import START
from workbench.tracking import FrameFit
from workbench.widgets.character_choice import CharacterChoice
from workbench.widgets.controls import toggle
from workbench.widgets.head_backends import make_head_view
from workbench.widgets.head_view import Carrier, HeadView
from workbench.widgets.latest import LatestWins
from workbench.widgets.panel_layout import classed, wrapped
from workbench.widgets.status_line import error_text
from workbench.widgets.waiting import Waiting

COLORINGS = ("skin", "residual", "difference", "blendshape", "uncertainty")
LOOKS = ("camera", "front", "free")
FIRST_S = 5.0
"""What the first uncertainty takes, its program included."""
WORKING = "computing the uncertainty of frame {frame} …"
FACELESS = "fw-faceless"
"""The class of a place whose head is hidden, because its frame has none."""


class HeadColumn:
    """A `HeadView` and its controls. `uncertainty(fit)` returns a standard deviation in mm for every vertex.

    `limit()` is the end of the residuals' colour scale, which picture and strip share. The uncertainty takes seconds,
    so it is computed in a separate thread. Until then the head shows its skin without a legend, and a note says what
    is being computed; cancelling it goes back to the skin.
    """

    def __init__(
        self, session: TuningSession, head: FittedHead, size: tuple[int, int], backend: str,
        uncertainty: Callable[[FrameFit], np.ndarray], waiting: Waiting, redraw: Callable[[], None],
        limit: Callable[[], float],
    ) -> None:  # fmt: skip
        self._session, self._head, self._size, self._limit = session, head, size, limit
        self._uncertainty, self._waiting, self._redraw = uncertainty, waiting, redraw
        self._compared: tuple | None = None
        self._other: np.ndarray | None = None
        """Vertices of the compared fit."""
        self._worker: LatestWins[FrameFit] = LatestWins(self._work_out, self._failed, "panel-uncertainty")
        self._spread: tuple[tuple, np.ndarray | str] | None = None
        self._colored = self._marked = False
        self._backend, self.character = backend, CharacterChoice(session, head.model)
        self.view: HeadView = make_head_view(head.model, size, backend, self.character.dressed, fills=True)
        self.view.set_view(LOOKS[0])
        self.look = widgets.ToggleButtons(
            options=list(LOOKS), style={"button_width": "auto"},
            tooltips=["as the camera sees it, with the picture's crop and zoom (V)", "from the front (V)",
                      "as turned with the mouse (V)"],
        )  # fmt: skip
        self.look.observe(lambda change: self.view.set_view(change["new"]), "value")
        self.color = widgets.Dropdown(
            options=COLORINGS, tooltip="colour of the surface; difference: to the compared configuration",
            layout=widgets.Layout(width="104px"),
        )  # fmt: skip
        self.shape = widgets.Dropdown(
            options=list(head.model.expression_names), tooltip="blendshape whose displacement is shown",
            layout=widgets.Layout(width="150px", display="none"),
        )  # fmt: skip
        self.points = toggle("points", "landmarks and residuals in 3D")
        self.compare = widgets.Dropdown(
            options=self._comparisons(), value="", tooltip="the outline of another fit; see the page Compare",
            layout=widgets.Layout(width="100px"),
        )  # fmt: skip
        for control in (self.color, self.shape, self.points, self.compare):
            control.observe(self._on_choice, "value")
        hidden = widgets.Layout(display=None if self.view.note else "none")
        self.note = widgets.Label(self.view.note or "", layout=hidden)
        self.working = widgets.HTML(layout=widgets.Layout(display="none"))
        above = widgets.HBox([self.look, self.color, self.shape], layout=wrapped())
        below = widgets.HBox([self.character.widget, self.points, self.compare], layout=wrapped())
        self._holder = classed(widgets.VBox([classed(self.view.widget, "fw-grow")]), "fw-grow")
        self.widget = widgets.VBox([above, self._holder, self.working, below, self.note])

    def show(self, fit: FrameFit, carrier: Carrier | None = None) -> None:
        """Show the head of a fit, and none for a frame without a face; `carrier` is as in `HeadView.at_once`."""
        if not fit.found:
            self._holder.add_class(FACELESS)
            return
        self._holder.remove_class(FACELESS)
        if self.character.follow():
            self._make_view()
        self._ghost(fit)
        with self.view.at_once(carrier):
            self.view.set_vertices(self._head.vertices(fit), self._head.personal(fit.identity).neutral)
            self.view.set_pose(fit.rotation, fit.translation, fit.camera, fit.image_size)
            self._color(fit)
            self._mark(fit)

    def next_look(self) -> None:
        """Look from the next of `LOOKS`."""
        self.look.value = LOOKS[(LOOKS.index(self.look.value) + 1) % len(LOOKS)]

    def show_webgl(self, there: bool | None) -> None:
        """Draw in the kernel if the browser has no WebGL; None: not known yet."""
        if there is False and self.view.note is None:
            self.use_pictures("This browser has no WebGL, so the head is sent as pictures from the kernel.")

    def use_pictures(self, why: str) -> None:
        """Switch to the back end that needs no WebGL in the browser."""
        self._backend = "pictures"
        self._make_view()
        self.note.value, self.note.layout.display = why, None
        self._redraw()

    def _make_view(self) -> None:
        dressed = self.character.dressed
        old, self.view = self.view, make_head_view(self._head.model, self._size, self._backend, dressed, fills=True)
        self.view.set_view(self.look.value)
        self._holder.children = (classed(self.view.widget, "fw-grow"),)
        self._compared = None  # the new view has no outline yet
        old.close()

    def refresh_comparisons(self) -> None:
        """Update the list of snapshots, and the outline of one that was kept again."""
        if (compared := self._compared) and compared[2] != id(self._session.snapshots.get(compared[0])):
            self._redraw()
        if list(self.compare.options) != (options := self._comparisons()):
            chosen = self.compare.value
            self.compare.options = options
            if chosen in [value for _, value in options]:
                self.compare.value = chosen

    def close(self) -> None:
        """Stop the thread and free the view."""
        self._worker.close()
        self.view.close()

    def wait_idle(self, timeout_s: float | int) -> bool:
        """Wait until the colours are computed; False if that takes longer."""
        return self._worker.wait_idle(timeout_s)

    def _color(self, fit: FrameFit) -> None:
        kind = self.color.value
        spread = self._spread_of(fit) if kind == "uncertainty" else None
        self._say(spread if isinstance(spread, str) else "")
        if kind == "difference" and self._other is None:
            self._say("Choose under compare… what to compare with.")
        if kind == "residual":
            self.view.set_values(
                self._head.surface_values(fit.residuals_percent), 0.0, self._limit(), "residual, % of eye distance"
            )
        elif kind == "difference" and self._other is not None:
            moved = np.linalg.norm(self._head.vertices(fit) - self._other, axis=1)
            self.view.set_values(moved, 0.0, max(float(moved.max()), 0.1), f"difference to {self.compare.value}, mm")
        elif kind == "blendshape":
            moved = self._head.displacement(fit, self.shape.value)
            self.view.set_values(moved, 0.0, max(float(moved.max()), 0.1), f"{self.shape.value} at 1, mm")
        elif isinstance(spread, np.ndarray):
            high = max(float(np.nanpercentile(spread, 99)), 0.01)
            self.view.set_values(spread, 0.0, high, "standard deviation, mm")
        elif self._colored:
            self.view.set_values(None, 0.0, 1.0, "")
        with_values = kind in ("residual", "blendshape") or (kind == "difference" and self._other is not None)
        self._colored = with_values or isinstance(spread, np.ndarray)

    def _spread_of(self, fit: FrameFit) -> np.ndarray | str:
        """Standard deviations of the vertices, or the message to show while there are none."""
        known = self._spread
        if known is not None and known[0] == self._key(fit):
            return known[1]
        self._worker.submit(fit)
        return WORKING.format(frame=fit.index)

    def _work_out(self, fit: FrameFit) -> None:
        key = self._key(fit)
        if self._spread is None or self._spread[0] != key:
            stop = partial(self.color.set_trait, "value", COLORINGS[0])
            with self._waiting.during("computing the uncertainty", cancel=stop, expected_s=FIRST_S):
                try:
                    found = self._uncertainty(fit)
                except WorkbenchError as error:
                    found = str(error)
            self._spread = key, found
        if not self._worker.newer():
            self._redraw()

    def _failed(self, error: Exception) -> None:
        self._say(error_text(error))

    def _key(self, fit: FrameFit) -> tuple:
        return fit.index, fit.expression.tobytes(), fit.rotation.tobytes(), self._session.config

    def _say(self, text: str) -> None:
        self.working.value, self.working.layout.display = html.escape(text), None if text else "none"

    def _mark(self, fit: FrameFit) -> None:
        if self.points.value:
            landmarks = self._head.landmarks(fit)
            colors = np.array(residual_colors(fit.residuals_percent), np.uint8)
            self.view.set_points(landmarks, colors, 2.5)
            self.view.set_segments(np.stack([landmarks, self._head.observed(fit, landmarks)], axis=1), colors)
        elif self._marked:
            self.view.set_points(None, None)
            self.view.set_segments(None, None)
        self._marked = self.points.value

    def _ghost(self, fit: FrameFit) -> None:
        name = self.compare.value
        kept = id(self._session.snapshots.get(name))
        key = (name, fit.index, kept, fit.identity.tobytes()) if name else None
        if key == self._compared:
            return
        if not name:
            self._other = None
            self.view.set_ghost(None)
        else:
            config = self._session.base if name == START else self._session.snapshots[name]
            other = self._session.fit_frame(fit.index if len(self._session) > 1 else 0, config=config)
            # A separate model, because the other configuration may have another identity.
            model = self._head.model.personal(other.identity)
            self._other = posed_vertices(model, other.expression, other.jaw, other.scale)
            self.view.set_ghost(self._other, 1.0, outline=True)
        self._compared = key

    def _comparisons(self) -> list[tuple[str, str]]:
        return [("compare…", ""), (START, START), *((name, name) for name in self._session.snapshots)]

    def _on_choice(self, _change) -> None:
        self.shape.layout.display = None if self.color.value == "blendshape" else "none"
        self._redraw()
