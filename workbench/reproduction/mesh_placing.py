"""Other programs' meshes in the pixels of a picture: which way a file's axes point, and how far the face is from it.

Files say neither whether y points up nor how vertices and axes go together. PRNet's OBJ files have y = h − 1 − row,
its MAT files y = row; 3DDFA's OBJ files have the row before the column; VRN's have the pixels of a crop.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from workbench.geometry import Camera
from workbench.pictures.mesh import to_pixels
from workbench.reproduction.mesh_files import OtherMesh

CROP_SIDE, CROPPED_FACE = 192, 90.0
"""VRN's picture, and the root of the area of the landmarks' box in it."""
CELL_PX = 1.5
"""Side of a cell in which the nearest point hides the others."""
IN_CROP = "in VRN's crop"
SAMPLES, FEW_SAMPLES, FEW_POINTS = 60_000, 6_000, 300
"""Points of a surface, about, to measure by; those of it and of the face that are enough to tell readings apart."""
ROUNDS = 3


@dataclass(frozen=True)
class Reading:
    """How to take a file's coordinates. In the picture x is the column, y the row, and z grows towards the camera."""

    swapped: bool = False
    """The row stands before the column."""
    up: bool = False
    """The row counts from below."""
    away: bool = False
    """z grows away from the camera."""
    cropped: bool = False
    """Pixels are those of VRN's crop."""

    def __str__(self) -> str:
        said = {
            "x and y swapped": self.swapped, "y up": self.up, "z away": self.away, IN_CROP: self.cropped,
        }  # fmt: skip
        return ", ".join(words for words, true in said.items() if true) or "as it is"

    def of(
        self, vertices: Float[np.ndarray, "n 3"], height: int, landmarks: Float[np.ndarray, "68 2"]
    ) -> Float[np.ndarray, "n 3"]:
        """The vertices in a picture of this height; `landmarks` tell where VRN has cut it."""
        x, y, z = vertices.T[[1, 0, 2] if self.swapped else [0, 1, 2]]
        if self.up:
            y = (CROP_SIDE if self.cropped else height) - 1 - y
        placed = np.stack([x, y, -z if self.away else z], axis=1)
        return _out_of_the_crop(placed, landmarks) if self.cropped else placed


READINGS = tuple(Reading(*each) for each in product((False, True), repeat=3))


def read_over(
    mesh: OtherMesh,
    face: Float[np.ndarray, "m 3"],
    height: int,
    landmarks: Float[np.ndarray, "68 2"],
) -> tuple[Reading, Float[np.ndarray, "n 3"]]:
    """The reading in which a mesh is closest to the face, and its vertices in the picture.

    `face` are points of a surface as `in_picture` gives them.
    """
    readings = list(READINGS)
    if mesh.vertices[:, :2].min() > -1.0 and mesh.vertices[:, :2].max() < CROP_SIDE:
        readings += [Reading(*each, cropped=True) for each in product((False, True), repeat=3)]
    placed = [reading.of(mesh.vertices, height, landmarks) for reading in readings]
    some = face[:: -(-len(face) // FEW_POINTS)]
    best = int(np.argmin([distance_px(some, vertices, mesh.triangles, FEW_SAMPLES) for vertices in placed]))
    return readings[best], placed[best]


def in_picture(camera: Camera, points_camera: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Column, row, and height towards the camera in pixels of the mean distance."""
    depth = points_camera[:, 2]
    scale = float(np.mean(camera.focal_px)) / depth.mean()
    return np.column_stack([to_pixels(camera, points_camera), scale * (depth.mean() - depth)])


def distance_px(
    face: Float[np.ndarray, "m 3"],
    vertices: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "t 3"] | None,
    samples: int = SAMPLES,
) -> float:
    """Mean distance of points from a mesh in a picture's pixels.

    What is common to all depths is taken out, beginning with the front of the mesh: a parallel projection does not
    know it.
    """
    points = _surface(vertices, triangles, samples)
    front, surface = _front(points), cKDTree(points)
    above = cKDTree(front[:, :2]).query(face[:, :2])[1]
    shift = np.array([0.0, 0.0, np.median(front[above, 2] - face[:, 2])])
    for _ in range(ROUNDS):
        nearest = surface.query(face + shift)[1]
        shift[2] = np.median(points[nearest, 2] - face[:, 2])
    return float(surface.query(face + shift)[0].mean())


def _surface(
    vertices: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "t 3"] | None, samples: int
) -> Float[np.ndarray, "s 3"]:
    """The vertices, and as many points of each triangle as make so many."""
    if triangles is None or len(triangles) == 0:
        return vertices
    side = int(np.ceil(np.sqrt(2.0 * samples / len(triangles))))
    first, second = np.meshgrid((np.arange(side) + 0.5) / side, (np.arange(side) + 0.5) / side)
    inside = first + second < 1.0
    weights = np.stack([first[inside], second[inside], 1.0 - first[inside] - second[inside]], axis=1)
    return np.concatenate([vertices, np.einsum("wk,tkc->twc", weights, vertices[triangles]).reshape(-1, 3)])


def _front(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "f 3"]:
    """The nearest point of each cell of the picture."""
    ordered = points[np.argsort(-points[:, 2], kind="stable")]
    cells = np.floor(ordered[:, :2] / CELL_PX).astype(np.int64)
    return ordered[np.unique((cells[:, 0] << 32) + cells[:, 1], return_index=True)[1]]


def _out_of_the_crop(
    placed: Float[np.ndarray, "n 3"], landmarks: Float[np.ndarray, "68 2"]
) -> Float[np.ndarray, "n 3"]:
    """The picture's pixels for those of the crop that VRN's run.sh makes from the landmarks' box."""
    low, size = landmarks.min(axis=0), np.ptp(landmarks, axis=0)
    scale = CROPPED_FACE / np.sqrt(size.prod())
    across = (placed[:, :2] + 0.5) / scale - 0.5 + low - size / 2.0
    return np.column_stack([across, placed[:, 2] / scale])
