"""From a render of both eyes to endless crops of one, as cameras take them and detectors cut them."""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.landmarks.alignment import FaceFrame, rolled, sampled
from workbench.landmarks.eyes import IRISES, eye_frame
from workbench.landmarks.schemes import DENSE_POINTS, FIRST_DENSE
from workbench.networks.eye_network import SIDE
from workbench.training.augment import (
    MIRRORED,
    TRAINING,
    Hardness,
    exposed,
    photographed,
    random_background,
    shadowed,
)
from workbench.training.pool import Pool

WIDTHS_PX = (9.0, 60.0)
"""Of a frontal eye in the picture that it is cut from."""
CROP_EYE_PX = 0.6 * SIDE
"""The same in the crop."""
AROUND = 1.4
"""Crops across what a picture is made of: what lens and codec do to a crop comes from beyond it too."""
FACE_EYE_PX = 25.0
"""Width of an eye in the whole-face crops that `augment.photographed` was made for."""
SMALLEST_PX = 12
MOST_MOVED_PX = 3
COVERED = 250
"""Coverage from which no background shows."""


@dataclass(frozen=True, eq=False)
class EyePicture:
    """What the network sees, and what it should say."""

    picture: UInt8[np.ndarray, "s s 3"]
    points: Float[np.ndarray, "9 2"]
    """Pupil and iris in pixels of the crop, as a right eye's."""
    is_open: bool


def eye_picture(
    pool: Pool, index: int, eye: int, rng: np.random.Generator, hardness: Hardness = TRAINING
) -> EyePicture:
    """A random crop of the person's right (0) or left (1) eye in a render; left ones come mirrored."""
    rgba, points = pool.picture(index)
    irises = pool.surface(index, _iris_vertices())
    if eye == 1:
        points, irises = points[list(MIRRORED)].copy(), irises[_mirrored_irises()].copy()
        points[:, 0], irises[:, 0] = (rgba.shape[1] - 1 - part[:, 0] for part in (points, irises))
    truth = np.concatenate([points[68:69], irises[: len(IRISES[0]) - 1]]).astype(np.float64)
    landmarks = points[:68].astype(np.float64)
    asked = _as_detected(eye_frame(landmarks, 0), rng, hardness.framing)
    to_render = _camera(asked, rng)
    side = max(SMALLEST_PX, int(np.ceil(AROUND * SIDE * asked.side / to_render.side)))
    to_render = FaceFrame(to_render.matrix, to_render.origin - to_render.matrix @ np.full(2, (side - 1) / 2))
    patch = sampled(rgba, _unmirrored(to_render, rgba.shape[1]) if eye == 1 else to_render, side)
    patch = exposed(patch, rng)
    picture = patch[..., :3].astype(np.float32) * rng.normal(1, 0.04, 3).astype(np.float32)
    if patch[..., 3].min() < COVERED:
        picture += random_background(rng, len(patch)) * (1 - patch[..., 3:].astype(np.float32) / 255)
    if rng.random() < 0.25 * hardness.damage:
        picture = shadowed(picture, rng)
    if hardness.damage > 0:
        eye_px = CROP_EYE_PX * asked.side / to_render.side
        picture = photographed(picture, rng, 0.6 * hardness.damage, eye_px / FACE_EYE_PX)
    to_patch = FaceFrame(np.linalg.inv(to_render.matrix) @ asked.matrix, to_render.to_face(asked.origin[None])[0])
    crop = sampled(np.clip(picture, 0, 255).astype(np.uint8), to_patch, SIDE)
    return EyePicture(crop, asked.to_face(truth), pupil_seen(landmarks[36:42], truth[0]))


def _as_detected(true: FaceFrame, rng: np.random.Generator, amount: float) -> FaceFrame:
    """The crop's frame where a detector's landmarks are off: a few percent of the eye's width, now and then many."""
    far = 2.5 if rng.random() < 0.1 else 1.0
    angle = np.radians(np.clip(rng.normal(0, 4), -12, 12) * far) * amount
    scale = np.exp(np.clip(rng.normal(0, 0.07), -0.2, 0.2) * far * amount)
    matrix = true.matrix @ rolled(angle) * scale
    middle = np.full(2, (SIDE - 1) / 2)
    shift = np.clip(rng.normal(0, 0.05, 2), -0.12, 0.12) * far * amount * CROP_EYE_PX
    return FaceFrame(matrix, true.to_image((middle + shift)[None])[0] - matrix @ middle)


def _camera(asked: FaceFrame, rng: np.random.Generator) -> FaceFrame:
    """From the pixels of a camera's picture about the eye's crop, coarse and turned as those are, to the render's."""
    scale = CROP_EYE_PX / np.exp(rng.uniform(*np.log(WIDTHS_PX)))  # crop pixels a pixel of the picture
    angle = rng.uniform(-0.6, 0.6)  # the head's roll in the picture
    between = np.full((1, 2), (SIDE - 1) / 2) + rng.uniform(-0.5, 0.5, 2) * scale
    return FaceFrame(asked.matrix @ rolled(angle) * scale, asked.to_image(between)[0])


def _unmirrored(frame: FaceFrame, width: int) -> FaceFrame:
    """A frame in the mirror image of a picture of this width, to the picture itself."""
    flip = np.diag([-1.0, 1.0])
    return FaceFrame(flip @ frame.matrix, flip @ frame.origin + [width - 1.0, 0.0])


def pupil_seen(lids: Float[np.ndarray, "6 2"], pupil: Float[np.ndarray, "2"]) -> bool:
    """Whether the pupil's middle lies between the lids, clear of them by a little."""
    width = float(np.linalg.norm(lids[0] - lids[3]))
    return cv2.pointPolygonTest(lids.astype(np.float32)[:, None], tuple(pupil.tolist()), True) > 0.02 * width


def moved(eye: EyePicture, rng: np.random.Generator) -> EyePicture:
    """The crop a little aside, brighter or darker: what makes another of one that has been made."""
    across, down = rng.integers(-MOST_MOVED_PX, MOST_MOVED_PX + 1, 2)
    way = np.float32([[1, 0, across], [0, 1, down]])
    picture = cv2.warpAffine(eye.picture, way, (SIDE, SIDE), flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    picture = cv2.convertScaleAbs(picture, alpha=float(np.exp(rng.normal(0, 0.1))), beta=float(rng.normal(0, 6)))
    return EyePicture(picture, eye.points + np.array([across, down]), eye.is_open)


@cache
def _iris_vertices() -> np.ndarray:
    """Of the right eye's border, then the left one's, in the order of `IRISES`."""
    return np.concatenate([DENSE_POINTS.vertices[eye[1:] - FIRST_DENSE] for eye in IRISES])


@cache
def _mirrored_irises() -> np.ndarray:
    """The left eye's border first: what is the right one's in a mirrored picture."""
    count = len(IRISES[0]) - 1
    return np.roll(np.arange(2 * count), count)
