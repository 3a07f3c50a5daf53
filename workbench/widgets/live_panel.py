"""The live panel: a camera, the landmarks on its picture, the animated avatar, and knobs that work while it runs."""

import threading
from pathlib import Path
from typing import Any

import ipywidgets as widgets
import numpy as np

from workbench.config import Config
from workbench.face import FaceModel, dressed_as, load_default_head
from workbench.runtime import ShortTurns
from workbench.session.live import LiveSession
from workbench.session.live_frame import FrameSource, LiveFrame
from workbench.session.recording import Recording
from workbench.tracking import FrameFit, Track
from workbench.widgets.camera_bar import CameraBar, cameras_by_name
from workbench.widgets.cell_reruns import replace_earlier
from workbench.widgets.closing import close_all_of
from workbench.widgets.kernel_comms import lose_no_messages
from workbench.widgets.latest import LatestWins
from workbench.widgets.live_messages import NEUTRAL, READYING, STOPPED, LiveMessages, welcome
from workbench.widgets.live_settings import LiveSettings
from workbench.widgets.live_status import LiveStatus
from workbench.widgets.live_view import LiveView
from workbench.widgets.panel_layout import classed, in_columns, in_line, style_sheet
from workbench.widgets.panel_page import PanelPage
from workbench.widgets.record_bar import NOT_STARTED, RecordBar
from workbench.widgets.slow_jobs import SlowJobs

FORSAKEN_S = 150.0
"""The kernel's camera stops after this time without a message from any page."""


