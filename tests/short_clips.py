"""Short clips: frames of the sample clip as landmark files and observations, and videos with times of their own."""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord, read_landmark_file
from workbench.samples import sample
from workbench.tracking import FrameObservation


def write_clip(path: Path, frames: Sequence[int], faceless: bool = False) -> Path:
    """These frames of the sample clip as a landmark file; `faceless`: none of them has a face."""
    stored = list(read_landmark_file(sample("performance-landmarks")))
    with LandmarkCsvWriter(path, confidence=True) as writer:
        for index, frame in enumerate(frames):
            record = stored[frame]
            landmarks = None if faceless else record.landmarks
            writer.write(LandmarkRecord(index, "", landmarks, record.landmarks.image_size))
    return path


def observations(frames: Sequence[int], gaps: Sequence[int] = (), cuts: Sequence[int] = ()) -> list[FrameObservation]:
    """The same as observations, with frames without a face and with cuts."""
    stored = list(read_landmark_file(sample("performance-landmarks")))
    found = [
        FrameObservation(index, stored[frame].landmarks, stored[frame].landmarks.image_size, cut=index in cuts)
        for index, frame in enumerate(frames)
    ]
    return [replace(each, landmarks=None) if each.index in gaps else each for each in found]


def write_timed_clip(path: Path, pictures: Sequence[np.ndarray], milliseconds: Sequence[float]) -> None:
    """A video whose pictures are shown at these times."""
    height, width = pictures[0].shape[:2]
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.codec_context.time_base = width, height, Fraction(1, 1000)
        for picture, time_ms in zip(pictures, milliseconds, strict=True):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = int(time_ms), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
