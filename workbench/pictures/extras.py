"""What can be drawn with a head: its own colours, points and segments in 3D, and a second, translucent head."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int, Integer, UInt8

from workbench.face.model import FaceModel

GHOST_COLOR = (150, 196, 255)
OUTLINE_COLOR = (214, 60, 180)
"""Magenta: it stands out from skin, from the page, and from the colours of numbers."""
SEGMENT_MM = 0.9
"""Thickness of a segment."""
INNER_REGIONS = ("eyeL", "eyeR", "teethU", "teethL", "tongue", "mouth_cavity", "eye_cavity")
"""Parts that would shine through a translucent skin."""
WET_REGIONS = ("eyeL", "eyeR", "teethU", "teethL", "tongue")
"""Parts that shine."""
ROD_SIDES = 6


@dataclass(frozen=True, eq=False)
class ColoredMesh:
    """A separate surface: hair, glasses, a hand; head frame, millimetres."""

    vertices: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "t 3"]
    colors: UInt8[np.ndarray, "n 3"]
    """RGB of each vertex."""


@dataclass(frozen=True)
class Extras:
    """Additions to one picture of a head; everything in the head frame, millimetres."""

    colors: UInt8[np.ndarray, "v 3"] | None = None
    """RGB of each vertex, in place of the head's texture and colours."""
    light: UInt8[np.ndarray, "v 3"] | None = None
    """Share, of 255, of the lights' red, green and blue that reaches each vertex; None: all of it. What is worn on the
    face takes it from the vertices that it is tied to."""
    points: Float[np.ndarray, "p 3"] | None = None
    point_colors: UInt8[np.ndarray, "p 3"] | None = None
    point_mm: float = 2.0
    """Diameter of the points."""
    segments: Float[np.ndarray, "s 2 3"] | None = None
    segment_colors: UInt8[np.ndarray, "s 3"] | None = None
    meshes: tuple[ColoredMesh, ...] = ()
    ghost: Float[np.ndarray, "v 3"] | None = None
    """Vertices of a second head."""
    ghost_opacity: float = 0.35
    ghost_outline: bool = False
    """Whether only the ghost's outline is drawn, over the head, not its surface."""
    rest: Float[np.ndarray, "v 3"] | None = None
    """The person without an expression, whom a character's hair follows; None: the neutral that the painter was made
    with."""
    body: Float[np.ndarray, "3"] | None = None
    """Rotation (axis-angle, to the camera) of a character's body, which its neck bends to; None: as the head."""


NOTHING = Extras()


def marks_mesh(
    extras: Extras,
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "t 3"], UInt8[np.ndarray, "n 3"]]:
    """Points as balls, segments as rods, and the meshes: (vertices, triangles, RGB of each vertex)."""
    shapes = [(mesh.vertices, mesh.triangles, mesh.colors) for mesh in extras.meshes]
    if extras.points is not None and len(extras.points):
        shapes.append(_balls(extras.points, extras.point_mm / 2, extras.point_colors))
    if extras.segments is not None and len(extras.segments):
        shapes.append(_rods(extras.segments, SEGMENT_MM / 2, extras.segment_colors))
    if not shapes:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3), np.uint8)
    starts = np.cumsum([0] + [len(vertices) for vertices, _, _ in shapes[:-1]])
    triangles = [shape[1] + start for shape, start in zip(shapes, starts, strict=True)]
    return np.concatenate([s[0] for s in shapes]), np.concatenate(triangles), np.concatenate([s[2] for s in shapes])


def outer_triangles(model: FaceModel) -> Integer[np.ndarray, "t 3"]:
    """The triangles of the skin, without the eye sockets and the inside of the mouth."""
    return model.triangles[is_outer(model)]


def is_outer(model: FaceModel) -> Bool[np.ndarray, "t"]:
    """Which of the model's triangles `outer_triangles` keeps."""
    return ~model.in_regions(INNER_REGIONS)[model.triangles].any(1)


def _balls(centres, radius, colors):
    corners, faces = _ball()
    vertices = (centres[:, None] + radius * corners).reshape(-1, 3)
    triangles = (faces + len(corners) * np.arange(len(centres))[:, None, None]).reshape(-1, 3)
    return vertices, triangles, np.repeat(colors, len(corners), axis=0)


def _rods(segments, radius, colors):
    """Open tubes; their ends lie inside points or the skin, or are too thin to be seen."""
    along = segments[:, 1] - segments[:, 0]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    helper = np.where(np.abs(along[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    side = np.cross(along, helper)
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    third = np.cross(along, side)
    angle = 2 * np.pi * np.arange(ROD_SIDES) / ROD_SIDES
    ring = radius * (np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * third[:, None])
    vertices = (segments[:, :, None] + ring[:, None]).reshape(-1, 3)
    here, following = np.arange(ROD_SIDES), (np.arange(ROD_SIDES) + 1) % ROD_SIDES
    faces = np.concatenate(
        [
            np.stack([here, following, following + ROD_SIDES], axis=1),
            np.stack([here, following + ROD_SIDES, here + ROD_SIDES], axis=1),
        ]
    )
    triangles = (faces + 2 * ROD_SIDES * np.arange(len(segments))[:, None, None]).reshape(-1, 3)
    return vertices, triangles, np.repeat(colors, 2 * ROD_SIDES, axis=0)


@lru_cache(maxsize=1)
def _ball() -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "t 3"]]:
    """Unit ball: an octahedron whose triangles are split twice."""
    corners = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(2):
        split = []
        for a, b, c in corners[faces]:
            ab, bc, ca = (middle / np.linalg.norm(middle) for middle in (a + b, b + c, c + a))
            split += [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        corners, numbering = np.unique(np.round(np.reshape(split, (-1, 3)), 9), axis=0, return_inverse=True)
        faces = numbering.reshape(-1, 3)
    return corners, faces
