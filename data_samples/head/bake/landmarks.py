"""Read and write `landmarks.toml`, the 68-point embedding as a commented data file.

Every point is a triangle of base.obj vertex ids with barycentric weights, so the file survives a new crop,
triangulation or neutral.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

HEADER = """\
# The iBUG 300-W 68 points on the default head.
#
# Numbering is 0-based. Left and right are the SUBJECT's: point 36 is the outer corner of the right eye (image left).
# `vertices` are 0-based vertex ids of MakeHuman's base.obj (hm08), `weights` their barycentric coordinates.
# `[[point]]` is fixed to the skin. The jaw line of detectors slides over the skin with the head pose: for points 0-16,
# `[[contour]]` gives one row of 17 points per yaw bin; yaw > 0 turns the nose to image left (the subject's own right).
# Fitted by bake/calibrate_landmarks.py to the detections of dlib's 68-point predictor on renders of this head.
"""

NAMES = (
    *(f"jaw line, right, {8 - i} from the chin" for i in range(8)),
    "chin",
    *(f"jaw line, left, {i + 1} from the chin" for i in range(8)),
    *(f"right brow, {place}" for place in ("outer end", "outer", "middle", "inner", "inner end")),
    *(f"left brow, {place}" for place in ("inner end", "inner", "middle", "outer", "outer end")),
    *(f"nose bridge, {place}" for place in ("root", "upper", "lower", "tip")),
    *(f"nostril line, {place}" for place in ("right wing", "right", "centre", "left", "left wing")),
    "right eye, outer corner",
    "right upper lid, outer",
    "right upper lid, inner",
    "right eye, inner corner",
    "right lower lid, inner",
    "right lower lid, outer",
    "left eye, inner corner",
    "left upper lid, inner",
    "left upper lid, outer",
    "left eye, outer corner",
    "left lower lid, outer",
    "left lower lid, inner",
    "right mouth corner",
    *(f"upper lip edge, {place}" for place in ("right", "right peak", "centre", "left peak", "left")),
    "left mouth corner",
    *(f"lower lip edge, {place}" for place in ("left", "left middle", "centre", "right middle", "right")),
    "right inner mouth corner",
    *(f"upper lip inside, {place}" for place in ("right", "centre", "left")),
    "left inner mouth corner",
    *(f"lower lip inside, {place}" for place in ("left", "centre", "right")),
)
# The point on the other side of the face.
MIRROR = np.array(
    [
        *(*range(16, -1, -1), *range(26, 16, -1)),  # jaw line, brows
        *(27, 28, 29, 30, *range(35, 30, -1)),  # nose
        *(45, 44, 43, 42, 47, 46, 39, 38, 37, 36, 41, 40),  # eyes
        *(*range(54, 47, -1), *range(59, 54, -1)),  # outer lips
        *(*range(64, 59, -1), 67, 66, 65),  # inner lips
    ]
)
GROUPS = {
    "jaw": slice(0, 17),
    "brows": slice(17, 27),
    "nose": slice(27, 36),
    "eyes": slice(36, 48),
    "outer lips": slice(48, 60),
    "inner lips": slice(60, 68),
}


@dataclass(frozen=True)
class Embedding:
    """Points on the surface as vertex triples and barycentric weights; ids are whatever the holder says."""

    vertices: Int[np.ndarray, "68 3"]
    weights: Float[np.ndarray, "68 3"]
    contour_yaw: Float[np.ndarray, "b"]
    """Ascending degrees, nose to image left positive."""
    contour_vertices: Int[np.ndarray, "b 17 3"]
    contour_weights: Float[np.ndarray, "b 17 3"]

    def renumbered(self, table: Int[np.ndarray, "k"]) -> "Embedding":
        """The same points with vertex id `i` replaced by `table[i]`."""
        return Embedding(
            table[self.vertices], self.weights, self.contour_yaw, table[self.contour_vertices], self.contour_weights
        )

    def symmetrised(self, mirror: Int[np.ndarray, "v"]) -> "Embedding":
        """Points on the subject's right and negative yaw bins copied, mirrored, onto the others.

        Midline points are left alone, so they must already lie on midline vertices or carry mirrored weights.
        """
        vertices, weights = self.vertices.copy(), self.weights.copy()
        copied = np.flatnonzero(np.arange(68) > MIRROR)
        vertices[copied], weights[copied] = mirror[vertices[MIRROR[copied]]], weights[MIRROR[copied]]
        contour, contour_weights = self.contour_vertices.copy(), self.contour_weights.copy()
        for row, yaw in enumerate(self.contour_yaw):
            if yaw > 0:
                other = int(np.flatnonzero(self.contour_yaw == -yaw)[0])
                contour[row], contour_weights[row] = mirror[contour[other]][::-1], contour_weights[other][::-1]
            elif yaw == 0:
                contour[row, 9:] = mirror[contour[row, :8]][::-1]
                contour_weights[row, 9:] = contour_weights[row, :8][::-1]
        return Embedding(vertices, weights, self.contour_yaw, contour, contour_weights)


def read_landmarks(path: Path) -> Embedding:
    """Load the file; vertex ids are base.obj ids and weights are normalised to sum exactly to one."""
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    points = sorted(data["point"], key=lambda point: point["id"])
    contour = sorted(data["contour"], key=lambda row: row["yaw"])

    def normalised(weights: list) -> np.ndarray:
        array = np.array(weights, float)
        return array / array.sum(axis=-1, keepdims=True)

    return Embedding(
        vertices=np.array([point["vertices"] for point in points]),
        weights=normalised([point["weights"] for point in points]),
        contour_yaw=np.array([row["yaw"] for row in contour], float),
        contour_vertices=np.array([row["vertices"] for row in contour]),
        contour_weights=normalised([row["weights"] for row in contour]),
    )


def format_landmarks(embedding: Embedding) -> str:
    """The text of `landmarks.toml` for an embedding in base.obj ids."""
    lines = [HEADER]
    for index, name in enumerate(NAMES):
        vertices, weights = embedding.vertices[index].tolist(), _rounded(embedding.weights[index])
        lines += [
            "[[point]]",
            f"id = {index}",
            f'name = "{name}"',
            f"vertices = {vertices}",
            f"weights = {weights}",
            "",
        ]
    for yaw, vertices, weights in zip(
        embedding.contour_yaw, embedding.contour_vertices, embedding.contour_weights, strict=True
    ):
        lines += ["[[contour]]", f"yaw = {yaw:g}", "vertices = ["]
        lines += [f"    {row.tolist()}," for row in vertices] + ["]", "weights = ["]
        lines += [f"    {_rounded(row)}," for row in weights] + ["]", ""]
    return "\n".join(lines).rstrip() + "\n"


def _rounded(weights: np.ndarray) -> list[float]:
    return [round(float(weight), 4) for weight in weights]
