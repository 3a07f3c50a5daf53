"""A plain shirt over the open end of the neck: MakeHuman's shoulders, a little outwards, in a texture of our own."""

import numpy as np
from clothes import Clothes
from jaxtyping import Float, UInt8
from makehuman import BaseMesh
from noise import noise

COLLAR_FRONT, COLLAR_BACK = (150.0, 48.0), (120.0, 155.0)
"""The collar's edge is a plane through these (y, z), millimetres in the head frame."""
WIDEST_MM, LOWEST_MM = 320.0, 340.0
THICK_MM = 3.0
ABOVE_MM, BELOW_MM = 40.0, 200.0
"""What the texture spans, measured down from the collar's edge."""
RIB_MM, RIBS = 15.0, 90
TEXTURE_SHAPE = (512, 1024)


def shirt(
    base: BaseMesh, points: Float[np.ndarray, "b 3"], face_islands: np.ndarray, islands: np.ndarray
) -> tuple[Float[np.ndarray, "n 3"], Clothes]:
    """Vertices (millimetres, head frame) and mesh; its UVs are the angle around the neck and the way down."""
    quads = base.quads[(base.groups == "body") & ~np.isin(islands, face_islands)]
    inside = (np.abs(points[:, 0]) < WIDEST_MM) & (points[:, 1] < LOWEST_MM)
    quads = quads[inside[quads].all(axis=1)]
    rows, quads = np.unique(quads, return_inverse=True)
    quads = quads.reshape(-1, 4)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    body = points[rows]
    down = (COLLAR_BACK[0] - COLLAR_FRONT[0]) / (COLLAR_BACK[1] - COLLAR_FRONT[1])
    below = body[:, 1] - COLLAR_FRONT[0] - down * (body[:, 2] - COLLAR_FRONT[1])
    angle = np.arctan2(body[:, 0], COLLAR_FRONT[1] + 52.0 - body[:, 2]) / (2 * np.pi) + 0.5
    uvs = np.stack([angle, 1 - (below + ABOVE_MM) / (ABOVE_MM + BELOW_MM)], axis=1)
    kept = (below[triangles] > -ABOVE_MM).all(axis=1) & (np.ptp(angle[triangles], axis=1) < 0.5)
    anchors = np.repeat(rows[:, None], 3, axis=1)
    weights = np.tile([1.0, 0.0, 0.0], (len(rows), 1))
    mesh = Clothes(anchors, weights, np.zeros((len(rows), 3)), {}, triangles, uvs, triangles)
    normals = np.zeros_like(body)
    corners = body[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.add.at(normals, triangles.ravel(), np.repeat(across, 3, axis=0))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    worn = np.unique(triangles[kept])
    return (body + THICK_MM * normals)[worn], mesh.of_triangles(kept)


def shirt_picture() -> UInt8[np.ndarray, "h w 4"]:
    """Grey knit with a ribbed collar, RGBA: nothing above the collar's edge."""
    height, width = TEXTURE_SHAPE
    row, column = np.mgrid[:height, :width]
    below = (row + 0.5) / height * (ABOVE_MM + BELOW_MM) - ABOVE_MM
    around = (column + 0.5) / width
    knit = noise(np.stack([around.ravel() * 700, below.ravel() / 1.1], axis=1), 31).reshape(height, width)
    light = 176 + 14 * (knit - 0.5)
    rib = 0.5 + 0.5 * np.cos(2 * np.pi * RIBS * around)
    collar = below < RIB_MM
    light = np.where(collar, 150 + 38 * rib, light)
    seam = np.exp(-(((below - RIB_MM) / 1.2) ** 2))
    edge = np.exp(-((below / 1.5) ** 2))
    light = light * (1 - 0.2 * seam) * (1 - 0.25 * edge)
    alpha = np.clip(below / 0.6 + 0.5, 0, 1)
    return np.dstack([light, light, light, 255 * alpha]).round().astype(np.uint8)
