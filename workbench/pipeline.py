"""The main job: pictures, videos or landmark files in; a folder with the track, tables and pictures out."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from workbench.frames import Frames
from workbench.tracking import Track

TRACK_FILE = "track.npz"
Progress = Callable[[str, int, int | None], None]
"""Called with the name of a step, frames done, and frames in all if known."""


@dataclass(frozen=True)
class RunResult:
    """What a run leaves behind."""

    folder: Path
    track: Track
    summary: dict[str, Any]
    files: tuple[Path, ...]
    notes: tuple[str, ...] = field(default=())
    """What a user should know: a damaged file, pictures that could not be made."""


@dataclass(frozen=True)
class RunInput:
    """Where the landmarks of a run come from: pictures through a detector, or a landmark file (pictures optional)."""

    frames: Frames | None
    landmark_file: Path | None
    paths: tuple[Path, ...]

    @property
    def name(self) -> str:
        """Short name for titles and folders."""
        return self.frames.name if self.frames is not None else self.paths[0].stem

    @property
    def frame_count(self) -> int | None:
        """Number of frames if known beforehand."""
        return self.frames.announced_count if self.frames is not None else None
