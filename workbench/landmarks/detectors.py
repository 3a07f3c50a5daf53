"""Finding faces and their 68 landmarks: what a detector offers, and detectors by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import ConfigError, MissingDependencyError
from workbench.landmarks.observations import Landmarks2D

Effort = Literal["quick", "thorough", "full"]
"""How hard to look for faces: at every frame, now and then, once a shot."""
Box = tuple[float, float, float, float]
"""(left, top, right, bottom): the edges of a face box in pixels; (0, 0) is the centre of the top-left pixel."""


@dataclass(frozen=True)
class FaceDetection:
    """One face found in a picture."""

    box: Box
    """Roughly square: from above the brows to the chin, cheek to cheek."""
    score: float
    """The detector's own measure; larger is surer."""

    @property
    def area(self) -> float:
        """Area of the box in square pixels."""
        left, top, right, bottom = self.box
        return (right - left) * (bottom - top)


@runtime_checkable
class LandmarkDetector(Protocol):
    """What the tracker and the panels need of a detector."""

    name: str

    def detect_faces(self, picture: UInt8[np.ndarray, "h w 3"], effort: Effort = "full") -> list[FaceDetection]:
        """Faces, the largest first; less effort may miss faces for the sake of speed."""
        ...

    def align(self, picture: UInt8[np.ndarray, "h w 3"], box: Box) -> Landmarks2D:
        """The landmarks of the face in `box`, as well as this detector can on one picture."""
        ...

    def refine(self, picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "68 2"]) -> Landmarks2D:
        """The landmarks of the face near `points` (a frame ago, or carried by optical flow), quickly."""
        ...


AUTO = "auto"
"""Not a detector but a choice: see `chosen_detector`."""


def _dlib(faces: str) -> LandmarkDetector:
    from workbench.landmarks.dlib_detector import DlibDetector  # dlib is optional: imported when it is asked for

    return DlibDetector(faces)


def _network() -> LandmarkDetector:
    from workbench.landmarks.network_detector import NetworkDetector  # reads the weights: when it is asked for

    return NetworkDetector()


def _mixed() -> LandmarkDetector:
    from workbench.landmarks.mixed_detector import MixedDetector

    return MixedDetector(_dlib("hog-then-cnn"), _network())


def _auto() -> LandmarkDetector:
    return DETECTORS[chosen_detector(AUTO)]()


DETECTORS: Mapping[str, Callable[[], LandmarkDetector]] = MappingProxyType(
    {
        AUTO: _auto,
        "dlib+network": _mixed,
        "network": _network,
        "dlib": partial(_dlib, "hog-then-cnn"),
        "dlib-hog": partial(_dlib, "hog"),
        "dlib-cnn": partial(_dlib, "cnn"),
    }
)
"""Detector name -> factory."""


def make_detector(name: str) -> LandmarkDetector:
    """Build a detector by name; its own `name` says which one "auto" became.

    Raises `ConfigError` for an unknown name and `MissingDependencyError` without the package that it needs.
    """
    _check(name)
    return DETECTORS[name]()


def chosen_detector(name: str = AUTO) -> str:
    """The detector that runs under a name: "auto" is "dlib+network" where dlib is installed, else "network".

    Raises `ConfigError` for an unknown name.
    """
    _check(name)
    return _automatic() if name == AUTO else name


def _automatic() -> str:
    from workbench.landmarks.dlib_detector import check_installed

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
