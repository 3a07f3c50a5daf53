"""The 68 iBUG points among those of MediaPipe's face mesh (468, or 478 with the irises, which are not used).

The two schemes were made apart, so that a correspondence is a choice. The numbers of the mesh are those of MediaPipe's
canonical face model; its contours (`FACEMESH_FACE_OVAL`, `..._EYEBROW`, `..._EYE`, `..._LIPS` in
mediapipe.python.solutions.face_mesh_connections) give the lines, and this is the rule along them:

- Eye corners, mouth corners, cupid's bow, nose tip, chin and the middles of the lips are vertices of the mesh.
- What lies between two of these is spread evenly along the contour, as iBUG does: each point is the vertex, or the
  middle of two neighbouring vertices, that is nearest. Lengths are means over the answers for seven photos.
- The jaw begins at the upper end of the ear (127). The brows are their upper edge. The nose bridge begins between 168
  and 6, on the line of the eyes. The outer edge of a nostril is the middle of 98 and 97, as in annotated photos.
- The subject's left is the mirrored right.
"""

import numpy as np
from jaxtyping import Float

from workbench.errors import InputError
from workbench.landmarks.scheme import MIRROR, POINT_COUNT

COUNTS = (468, 478)
"""Points of the mesh without and with the irises."""
FARTHEST = 10.0
"""Widths or heights of the picture from its corner; a face farther off was not given as fractions."""

_RIGHT: dict[int, tuple[int, ...]] = {
    **dict(enumerate([(127,), (93, 234), (93, 132), (58,), (172,), (136, 150), (149,), (148, 176)])),  # jaw
    **dict(enumerate([(70,), (63,), (105,), (66,), (107,)], 17)),  # brow
    **dict(enumerate([(97, 98), (97,)], 31)),  # nose base
    **dict(enumerate([(33,), (160,), (158,), (133,), (153,), (144,)], 36)),  # eye
    **dict(enumerate([(61,), (39, 40), (37,)], 48)),  # upper lip, outer edge
    **dict(enumerate([(84, 181), (91,)], 58)),  # lower lip, outer edge
    **dict(enumerate([(78,), (81,)], 60)),  # upper lip, inner edge
    67: (178,),  # lower lip, inner edge
}
_MIDDLE: dict[int, tuple[int, ...]] = {
    8: (152,),
    **dict(enumerate([(6, 168), (197,), (5, 195), (4,)], 27)),  # nose bridge
    33: (2,),
    51: (0,),
    57: (17,),
    62: (13,),
    66: (14,),
}
_MIRRORED = {
    **{127: 356, 234: 454, 93: 323, 132: 361, 58: 288, 172: 397, 136: 365, 150: 379, 149: 378, 176: 400, 148: 377},
    **{70: 300, 63: 293, 105: 334, 66: 296, 107: 336, 98: 327, 97: 326},
    **{33: 263, 160: 387, 158: 385, 133: 362, 153: 380, 144: 373},
    **{61: 291, 40: 270, 39: 269, 37: 267, 84: 314, 181: 405, 91: 321, 78: 308, 81: 311, 178: 402},
}
"""Vertices of the subject's right -> left that the table uses."""
_LEFT = {MIRROR[point]: tuple(_MIRRORED[vertex] for vertex in vertices) for point, vertices in _RIGHT.items()}

VERTICES: tuple[tuple[int, ...], ...] = tuple((_RIGHT | _MIDDLE | _LEFT)[point] for point in range(POINT_COUNT))
"""For each of the 68 points one vertex of the mesh, or two in whose middle it lies."""


def ibug_points(where: str, mesh: Float[np.ndarray, "n 2"], image_size: tuple[int, int]) -> Float[np.ndarray, "68 2"]:
    """The 68 points in pixels, from 468 or 478 as fractions of the picture's width and height.

    MediaPipe counts from the outer edge of the first pixel, so that half a pixel is subtracted. Raises `InputError`,
    which begins with the place in the file, for coordinates that are no fractions.
    """
    farthest = np.nanmax(np.abs(mesh), initial=0.0)
    if farthest > FARTHEST:
        raise InputError(
            f"{where}: MediaPipe's points are fractions of the picture's width and height, got {farthest:g}: "
            "give them as MediaPipe does"
        )
    return np.stack([mesh[list(vertices)].mean(axis=0) for vertices in VERTICES]) * image_size - 0.5
