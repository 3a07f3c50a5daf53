"""Read MakeHuman's clothes: a mesh (`.obj`) and how it sits on the base mesh (`.mhclo`).

"Clothes" is MakeHuman's word for whatever is worn by the base mesh: eyes, teeth, tongue, brows, lashes and hair too.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

UNMOVED = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Clothes:
    """Vertex = Σ_j weight_j · base[anchor_j] + offset · scale, decimetres (+y up, +z out of the face)."""

    anchors: Int[np.ndarray, "n 3"]
    """Vertices of the base mesh."""
    weights: Float[np.ndarray, "n 3"]
    offsets: Float[np.ndarray, "n 3"]
    scale: dict[int, tuple[int, int, float]]
    """Per axis two vertices of the base mesh, and how far apart they were along it when the clothes were made."""
    triangles: Int[np.ndarray, "t 3"]
    uvs: Float[np.ndarray, "u 2"]
    triangles_uv: Int[np.ndarray, "t 3"]

    def worn(self, base: Float[np.ndarray, "b 3"]) -> Float[np.ndarray, "n 3"]:
        """The vertices on a base mesh, in its unit and axes."""
        signs = np.array([1.0, -1.0, -1.0])
        ratio = np.ones(3)
        for axis, (first, second, length) in self.scale.items():
            ratio[axis] = abs(base[first, axis] - base[second, axis]) / length
        return np.einsum("nj,njd->nd", self.weights, base[self.anchors]) + self.offsets * ratio * signs

    def of_triangles(self, chosen: Bool[np.ndarray, "t"]) -> "Clothes":
        """Some of its triangles, with the vertices and UV points that they use."""
        vertices, triangles = np.unique(self.triangles[chosen], return_inverse=True)
        points, triangles_uv = np.unique(self.triangles_uv[chosen], return_inverse=True)
        return Clothes(
            anchors=self.anchors[vertices],
            weights=self.weights[vertices],
            offsets=self.offsets[vertices],
            scale=self.scale,
            triangles=triangles.reshape(-1, 3),
            uvs=self.uvs[points],
            triangles_uv=triangles_uv.reshape(-1, 3),
        )

    def seen(self, alpha: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "t"]:
        """Triangles that a texture's alpha (0 to 1) does not leave fully transparent at their middle."""
        height, width = alpha.shape
        middle = self.uvs[self.triangles_uv].mean(axis=1)
        column = np.clip((middle[:, 0] * width).astype(int), 0, width - 1)
        row = np.clip(((1 - middle[:, 1]) * height).astype(int), 0, height - 1)
        return alpha[row, column] > 0


def read_clothes(fit: Path, mesh: Path) -> Clothes:
    """One piece from its two files. Raises ValueError where they do not belong together."""
    rows, scale = _read_fit(fit)
    count, uvs, triangles, triangles_uv = _read_mesh(mesh)
    if count != len(rows):
        raise ValueError(f"{mesh} has {count} vertices, {fit} fits {len(rows)}; take both from one release.")
    table = np.array(rows)
    return Clothes(table[:, :3].astype(int), table[:, 3:6], table[:, 6:], scale, triangles, uvs, triangles_uv)


def _read_fit(path: Path) -> tuple[list[list[float]], dict[int, tuple[int, int, float]]]:
    rows, scale, listing = [], {}, False
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        fields = line.split()
        if not fields or fields[0] == "#":
            continue
        if fields[0] in ("x_scale", "y_scale", "z_scale"):
            scale["xyz".index(fields[0][0])] = (int(fields[1]), int(fields[2]), float(fields[3]))
        elif fields[0] == "verts":
            listing = True
        elif fields[0] in ("weights", "delete_verts"):
            listing = False
        elif listing and fields[0].isdigit():
            numbers = [float(field) for field in fields]
            rows.append(numbers if len(numbers) > 1 else [*numbers * 3, 1.0, 0.0, 0.0, *UNMOVED])
    return rows, scale


def _read_mesh(path: Path) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Vertex count, UV points, and triangles by vertex and by UV point; faces are cut into fans."""
    count, uvs, triangles, triangles_uv = 0, [], [], []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        kind, *fields = line.split() or [""]
        if kind == "v":
            count += 1
        elif kind == "vt":
            uvs.append([float(x) for x in fields[:2]])
        elif kind == "f":
            corners = np.array([[int(x) - 1 for x in corner.split("/")[:2]] for corner in fields])
            for last in range(2, len(corners)):
                fan = corners[[0, last - 1, last]]
                triangles.append(fan[:, 0])
                triangles_uv.append(fan[:, 1])
    return count, np.array(uvs), np.array(triangles), np.array(triangles_uv)
