"""The pictures of a run on unrelated photos, each drawn as soon as it is fitted."""

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import numpy as np
from jaxtyping import UInt8

from workbench.face import DressedHead, FaceModel
from workbench.files import NewFiles
from workbench.pictures.overlay_files import OverlayPictures
from workbench.pipeline.sources import canvas
from workbench.tracking import FrameFit, FrameObservation
from workbench.tracking.track_writer import TrackWriter


class StillPictures:
    """Draws `overlay/0012-name.jpg` for each still (`overlay.png` for a single one); used in a `with` block."""

    def __init__(
        self, source, model: FaceModel, names: Sequence[str], folder: Path, dressed: DressedHead | None = None
    ) -> None:
        self._source, self._names, self._folder = source, names, folder
        self._pictures = OverlayPictures(model, dressed=dressed)
        self._new = NewFiles(folder / "overlay")

    def add(self, observation: FrameObservation, fit: FrameFit) -> None:
        """Draw a still that was just fitted."""
        self._draw(fit, observation.picture)

    def add_missing(self, writer: TrackWriter) -> None:
        """Draw the finished stills of an interrupted run whose pictures are not there."""
        for position in range(len(writer)):
            if not self._path(position).exists():
                self._draw(writer[position], None)
        self.flush()

    def flush(self) -> None:
        """Write what is still being drawn."""
        self._pictures.flush()

    def files(self, count: int) -> tuple[Path, ...]:
        """The pictures of the first `count` stills."""
        paths = map(self._path, range(count))
        return tuple(path for path in paths if path.exists())

    def discard(self) -> None:
        """Remove the pictures that no earlier run had drawn, and their folder if new and with nothing else in it."""
        self._new.discard()

    def notes(self) -> list[str]:
        """What a user should know about them."""
        return [self._pictures.note] if self._pictures.note else []

    def _draw(self, fit: FrameFit, picture: UInt8[np.ndarray, "h w 3"] | None) -> None:
        picture = self._picture(fit) if picture is None else picture
        if picture is not None:
            path = self._path(fit.index)
            self._new.expect(path)
            self._pictures.add(path, picture, fit)

    def _picture(self, fit: FrameFit) -> UInt8[np.ndarray, "h w 3"] | None:
        if not self._source.views:
            return canvas(fit.image_size)
        frame = next(self._source.frames.iterate(fit.index), None)
        return None if frame is None else frame.picture

    def _path(self, index: int) -> Path:
        if len(self._names) == 1:
            return self._folder / "overlay.png"
        return self._folder / "overlay" / f"{index:04d}-{Path(self._names[index]).stem}.jpg"

    def __enter__(self) -> "StillPictures":
        self._pictures.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._pictures.__exit__(kind, error, traceback)
