"""Live recordings: timed fits resampled to a constant frame rate as a track, together with the pictures."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int

from workbench.config import Config
from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.files import make_folder, writing
from workbench.frames import VideoWriter
from workbench.pipeline import software_versions
from workbench.pipeline.output_folder import check_no_results
from workbench.session.live_frame import LiveFrame
from workbench.tracking import FrameFit, Track
from workbench.tracking.records import stack_fits
from workbench.tracking.track_layout import file_record, model_record, scheme_record

SLOWEST_RATE = 5.0
"""Lowest frame rate of a recording, in frames per second, however slowly the frames came."""
MOST_BYTES, MOST_S = 256 << 20, 900.0
"""Limits on picture memory and seconds at which a recording ends automatically."""


def even_frames(times_s: Sequence[float]) -> tuple[Int[np.ndarray, "n"], float]:
    """Index of the nearest of these ascending times for each instant of an even grid, and the grid's rate in 1/s.

    The grid interval is the median interval of the times: a steady stream keeps every frame, and dropped frames are
    replaced by the nearest one, so that the timing is preserved.
    """
    times = np.asarray(times_s, float)
    intervals = np.diff(times)
    if not len(intervals) or np.median(intervals) <= 0.0:
        return np.arange(len(times)), 25.0
    rate = max(1.0 / float(np.median(intervals)), SLOWEST_RATE)
    instants = times[0] + np.arange(round((times[-1] - times[0]) * rate) + 1) / rate
    after = np.clip(np.searchsorted(times, instants), 1, len(times) - 1)
    earlier = instants - times[after - 1] < times[after] - instants
    return np.where(earlier, after - 1, after), rate


@dataclass(frozen=True)
class Recording:
    """A series of live fits. `track` is like that of any run; `save` writes it for `workbench export`."""

    track: Track
    jpegs: tuple[bytes, ...]
    """The picture of each frame; empty if pictures were not kept."""

    def __len__(self) -> int:
        return len(self.track)

    def __repr__(self) -> str:
        return f"Recording({len(self)} frames, {self.seconds:.1f} s, {'with' if self.jpegs else 'without'} pictures)"

    @property
    def seconds(self) -> float:
        """Duration."""
        return len(self) / self.track.meta["rate"]

    def save(self, folder: str | Path, overwrite: bool = False) -> Path:
        """Write track.npz into a folder, and clip.mp4 if pictures were kept; returns the path of the track.

        Raises `OutputError` for a folder that already contains one of them, unless `overwrite` is set: then an earlier
        clip.mp4 is replaced or, once the track is written, deleted. The same for what cannot be written.
        """
        folder = Path(folder)
        if not overwrite:
            check_no_results(folder, ("track.npz", "clip.mp4"), "a recording or a run", "overwrite=True")
        make_folder(folder)
        track, clip = self.track, folder / "clip.mp4"
        if self.jpegs:
            with VideoWriter(clip, rate=track.meta["rate"]) as writer:
                for jpeg in self.jpegs:
                    writer.write(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR_RGB))
            track = replace(track, meta={**track.meta, "inputs": [file_record(clip)]})
        track.save(folder / "track.npz")
        if not self.jpegs:
            with writing(clip):
                clip.unlink(missing_ok=True)
        return folder / "track.npz"


class Recorder:
    """Collects live fits, optionally with their pictures, until `finish`."""

    def __init__(self, keep_pictures: bool) -> None:
        self._keep = keep_pictures
        self._fits: list[FrameFit] = []
        self._times: list[float] = []
        self._jpegs: list[bytes] = []
        self._bytes = 0
        self.ended = ""
        """Why no more frames are taken, in one sentence; empty while recording."""

    def __len__(self) -> int:
        return len(self._fits)

    @property
    def seconds(self) -> float:
        """Time from the first frame to the latest."""
        return self._times[-1] - self._times[0] if self._times else 0.0

    def add(self, fit: FrameFit, frame: LiveFrame) -> None:
        """Add the next frame, unless the recording has ended automatically; `ended` says why."""
        self.ended = self.ended or self._obstacle(fit)
        if self.ended:
            return
        self._fits.append(fit)
        self._times.append(frame.time_s)
        if self._keep:
            self._jpegs.append(frame.jpeg)
            self._bytes += len(frame.jpeg)

    def _obstacle(self, fit: FrameFit) -> str:
        if self._fits and fit.image_size != self._fits[0].image_size:
            return "The camera's picture size changed, so the recording ended."
        if self._bytes > MOST_BYTES or self.seconds > MOST_S:
            return "The recording reached its maximum length and ended."
        return ""

    def finish(self, model: FaceModel, config: Config, source: str, detector: str) -> Recording:
        """The recording as a track. Raises `InputError` if there is no frame with a face."""
        if not any(fit.found for fit in self._fits):
            raise InputError("No face was found while recording, so nothing was kept; record again.")
        chosen, rate = even_frames(self._times)
        fits = [replace(self._fits[k], index=position) for position, k in enumerate(chosen.tolist())]
        columns = stack_fits(fits)
        meta = live_meta(model, config, source, detector, rate)
        meta["live"]["times_s"] = _since_first(self._times)[chosen].round(4).tolist()
        jpegs = tuple(self._jpegs[k] for k in chosen.tolist()) if self._jpegs else ()
        return Recording(Track(meta=meta, **columns), jpegs)


def live_meta(model: FaceModel, config: Config, source: str, detector: str, rate: float) -> dict[str, Any]:
    """Metadata of a track from a camera: the keys of any run, plus the source."""
    return {
        "expression_names": list(model.expression_names),
        "stages": [stage.name for stage in config.stages if stage.enabled],
        "config": json.loads(config.model_dump_json()),
        "inputs": [],
        "landmarks": None,
        "detector": detector,
        "names": [],
        "stills": False,
        "rate": rate,
        "camera_guessed": config.camera.guessed,
        "model": model_record(model),
        **scheme_record(model.scheme),
        "versions": software_versions(),
        "live": {"camera": source},
    }


def _since_first(times: Sequence[float]) -> Float[np.ndarray, "n"]:
    return np.asarray(times, float) - (times[0] if len(times) else 0.0)
