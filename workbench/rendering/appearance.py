"""Albedo and light of one person from one picture (Deep Energies, Sec. 3): linear least squares, alternated.

With the albedo known the nine coefficients per channel are a linear least-squares problem, and with the light known so
is the albedo. Albedo and light share one factor per channel that no picture tells: here the mean albedo of the skin
that is seen is held at that of the model's own colours, so a darker skin shows as a dimmer light.

Skin is measured vertex by vertex where landmarks hold the model to the picture: in front of the ends of the jaw's
contour, above the chin, away from the outline. Ears, neck and all that is hidden continue what is measured beside them
and on the other side of the face. Eyes, teeth, the mouth's inside and the hair are the model's, tinted as a whole: gaze
and hair are not fitted, so that single vertices would take on the colours of something else.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import binary_erosion, distance_transform_edt
from scipy.sparse import coo_matrix, csr_matrix, diags_array
from scipy.sparse.linalg import spsolve

from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.files import atomic_path
from workbench.reading import checked_arrays, checked_file, reading
from workbench.rendering.camera import AnyCamera
from workbench.rendering.lighting import LAMBERT, spherical_harmonics
from workbench.rendering.renderer import render
from workbench.rendering.topology import mesh_topology

FACE_REGIONS = ("skin", "lips", "brow")
"""What is estimated vertex by vertex."""
TINTED_REGIONS = (("eyeL", "eyeR"), ("teethU", "teethL"), ("tongue",), ("mouth_cavity",), ("scalp",))
"""What gets one factor per channel for all of its vertices."""
LEAST_PIXELS = 1000
STEPS = 4
"""Alternations of light and albedo."""
ROBUST_STEPS = 6
"""Reweighted solves within each light step."""
LEAST_FACING = 0.25
"""Cosine to the camera below which a surface is too foreshortened to be measured."""
OUTLINE_SHARE = 0.03
"""Distance from the outline, in sides of a square as large as the face, within which background may show through."""
LARGEST_RATIO = 1.0
"""Logarithm of the ratio to the expected colour from which a pixel counts as something else: hair, a microphone."""
SMOOTH, MIRROR, PRIOR = 1.0, 0.5, 0.002
"""Weights of neighbours, mirror image and the model's colours against one pixel."""
TINT_PRIOR, TINT_RANGE = 20.0, (0.1, 1.5)
"""Pixels of the model's own colours that count in a tint, and its bounds."""
LARGEST = 1e9
"""Of a stored appearance's numbers: colours and light are near one, pixels are counted."""
RIDGE = 1e-3
"""Weight of small light coefficients, as a share of the pixels."""


@dataclass(frozen=True)
class Appearance:
    """What a renderer needs besides geometry: colours per vertex and light, in the picture's own encoding, 0 to 1."""

    albedo: Float[np.ndarray, "v 3"]
    light: Float[np.ndarray, "9 3"]
    """Spherical-harmonic coefficients in the camera frame; see `lighting`."""
    seen: Float[np.ndarray, "v"]
    """Pixels that measured each vertex; 0 where the albedo was filled in."""
    residual: float
    """Root mean square difference to the picture over the pixels that were used."""

    def save(self, path: str | Path) -> None:
        """Write an .npz file, completely or not at all. Raises `InputError` for another suffix."""
        if Path(path).suffix != ".npz":
            raise InputError(f"An appearance is stored as .npz, got {Path(path).name}; change the name.")
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(
                stream, albedo=self.albedo, light=self.light, seen=self.seen, residual=np.float64(self.residual)
            )


def known_appearance(
    picture: UInt8[np.ndarray, "..."] | Float[np.ndarray, "..."],
    model: FaceModel,
    vertices_camera: Float[np.ndarray, "v 3"],
    camera: AnyCamera,
    albedo: Float[np.ndarray, "v 3"],
    hidden: Bool[np.ndarray, "h w"] | None = None,
) -> Appearance:
    """The light of the face in a picture, its albedo known; the rest as in `estimate_appearance`.

    Pixels that something else hides, as hair, do not count.
    """
    view = _view(_unit_picture(picture), model, np.asarray(vertices_camera), camera)
    pixels = _face_pixels(view, model, hidden)
    light, shade = _solve_light(pixels, albedo)
    difference = (pixels.corners @ albedo) * shade - pixels.colors
    residual = float(np.sqrt((difference**2).mean()))
    seen = pixels.corners.T @ np.ones(len(pixels.colors))
    return Appearance(albedo.astype(np.float32), light.astype(np.float32), seen.astype(np.float32), residual)


