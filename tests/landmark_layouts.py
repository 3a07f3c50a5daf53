"""Landmarks as other programs write them, layout by layout."""

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from workbench.landmarks.formats.mediapipe import VERTICES

REAL_MESH = Path(__file__).parent / "data" / "astronaut_mediapipe.json"
"""What MediaPipe 0.10.21's face mesh with irises found in the bundled portrait (512 × 512), in its web layout."""

Face = np.ndarray
"""(68, 2), pixels counted from 0."""


def openface_csv(rows: Sequence[tuple[str, Face]]) -> str:
    """FeatureExtraction's table; each row begins with the cells `frame, face_id, timestamp, confidence, success`."""
    named = [f"{axis}_{i}" for axis in "xy" for i in range(68)]
    header = [
        "frame",
        "face_id",
        "timestamp",
        "confidence",
        "success",
        "gaze_0_x",
        "eye_lmk_x_0",
        *named,
        "X_0",
        "AU01_r",
    ]
    lines = [", ".join(header)]
    for beginning, face in rows:
        lines.append(f"{beginning}, 0.01, 7.5, {', '.join(f'{value:.4f}' for value in face.T.ravel())}, 12.1, 0.40")
    return "\n".join(lines) + "\n"


def openface_picture_csv(rows: Sequence[tuple[float, Face]]) -> str:
    """FaceLandmarkImg's table: faces of one picture with their confidence."""
    lines = [", ".join(["face", "confidence", *(f"{axis}_{i}" for axis in "xy" for i in range(68))])]
    for number, (confidence, face) in enumerate(rows):
        lines.append(f"{number}, {confidence:.3f}, {', '.join(f'{value:.4f}' for value in face.T.ravel())}")
    return "\n".join(lines) + "\n"


def ibug_pts(face: Face) -> str:
    """300-W's annotation, which has two spaces before 68, counts pixels from 1, and ends its lines as Windows does."""
    return "\r\n".join(["version: 1", "n_points:  68", "{", *(f"{x + 1:.6f} {y + 1:.6f}" for x, y in face), "}", ""])


def dlib_xml(pictures: Sequence[tuple[str, Sequence[str]]]) -> str:
    """imglab's file: the attributes of each picture, and its boxes."""
    images = [f"  <image {attributes}>\n{''.join(boxes)}  </image>\n" for attributes, boxes in pictures]
    return (
        "<?xml version='1.0' encoding='ISO-8859-1'?>\n"
        "<?xml-stylesheet type='text/xsl' href='image_metadata_stylesheet.xsl'?>\n"
        f"<dataset>\n<name>imglab dataset</name>\n<comment>Faces</comment>\n<images>\n{''.join(images)}</images>\n"
        "</dataset>\n"
    )


def dlib_box(face: Face, more: str = "") -> str:
    """A box with its 68 parts; `more` are further attributes of it."""
    parts = "".join(
        f"      <part name={quoteattr(f'{i:02d}')} x='{x:.6f}' y='{y:.6f}'/>\n" for i, (x, y) in enumerate(face)
    )
    return f"    <box top='10' left='20' width='300' height='310'{more}>\n{parts}    </box>\n"


def mesh_of(face: Face, size: tuple[int, int], count: int = 478) -> np.ndarray:
    """A mesh (count, 3), fractions of the picture, whose 68 points are those of `face`."""
    means = np.zeros((68, count))
    for point, vertices in enumerate(VERTICES):
        means[point, list(vertices)] = 1.0 / len(vertices)
    fractions = (face + 0.5) / size
    middle = fractions.mean(axis=0)
    xy = middle + np.linalg.pinv(means) @ (fractions - middle)
    return np.column_stack([xy, np.full(count, -0.02)])


def mediapipe_csv(meshes: Sequence[np.ndarray | None]) -> str:
    """A table of meshes with a row for each frame, empty where there is no face."""
    count = next(len(mesh) for mesh in meshes if mesh is not None)
    lines = [",".join(["frame", *(f"{axis}{i}" for i in range(count) for axis in "xyz")])]
    for frame, mesh in enumerate(meshes):
        cells = [""] * 3 * count if mesh is None else [f"{value:.9f}" for value in mesh.ravel()]
        lines.append(",".join([str(frame), *cells]))
    return "\n".join(lines) + "\n"


def named_points(mesh: np.ndarray) -> list[dict[str, float]]:
    """A mesh as MediaPipe's JSON names coordinates."""
    return [dict(zip("xyz", map(float, point), strict=True)) for point in mesh]
