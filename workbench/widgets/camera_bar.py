"""The camera controls of a live panel: choice, on and off, and the display of its pictures and the avatar."""

from collections.abc import Callable
from pathlib import Path

import ipywidgets as widgets

from workbench.samples import sample
from workbench.session.kernel_camera import KernelCamera
from workbench.session.live_frame import FrameSource
from workbench.widgets.controls import menu, small_button
from workbench.widgets.live_view import BrowserCamera, LiveView

BROWSER, KERNEL, SAMPLE = "browser's camera", "kernel's camera", "sample clip"
LOOKS = {"head turns": "head", "as the camera sees it": "camera", "expression alone": "expression"}


class CameraBar:
    """Buttons and menus; `widgets` go before the settings, `looks` elsewhere.

    `switch(on)` is called to switch the camera on or off, `changed` when another camera is chosen, `calibrate` when
    the user requests a neutral calibration.
    """

    def __init__(
        self,
        view: LiveView,
        cameras: dict[str, FrameSource],
        switch: Callable[[bool], None],
        changed: Callable[[], None],
        calibrate: Callable[[], None],
    ) -> None:
        self._cameras = cameras
        self.run = widgets.ToggleButton(
            value=False, description="▶ start", button_style="primary", tooltip="switch the camera on or off",
            layout=widgets.Layout(width="76px", flex="0 0 auto"),
        )  # fmt: skip
        self.run.observe(lambda change: switch(change["new"]), "value")
        # Linked in the browser, so that the camera switches off even while the kernel is busy.
        running = widgets.jsdlink((self.run, "value"), (view, "running"))
        self.camera = menu(list(cameras), "170px", "source of the pictures")
        self.camera.observe(lambda _change: changed(), "value")
        self.neutral = small_button("☺ neutral face", "look into the camera with a neutral face, then press")
        self.neutral.on_click(lambda _button: calibrate())
        self.mirror = widgets.ToggleButton(
            value=True, description="mirror", tooltip="show everything mirrored",
            layout=widgets.Layout(width="auto", flex="0 0 auto"),
        )  # fmt: skip
        self._links = running, widgets.jsdlink((self.mirror, "value"), (view, "mirror"))
        self.looking = menu(LOOKS, "160px", "how the avatar is shown; drag to turn it")
        self.looking.observe(lambda change: setattr(view, "looking", change["new"]), "value")
        self.widgets, self.looks = (self.run, self.camera, self.neutral), (self.mirror, self.looking)

    @property
    def chosen(self) -> FrameSource:
        """The camera selected in the menu."""
        return self._cameras[self.camera.value]

    def show_running(self, running: bool) -> None:
        """Update the button's label."""
        self.run.value = running
        self.run.description = "■ stop" if running else "▶ start"
        self.run.button_style = "danger" if running else "primary"


def cameras_by_name(view: LiveView, wanted: int | str | Path | FrameSource | None) -> dict[str, FrameSource]:
    """The available cameras by name, with the wanted one first (None: the browser's).

    Raises `InputError` for a video that does not exist.
    """
    cameras: dict[str, FrameSource] = {
        BROWSER: BrowserCamera(view),
        KERNEL: KernelCamera(0),
        SAMPLE: KernelCamera(sample("laugh")),
    }
    if wanted is None:
        return cameras
    camera = KernelCamera(wanted) if isinstance(wanted, int | str | Path) else wanted
    return {KERNEL if wanted == 0 else camera.name: camera, **cameras}
