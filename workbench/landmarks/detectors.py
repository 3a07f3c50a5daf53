"""Landmark detectors by name."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType

from workbench.errors import ConfigError
from workbench.landmarks.dense_detector import DenseDetector
from workbench.landmarks.detection import AUTO, RECOMMENDED, LandmarkDetector
from workbench.landmarks.dlib_detector import DlibDetector
from workbench.landmarks.mediapipe_detector import MediapipeDetector
from workbench.landmarks.mixed_detector import MixedDetector
from workbench.landmarks.network_detector import NetworkDetector
from workbench.landmarks.pupil_detector import PupilDetector


def _mixed() -> LandmarkDetector:
    return MixedDetector(DlibDetector("hog-then-cnn"), NetworkDetector())


DETECTORS: Mapping[str, Callable[[], LandmarkDetector]] = MappingProxyType(
    {
        "dlib+network": _mixed,
        "network": NetworkDetector,
        "network+pupils": PupilDetector,
        "dense": DenseDetector,
        "dlib": partial(DlibDetector, "hog-then-cnn"),
        "dlib-hog": partial(DlibDetector, "hog"),
        "dlib-cnn": partial(DlibDetector, "cnn"),
        MediapipeDetector.name: partial(MediapipeDetector, None),
    }
)
"""Detector name -> factory."""


def make_detector(name: str, face_landmarker: str | Path | None = None) -> LandmarkDetector:
    """Build a detector by name, or the one that "auto" stands for.

    `face_landmarker` is the path of the model file that the detector mediapipe needs. Raises `ConfigError` for an
    unknown name or model file, and `MissingDependencyError` if the package that it needs is missing.
    """
    name = chosen_detector(name)
    if name == MediapipeDetector.name:
        return MediapipeDetector(face_landmarker)
    return DETECTORS[name]()


def chosen_detector(name: str = AUTO) -> str:
    """The detector that runs under a name: its own, or `RECOMMENDED` for "auto".

    Raises `ConfigError` for an unknown name.
    """
    if name == AUTO:
        return RECOMMENDED
    if name not in DETECTORS:
        raise ConfigError(f"there is no landmark detector {name!r}: choose one of {', '.join((AUTO, *DETECTORS))}")
    return name
