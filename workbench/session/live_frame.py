"""Frames of a live camera, and the protocol of their sources."""

from collections.abc import Callable
from functools import cached_property
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import UInt8

from workbench.errors import InputError
from workbench.frames import decoded_picture

LIVE_SIZE = (640, 480)
"""Size requested from cameras, (width, height); larger pictures are reduced to it before any processing."""
JPEG_QUALITY = 85


class LiveFrame:
    """One picture of a live camera, as RGB, JPEG or both; the missing form is made on request."""

    def __init__(
        self,
        number: int,
        time_s: float | int,
        picture: UInt8[np.ndarray, "h w 3"] | None = None,
        jpeg: bytes | None = None,
    ) -> None:
        """`number` increases, `time_s` is the source's clock. Raises `InputError` without a picture in either form."""
        if picture is None and not jpeg:
            raise InputError(f"Frame {number} of the camera is empty; check the camera.")
        self.number, self.time_s = number, float(time_s)
        self._picture, self._jpeg = picture, jpeg

    def __repr__(self) -> str:
        return f"LiveFrame({self.number}, {self.time_s:.3f} s)"

    @cached_property
    def picture(self) -> UInt8[np.ndarray, "h w 3"]:
        """RGB. Raises `InputError` if the bytes are not a JPEG."""
        if self._picture is not None:
            return self._picture
        try:
            return decoded_picture(self._jpeg, f"frame {self.number}")
        except InputError as error:
            raise InputError(f"Frame {self.number} of the camera is not a readable JPEG; it was skipped.") from error

    @cached_property
    def jpeg(self) -> bytes:
        """The picture as JPEG, for the browser."""
        if self._jpeg is not None:
            return self._jpeg
        return cv2.imencode(".jpg", self._picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def reduced(picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "a b 3"]:
    """The picture reduced to fit into `LIVE_SIZE`, with its proportions kept."""
    height, width = picture.shape[:2]
    scale = min(LIVE_SIZE[0] / width, LIVE_SIZE[1] / height)
    if scale >= 1.0:
        return picture
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


Deliver = Callable[[LiveFrame], None]
"""Receives the latest frame; called from the source's thread, returns at once."""
Trouble = Callable[[str], None]
"""Receives a one-sentence message for the user after the source has stopped."""


@runtime_checkable
class FrameSource(Protocol):
    """A source of live frames, in the browser or on the kernel's computer."""

    name: str
    """Name shown to the user."""
    mirrored: bool
    """Whether users expect a mirrored picture."""
    in_browser: bool
    """Whether the browser already has the pictures, so that they need not be sent."""

    def start(self, deliver: Deliver, trouble: Trouble) -> None:
        """Start delivering frames; returns at once."""
        ...

    def skipped(self, frame: LiveFrame) -> None:
        """Called when a frame was not fitted; the next one may be sent."""
        ...

    def stop(self) -> None:
        """Release the camera; nothing is delivered afterwards. Stopping twice is fine."""
        ...
