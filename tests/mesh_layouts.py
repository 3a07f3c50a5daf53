"""A mesh in the files that 3DDFA, PRNet and VRN write, as their programs' sources have it.

`vertices` are in the picture: column, row, and towards the camera, in pixels.
"""

from pathlib import Path

import numpy as np
from scipy.io import savemat

from workbench.reproduction.mesh_placing import CROP_SIDE, CROPPED_FACE


def write_obj(path: Path, vertices: np.ndarray, triangles: np.ndarray, decimals: int = 4) -> None:
    """Vertices with colours, and faces counted from 1."""
    lines = [f"v {x:.{decimals}f} {y:.{decimals}f} {z:.{decimals}f} 0.8 0.6 0.5" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in triangles + 1]
    path.write_text("\n".join(lines) + "\n")


def write_3ddfa_mat(path: Path, vertices, triangles, height: int) -> None:
    """`dump_vertex`: a vertex a column, rows from 1."""
    savemat(path, {"vertex": np.add(vertices, [0.0, 1.0, 0.0]).T.astype(np.float32)})


def write_3ddfa_obj(path: Path, vertices, triangles, height: int) -> None:
    """`write_obj_with_colors`: the row before the column (issue 138 of cleardusk/3DDFA)."""
    write_obj(path, vertices[:, [1, 0, 2]], triangles)


def write_3ddfa_v2_obj(path: Path, vertices, triangles, height: int) -> None:
    """`ser_to_obj_single`: rows from below, height − y, two decimals."""
    write_obj(path, vertices * [1.0, -1.0, 1.0] + [0.0, height, 0.0], triangles, 2)


def write_prnet_obj(path: Path, vertices, triangles, height: int) -> None:
    """demo.py with `is3d`: rows from below, h − 1 − y, and triangles the other way round."""
    write_obj(path, vertices * [1.0, -1.0, 1.0] + [0.0, height - 1.0, 0.0], triangles[:, ::-1])


def write_prnet_mat(path: Path, vertices, triangles, height: int) -> None:
    """demo.py with `isMat`: a vertex a row, triangles from 0, colours."""
    colors = np.full((len(vertices), 3), 0.5)
    given = {"vertices": vertices.astype(np.float32), "colors": colors, "triangles": triangles.astype(np.int32)}
    savemat(path, given)


def write_vertices_npy(path: Path, vertices, triangles, height: int) -> None:
    """What `get_vertices` returns, saved."""
    np.save(path, vertices.astype(np.float32))


def write_vrn_obj(path: Path, vertices, triangles, landmarks: np.ndarray) -> np.ndarray:
    """raw2obj.py on run.sh's crop of 192 × 192 pixels, two decimals. Returns which vertices lie inside of it."""
    low, size = landmarks.min(axis=0), landmarks.max(axis=0) - landmarks.min(axis=0)
    scale = CROPPED_FACE / np.sqrt(size[0] * size[1])
    corner = (low - size / 2.0) * scale
    cropped = np.column_stack([(vertices[:, :2] + 0.5) * scale - 0.5 - corner, 100.0 - vertices[:, 2] * scale])
    inside = ((cropped[:, :2] > 0.0) & (cropped[:, :2] < CROP_SIDE - 1)).all(axis=1)
    numbers = np.cumsum(inside) - 1
    kept = triangles[inside[triangles].all(axis=1)]
    write_obj(path, cropped[inside], numbers[kept], 2)
    return inside


WHOLE_PICTURE = {
    "3DDFA mat": ("frame_200_0.mat", write_3ddfa_mat, "as it is"),
    "3DDFA obj": ("frame_200_0.obj", write_3ddfa_obj, "x and y swapped"),
    "3DDFA_V2 obj": ("frame_200_1.obj", write_3ddfa_v2_obj, "y up"),
    "PRNet obj": ("frame_200.obj", write_prnet_obj, "y up"),
    "PRNet mat": ("frame_200_mesh.mat", write_prnet_mat, "as it is"),
    "vertices npy": ("frame_200.npy", write_vertices_npy, "as it is"),
}
"""Files in the pixels of the whole picture: name, what writes it, and how its axes are named."""
