"""The picture with its landmarks, and the tools to select, mute, weight, move and name them."""

from collections.abc import Callable

import ipywidgets as widgets
import numpy as np

from workbench.errors import WorkbenchError
from workbench.landmarks.uncertainty import ellipses
from workbench.session import FittedHead, TuningSession
from workbench.session.gesture import Gesture
from workbench.session.landmark_edits import rescaled, unmuted, weighed
from workbench.tracking import FrameFit
from workbench.widgets.controls import small_button, toggle
from workbench.widgets.overlay_view import OverlayEvent, OverlayView
from workbench.widgets.panel_layout import classed, group, wrapped
from workbench.widgets.picture_layers import PictureLayers
from workbench.widgets.waiting import Waiting

UNITS = {"%": "% of eye distance", "px": "px"}
WEIGHT_STEPS = {"weight_up": 2.0, "weight_down": 0.5}
POINTS = ("observed", "model", "residuals")
"""Layers that the button for points switches together."""
LAYERS = {
    "points": ("points", "rings: detections; dots: the model; lines: residuals"),
    "arrows": ("arrows", "residuals four times as long, from the model to the detection"),
    "wire": ("mesh", "wireframe of the fitted head"),
    "layer": ("face", "the fitted head over the photo"),
    "lines": ("lines", "connect the model's landmarks"),
    "labels": ("123", "landmark numbers"),
    "ellipses": ("σ", "where each point may be: the ellipse that holds 80 % of its places, as the detector says"),
    "bright": ("☀", "brighten a dark picture"),
    "heat": (
        "heat",
        "the landmark network's view: its crop, and where it locates the selected landmarks (all, if none is selected)",
    ),
}
"""What can be shown over the picture: label and tooltip of their buttons."""


