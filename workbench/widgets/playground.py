"""A photo, a few sliders, and a fit that follows them immediately."""

import html
import threading

import cv2
import ipywidgets as widgets
import numpy as np
from jaxtyping import UInt8

from workbench.config import DEFAULT_PRESET, FACE_IT_PRESETS, Config, preset
from workbench.errors import InputError, WorkbenchError
from workbench.face import DressedHead, FaceModel
from workbench.landmarks.observations import Landmarks2D
from workbench.pictures import HeadPanel, draw_overlay, side_by_side
from workbench.pictures.overlay import OverlayParts
from workbench.plots import close_up
from workbench.tracker import FaceTracker
from workbench.tracking import FrameFit, FrameObservation
from workbench.widgets.cell_reruns import replace_earlier
from workbench.widgets.closing import close_all_of
from workbench.widgets.controls import preset_names

PARTS = OverlayParts(text=False)
JPEG_QUALITY = 90
SIDE_PX = 440
SEEN_WHOLE = {"max_width": "100%", "max_height": "calc(100vh - 340px)", "min_height": "240px", "object_fit": "contain"}
"""Layout of the pictures: the sliders above them stay in view, in a notebook of a low window too."""
Number = float | int


def adjusted(config: Config, sigma_smooth: float, rho: int, epsilon: int, jaw: float, fov_deg: float) -> Config:
    """The configuration with the values of the sliders.

    `rho` limits the stages that free only the pose, `epsilon` those that free weights. `jaw` multiplies the landmark
    weight of the jaw contour, in every stage and in the calibration of the identity.
    """
    stages = [
        stage.model_copy(
            update={
                "limit": epsilon if "expression" in stage.free else rho,
                "landmarks": {**stage.landmarks, "jaw": jaw * stage.landmark_weights()[0]},
            }
        ).model_dump()
        for stage in config.stages
    ]
    return config.changed(
        weights={"sigma_smooth": sigma_smooth},
        identity={"jaw": jaw * config.identity.jaw},
        camera={"fov_deg": fov_deg},
        stages=stages,
    )


def start_values(config: Config) -> dict[str, Number]:
    """The slider values of an unchanged configuration."""
    limits = {"expression" in stage.free: stage.limit for stage in config.stages}
    return {
        "sigma_smooth": config.weights.sigma_smooth,
        "rho": limits.get(False, 15),
        "epsilon": limits.get(True, 15),
        "jaw": 1.0,
        "fov_deg": config.camera.fov_deg,
    }


