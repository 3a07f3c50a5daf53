"""Short clips for sweeps: frames of the sample clip as landmark files and observations."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

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
