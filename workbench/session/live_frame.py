"""Frames of a camera while it runs, and where they come from."""

from collections.abc import Callable
from functools import cached_property
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import UInt8

from workbench.errors import InputError
from workbench.frames import decoded_picture

LIVE_SIZE = (640, 480)
"""What cameras are asked for, (width, height); larger pictures are reduced to it before anything is done with them."""
JPEG_QUALITY = 85


class LiveFrame:
    """One picture of a running camera, as RGB, as JPEG, or both; what is missing is made when it is asked for."""

    def __init__(
        self,
        number: int,
        time_s: float | int,
        picture: UInt8[np.ndarray, "h w 3"] | None = None,
        jpeg: bytes | None = None,
    ) -> None:
        """`number` counts up, `time_s` is the source's clock. Raises `InputError` without a picture in any form."""
        if picture is None and not jpeg:
            raise InputError(f"Frame {number} of the camera is empty; check the camera.")
        self.number, self.time_s = number, float(time_s)
        self._picture, self._jpeg = picture, jpeg

    def __repr__(self) -> str:
        return f"LiveFrame({self.number}, {self.time_s:.3f} s)"

    @cached_property
    def picture(self) -> UInt8[np.ndarray, "h w 3"]:
        """RGB. Raises `InputError` for bytes that are no JPEG."""
        if self._picture is not None:
            return self._picture
        try:
            return decoded_picture(self._jpeg, f"frame {self.number}")
        except InputError as error:
            raise InputError(f"Frame {self.number} of the camera is no readable JPEG; it was left out.") from error

    @cached_property
    def jpeg(self) -> bytes:
        """The picture as a browser shows it."""
        if self._jpeg is not None:
            return self._jpeg
        return cv2.imencode(".jpg", self._picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def reduced(picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "a b 3"]:
    """The picture no larger than `LIVE_SIZE` either way, in its own proportions."""
    height, width = picture.shape[:2]
    scale = min(LIVE_SIZE[0] / width, LIVE_SIZE[1] / height)
    if scale >= 1.0:
        return picture
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


Deliver = Callable[[LiveFrame], None]
"""Takes the newest frame; called from the source's thread, returns at once."""
Trouble = Callable[[str], None]
"""Takes one sentence for the user; the source has stopped."""


@runtime_checkable
class FrameSource(Protocol):
    """A camera, wherever it is plugged in."""

    name: str
    """As it is shown to the user."""
    mirrored: bool
    """Whether users expect to see themselves as in a mirror."""
    in_browser: bool
    """Whether the browser has the pictures already, and need not be sent them."""

    def start(self, deliver: Deliver, trouble: Trouble) -> None:
        """Begin to deliver frames; returns at once."""
        ...

    def skipped(self, frame: LiveFrame) -> None:
        """The frame was left without a fit; the next one may come."""
        ...

    def stop(self) -> None:
        """Let the camera go; afterwards nothing is delivered. Stopping twice is fine."""
        ...
