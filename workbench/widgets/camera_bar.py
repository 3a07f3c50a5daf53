"""The camera of a live panel: which one, on or off, and how its pictures and the avatar are shown."""

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
    """Buttons and menus; those of `widgets` belong before the settings, `looks` elsewhere.

    `switch` is called with whether the camera is to be on, `changed` when another one is chosen, `calibrate` when the
    user asks for it.
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
        # In the browser itself, so that the camera goes off even while the kernel is busy.
        widgets.jsdlink((self.run, "value"), (view, "running"))
        self.camera = menu(list(cameras), "150px", "where the pictures come from")
        self.camera.observe(lambda _change: changed(), "value")
        self.neutral = small_button("☺ neutral face", "look into the camera with a neutral face, then press")
        self.neutral.on_click(lambda _button: calibrate())
        self.mirror = widgets.ToggleButton(
            value=True, description="mirror", tooltip="show everything as in a mirror",
            layout=widgets.Layout(width="auto", flex="0 0 auto"),
        )  # fmt: skip
        widgets.jsdlink((self.mirror, "value"), (view, "mirror"))
        self.looking = menu(LOOKS, "160px", "how the avatar is shown; drag it to turn it")
        self.looking.observe(lambda change: setattr(view, "looking", change["new"]), "value")
        self.widgets, self.looks = (self.run, self.camera, self.neutral), (self.mirror, self.looking)

    @property
    def chosen(self) -> FrameSource:
        """The camera of the menu."""
        return self._cameras[self.camera.value]

    def show_running(self, running: bool) -> None:
        """Say what the button does now."""
        self.run.value = running
        self.run.description = "■ stop" if running else "▶ start"
        self.run.button_style = "danger" if running else "primary"


def cameras_by_name(view: LiveView, wanted: int | str | Path | FrameSource | None) -> dict[str, FrameSource]:
    """The cameras to choose from by name; the wanted one first, None: the browser's.

    Raises `InputError` for a video that does not exist.
    """
    cameras: dict[str, FrameSource] = {
        BROWSER: BrowserCamera(view),
        KERNEL: KernelCamera(0),
        SAMPLE: KernelCamera(sample("performance")),
    }
    if wanted is None:
        return cameras
    camera = KernelCamera(wanted) if isinstance(wanted, int | str | Path) else wanted
    return {KERNEL if wanted == 0 else camera.name: camera, **cameras}
