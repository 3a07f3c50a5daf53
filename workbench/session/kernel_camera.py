"""A camera on the computer that runs Python, or a video file in its place, read in a separate thread."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2

from workbench.errors import InputError
from workbench.session.live_frame import LIVE_SIZE, Deliver, LiveFrame, Trouble, reduced

PATIENCE_S = 2.0
"""Time without a picture after which a camera counts as unplugged."""
SLOWEST_RATE, FASTEST_RATE = 1.0, 120.0
"""Range of plausible frame rates, in frames per second, in a video's header."""


class KernelCamera:
    """`cv2.VideoCapture` on a device number, or a video file played in a loop at its own frame rate.

    The consumer may be slow: only the latest frame matters. Raises `InputError` for a file that does not exist.
    """

    mirrored = in_browser = False

    def __init__(self, device: int | str | Path = 0) -> None:
        self.device = device
        self._is_file = not isinstance(device, int)
        if self._is_file and not Path(device).is_file():
            raise InputError(f"There is no video {device}; name a file, or a camera by its number (0 is the first).")
        self.name = Path(device).name if self._is_file else f"camera {device} of the kernel"
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def __repr__(self) -> str:
        return f"KernelCamera({self.device!r})"

    @property
    def running(self) -> bool:
        """Whether its thread runs."""
        return self._thread is not None and self._thread.is_alive()

    def start(self, deliver: Deliver, trouble: Trouble) -> None:
        """See `FrameSource.start`. If the camera does not open, `trouble` is called."""
        self.stop()
        self._stopped = threading.Event()
        arguments = (self._stopped, deliver, trouble)
        self._thread = threading.Thread(target=self._read, args=arguments, name="kernel-camera", daemon=True)
        self._thread.start()

    def skipped(self, frame: LiveFrame) -> None:
        """See `FrameSource.skipped`; nothing to do, because the camera is read continuously."""

    def stop(self) -> None:
        """See `FrameSource.stop`."""
        self._stopped.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=10)

    def _read(self, stopped: threading.Event, deliver: Deliver, trouble: Trouble) -> None:
        with _quiet():
            capture = cv2.VideoCapture(str(self.device) if self._is_file else self.device)
        try:
            problem = self._deliver_all(capture, stopped, deliver)
        finally:
            capture.release()
        if problem and not stopped.is_set():
            trouble(problem)

    def _deliver_all(self, capture, stopped: threading.Event, deliver: Deliver) -> str | None:
        """Deliver frames until stopped or the camera fails; returns the message for the user."""
        if not capture.isOpened():
            return self._cannot_open()
        if not self._is_file:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, LIVE_SIZE[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, LIVE_SIZE[1])
        rate = capture.get(cv2.CAP_PROP_FPS)
        interval = 1.0 / rate if SLOWEST_RATE <= rate <= FASTEST_RATE else 0.04
        number, seen, due = 0, time.monotonic(), time.monotonic()
        while not stopped.is_set():
            grabbed, picture = capture.read()
            now = time.monotonic()
            if not grabbed:
                if self._is_file and number:
                    capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
                if now - seen > PATIENCE_S:
                    return self._fell_silent(number)
                stopped.wait(0.01)
                continue
            seen = now
            deliver(LiveFrame(number, now, reduced(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))))
            number += 1
            if self._is_file:
                due = max(due + interval, now)
                stopped.wait(due - now)
        return None

    def _cannot_open(self) -> str:
        if self._is_file:
            return f"The video {self.device} cannot be read; convert it to MP4 (H.264)."
        return (
            f"The computer that runs Python has no camera {self.device}, or another program uses it; "
            "use the browser's camera or name another number."
        )

    def _fell_silent(self, number: int) -> str:
        if self._is_file:
            return f"The video {self.device} delivers no pictures; try another one."
        if not number:
            return f"{self.name.capitalize()} delivers no pictures; try another one."
        return f"{self.name.capitalize()} no longer delivers pictures; plug it in again and press start."


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence OpenCV, which reports a missing camera on standard error; users get our message instead."""
    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)
