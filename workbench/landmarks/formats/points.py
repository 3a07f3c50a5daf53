"""One face of another program as the 68 iBUG points in pixels, by how many points it has.

68 points are pixels already: (0, 0) is the centre of the top-left pixel, x right, y down, in iBUG's order, which begins
at the subject's right ear. 468 or 478 points are those of MediaPipe's face mesh, as fractions of the picture's width
and height.
"""

import numpy as np
from jaxtyping import Float

from workbench.errors import InputError
from workbench.landmarks.formats import mediapipe
from workbench.landmarks.formats.records import checked_landmarks
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import POINT_COUNT

COUNTS = (POINT_COUNT, *mediapipe.COUNTS)


def face_landmarks(
    where: str, points: Float[np.ndarray, "n 2"], confidence: Float[np.ndarray, "68"] | None, size: tuple[int, int]
) -> Landmarks2D:
    """The landmarks of a face of 68, 468 or 478 points; confidence of 68. Raises `InputError` with the place."""
    if len(points) not in COUNTS:
        raise InputError(f"{where}: a face has 68 points, or MediaPipe's 468 or 478; got {len(points)}")
    if len(points) != POINT_COUNT:
        points = mediapipe.ibug_points(where, points, size)
    return checked_landmarks(where, points, confidence, size)
