"""A live panel in a notebook in a real browser, with a clip as its camera: what tests and the benchmark share."""

from pathlib import Path

import cv2

PANEL = """
    from workbench.widgets import LivePanel

    panel = LivePanel()
    panel
    """
START = "panel.start()"
DISPLAY = ".fw-live"
JPEG_QUALITY = 92


def write_camera_clip(video: Path, target: Path) -> None:
    """A video as Motion JPEG, which Chromium plays over and over as its fake camera, 30 frames per second."""
    capture = cv2.VideoCapture(str(video))
    with target.open("wb") as stream:
        while True:
            grabbed, picture = capture.read()
            if not grabbed:
                break
            stream.write(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes())
    capture.release()


def fake_camera(clip: Path) -> list[str]:
    """Flags with which Chromium has this clip as its only camera, and may use it."""
    return [
        "--use-fake-ui-for-media-stream",
        "--use-fake-device-for-media-stream",
        f"--use-file-for-fake-video-capture={clip}",
    ]


def wait_for_frames(page, more: int, timeout_s: float = 300.0) -> None:
    """Wait until so many frames have been drawn from now on."""
    page.page.wait_for_function(
        """([more, since]) => {
          const log = document.querySelector('.fw-live').live.log;
          return log.filter((entry) => entry.drawn > since).length >= more;
        }""",
        arg=[more, page.page.evaluate("() => performance.now()")],
        timeout=1000 * timeout_s,
    )


def measured(page, seconds: float) -> list[dict]:
    """Frames drawn during some seconds: number, when it was grabbed and drawn (ms), whether a face was found."""
    return page.page.evaluate(
        """async (seconds) => {
          const log = document.querySelector('.fw-live').live.log, start = performance.now();
          await new Promise((done) => setTimeout(done, 1000 * seconds));
          return log.filter((entry) => entry.drawn > start);
        }""",
        seconds,
    )
