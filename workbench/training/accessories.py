"""What people wear on their heads: hair, hats and hoods, and glasses, as coloured meshes in the head frame."""

import numpy as np
from jaxtyping import Float, Int

from workbench.face.model import FaceModel
from workbench.pictures.extras import ColoredMesh

ROWS, COLUMNS = 44, 72


def hair(
    vertices: Float[np.ndarray, "v 3"], model: FaceModel, color: Float[np.ndarray, "3"], rng: np.random.Generator
) -> ColoredMesh:
    """A random head of hair, or a hat, over these head-frame vertices: a shell around the skull, open at the face.

    The shell is a surface over azimuth (0 at the face) and height. Its radius is the skull's with a thickness that
    varies smoothly; below the ears it hangs down as far as the hair is long.
    """
    scalp = vertices[model.regions["scalp"]]
    middle = (scalp.min(0) + scalp.max(0)) / 2
    half = (scalp.max(0) - scalp.min(0)) / 2
    forehead = vertices[model.landmarks.vertices[27, 0], 1]
    thickness, bulge = rng.uniform(3, 26), rng.uniform(0, 14)
    length = rng.choice([0.0, rng.uniform(0, 60), rng.uniform(60, 190)], p=[0.35, 0.35, 0.3])
    hairline = forehead - rng.uniform(18, 62)
    fringe_side = rng.uniform(-1, 1) * rng.uniform(0, 25)
    opening = np.radians(rng.uniform(48, 88))
    azimuth = np.linspace(-np.pi, np.pi, COLUMNS)
    crown, rim = scalp[:, 1].min(), scalp[:, 1].max() - rng.uniform(0, 30)
    # How far down each direction's hair reaches: to the hairline before the face, to its full length behind.
    behind = np.clip((np.abs(azimuth) - opening) / np.radians(14), 0, 1)
    behind = behind * behind * (3 - 2 * behind)
    ragged = (
        rng.normal(0, 1, (3,))
        @ np.stack([np.sin(azimuth * k + rng.uniform(0, 6)) for k in (3, 7, 13)])
        * rng.uniform(0, 5)
    )
    lowest = (hairline + fringe_side * np.sin(azimuth)) * (1 - behind) + (rim + length) * behind + ragged
    share = np.linspace(0, 1, ROWS)[:, None] ** 1.2
    height = crown - thickness - bulge + share * (lowest - (crown - thickness - bulge))
    # Radius of the skull's ellipsoid at a height; below its middle it stays as wide as it is there.
    across = np.clip((middle[1] - height) / (half[1] + thickness + bulge), 0, 1)
    round_ = np.sqrt(np.clip(1 - across**2, 0, 1))
    wave = _bumps(rng, ROWS, COLUMNS) * rng.uniform(0.5, 5)
    below = np.clip((height - rim) / 60, 0, 1)
    radius_x = round_ * (half[0] + 2 + thickness + wave) * (1 - 0.12 * below)
    radius_z = round_ * (half[2] + 2 + thickness + wave)
    x = middle[0] + radius_x * np.sin(azimuth)
    z = middle[2] - radius_z * np.cos(azimuth)
    strands = 1 + rng.uniform(0.03, 0.22) * _streaks(rng, ROWS, COLUMNS) + 0.1 * _bumps(rng, ROWS, COLUMNS)
    if rng.random() < 0.15:  # a hat or a hood: cloth of any colour
        color, strands = rng.uniform(0.03, 0.9, 3), 1 + 0.05 * _bumps(rng, ROWS, COLUMNS)
    colors = np.clip(color * strands[..., None] * 255, 0, 255).astype(np.uint8)
    points = np.stack([x, np.broadcast_to(height, x.shape), z], axis=-1)
    return ColoredMesh(points.reshape(-1, 3), _grid(ROWS, COLUMNS), colors.reshape(-1, 3))