def jpeg(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """An RGB picture as JPEG bytes, for `ipywidgets.Image`."""
    encoded = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    return encoded.tobytes()


class FitPlayground(widgets.VBox):
    """Sliders on one photo: every move re-fits it and shows the overlay, the 3D head and the error.

    Callbacks may come from any thread, as in JupyterLab: one lock guards the tracker, and the head is drawn in its own
    thread. `fit` and `config` hold the latest result; `dressed` shows the default head as a character. In
    JupyterLab, a rerun of the cell that made it closes it. Raises `InputError` for a Deep Energies configuration.
    """

    def __init__(
        self,
        picture: UInt8[np.ndarray, "h w 3"],
        landmarks: Landmarks2D,
        model: FaceModel,
        config: Config | None = None,
        dressed: DressedHead | None = None,
    ) -> None:
        config = preset(DEFAULT_PRESET) if config is None else config
        self._panel: HeadPanel | None = None  # nothing to free until it is made
        if not config.traits.real_time:
            raise InputError(
                f"{config.traits.title} takes seconds per fit, which is too slow for sliders; use one of "
                f"{', '.join(FACE_IT_PRESETS)}."
            )
        self._picture, self._model, self._start, self._base = picture, model, config, config
        self._observation = FrameObservation(0, landmarks, landmarks.image_size)
        self._lock = threading.RLock()
        self._quiet = False
        self._tracker = FaceTracker(model, config, stills=True)
        self._panel = HeadPanel(model, (SIDE_PX, SIDE_PX), dressed=dressed)
        self.config, self.fit = config, None
        self.preset = widgets.Dropdown(
            options=preset_names(config),
            value=config.preset,
            description="preset",
            style={"description_width": "130px"},
        )
        self.sliders = _sliders(start_values(config))
        self.status = widgets.HTML()
        self.image = widgets.Image(format="jpeg", layout=widgets.Layout(**SEEN_WHOLE))
        self.preset.observe(self._on_preset, "value")
        for slider in self.sliders.values():
            slider.observe(self._on_slider, "value")
        grid = widgets.GridBox(
            [self.preset, *self.sliders.values()],
            layout=widgets.Layout(grid_template_columns="repeat(2, minmax(280px, 1fr))", max_width=f"{2 * SIDE_PX}px"),
        )
        super().__init__([grid, self.status, self.image])
        replace_earlier(self)
        self.refit()

    def __repr__(self) -> str:
        return f"FitPlayground({self.preset.value!r}, {self._model.name!r})"

    def refit(self) -> FrameFit | None:
        """Fit with the current slider values and show the result; for unusable values, show why and return None."""
        with self._lock:
            try:
                values = {name: slider.value for name, slider in self.sliders.items()}
                self.config = adjusted(self._base, **values)
                self._tracker.configure(self.config)
                self.fit = self._tracker.push(self._observation)[0]
                self.image.value = jpeg(self._draw(self.fit))
            except WorkbenchError as error:
                self.status.value = f"<b style='color:#b3261e'>{html.escape(str(error))}</b>"
                return None
            self.status.value = status_line(self.fit)
            return self.fit

    def close(self) -> None:
        """Close the widget and its renderer."""
        if self._panel is not None:
            self._panel.painter.close()
        close_all_of(self)

    def _draw(self, fit: FrameFit) -> UInt8[np.ndarray, "h w 3"]:
        head = self._panel.submit(fit)  # drawn in parallel with the overlay
        overlay = draw_overlay(*close_up(self._picture, fit, SIDE_PX), parts=PARTS)
        return side_by_side(overlay, head.result()[0])

    def _on_slider(self, _change) -> None:
        if not self._quiet:
            self.refit()

    def _on_preset(self, change) -> None:
        with self._lock:
            name = change["new"]
            self._base = preset(name) if name in FACE_IT_PRESETS else self._start
            self._quiet = True  # one fit for the preset, not one per slider that it moves
            try:
                for name, value in start_values(self._base).items():
                    self.sliders[name].value = value
            finally:
                self._quiet = False
            self.refit()


def status_line(fit: FrameFit) -> str:
    """Error, pose and time of a fit as one line of HTML."""
    pixels, _, percent = fit.errors
    yaw, pitch, roll = fit.angles_deg
    return (
        f"<code>error <b>{pixels:.2f} px</b> ({percent:.2f} % of the eye distance) &nbsp; yaw {yaw:+.1f}° "
        f"pitch {pitch:+.1f}° roll {roll:+.1f}° &nbsp; solved in {fit.milliseconds[2]:.0f} ms</code>"
    )


def _sliders(values: dict[str, Number]) -> dict[str, widgets.Widget]:
    def slider(kind, name, label, low, high, step, tip):
        return kind(
            value=values[name], min=low, max=high, step=step, description=label, tooltip=tip,
            style={"description_width": "130px"}, layout=widgets.Layout(width="auto"),
        )  # fmt: skip

    real, whole = widgets.FloatSlider, widgets.IntSlider
    return {
        "sigma_smooth": slider(real, "sigma_smooth", "sparsity ω_σ", 0, 60, 0.5, "Eq. 11, smoothed L1 norm"),
        "rho": slider(whole, "rho", "pose steps ρ", 0, 50, 1, "iterations of the pose (Eq. 8)"),
        "epsilon": slider(whole, "epsilon", "expression steps ε", 0, 50, 1, "iterations of the weights (Eq. 10)"),
        "jaw": slider(real, "jaw", "jaw landmarks ×", 0, 3, 0.1, "factor on the weight of the 17 contour points"),
        "fov_deg": slider(real, "fov_deg", "field of view, °", 10, 110, 1, "along the longer side of the picture"),
    }
