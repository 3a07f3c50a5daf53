"""The live panel: a camera, the landmarks on its picture, the moving avatar, and every knob while it runs."""

import html
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import ipywidgets as widgets
import numpy as np

from workbench.config import FACE_IT_PRESETS, Config, preset
from workbench.errors import InputError, WorkbenchError
from workbench.face import FaceModel, load_default_head
from workbench.samples import sample
from workbench.session.gesture import Gesture
from workbench.session.kernel_camera import KernelCamera
from workbench.session.knobs import changed_by
from workbench.session.live import LiveFit, LiveSession
from workbench.session.live_frame import FrameSource, LiveFrame
from workbench.session.recording import Recording
from workbench.tracking import FrameFit, Track
from workbench.widgets.controls import Controls, small_button
from workbench.widgets.drag_watch import DragWatch
from workbench.widgets.latest import LatestWins
from workbench.widgets.live_view import BrowserCamera, LiveView
from workbench.widgets.tuning_panel import CONTROLS_PX, STYLE

PAGES = ("ω", "ρ ε", "camera", "points", "a b c")
BROWSER, KERNEL, SAMPLE = "browser's camera", "kernel's camera", "sample clip"
LOOKS = {"head turns": "head", "as the camera sees it": "camera", "expression alone": "expression"}
WELCOME = "Press start. The pictures go from the browser to the kernel and nowhere else."
STOPPED = "Stopped; the camera is off."
READYING = "Getting ready …"
NEUTRAL = "Look into the camera with a neutral face: mouth closed, brows at rest …"
STATUS_S = 0.25
FORSAKEN_S = 150.0
"""The kernel's camera stops when no page has been heard of for so long."""