class LivePanel(widgets.VBox):
    """Tracks a face in front of a camera and fits every frame; show it with `LivePanel()` and press start.

    `camera`: None for the browser's camera, a number or a video file for one of the kernel's, or a `FrameSource`.
    Frames are dropped, not queued: of those that arrive during a fit only the latest counts. All work is done in one
    thread, so cells can still run; in JupyterLab, a rerun of its cell closes it. `fit` is the latest fit, `track` the
    last recording. Raises `InputError` for a video that does not exist and for a Deep Energies configuration.
    """

    def __init__(
        self,
        camera: int | str | Path | FrameSource | None = None,
        model: FaceModel | None = None,
        config: Config | None = None,
        height_px: int = 372,
    ) -> None:
        lose_no_messages()
        self._closed = True  # nothing to free until everything is built
        self.session = LiveSession(load_default_head() if model is None else model, config)
        model = self.session.model  # with the detector's points
        self.fit: FrameFit | None = None
        self._source: FrameSource | None = None
        self._lock, self._warm = threading.RLock(), False
        self._person: np.ndarray = self.session.identity
        self.view = LiveView(model, height_px - 32, dressed_as(self.session.config.head.character, model))
        self._messages, self.drags = LiveMessages(self.view), PanelPage()
        self.say = self._messages.say
        self._slow, self._turns = SlowJobs(self._messages.failed, "live-save"), ShortTurns()
        cameras = cameras_by_name(self.view, camera)
        self._cameras = CameraBar(self.view, cameras, self._switch, self._on_camera, self.calibrate)
        self.run_button, self.camera, self.neutral = self._cameras.widgets
        self.mirror, self.looking = self._cameras.looks
        self._worker: LatestWins[LiveFrame] = LatestWins(self._work, self._messages.failed, "live-fit")
        self.view.on_left(self.stop)
        self.view.observe(self._on_running, "running")
        super().__init__([style_sheet(), self.drags, *self._build(height_px)])
        classed(self, "fw-panel", "fw-live-panel")
        self._closed = False
        replace_earlier(self)
        self.say(welcome(self._cameras.chosen))

    def __repr__(self) -> str:
        return f"LivePanel({self.session!r}, {'running' if self.running else 'stopped'})"

    # --- for scripts and cells ---

    @property
    def running(self) -> bool:
        """Whether the camera is on."""
        return self._source is not None

    @property
    def recording(self) -> Recording | None:
        """The last recording; None if there is none."""
        return self._recording.recording

    @property
    def track(self) -> Track:
        """The last recording as a track. Raises `InputError` if there is none."""
        return self._recording.last.track

    def start(self) -> None:
        """Switch the camera on."""
        with self._lock:
            if self.running or self._closed:
                return
            self._begin()
            self.view.running = True

    def stop(self) -> None:
        """Switch the camera off; a recording in progress is kept."""
        with self._lock:
            if not self.running:
                return
            self._end()
            self.view.running = False
            self.say(STOPPED)

    def calibrate(self) -> None:
        """Treat the next frames as a neutral face."""
        if not self.running:
            self.say(NOT_STARTED, wrong=True)
            return
        self.say(NEUTRAL)
        self._messages.guarded(self.session.calibrate_neutral)

    def record(self, on: bool = True) -> None:
        """Start or stop a recording."""
        self.record_button.value = on

    def save(self, folder: str | Path, overwrite: bool = False) -> Path:
        """Write the last recording into a folder: track.npz, and clip.mp4 if pictures were kept; the track's path.

        Raises `InputError` if there is none, and `OutputError` for a folder that already contains a track or clip,
        unless `overwrite` is set.
        """
        return self._recording.last.save(folder, overwrite)

    def wait_idle(self, timeout_s: float | int = 60.0) -> bool:
        """Wait until no frame is being fitted and nothing is being saved; False if that takes longer."""
        return self._slow.wait_idle(timeout_s) and self._worker.wait_idle(timeout_s)

    def turn(self, path: str, value: Any) -> None:
        """Turn a knob as a user would; `session.knobs.KNOBS` lists the paths."""
        self.controls.by_path[path].turn(value)

    def close(self) -> None:
        """Switch the camera off, stop the threads and free the views."""
        if self._closed:
            return
        self.stop()
        self._closed = True
        self._worker.close()
        self._slow.close()
        close_all_of(self)

    # --- parts ---

    def _build(self, height_px: int) -> list[widgets.Widget]:
        session, messages = self.session, self._messages
        self.status = LiveStatus()
        settings = LiveSettings(session, self.drags, messages.guarded, self.status.write, height_px - 34)
        self.controls = settings.controls
        self.preset, self.undo, self.defaults = settings.widgets
        self._recording = RecordBar(session, lambda: self.running, lambda: self.camera.value, messages, self._slow)
        self.record_button, self.pictures, self.folder, self.save_button, self.saved = self._recording.widgets
        return [
            in_line(*self._cameras.widgets, *settings.widgets, self.status),
            in_columns(self.controls.widget, self.view),
            in_line(*self._recording.widgets, *self._cameras.looks),
        ]

    # --- what the user does ---

    def _begin(self) -> None:
        self._source = self._cameras.chosen
        self.view.mirror = self.mirror.value = self._source.mirrored
        self.session.start_anew()
        self.say(READYING)
        self._source.start(self._worker.submit, self._on_trouble)
        self._turns.turn(on=True)

    def _end(self) -> None:
        source, self._source = self._source, None
        source.stop()
        self._turns.turn(on=False)
        self.view.forget_unseen()
        self._recording.end()

    def _switch(self, on: bool) -> None:
        self.start() if on else self.stop()

    def _on_running(self, change) -> None:
        self._cameras.show_running(change["new"])
        self._switch(change["new"])

    def _on_camera(self) -> None:
        with self._lock:
            if self.running:
                self._end()
                self._begin()
            else:
                self.say(welcome(self._cameras.chosen))

    def _on_trouble(self, sentence: str) -> None:
        self.stop()
        self.say(sentence, wrong=True)

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
        self._tell()
        if not source.in_browser and self.view.silence_s > FORSAKEN_S:
            self.stop()

    def _tell(self) -> None:
        """Tell the user what they are waiting for, and update the status from time to time."""
        self._messages.waited(self.session)
        if ended := self.session.recording_ended:
            self._recording.end()
            self.say(ended, wrong=True)
        self.status.tell(self.session)
