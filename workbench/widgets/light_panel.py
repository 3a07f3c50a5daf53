"""A lamp to move around a rendered head, and the nine coefficients per colour that represent it."""

import html
import threading
import time
from collections.abc import Callable

import cv2
import ipywidgets as widgets
import numpy as np
from jaxtyping import Float, UInt8

from workbench.arrays import AnyArray
from workbench.errors import WorkbenchError
from workbench.pictures import side_by_side
from workbench.plots import as_picture, ball_normals
from workbench.rendering import ambient_light, directional_light, spherical_harmonics
from workbench.rendering.lighting import LAMBERT
from workbench.runtime import COMPUTING
from workbench.widgets.cell_reruns import replace_earlier
from workbench.widgets.closing import close_all_of
from workbench.widgets.playground import Number, jpeg

Light = Float[np.ndarray, "9 3"]
SIDE_PX, BALL_PX, MARGIN_PX = 320, 180, 20
"""Height of the picture, size of the ball next to it and margin around the ball."""
BALL_ALBEDO, GROUND = 0.7, 0.2
"""Below 1, because light that suits a face would overexpose a white ball."""
FUNCTIONS = ("1", "y", "z", "x", "xy", "yz", "3z²−1", "xz", "x²−y²")
"""The nine basis functions, up to a factor."""
LARGEST = 6.0
"""Range of a coefficient's slider: the brightest lamp and ambient light together give 5.3 on the first."""
WIDTH = "700px"
START = {"azimuth": -35, "elevation": 35, "lamp": 0.6, "ambient": 0.45}


def lamp_light(azimuth: Number, elevation: Number, lamp: Number, ambient: Number) -> Light:
    """Light of a distant lamp plus uniform ambient light.

    Angles in degrees as seen from the head: `azimuth` 0 is towards the camera, positive towards image right, ±180
    behind the head; `elevation` is positive above. A surface facing the lamp shows its albedo times `lamp` + `ambient`.
    """
    side, rise = np.radians([azimuth, elevation])
    direction = np.cos(rise) * np.sin(side), -np.sin(rise), -np.cos(rise) * np.cos(side)
    return directional_light(tuple(map(float, direction)), float(lamp)) + ambient_light(float(ambient))


def lit_ball(light: Light, side: int) -> UInt8[np.ndarray, "s s 3"]:
    """A light grey matte ball under the light, on dark grey: the irradiance for each direction."""
    normals = ball_normals(side)
    functions = np.stack(spherical_harmonics(*np.moveaxis(normals, -1, 0)), axis=-1)
    return as_picture(np.where(np.isfinite(normals), BALL_ALBEDO * (LAMBERT * functions) @ light, GROUND))


