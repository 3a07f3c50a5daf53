"""What a landmark detector offers: faces in a picture, and the landmarks of each."""

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from workbench.landmarks.observations import Landmarks2D

AUTO = "auto"
"""Not a detector's name but a choice, which leaves it to the workbench: `RECOMMENDED`."""
RECOMMENDED = "network"
"""The detector that runs under "auto": it finds the most faces, comes nearest to them, and needs no other package."""
Effort = Literal["quick", "thorough", "full"]
"""How hard to look for faces: at every frame, now and then, once per shot."""
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
        """The landmarks of the face in `box`, as accurately as this detector can on one picture."""
        ...

    def refine(self, picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "points 2"]) -> Landmarks2D:
        """The landmarks of the face near `points` (a frame ago, or carried by optical flow), quickly."""
        ...
