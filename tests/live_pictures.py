"""Frames of the sample clip, and a camera that delivers them when a test says so."""

import cv2

from workbench.samples import sample
from workbench.session.live_frame import LiveFrame

RATE = 25.0


def sample_frames(count):
    """The first frames of the clip, as a camera would deliver them."""
    capture = cv2.VideoCapture(str(sample("performance")))
    frames = []
    for number in range(count):
        _, picture = capture.read()
        frames.append(LiveFrame(number, number / RATE, cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)))
    capture.release()
    return frames


class HandCamera:
    """Delivers a frame when it is told to."""

    name, mirrored, in_browser = "hand camera", False, False

    def __init__(self):
        self.deliver = self.trouble = None
        self.skips = []

    def start(self, deliver, trouble):
        self.deliver, self.trouble = deliver, trouble

    def skipped(self, frame):
        self.skips.append(frame.number)

    def stop(self):
        self.deliver = None
