"""Landmark detectors by name."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType

from workbench.errors import ConfigError, MissingDependencyError
from workbench.landmarks.dense_detector import DenseDetector
from workbench.landmarks.detection import LandmarkDetector
from workbench.landmarks.dlib_detector import DlibDetector, check_installed
from workbench.landmarks.mediapipe_detector import MediapipeDetector
from workbench.landmarks.mixed_detector import MixedDetector
from workbench.landmarks.network_detector import NetworkDetector
from workbench.landmarks.pupil_detector import PupilDetector

AUTO = "auto"
"""Not a detector but a choice: see `chosen_detector`."""


def _mixed() -> LandmarkDetector:
    return MixedDetector(DlibDetector("hog-then-cnn"), NetworkDetector())


def _auto() -> LandmarkDetector:
    return DETECTORS[chosen_detector(AUTO)]()


DETECTORS: Mapping[str, Callable[[], LandmarkDetector]] = MappingProxyType(
    {
        AUTO: _auto,
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
    """Build a detector by name; its own `name` says which one "auto" became.

    `face_landmarker` is the path of the model file that the detector mediapipe needs. Raises `ConfigError` for an
    unknown name or model file, and `MissingDependencyError` without the package that it needs.
    """
    _check(name)
    if name == MediapipeDetector.name:
        return MediapipeDetector(face_landmarker)
    return DETECTORS[name]()


def chosen_detector(name: str = AUTO) -> str:
    """The detector that runs under a name: "auto" is "dlib+network" where dlib is installed, else "network".

    Raises `ConfigError` for an unknown name.
    """
    _check(name)
    return _automatic() if name == AUTO else name


def _automatic() -> str:
    try:
        check_installed()
    except MissingDependencyError:
        return "network"
    return "dlib+network"


def fallback_note(asked: str, runs: str) -> str | None:
    """What users should know where "auto" had to do without dlib; None otherwise."""
    if asked != AUTO or runs != "network":
        return None
    return "dlib is not installed, so the workbench's own network found the landmarks."


def _check(name: str) -> None:
    if name not in DETECTORS:
        raise ConfigError(f"there is no landmark detector {name!r}: choose one of {', '.join(DETECTORS)}")
