"""The first bundled clip as the detectors of presets see it whose points go beyond the 68."""

from workbench.config import preset
from workbench.frames import open_frames
from workbench.landmarks.detectors import make_detector
from workbench.samples import sample
from workbench.sweeps import SweptClip
from workbench.tracking import FrameObservation

FRAMES = 8
NOBODY = 5
"""The frame that shows no face."""


def config_of(name):
    """The preset with the clip's lens."""
    return preset(name).changed(camera={"fov_deg": 33.0}, identity={"frames": 3})


def clip_for(name):
    """The clip with the landmarks of a preset's detector."""
    detector, found, points = make_detector(preset(name).landmarks.detector), [], None
    for number, frame in zip(range(FRAMES), open_frames(sample("performance")).iterate(42), strict=False):
        if points is None:
            points = detector.align(frame.picture, detector.detect_faces(frame.picture, "quick")[0].box).points
        landmarks = detector.refine(frame.picture, points)
        points = landmarks.points
        found.append(FrameObservation(number, None if number == NOBODY else landmarks, landmarks.image_size))
    return SweptClip("clip", name, tuple(found), False)