class LightPanel(widgets.VBox):
    """Sliders for a lamp and for its nine coefficients: every move calls `draw` with the light and shows the picture.

    The lamp sets the coefficients; moving a single coefficient does not change the lamp. `draw` takes the light and
    returns colours from 0 to 1; it is called with `COMPUTING` held, from the thread in which a slider moves. `light`
    is the light shown. In JupyterLab, a rerun of the cell that made it closes it.
    """

    def __init__(self, draw: Callable[[Light], Float[AnyArray, "h w 3"]]) -> None:
        self._draw = draw
        self._lock = threading.RLock()
        self._quiet = False
        self.lamp = _lamp_sliders()
        self.coefficients = [_coefficient_slider(k) for k in range(9)]
        self.status = widgets.HTML()
        fixed = widgets.Layout(max_width="100%", object_fit="contain", align_self="flex-start")
        self.image = widgets.Image(format="jpeg", layout=fixed)
        for slider in self.lamp.values():
            slider.observe(self._on_lamp, "value")
        for slider in self.coefficients:
            slider.observe(self._on_coefficient, "value")
        two = widgets.Layout(grid_template_columns="repeat(2, minmax(260px, 1fr))", max_width=WIDTH)
        nine = widgets.Layout(grid_template_columns="repeat(3, minmax(200px, 1fr))", max_width=WIDTH)
        super().__init__(
            [
                widgets.GridBox(list(self.lamp.values()), layout=two),
                self.image,
                widgets.HTML("The nine coefficients"),
                widgets.GridBox(self.coefficients, layout=nine),
                self.status,
            ]
        )
        self.light = np.zeros((9, 3))
        self._on_lamp(None)
        replace_earlier(self)

    def __repr__(self) -> str:
        return f"LightPanel({[round(slider.value, 2) for slider in self.coefficients]})"

    def use(self, light: Light) -> None:
        """Show this light; the coefficient sliders show its mean over the colours."""
        with self._lock:
            self._place(light.mean(axis=1))
            self._show(light)

    def close(self) -> None:
        """Close the panel and its sliders."""
        close_all_of(self)

    def _on_lamp(self, _change) -> None:
        with self._lock:
            if not self._quiet:
                self.use(lamp_light(**{name: slider.value for name, slider in self.lamp.items()}))

    def _on_coefficient(self, _change) -> None:
        with self._lock:
            if not self._quiet:
                values = np.array([slider.value for slider in self.coefficients])
                self._show(np.repeat(values[:, None], 3, axis=1))

    def _place(self, values: Float[np.ndarray, "9"]) -> None:
        self._quiet = True  # one picture for the light, not one per slider that it moves
        try:
            for slider, value in zip(self.coefficients, values, strict=True):
                slider.value = float(value)
        finally:
            self._quiet = False

    def _show(self, light: Light) -> None:
        began = time.perf_counter()
        try:
            with COMPUTING:
                picture = as_picture(self._draw(light))
        except WorkbenchError as error:
            self.status.value = f"<b style='color:#b3261e'>{html.escape(str(error))}</b>"
            return
        self.light = light
        self.status.value = f"<code>drawn in {1e3 * (time.perf_counter() - began):.0f} ms</code>"
        height, width = picture.shape[:2]
        shown = cv2.resize(picture, (round(width * SIDE_PX / height), SIDE_PX), interpolation=cv2.INTER_CUBIC)
        self.image.value = jpeg(side_by_side(shown, _beside(lit_ball(light, BALL_PX))))


def _beside(ball: UInt8[np.ndarray, "s s 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """The ball centred in a column as high as the picture."""
    column = np.full((SIDE_PX, BALL_PX + 2 * MARGIN_PX, 3), round(255 * GROUND), np.uint8)
    top = (SIDE_PX - BALL_PX) // 2
    column[top : top + BALL_PX, MARGIN_PX : MARGIN_PX + BALL_PX] = ball
    return column


def _lamp_sliders() -> dict[str, widgets.Widget]:
    def slider(kind, name, label, low, high, step, tip):
        return kind(
            value=START[name], min=low, max=high, step=step, description=label, tooltip=tip,
            style={"description_width": "115px"}, layout=widgets.Layout(width="auto"),
        )  # fmt: skip

    real, whole = widgets.FloatSlider, widgets.IntSlider
    return {
        "azimuth": slider(whole, "azimuth", "from the side, °", -180, 180, 5, "0: from the camera; 90: image right"),
        "elevation": slider(whole, "elevation", "from above, °", -90, 90, 5, "90: from the ceiling; −90: from below"),
        "lamp": slider(real, "lamp", "lamp", 0, 2, 0.05, "brightness of a white surface facing the lamp"),
        "ambient": slider(real, "ambient", "ambient", 0, 1, 0.05, "uniform light from all directions"),
    }


def _coefficient_slider(k: int) -> widgets.FloatSlider:
    return widgets.FloatSlider(
        value=0.0, min=-LARGEST, max=LARGEST, step=0.01, description=FUNCTIONS[k], readout_format=".2f",
        style={"description_width": "60px"}, layout=widgets.Layout(width="auto"),
    )  # fmt: skip
