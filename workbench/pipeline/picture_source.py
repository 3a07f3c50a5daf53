"""Frames of pictures with what a detector finds in them."""

from collections.abc import Iterator

import numpy as np

from workbench.config import Config
from workbench.frames import Frame, Frames, read_ahead
from workbench.landmarks.detection import LandmarkDetector
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.schemes import detector_scheme
from workbench.landmarks.tracker_options import TrackerOptions, options_for
from workbench.landmarks.tracking import LandmarkTracker
from workbench.tracking import FrameObservation
from workbench.tracking.observation import motion_of

STILL_CONFIDENCE = 0.5
"""Median landmark confidence that a photo needs: no later frame would put a doubtful face right."""


class PictureSource:
    """Frames through a detector and, unless they are stills, through the landmark tracker."""

    def __init__(self, frames: Frames, detector: LandmarkDetector, config: Config, keep_pictures: bool = False):
        """`keep_pictures` hands every frame's picture on with its observation."""
        self.frames, self._keep, self._compares = frames, keep_pictures, config.compares_pictures
        self.single_picture = frames.kind == "images" and frames.announced_count == 1
        self.image_size = frames.image_size
        self.count = frames.announced_count
        self.detector, self.scheme = detector.name, detector_scheme(detector.name)
        face = config.landmarks.face
        self._tracker = LandmarkTracker(detector, options_for(detector.name, face))
        self._finder = LandmarkTracker(detector, TrackerOptions(face=face, accept_confidence=STILL_CONFIDENCE))

    @property
    def views(self) -> list[Frames]:
        """The pictures of every view."""
        return [self.frames]

    def notes(self) -> list[str]:
        return list(self.frames.notes)

    def observations(self, start: int, state: dict[str, np.ndarray], stills: bool) -> Iterator[FrameObservation]:
        if stills:
            yield from (observation for _, observation in self.stills(start))
            return
        frames, before = read_ahead(self.frames.iterate(max(start - 1, 0))), None
        if start:
            before = next(frames).picture
            self._tracker.restore(state, before)
        for frame in frames:
            height, width = frame.picture.shape[:2]
            found = self._tracker.step(frame.picture)
            times = (found.milliseconds["detect"], found.milliseconds["landmarks"])
            kept = frame.picture if self._keep else None
            motion = motion_of(before, frame.picture) if self._compares else None
            yield FrameObservation(
                frame.index, found.landmarks, (width, height), found.source, found.cut, times, kept, motion=motion
            )
            before = frame.picture

    def stills(self, start: int = 0) -> Iterator[tuple[Frame, FrameObservation]]:
        """Each frame as a separate picture, with what is found in it."""
        yield from ((frame, self._still(frame)) for frame in read_ahead(self.frames.iterate(start)))

    def state(self) -> dict[str, np.ndarray]:
        return self._tracker.state()

    def _still(self, frame: Frame) -> FrameObservation:
        height, width = frame.picture.shape[:2]
        self._finder.reset()
        found = self._finder.step(frame.picture)
        times = (found.milliseconds["detect"], found.milliseconds["landmarks"])
        kept = frame.picture if self._keep else None
        return FrameObservation(frame.index, found.landmarks, (width, height), found.source, True, times, picture=kept)


def picture_source(frames: Frames, config: Config, keep_pictures: bool = False) -> PictureSource:
    """Frames through the detector of a configuration."""
    detector = make_detector(config.landmarks.detector, config.landmarks.face_landmarker)
    return PictureSource(frames, detector, config, keep_pictures)