class LivePanel(widgets.VBox):
    """Follows a face before a camera and fits every frame; show it with `LivePanel()` and press start.

    `camera`: None for the browser's camera, a number or a video file for one of the kernel's, or a `FrameSource`.
    Frames are dropped rather than queued: of those that come during a fit only the newest counts. All work is done in
    one thread, so cells can run meanwhile. `fit` is the newest fit, `track` the last recording. Raises `InputError`
    for a video that does not exist and for a configuration of Deep Energies.
    """

    def __init__(
        self,
        camera: int | str | Path | FrameSource | None = None,
        model: FaceModel | None = None,
        config: Config | None = None,
        height_px: int = 372,
    ) -> None:
        self._closed = True  # nothing to free until all is there
        model = load_default_head() if model is None else model
        self.session = LiveSession(model, config)
        self.fit: FrameFit | None = None
        self.recording: Recording | None = None
        self._lock = threading.RLock()
        self._source: FrameSource | None = None
        self._warm = self._quiet = False
        self._person: np.ndarray = self.session.identity
        self._written = 0.0
        self.view = LiveView(model, height_px - 32)
        self._cameras = self._offered(camera)
        self._build(height_px)
        self._worker: LatestWins[LiveFrame] = LatestWins(self._work, self._failed, "live-fit")
        self._slow = ThreadPoolExecutor(max_workers=1, thread_name_prefix="live-save")
        self.view.on_left(self.stop)
        self.view.observe(self._on_running, "running")
        style = widgets.HTML(STYLE, layout=widgets.Layout(display="none"))
        self.drags = DragWatch()
        super().__init__([style, self.drags, self._camera_bar, self._main, self._record_bar])
        self.add_class("fw-panel")
        self.add_class("fw-live-panel")
        self._closed = False
        self.say(WELCOME)

    def __repr__(self) -> str:
        return f"LivePanel({self.session!r}, {'running' if self.running else 'stopped'})"

    # --- for scripts and cells ---

    @property
    def running(self) -> bool:
        """Whether the camera is on."""
        return self._source is not None

    @property
    def track(self) -> Track:
        """The last recording as a track. Raises `InputError` if there is none."""
        if self.recording is None:
            raise InputError("Nothing has been recorded yet; press record while the camera runs.")
        return self.recording.track

    def start(self) -> None:
        """Switch the camera on."""
        with self._lock:
            if self.running or self._closed:
                return
            self._begin()
            self.view.running = True

    def stop(self) -> None:
        """Switch the camera off; a recording that is going on is kept."""
        with self._lock:
            if not self.running:
                return
            self._end()
            self.view.running = False
            self.say(STOPPED)

    def calibrate(self) -> None:
        """Take the next frames as a neutral face."""
        if not self.running:
            self.say("Start the camera first.", wrong=True)
            return
        self.session.calibrate_neutral()
        self.say(NEUTRAL)

    def record(self, on: bool = True) -> None:
        """Begin or end a recording."""
        self.record_button.value = on

    def save(self, folder: str | Path, overwrite: bool = False) -> Path:
        """Write the last recording into a folder: track.npz, and clip.mp4 if pictures were kept; the track's path.

        Raises `InputError` if there is none, and `OutputError` for a folder that holds a track or clip already,
        unless told to `overwrite`.
        """
        if self.recording is None:
            raise InputError("Nothing has been recorded yet; press record while the camera runs.")
        return self.recording.save(folder, overwrite)

    def wait_idle(self, timeout_s: float | int = 60.0) -> bool:
        """Wait until no frame is being fitted and nothing is being saved; False if that takes longer."""
        try:
            self._slow.submit(int).result(timeout_s)
        except TimeoutError:
            return False
        return self._worker.wait_idle(timeout_s)

    def turn(self, path: str, value: Any) -> None:
        """Turn a knob as a user would; `session.knobs.KNOBS` lists the paths."""
        self.controls.by_path[path].turn(value)

    def say(self, text: str, wrong: bool = False) -> None:
        """Show a sentence over the picture; an empty one takes it away."""
        with self.view.hold_sync():
            self.view.message, self.view.alert = text, wrong

    def close(self) -> None:
        """Switch the camera off, end the threads and free the views."""
        if self._closed:
            return
        self.stop()
        self._closed = True
        self._worker.close()
        self._slow.shutdown(wait=False, cancel_futures=True)
        self.view.close()
        super().close()

    # --- parts ---

    def _offered(self, camera: int | str | Path | FrameSource | None) -> dict[str, FrameSource]:
        """The cameras of the menu by name; the wanted one first."""
        cameras: dict[str, FrameSource] = {
            BROWSER: BrowserCamera(self.view),
            KERNEL: KernelCamera(0),
            SAMPLE: KernelCamera(sample("performance")),
        }
        if camera is None:
            return cameras
        wanted = KernelCamera(camera) if isinstance(camera, int | str | Path) else camera
        if camera == 0:
            return {KERNEL: wanted, **cameras}
        return {wanted.name: wanted, **cameras}

    def _build(self, height_px: int) -> None:
        session = self.session
        self.run_button = widgets.ToggleButton(
            value=False, description="▶ start", button_style="primary", tooltip="switch the camera on or off",
            layout=widgets.Layout(width="76px", flex="0 0 auto"),
        )  # fmt: skip
        self.run_button.observe(self._on_run_button, "value")
        # In the browser itself, so that the camera goes off even while the kernel is busy.
        widgets.jsdlink((self.run_button, "value"), (self.view, "running"))
        self.camera = _menu(list(self._cameras), "150px", "where the pictures come from")
        self.camera.observe(self._on_camera, "value")
        names = list(FACE_IT_PRESETS)
        self.preset = _menu(names, "96px", "preset", session.config.preset)
        self.preset.observe(self._on_preset, "value")
        self.looking = _menu(LOOKS, "160px", "how the avatar is shown; drag it to turn it")
        self.looking.observe(lambda change: setattr(self.view, "looking", change["new"]), "value")
        self.mirror = widgets.ToggleButton(
            value=True, description="mirror", tooltip="show everything as in a mirror",
            layout=widgets.Layout(width="auto", flex="0 0 auto"),
        )  # fmt: skip
        widgets.jsdlink((self.mirror, "value"), (self.view, "mirror"))
        self.neutral = small_button("☺ neutral face", "look into the camera with a neutral face, then press")
        self.neutral.on_click(lambda _button: self.calibrate())
        self.undo = small_button("↶ undo", "take back the last change or calibration")
        self.undo.on_click(lambda _button: self._on_undo())
        self.defaults = small_button("defaults", "back to the settings of the start; undo brings yours back")
        self.defaults.on_click(lambda _button: self._guarded(self._use, session.base))
        self.status = widgets.HTML(layout=widgets.Layout(min_width="0", flex="1 1 0", overflow="hidden"))
        self.status.add_class("fw-status")
        buttons = [self.run_button, self.camera, self.neutral, self.preset, self.undo, self.defaults]
        self._camera_bar = widgets.HBox([*buttons, self.status], layout=widgets.Layout(align_items="center"))
        self.controls = Controls(session.config, self._on_knob, height_px - 34, PAGES)
        self._main = widgets.GridBox(
            [self.controls.widget, self.view],
            layout=widgets.Layout(
                grid_template_columns=f"{CONTROLS_PX}px minmax(240px, 1fr)", grid_gap="6px", width="100%"
            ),
        )
        self.record_button = widgets.ToggleButton(
            value=False, description="● record", tooltip="keep every frame from now on",
            layout=widgets.Layout(width="auto", flex="0 0 auto"),
        )  # fmt: skip
        self.record_button.observe(self._on_record, "value")
        self.pictures = widgets.Checkbox(
            value=True, description="with pictures", indent=False, tooltip="keep the camera's pictures too",
            layout=widgets.Layout(width="auto", flex="0 0 auto"),
        )  # fmt: skip
        self.folder = widgets.Text(
            str(free_folder(Path("recording"))), tooltip="folder to write", layout=widgets.Layout(width="150px")
        )
        self.save_button = small_button("save", "write the recording as track.npz and clip.mp4")
        self.save_button.on_click(lambda _button: self._slow.submit(self._guarded, self._on_save))
        self.saved = widgets.HTML(layout=widgets.Layout(min_width="0", flex="1 1 auto"))
        parts = [self.record_button, self.pictures, self.folder, self.save_button, self.saved]
        self._record_bar = widgets.HBox(
            [*parts, self.mirror, self.looking], layout=widgets.Layout(align_items="center")
        )

    # --- what the user does ---

    def _begin(self) -> None:
        self._source = self._cameras[self.camera.value]
        self.view.mirror = self.mirror.value = self._source.mirrored
        self.session.start_anew()
        self.say(READYING)
        self._source.start(self._worker.submit, self._on_trouble)

    def _end(self) -> None:
        source, self._source = self._source, None
        source.stop()
        self.view.forget_unseen()
        self._end_recording()

    def _on_run_button(self, change) -> None:
        self.start() if change["new"] else self.stop()

    def _on_running(self, change) -> None:
        running = change["new"]
        self.run_button.value = running
        self.run_button.description = "■ stop" if running else "▶ start"
        self.run_button.button_style = "danger" if running else "primary"
        self.start() if running else self.stop()

    def _on_camera(self, _change) -> None:
        with self._lock:
            if self.running:
                self._end()
                self._begin()

    def _on_knob(self, path: str, value: Any) -> None:
        def change() -> None:
            config = self.session.config.changed(**changed_by(self.session.config, path, value))
            self.session.use(config, Gesture(path, self.drags.drag))
            self._show_config(but=path)

        self._guarded(change)

    def _on_preset(self, change) -> None:
        if not self._quiet:
            self._guarded(self._use, preset(change["new"]))

    def _use(self, config: Config) -> None:
        try:
            self.session.use(config)
        finally:
            self._show_config()

    def _on_undo(self) -> None:
        if not self.session.undo():
            self._write("nothing to take back")
            return
        self._show_config()

    def _on_record(self, change) -> None:
        if not change["new"]:
            self._end_recording()
        elif self.running:
            self.session.start_recording(self.pictures.value)
            self.record_button.button_style = "danger"
        else:
            self.record_button.value = False
            self.say("Start the camera first.", wrong=True)

    def _on_save(self) -> None:
        folder = Path(self.folder.value.strip() or "recording").expanduser()
        self.saved.value = "saving …"
        try:
            self.save(folder)
        except WorkbenchError:
            self.saved.value = ""
            raise
        files = "track.npz, clip.mp4" if self.recording.jpegs else "track.npz"
        self.saved.value = f"wrote {html.escape(str(folder))} ({files})"
        self.folder.value = str(free_folder(folder))

    def _end_recording(self) -> None:
        if self.session.recording is None:
            return
        name = self.camera.value

        def end() -> None:
            self.recording = self.session.stop_recording(name)
            self.saved.value = f"recorded {len(self.recording)} frames, {self.recording.seconds:.1f} s: save them"

        self._guarded(end)
        self.record_button.value, self.record_button.button_style = False, ""

    def _on_trouble(self, sentence: str) -> None:
        self.stop()
        self.say(sentence, wrong=True)

    def _guarded(self, act, *arguments) -> None:
        try:
            act(*arguments)
        except WorkbenchError as error:
            self.say(str(error), wrong=True)
        except OSError as error:
            self.say(f"That could not be written ({error}); name another folder.", wrong=True)

    def _show_config(self, but: str | None = None) -> None:
        config = self.session.config
        self.controls.show(config, but)
        self._quiet = True
        try:
            self.preset.value = config.preset
        finally:
            self._quiet = False

    # --- in the worker's thread ---

    def _work(self, frame: LiveFrame) -> None:
        source = self._source
        if source is None:
            return
        if not self._warm:
            self.session.warm_up()
            self._warm = True
        try:
            live = self.session.step(frame)
        except Exception:
            source.skipped(frame)
            raise
        if self._source is not source:
            return
        self.fit = live.fit
        if self.session.identity is not self._person:
            self._person = self.session.identity
            self.view.set_person(self._person)
        self.view.show(live.fit, frame, live.milliseconds, not source.in_browser)
        self._tell(live)
        if not source.in_browser and self.view.silence_s > FORSAKEN_S:
            self.stop()

    def _tell(self, live: LiveFit) -> None:
        """Say what the user waits for, and now and then how it goes."""
        gathering, ended = self.session.gathering, self.session.recording_ended
        if self.view.message == READYING or (self.view.message == NEUTRAL and gathering is None):
            self.say("")
        if ended:
            self._end_recording()
            self.say(ended, wrong=True)
        if time.monotonic() - self._written < STATUS_S:
            return
        recording = self.session.recording
        words = [f"face shape: {self.session.calibrated}"]
        if gathering is not None:
            words = [f"neutral face: {gathering[0]} of {gathering[1]} frames"]
        if recording is not None:
            words.append(f"<b>● {recording[1]:.1f} s, {recording[0]} frames</b>")
        self._write(" &nbsp; ".join(words))

    def _write(self, text: str) -> None:
        self._written = time.monotonic()
        self.status.value = f"<code>{text}</code>"

    def _failed(self, error: Exception) -> None:
        # A thread has nobody to raise to.
        self.say(str(error) if isinstance(error, WorkbenchError) else f"{type(error).__name__}: {error}", wrong=True)


def free_folder(folder: Path) -> Path:
    """This folder if it holds no track, else the next one by number: recording, recording-2, recording-3."""
    stem, number = folder.name, 1
    head, _, tail = stem.rpartition("-")
    if head and tail.isdigit():
        stem, number = head, int(tail)
    while True:
        found = folder.with_name(stem if number == 1 else f"{stem}-{number}")
        if not (found / "track.npz").exists():
            return found
        number += 1


def _menu(options, width: str, tip: str, value: str | None = None) -> widgets.Dropdown:
    chosen = {} if value is None else {"value": value}
    return widgets.Dropdown(
        options=options, tooltip=tip, layout=widgets.Layout(width=width, flex="0 0 auto"), **chosen
    )  # fmt: skip
