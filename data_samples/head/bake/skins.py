"""Photographed skins in the head's own UV layout.

The pictures are crops of MakeHuman's atlas: the islands of head, scalp and mouth. Neck and eye sockets lie elsewhere in
the atlas and are painted: the neck goes on in the colour at the jaw's edge.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from bare_brows import Band, brow_band, without_brows
from crop import Crop
from jaxtyping import Float, Int, UInt8
from noise import noise
from scipy.spatial import cKDTree
from texture import OVERSAMPLING, Padding, Raster, assembled, padding, rasterise

SKIN_PX = 1536

ATLAS_U, ATLAS_V = (0.625, 1.0), (0.0, 0.83)
"""The part of MakeHuman's atlas that the pictures show, v up."""
COARSE_PX = 800
"""Pictures lower than this lack pores; they take them from a fine one."""
DONORS = {
    "middleage_lightskinned_female": "middleage_lightskinned_female2",
    "old_lightskinned_female": "middleage_lightskinned_female2",
    "old_lightskinned_female2": "middleage_lightskinned_female2",
    "old_lightskinned_male": "old_lightskinned_male2",
    "young_darkskinned_female": "middleage_darkskinned_female",
    "young_lightskinned_female": "young_lightskinned_female2",
}
"""Whose pores a coarse picture takes."""
DONATED_PX = 5.0
"""Detail up to this size (standard deviation of a Gaussian, fine pixels) is taken over."""
SOCKET = np.array([150.0, 84.0, 74.0])
SEAM_MM, SEAM_STEP, SEAM_POINTS = 9.0, 60, 48
NECK_DETAIL = 0.05
REMAP_ROW = 4096
MOUTH_DEEP_MM = 45.0


@dataclass(frozen=True)
class Canvas:
    """Where each texel of the head's texture lies on the head and in MakeHuman's atlas."""

    raster: Raster
    padding: Padding
    points: Float[np.ndarray, "n 3"]
    """Millimetres, neutral head."""
    atlas: Float[np.ndarray, "n 2"]
    region: np.ndarray
    """"face", "mouth", "socket", "neck", or "" where eyes, teeth and tongue of the plain head are."""
    mouth_front: float
    """Depth of the lips, millimetres."""
    seam: Int[np.ndarray, "e"]
    """Texels of the face at the jaw's edge, a sample of them."""
    neck_from: Int[np.ndarray, "m k"]
    """For each texel of the neck, the entries of `seam` that it takes its colour from."""
    neck_weights: Float[np.ndarray, "m k"]
    neck_mottle: Float[np.ndarray, "m"]
    brows: Band


def make_canvas(
    crop: Crop,
    neutral: np.ndarray,
    uvs: np.ndarray,
    triangles: np.ndarray,
    triangles_uv: np.ndarray,
    landmarks: Float[np.ndarray, "68 3"],
) -> Canvas:
    """The texels of the head's texture."""
    raster = rasterise(uvs, triangles_uv, SKIN_PX * OVERSAMPLING)
    quad = raster.triangle // 2
    atlas = raster.gathered(crop.uvs, triangles_uv)
    points = raster.gathered(neutral, triangles)
    region = np.full(len(quad), "face", dtype="<U6")
    region[crop.mouth_cavity[crop.quads[quad]].any(axis=1)] = "mouth"
    region[crop.eye_cavity[crop.quads[quad]].any(axis=1)] = "socket"
    inside = (ATLAS_U[0] <= atlas[:, 0]) & (ATLAS_V[1] >= atlas[:, 1])
    face_island = crop.quad_island == crop.quad_island[crop.outer[crop.quads].all(axis=1)][0]
    region[(region == "face") & ~(face_island[quad] & inside)] = "neck"
    region[crop.quad_part[quad] > 0] = ""
    neck, face = points[region == "neck"], np.flatnonzero(region == "face")
    near = cKDTree(neck[::SEAM_STEP]).query(points[face], distance_upper_bound=SEAM_MM)[0] < SEAM_MM
    seam = face[near][::SEAM_STEP]
    distance, nearest = cKDTree(points[seam]).query(neck, k=SEAM_POINTS)
    weights = 1.0 / (distance + 2.0) ** 2
    corners = neutral[triangles]
    ahead = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < 0
    return Canvas(
        raster=raster,
        padding=padding(raster, SKIN_PX * OVERSAMPLING),
        points=points,
        atlas=atlas,
        region=region,
        mouth_front=float(neutral[crop.lip_seam, 2].min()),
        seam=seam,
        neck_from=nearest,
        neck_weights=weights / weights.sum(axis=1, keepdims=True),
        neck_mottle=noise(neck / 1.1, 21) + noise(neck / 4.0, 22) - 1.0,
        brows=brow_band(points, np.flatnonzero((region == "face") & ahead[raster.triangle]), landmarks),
    )


def read_skin(folder: Path, name: str) -> Float[np.ndarray, "h w 3"]:
    """A skin (RGB), with the pores of a fine one where it is a coarse picture."""
    picture = _read_rgb(folder / f"{name}.jpg")
    if len(picture) >= COARSE_PX:
        return picture
    donor = _read_rgb(folder / f"{DONORS[name]}.jpg")
    smooth = cv2.resize(picture, donor.shape[1::-1], interpolation=cv2.INTER_CUBIC)
    base = cv2.GaussianBlur(donor, (0, 0), DONATED_PX)
    return np.clip(smooth * donor / np.maximum(base, 8.0), 0, 255)


def skin_texture(canvas: Canvas, skin: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "s s 3"]:
    """The head's texture with one skin on it, RGB."""
    colour = without_brows(_sampled(skin, canvas.atlas), canvas.brows)
    region = canvas.region
    skin_tone = np.median(colour[region == "face"], axis=0)
    smooth = np.einsum("nk,nkd->nd", canvas.neck_weights, colour[canvas.seam][canvas.neck_from])
    colour[region == "neck"] = smooth * (1 + NECK_DETAIL * canvas.neck_mottle)[:, None]
    mouth = region == "mouth"
    depth = np.clip((canvas.points[mouth, 2] - canvas.mouth_front) / MOUTH_DEEP_MM, 0, 1)
    colour[mouth] *= (0.72 * (1 - depth) + 0.12)[:, None]
    colour[region == "socket"] = 0.55 * SOCKET * (0.35 + 0.65 * skin_tone / 200.0) + 0.25 * skin_tone
    colour[region == ""] = skin_tone
    return assembled(canvas.raster, np.clip(colour, 0, 255), SKIN_PX * OVERSAMPLING, canvas.padding)


def _sampled(picture: np.ndarray, atlas: np.ndarray) -> np.ndarray:
    height, width = picture.shape[:2]
    column = (atlas[:, 0] - ATLAS_U[0]) / (ATLAS_U[1] - ATLAS_U[0]) * width - 0.5
    row = (1 - (atlas[:, 1] - ATLAS_V[0]) / (ATLAS_V[1] - ATLAS_V[0])) * height - 0.5
    # OpenCV's pictures have at most 32767 rows.
    place = [side.astype(np.float32) for side in (column, row)]
    strips = [np.pad(side, (0, -len(side) % REMAP_ROW)).reshape(-1, REMAP_ROW) for side in place]
    sampled = cv2.remap(picture.astype(np.float32), *strips, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return sampled.reshape(-1, 3)[: len(atlas)].astype(np.float64)


def _read_rgb(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_COLOR)[:, :, ::-1].astype(np.float64)