def load_appearance(path: str | Path, model: FaceModel) -> Appearance:
    """An appearance that `Appearance.save` wrote.

    Raises `InputError` for a missing or damaged file and for another model's.
    """
    absent = f"There is no appearance {path}; estimate one with estimate_appearance and save it."
    path = checked_file(path, "an appearance", absent=absent)
    kind = "an appearance, it is damaged or of another kind"
    with reading(path, kind, "estimate it again"), path.open("rb") as stream, checked_arrays(stream) as stored:
        albedo, light, seen = (_numbers(stored, name) for name in ("albedo", "light", "seen"))
        residual = float(_numbers(stored, "residual"))
        if albedo.shape != (*seen.shape, 3) or light.shape != (9, 3):
            raise ValueError(f"albedo, light and seen have the shapes {albedo.shape}, {light.shape} and {seen.shape}")
    if len(albedo) != len(model.neutral):
        raise InputError(
            f"{path} holds the colours of {len(albedo)} vertices, the model has {len(model.neutral)}; "
            "estimate the appearance with this model."
        )
    return Appearance(albedo, light, seen, residual)


def _numbers(stored: Mapping[str, np.ndarray], name: str) -> Float[np.ndarray, "..."]:
    """An array as 32-bit numbers. Raises ValueError unless it holds numbers of colours, light or pixels."""
    array = stored[name]
    if array.dtype not in (np.float32, np.float64) or not (np.abs(array) < LARGEST).all():
        raise ValueError(f"{name} holds something other than finite numbers")
    return array if name == "residual" else array.astype(np.float32)


def estimate_appearance(
    picture: UInt8[np.ndarray, "..."] | Float[np.ndarray, "..."],
    model: FaceModel,
    vertices_camera: Float[np.ndarray, "v 3"],
    camera: AnyCamera,
) -> Appearance:
    """Albedo per vertex and light of the face in a picture, given its camera-frame vertices.

    The picture is h × w × RGB, 8 bits or 0 to 1. Best on a frame near neutral, fitted well. Raises `InputError` for a
    picture of another shape, for vertices that are not the model's, and when fewer than 1000 pixels show the face.
    """
    view = _view(_unit_picture(picture), model, np.asarray(vertices_camera), camera)
    pixels = _face_pixels(view, model)
    own = model.colors / 255.0
    smoothing = _smoothing(model)
    face = _face(model)
    albedo = own.copy()
    for _ in range(STEPS):
        light, shade = _solve_light(pixels, albedo)
        weights = _inliers(pixels, own, shade)
        albedo = _solve_albedo(pixels, weights, shade, own, smoothing)
        seen = pixels.corners.T @ weights
        measured = face & (seen > 0.5)
        # The one factor per channel that no picture tells.
        albedo *= own[measured].mean(axis=0) / np.maximum(albedo[measured].mean(axis=0), 1e-6)
        albedo[~face] = own[~face]
        albedo = np.clip(albedo, 0.01, 1.0)
    light, shade = _solve_light(pixels, albedo)
    difference = (pixels.corners @ albedo) * shade - pixels.colors
    residual = float(np.sqrt(np.average((difference**2).mean(axis=1), weights=np.maximum(weights, 1e-9))))
    for names in TINTED_REGIONS:
        part = model.in_regions(names)
        albedo[part] = np.clip(own[part] * _tint(_part_pixels(view, model, part), own, light), 0.01, 1.0)
    return Appearance(albedo.astype(np.float32), light.astype(np.float32), seen.astype(np.float32), residual)


@dataclass(frozen=True)
class _Pixels:
    """Pixels that show the face."""

    colors: Float[np.ndarray, "p 3"]
    functions: Float[np.ndarray, "p 9"]
    """(A_l/π) Y_lm of each normal."""
    corners: csr_matrix
    """Barycentric coordinates: pixels × vertices."""


def _unit_picture(picture: np.ndarray) -> Float[np.ndarray, "h w 3"]:
    if picture.ndim != 3 or picture.shape[2] != 3:
        raise InputError(f"Appearance is estimated from an RGB picture, got an array of shape {picture.shape}.")
    return picture / 255.0 if picture.dtype == np.uint8 else np.asarray(picture, float)


