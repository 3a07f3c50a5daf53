"""A pair of glasses for a head: two rims, a bridge and temples as tubes."""

import numpy as np

from workbench.pictures.extras import ColoredMesh

COLOR = (34, 26, 24)
WIRE_MM, TEMPLE_MM = 1.3, 1.1
AHEAD_MM, DROP_MM, APART_MM = 14.0, 4.0, 1.5
"""Of the rims' middles from the eyes' landmarks: towards the camera, down, and away from the nose."""
BROWS_MM = 4.0
"""Of the rims from the brows, towards the camera."""
SQUARENESS = 2.8
"""Exponent of the rims' superellipse; 2 is round."""
BEND_MM = 12.0
"""Length of a temple over which it turns back."""
AROUND, SIDES = 49, 10


def glasses(landmarks: np.ndarray) -> ColoredMesh:
    """Glasses for a head with these 68 landmarks at rest, (68, 3) in the head frame; they do not move with the face."""
    right, left = landmarks[36:42].mean(0), landmarks[42:48].mean(0)
    apart = left[0] - right[0]
    half = np.array([0.38 * apart, 0.29 * apart])
    nose, depth = landmarks[27], min(left[2] - AHEAD_MM, right[2] - AHEAD_MM, landmarks[17:27, 2].min() - BROWS_MM)
    angle = np.linspace(0, 2 * np.pi, AROUND)
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    rim = np.sign(circle) * np.abs(circle) ** (2 / SQUARENESS)
    tubes = []
    outward = np.array([APART_MM, 0.0, 0.0])
    for eye, side in ((right - outward, -1.0), (left + outward, 1.0)):
        x, y = eye[0] + half[0] * rim[:, 0], eye[1] + DROP_MM + half[1] * rim[:, 1]
        tubes.append(_tube(np.stack([x, y, _bowed(x, depth)], 1), WIRE_MM))
        hinge = np.array([eye[0] + side * half[0], eye[1] + DROP_MM - 0.45 * half[1], 0.0])
        hinge[2] = _bowed(hinge[0], depth)
        temple = landmarks[0 if side < 0 else 16]
        corner = np.array([0.96 * temple[0], hinge[1], hinge[2] + 2.0])
        ear = np.array([temple[0] + side * 2.0, hinge[1] - 3.0, temple[2] + 14.0])
        bend = np.linspace(0.0, 1.0, 9)[:, None]
        behind = corner + BEND_MM * (ear - corner) / np.linalg.norm(ear - corner)
        around = (1 - bend) ** 2 * hinge + 2 * bend * (1 - bend) * corner + bend**2 * behind
        tubes.append(_tube(np.concatenate([around, ear[None]]), TEMPLE_MM))
    inner = [right[0] - APART_MM + half[0], left[0] + APART_MM - half[0]]
    height = (right[1] + left[1]) / 2 + DROP_MM - 0.35 * half[1]
    x = np.linspace(inner[0], inner[1], 9)
    arch = np.sin(np.linspace(0, np.pi, 9))
    over = min(_bowed(nose[0], depth), nose[2] - 4.0)
    tubes.append(_tube(np.stack([x, height - 3.0 * arch, _bowed(x, depth) * (1 - arch) + over * arch], 1), WIRE_MM))
    starts = np.cumsum([0] + [len(points) for points, _ in tubes[:-1]])
    points = np.concatenate([points for points, _ in tubes])
    triangles = np.concatenate([triangles + start for (_, triangles), start in zip(tubes, starts, strict=True)])
    return ColoredMesh(points, triangles, np.tile(np.array(COLOR, np.uint8), (len(points), 1)))


def _bowed(x, depth: float):
    """Depth of the frame: it bends around the face."""
    return depth + 0.004 * x**2


def _tube(path: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, np.where(np.abs(along[:, 2:]) < 0.7, [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    ring = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * np.cross(along, across)[:, None]
    index = np.arange(len(path) * SIDES).reshape(len(path), SIDES)
    a, b = index[:-1], np.roll(index, -1, axis=1)[:-1]
    c, d = index[1:], np.roll(index, -1, axis=1)[1:]
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    return (path[:, None] + radius * ring).reshape(-1, 3), triangles
