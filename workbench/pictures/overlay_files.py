"""Overlay videos and stills: left the frame with the fit drawn into it, right the head in 3D."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8

from workbench.errors import InputError
from workbench.face import DressedHead, FaceModel, posed_vertices
from workbench.frames import RATE_OF_IMAGES, Frame, Frames, VideoWriter, write_picture
from workbench.pictures.background import background_picture
from workbench.pictures.extras import Extras
from workbench.pictures.head_picture import HeadRenderer, PlainPainter, head_painter, portrait_view
from workbench.pictures.neck import BODY_SHARE
from workbench.pictures.overlay import ALL_BUT_MESH, OverlayParts, displayed_size, draw_overlay, side_by_side
from workbench.tracking.records import FrameFit

HEAD_VIEWS = ("pose", "front")
"""The 3D head turns with the face, or stays frontal so that only the expression moves."""

LARGEST_HEAD_PX = 480
"""Longest side of the 3D picture as rendered; next to larger frames it is enlarged."""
VIDEO_SUPERSAMPLING = 1.5
"""Edges a little less smooth than in stills, for half of the time."""


@runtime_checkable
class Fits(Protocol):
    """A `Track`, or anything else that holds the fits of a run in ascending order of their frames."""

    def __len__(self) -> int: ...

    def __getitem__(self, position: int, /) -> FrameFit: ...


def write_overlay_video(
    frames: Frames,
    track: Fits,
    model: FaceModel,
    path: str | Path,
    progress: Callable[[int, int], None] | None = None,
    view: str = "pose",
    parts: OverlayParts = ALL_BUT_MESH,
    dressed: DressedHead | None = None,
    rate: float | None = None,
) -> str | None:
    """Write an H.264 video of a tracked input: the frames of `track` with their fits, beside the head in 3D.

    A second, streaming pass over the frames that holds two of them at a time; the head is rendered in its own thread
    while the previous frame is encoded. Frames of a different size from the first are scaled to fit into its size.
    `dressed` shows the head as a character with the fitted face, `rate` replaces the input's frames per second.
    `progress` is called with (frames done, frames of the track). Returns a note where the head had to be drawn without
    GL, else None. Raises `InputError` for an empty track, and if none of its frames is in the input; after any error
    there is nothing under `path`.
    """
    if len(track) == 0:
        raise InputError("The track has no frames, so there is nothing to draw; track the input first.")
    size = displayed_size(frames.image_size)
    with (
        HeadPanel(model, size, view, VIDEO_SUPERSAMPLING, dressed) as panel,
        VideoWriter(path, rate=rate or frames.rate or RATE_OF_IMAGES) as writer,
    ):
        waiting: tuple[np.ndarray, Future] | None = None
        for frame, fit in _matched(frames, track):
            head = panel.submit(fit)
            overlay = _on_canvas(draw_overlay(frame.picture, fit, model, parts, within=size), size)
            if waiting is not None:
                _write(writer, waiting, progress, len(track))
            waiting = overlay, head
        if waiting is None:
            raise InputError(f"None of the track's frames is in {frames.name}; pass the input that was tracked.")
        _write(writer, waiting, progress, len(track))
        return panel.note


def write_overlay_picture(
    path: str | Path,
    picture: UInt8[np.ndarray, "h w 3"],
    fit: FrameFit,
    model: FaceModel,
    view: str = "pose",
    parts: OverlayParts = ALL_BUT_MESH,
    dressed: DressedHead | None = None,
) -> str | None:
    """Write one frame with its fit and the head in 3D beside it, as PNG or JPEG; returns a note as the video does."""
    with OverlayPictures(model, view, parts, dressed) as pictures:
        pictures.add(path, picture, fit)
        pictures.flush()
        return pictures.note


class OverlayPictures:
    """Overlay pictures of frames of any sizes, one after the other, all by one renderer; used in a `with` block.

    The head of one frame is rendered while the caller is busy with the next.
    """

    def __init__(
        self,
        model: FaceModel,
        view: str = "pose",
        parts: OverlayParts = ALL_BUT_MESH,
        dressed: DressedHead | None = None,
    ) -> None:
        self.model, self.view, self.parts, self.dressed = model, view, parts, dressed
        self._panel: HeadPanel | None = None
        self._waiting: tuple[str | Path, np.ndarray, Future] | None = None

    @property
    def note(self) -> str | None:
        """What a user should know about the quality of the pictures, once there is one."""
        return None if self._panel is None else self._panel.note

    def add(self, path: str | Path, picture: UInt8[np.ndarray, "h w 3"], fit: FrameFit) -> None:
        """Take the next frame, to be written as PNG or JPEG; it may be written only with the next one or by `flush`."""
        overlay = draw_overlay(picture, fit, self.model, self.parts)
        head = self._panel_beside(overlay).submit(fit)
        self.flush()
        self._waiting = path, overlay, head

    def flush(self) -> None:
        """Write what is still to be written."""
        if self._waiting is not None:
            path, overlay, head = self._waiting
            self._waiting = None
            write_picture(path, side_by_side(overlay, head.result()[0]))

    def _panel_beside(self, overlay: UInt8[np.ndarray, "h w 3"]) -> "HeadPanel":
        height, width = overlay.shape[:2]
        if self._panel is None:
            self._panel = HeadPanel(self.model, (width, height), self.view, dressed=self.dressed)
        self._panel.resize((width, height))
        return self._panel

    def __enter__(self) -> "OverlayPictures":
        return self

    def __exit__(self, *_: object) -> None:
        if self._panel is not None:
            self._panel.painter.close()


class HeadPanel:
    """The 3D head of one fit after the other, sized to go beside frames of (width, height); `dressed`: as a character.

    Raises `InputError` for a `view` other than "pose" and "front".
    """

    def __init__(
        self,
        model: FaceModel,
        frame_size: tuple[int, int],
        view: str = "pose",
        supersampling: float = 2.0,
        dressed: DressedHead | None = None,
    ) -> None:
        if view not in HEAD_VIEWS:
            raise InputError(f'The view of the head is "pose" or "front", got {view!r}.')
        size = _size_beside(frame_size)
        self.model, self.view = model, view
        self.camera, self.translation = portrait_view(model, size)
        self.painter: HeadRenderer | PlainPainter = head_painter(
            model, size, supersampling=supersampling, fade_neck=True, dressed=dressed
        )
        self.note = self.painter.note
        self._identity: np.ndarray | None = None
        self._person = model

    def resize(self, frame_size: tuple[int, int]) -> None:
        """Go beside frames of another (width, height) from now on."""
        size = _size_beside(frame_size)
        if size != self.painter.size:
            self.painter.resize(size)
            self.camera, self.translation = portrait_view(self.model, size)

    def submit(self, fit: FrameFit) -> Future:
        """A future of (picture, mask); the picture of a frame without a face is empty."""
        if not fit.found:
            empty: Future = Future()
            picture = background_picture(None, self.painter.size)
            empty.set_result((picture, np.zeros(picture.shape[:2], np.uint8)))
            return empty
        # The frames of a run share their identity, and to bake one into the model takes longer than to draw it.
        if self._identity is None or not np.array_equal(fit.identity, self._identity):
            self._identity, self._person = fit.identity, self.model.personal(fit.identity)
        rotation = fit.rotation if self.view == "pose" else np.zeros(3)
        vertices = posed_vertices(self._person, fit.expression, fit.jaw, fit.scale)
        extras = Extras(rest=self._person.neutral, body=BODY_SHARE * rotation)
        return self.painter.submit(vertices, self.camera, rotation, self.translation, extras=extras)

    def __enter__(self) -> "HeadPanel":
        return self

    def __exit__(self, *_: object) -> None:
        self.painter.close()


def _size_beside(frame_size: tuple[int, int]) -> tuple[int, int]:
    width, height = min(frame_size), frame_size[1]
    scale = min(1.0, LARGEST_HEAD_PX / height)
    return max(1, round(width * scale)), max(1, round(height * scale))


def _matched(frames: Frames, track: Fits) -> Iterator[tuple[Frame, FrameFit]]:
    """Frames and fits of equal index; a track may leave frames out."""
    place, fit = 0, track[0]
    for frame in frames.iterate(fit.index):
        while fit.index < frame.index and place + 1 < len(track):
            place += 1
            fit = track[place]
        if fit.index == frame.index:
            yield frame, fit
            if place + 1 == len(track):
                return


def _write(writer: VideoWriter, waiting: tuple[np.ndarray, Future], progress, total: int) -> None:
    overlay, head = waiting
    writer.write(side_by_side(overlay, head.result()[0]))
    if progress is not None:
        progress(writer.count, total)


def _on_canvas(picture: UInt8[np.ndarray, "h w 3"], size: tuple[int, int]) -> UInt8[np.ndarray, "ch cw 3"]:
    """The picture in the middle of (width, height): images of one folder may differ in size, a video may not."""
    height, width = picture.shape[:2]
    if (width, height) == size:
        return picture
    canvas = background_picture(None, size)
    left, top = (size[0] - width) // 2, (size[1] - height) // 2
    canvas[top : top + height, left : left + width] = picture
    return canvas