def glasses(
    landmarks_head: Float[np.ndarray, "68 3"], rng: np.random.Generator
) -> tuple[ColoredMesh, list[Float[np.ndarray, "n 3"]]]:
    """A random pair of glasses before these head-frame landmarks, and the outlines of its two lenses (for tints)."""
    left, right = landmarks_head[36:42].mean(0), landmarks_head[42:48].mean(0)
    apart = right[0] - left[0]
    nose = landmarks_head[27]
    width, height = rng.uniform(0.36, 0.46) * apart, rng.uniform(0.2, 0.36) * apart
    squareness, wire = rng.uniform(2.0, 5.0), rng.uniform(0.6, 3.2)
    ahead = rng.uniform(8, 16)
    drop = rng.uniform(-2, 7)
    angle = np.linspace(0, 2 * np.pi, 41)
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    outline = np.sign(circle) * np.abs(circle) ** (2 / squareness)
    color = rng.uniform(0.02, 0.25, 3) if rng.random() < 0.7 else rng.uniform(0.1, 0.8, 3)
    pieces, lenses = [], []
    depth = min(left[2], right[2], nose[2]) - ahead
    for centre in (left, right):
        path = np.column_stack([
            centre[0] + 1.02 * width * outline[:, 0],
            centre[1] + drop + height * outline[:, 1],
            np.full(len(outline), depth) + 0.12 * np.abs(centre[0] + width * outline[:, 0]),
        ])  # fmt: skip
        lenses.append(path)
        pieces.append(_tube(path, wire))
    bridge_y = (left[1] + right[1]) / 2 + drop - 0.4 * height
    pieces.append(_tube(np.array([[left[0] + width, bridge_y, depth + 2], [nose[0], bridge_y - 2, depth - 1],
                                  [right[0] - width, bridge_y, depth + 2]]), wire))  # fmt: skip
    for centre, side in ((left, -1), (right, 1)):
        hinge = np.array([centre[0] + side * width, bridge_y, depth + 0.12 * (abs(centre[0]) + width)])
        ear = np.array([landmarks_head[0 if side < 0 else 16, 0] * 1.04, bridge_y - 4, nose[2] + 105])
        pieces.append(_tube(np.stack([hinge, ear]), wire * rng.uniform(0.8, 1.8)))
    starts = np.cumsum([0] + [len(v) for v, _ in pieces[:-1]])
    vertices = np.concatenate([v for v, _ in pieces])
    triangles = np.concatenate([t + start for (_, t), start in zip(pieces, starts, strict=True)])
    colors = np.tile((255 * color).astype(np.uint8), (len(vertices), 1))
    return ColoredMesh(vertices, triangles, colors), lenses


def _grid(rows: int, columns: int) -> Int[np.ndarray, "t 3"]:
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    return np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])


def _tube(path: Float[np.ndarray, "n 3"], radius: float, sides: int = 6) -> tuple[np.ndarray, np.ndarray]:
    along = np.gradient(path, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    across = np.cross(along, np.where(np.abs(along[:, 2:]) < 0.7, [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]))
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    third = np.cross(along, across)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * third[:, None]
    return (path[:, None] + radius * ring).reshape(-1, 3), _grid(len(path), sides + 1)


def _bumps(rng, rows: int, columns: int) -> np.ndarray:
    """Smooth noise that closes around the head."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, columns), np.linspace(0, np.pi, rows))
    waves = [
        rng.normal() * np.sin(k * u + rng.uniform(0, 7)) * np.cos(m * v + rng.uniform(0, 7))
        for k, m in ((1, 1), (2, 2), (3, 1), (5, 3), (7, 5), (11, 7))
    ]
    return np.sum(waves, axis=0) / 1.5


def _streaks(rng, rows: int, columns: int) -> np.ndarray:
    """Strands: noise that changes quickly around the head and slowly along the hair."""
    coarse = rng.standard_normal((5, columns))
    coarse[:, -1] = coarse[:, 0]
    at = np.linspace(0, 4, rows)
    lower = np.minimum(at.astype(int), 3)
    return coarse[lower] * (1 - (at - lower))[:, None] + coarse[lower + 1] * (at - lower)[:, None]