@dataclass(frozen=True)
class _View:
    """The picture, and what the model shows at its pixels."""

    colors: Float[np.ndarray, "h w 3"]
    triangle: Int[np.ndarray, "h w"]
    normals: Float[np.ndarray, "h w 3"]
    barycentric: Float[np.ndarray, "h w 3"]
    facing: Float[np.ndarray, "h w"]


def _view(colors: np.ndarray, model: FaceModel, vertices: np.ndarray, camera: AnyCamera) -> _View:
    height, width = colors.shape[:2]
    count = len(model.neutral)
    if vertices.shape != (count, 3) or not np.isfinite(vertices).all():
        raise InputError(f"The pose needs {count} finite camera-frame vertices, got shape {vertices.shape}; fit first.")
    topology = mesh_topology(model.triangles, count)
    rendering = render(
        vertices, topology, camera, model.colors / 255.0, np.zeros((9, 3)), np.zeros(3),
        size=(width, height), antialias=False,
    )  # fmt: skip
    normals = np.asarray(rendering.normals, float)
    places = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)
    facing = _facing(normals, np.asarray(rendering.depth), places, camera)
    return _View(colors, np.asarray(rendering.triangle), normals, np.asarray(rendering.barycentric, float), facing)


def _face_pixels(view: _View, model: FaceModel, hidden: Bool[np.ndarray, "h w"] | None = None) -> _Pixels:
    """Pixels that landmarks hold to the face, away from its outline, not too foreshortened and not hidden."""
    ends, chin = model.landmarks.of(model.neutral)[[0, 16], 2].mean(), model.landmarks.of(model.neutral)[8, 1]
    held = (model.neutral[:, 2] < ends) & (model.neutral[:, 1] < chin)
    # Hair may hang over the scalp's border as the background does over the outline.
    inner = (view.triangle >= 0) & ~_shows(view, model, model.in_regions(("scalp",)))
    if hidden is not None:
        inner &= ~hidden
    mask = _shows(view, model, _face(model) & held)
    mask &= distance_transform_edt(np.pad(inner, 1))[1:-1, 1:-1] > OUTLINE_SHARE * np.sqrt(mask.sum())
    mask = binary_erosion(mask) & (view.facing > LEAST_FACING)
    if mask.sum() < LEAST_PIXELS:
        raise InputError(
            f"The face covers {int(mask.sum())} usable pixels, {LEAST_PIXELS} are needed; "
            "choose a frame with a larger face that looks at the camera."
        )
    return _pixels(view, model, mask)


def _part_pixels(view: _View, model: FaceModel, part: Bool[np.ndarray, "v"]) -> _Pixels:
    """Pixels that show these vertices, without the outermost where enough are left, as in the eyes of a large face."""
    whole = _shows(view, model, part) & (view.facing > LEAST_FACING)
    inner = binary_erosion(whole)
    return _pixels(view, model, inner if inner.sum() > TINT_PRIOR else whole)


def _shows(view: _View, model: FaceModel, part: Bool[np.ndarray, "v"]) -> Bool[np.ndarray, "h w"]:
    return np.append(part[model.triangles].all(axis=1), False)[view.triangle]


def _pixels(view: _View, model: FaceModel, mask: Bool[np.ndarray, "h w"]) -> _Pixels:
    rows = np.repeat(np.arange(mask.sum()), 3)
    triangles = model.triangles[view.triangle[mask]].astype(np.int64)
    corners = csr_matrix(
        (view.barycentric[mask].ravel(), (rows, triangles.ravel())), shape=(mask.sum(), len(model.neutral))
    )
    functions = np.stack(spherical_harmonics(*view.normals[mask].T), axis=1) * LAMBERT
    return _Pixels(view.colors[mask], functions, corners)


def _facing(normals, depth, pixels, camera) -> Float[np.ndarray, "h w"]:
    """Cosine between normal and the direction to the camera."""
    if not hasattr(camera, "focal_px"):
        return -normals[..., 2]
    rays = (pixels - np.asarray(camera.principal_point_px)) / np.asarray(camera.focal_px)
    rays = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1)
    return -(normals * rays).sum(axis=-1) / np.linalg.norm(rays, axis=-1)


def _face(model: FaceModel) -> Bool[np.ndarray, "v"]:
    """Vertices that are estimated one by one; all of them for a model that names none."""
    face = model.in_regions(FACE_REGIONS)
    return face if face.any() else ~face