class LandmarkTools:
    """The overlay of the current frame and its toolbars; edits go to the session."""

    def __init__(
        self, session: TuningSession, head: FittedHead, said: Callable[[str], None], waiting: Waiting,
        redraw: Callable[[], None],
    ) -> None:  # fmt: skip
        self._session, self._head, self._said, self._redraw = session, head, said, redraw
        self.frame, self._drags, self._dragging, self._before = 0, 0, False, session.config
        self.view = OverlayView(height_px=0, scheme=session.material.scheme, unit=UNITS["%"], at_face=True)
        self.view.on_event(self._on_event)
        self._pictures = PictureLayers(session, head, self.view, said, waiting, self._switch_off)
        tools, shown = self._tools(), self._shown()
        self._on_layers()
        self.widget = widgets.VBox([tools, classed(self.view, "fw-grow"), shown])

    def show_picture(self, frame: int) -> None:
        """Show a frame before it is fitted; layers of other frames are removed."""
        if frame != self.frame:
            self.frame = frame
            self.view.set_layer(None)
            self.view.set_heat(None)
        self.view.set_picture(self._session.picture(frame))

    def show(self, fit: FrameFit, note: str = "") -> None:
        """Show the fit of a frame on its picture, as one message to the browser; `note` is shown over it."""
        with self.view.hold_sync():
            self.show_picture(self._frame_of(fit))
            self.view.message = note or ("" if fit.found else f"frame {self.frame}: no face")
            if fit.found:
                self._show_points(fit)
            else:
                self.view.set_fit(None)
                self.view.set_heat(None)

    def _show_points(self, fit: FrameFit) -> None:
        values = self.residuals(fit)
        self.view.set_fit(fit.observed, fit.projected, values, fit.confidence, self._weights())
        if self.layers["wire"].value:
            self.view.set_wire(self._head.wire(fit))
        if self.layers["ellipses"].value:
            doubted = fit.landmarks is not None and fit.landmarks.covariance is not None
            self.view.set_ellipses(ellipses(fit.observed, fit.covariance) if doubted else None)
        self._pictures.show(fit)

    def wait_idle(self, timeout_s: float | int) -> bool:
        """Wait until the layers are drawn; False if that takes longer."""
        return self._pictures.wait_idle(timeout_s)

    def residuals(self, fit: FrameFit) -> np.ndarray:
        """Residuals in the chosen unit."""
        return fit.residuals_px if self.unit.value == "px" else fit.residuals_percent

    def in_percent(self) -> bool:
        """Whether residuals are shown in % of the eye distance."""
        return self.unit.value == "%"

    def refresh_groups(self) -> None:
        """Update the menu: groups first, then saved subsets."""
        if list(self.group.options) != (options := self._groups()):
            self.group.options = options

    def close(self) -> None:
        """Stop the thread and the renderer of the face layer."""
        self._pictures.close()

    def _frame_of(self, fit: FrameFit) -> int:
        return fit.index if len(self._session) > 1 else 0

    def _weights(self) -> np.ndarray:
        """Weight of each landmark in the last stage."""
        config = self._session.config
        last = config.running(start=False)[-1]
        scheme = self._session.material.scheme
        return np.multiply(last.landmark_weights(config.subsets, scheme), config.point_weights(scheme))

    # --- parts ---

    def _tools(self) -> widgets.Widget:
        """The toolbar above the picture: editing landmarks."""
        self.tool = widgets.ToggleButtons(
            options=[("➤ select", "select"), ("◌ lasso", "lasso"), ("✥ move", "move")], style={"button_width": "auto"},
            tooltips=["click landmarks; Ctrl adds", "draw around landmarks", "drag a wrong detection to its position"],
        )  # fmt: skip
        widgets.link((self.tool, "value"), (self.view, "tool"))
        self.mute = small_button("mute", "mute or unmute the selected landmarks (m)")
        self.up, self.down = small_button("×2", "double their weight (+)"), small_button("÷2", "halve their weight (−)")
        self.back = small_button("⟲", "reset the selected landmarks to their detected positions (r)")
        for button, kind in (
            (self.mute, "mute"), (self.up, "weight_up"), (self.down, "weight_down"), (self.back, "reset"),
        ):  # fmt: skip
            button.on_click(lambda _button, kind=kind: self._on_event(self._of_selection(kind)))
        self.group = widgets.Dropdown(
            options=self._groups(), value="", tooltip="select a group or a saved subset",
            layout=widgets.Layout(width="84px"),
        )  # fmt: skip
        self.group.observe(self._on_group, "value")
        self.unit = widgets.Dropdown(
            options=list(UNITS), tooltip="unit of residuals: % of the outer-eye distance, or pixels",
            layout=widgets.Layout(width="48px"),
        )  # fmt: skip
        self.unit.observe(self._on_unit, "value")
        self.name = widgets.Text(placeholder="name", tooltip="name of a subset", layout=widgets.Layout(width="64px"))
        self.save = small_button("name it", "save the selection under this name, for stages and weights")
        self.save.on_click(lambda _button: self._save())
        self._of_chosen = group(self.mute, self.up, self.down, self.back, self.name, self.save, name="fw-chosen")
        self._of_chosen.layout.display = "none"
        self.view.observe(self._on_selection, "selection")
        return widgets.HBox([group(self.tool, self.group, self.unit), self._of_chosen], layout=wrapped())

    def _shown(self) -> widgets.Widget:
        """The toolbar below the picture: layers drawn over it."""
        self.layers = {name: toggle(text, tip, value=name == "points") for name, (text, tip) in LAYERS.items()}
        seen = (observation.landmarks for observation in self._session.material.observations)
        if all(landmarks is None or landmarks.covariance is None for landmarks in seen):
            self.layers["ellipses"].layout.display = "none"
        for button in self.layers.values():
            button.observe(lambda _change: self._on_layers(), "value")
        self.opacity = widgets.FloatSlider(
            0.6, min=0.0, max=1.0, step=0.05, readout=False, tooltip="opacity of the face",
            layout=widgets.Layout(width="70px", display="none"),
        )  # fmt: skip
        widgets.link((self.opacity, "value"), (self.view, "layer_opacity"))
        return widgets.HBox([*self.layers.values(), self.opacity], layout=wrapped())

    # --- what the user does ---

    def _of_selection(self, kind: str) -> OverlayEvent:
        return OverlayEvent(kind, tuple(self.view.selection), None, None)

    def _on_event(self, event: OverlayEvent) -> None:
        try:
            self._act(event)
        except WorkbenchError as error:
            self._said(str(error))

    def _act(self, event: OverlayEvent) -> None:
        session, points = self._session, event.points
        if event.kind in ("mute", "weight_up", "weight_down", "reset") and not points:
            self._said("Select landmarks first: click them, or draw around them with the lasso.")
            return
        if event.kind in ("select", "lasso") and self.layers["heat"].value:
            self._redraw()
        config, scheme = session.config, session.material.scheme
        if event.kind == "mute":
            heard = any(config.point_weights(scheme)[point] for point in points)
            changed = weighed(config, points, 0.0) if heard else unmuted(config, points, scheme)
            session.use(changed, "mute" if heard else "unmute")
        elif event.kind in WEIGHT_STEPS:
            session.use(rescaled(config, points, WEIGHT_STEPS[event.kind], scheme), "landmark weight")
        elif event.kind in ("drag", "drop"):
            session.move(self.frame, points[0], (event.x, event.y), self._gesture(event))
        elif event.kind == "cancel" and self._dragging:
            session.use(self._before, "landmark drag", self._gesture(event))
        elif event.kind == "reset":
            session.put_back(self.frame, points)

    def _gesture(self, event: OverlayEvent) -> Gesture:
        """A drop after a drag ends the drag; a drop alone is an arrow key, which moves all selected landmarks."""
        if event.kind == "drag" and not self._dragging:
            self._drags, self._dragging, self._before = self._drags + 1, True, self._session.config
        gesture = Gesture(f"move {self.frame}", self._drags if self._dragging else 0)
        self._dragging = event.kind == "drag"
        return gesture

    def _on_group(self, change) -> None:
        name = change["new"]
        if name:
            points = self._session.config.subsets.get(name, self._session.material.scheme.groups.get(name, ()))
            self.view.selection = list(points)
            self.group.value = ""

    def _save(self) -> None:
        try:
            self._session.save_subset(self.name.value.strip(), self.view.selection)
        except WorkbenchError as error:
            self._said(str(error))
            return
        self._said(f"Saved the subset {self.name.value.strip()!r} of {len(self.view.selection)} points.")

    def _groups(self) -> list[tuple[str, str]]:
        names = [*self._session.material.scheme.groups, *self._session.config.subsets]
        return [("select…", ""), *((name.replace("_", " "), name) for name in names)]

    def _switch_off(self, name: str) -> None:
        self.layers[name].value = False

    def _on_layers(self) -> None:
        chosen = {name: button.value for name, button in self.layers.items()}
        chosen |= dict.fromkeys(POINTS, chosen.pop("points"))
        self.opacity.layout.display = None if chosen["layer"] else "none"
        self.view.layers = {**self.view.layers, **chosen}
        self._redraw()

    def _on_selection(self, change) -> None:
        self._of_chosen.layout.display = None if change["new"] else "none"

    def _on_unit(self, change) -> None:
        self.view.unit = UNITS[change["new"]]
        self._redraw()