def _solve_light(pixels: _Pixels, albedo: np.ndarray) -> tuple[Float[np.ndarray, "9 3"], Float[np.ndarray, "p 3"]]:
    """The light under which this albedo looks most like the picture, and what it shows on white; robust (Tukey)."""
    base = pixels.corners @ albedo
    weights = np.ones(len(base))
    for _ in range(ROBUST_STEPS):
        light = np.empty((9, 3))
        for channel in range(3):
            system = pixels.functions * base[:, channel : channel + 1]
            normal = system.T @ (weights[:, None] * system)
            damping = RIDGE * np.trace(normal) / 9.0 * np.diag([0.0] + [1.0] * 8)
            light[:, channel] = np.linalg.solve(normal + damping, system.T @ (weights * pixels.colors[:, channel]))
        residual = np.linalg.norm(base * (pixels.functions @ light) - pixels.colors, axis=1)
        width = 4.685 * max(1.4826 * float(np.median(residual)), 1e-3)
        weights = np.clip(1.0 - (residual / width) ** 2, 0.0, None) ** 2
    return light, pixels.functions @ light


def _inliers(pixels: _Pixels, own: np.ndarray, shade: np.ndarray) -> Float[np.ndarray, "p"]:
    """Weights 0 to 1: whether a pixel can be skin of some tone in this light, and not hair or a microphone."""
    expected = np.maximum((pixels.corners @ own) * shade, 0.02)
    ratio = np.log(np.maximum(pixels.colors, 0.02) / expected)
    farthest = np.abs(ratio - np.median(ratio, axis=0)).max(axis=1)
    lit = np.clip(shade.min(axis=1) / 0.1, 0.0, 1.0)
    return lit * np.clip(1.0 - (farthest / LARGEST_RATIO) ** 2, 0.0, None) ** 2


def _solve_albedo(pixels: _Pixels, weights, shade, own, smoothing: csr_matrix) -> Float[np.ndarray, "v 3"]:
    """The albedo that this light makes look like the picture, smooth in its difference to the model's colours."""
    albedo = np.empty_like(own)
    for channel in range(3):
        system = diags_array(shade[:, channel]) @ pixels.corners
        weighted = diags_array(weights) @ system
        misfit = pixels.colors[:, channel] - system @ own[:, channel]
        normal = (system.T @ weighted + smoothing).tocsc()
        albedo[:, channel] = own[:, channel] + spsolve(normal, weighted.T @ misfit)
    return albedo


def _tint(pixels: _Pixels, own: np.ndarray, light: np.ndarray) -> Float[np.ndarray, "3"]:
    """The factor that brings the model's colours in this light closest to the picture's; one where nothing is seen."""
    if not len(pixels.colors):
        return np.ones(3)
    shown = (pixels.corners @ own) * np.maximum(pixels.functions @ light, 0.0)
    one = TINT_PRIOR * np.maximum((shown**2).mean(axis=0), 1e-6)
    return np.clip((one + (shown * pixels.colors).sum(axis=0)) / (one + (shown**2).sum(axis=0)), *TINT_RANGE)


def _smoothing(model: FaceModel) -> csr_matrix:
    """Quadratic form of a correction to the albedo: differences between neighbours and mirror images, and its size."""
    count = len(model.neutral)
    edges = np.unique(np.sort(model.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    face = _face(model)
    edges = edges[face[edges].all(axis=1)]
    mirrored = np.stack([np.arange(count), model.mirror], axis=1)
    mirrored = mirrored[mirrored[:, 0] < mirrored[:, 1]]
    laplacian = SMOOTH * differences(edges, count) + MIRROR * differences(mirrored, count)
    return (laplacian + PRIOR * diags_array(np.ones(count))).tocsr()


def differences(pairs: Int[np.ndarray, "n 2"], count: int) -> csr_matrix:
    """Quadratic form Σ (x_i − x_j)² over pairs (i, j) of `count` numbers."""
    rows = np.arange(len(pairs))
    ones = np.ones(len(pairs))
    matrix = coo_matrix(
        (np.concatenate([ones, -ones]), (np.concatenate([rows, rows]), pairs.T.ravel())), shape=(len(pairs), count)
    ).tocsr()
    return (matrix.T @ matrix).tocsr()
