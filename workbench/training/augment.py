"""From one render to endless training pictures: crop, background, clothes, occluders, light, lens, sensor, compression.

Everything here is made of noise, shapes and the renders themselves; no photograph is used.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.landmarks.alignment import FaceFrame, frame_from_points, rolled
from workbench.landmarks.network_detector import CROP_SIDE, crop_frame
from workbench.landmarks.scheme import MIRROR
from workbench.landmarks.schemes import DensePoints
from workbench.training import variation
from workbench.training.pool import Pool


@dataclass(frozen=True, eq=False)
class TrainingPicture:
    """What the network sees, and what it should say."""

    picture: UInt8[np.ndarray, "s s 3"]
    points: Float[np.ndarray, "70 2"]
    """The 68 landmarks and the two pupils in pixels of the picture; points outside of it are possible."""
    is_face: bool
    dense: Float[np.ndarray, "n 2"]
    """The dense points, where they were asked for; none otherwise."""

    @property
    def landmarks(self) -> Float[np.ndarray, "68 2"]:
        """The 68 landmarks alone."""
        return self.points[:68]


@dataclass(frozen=True)
class Hardness:
    """How far training pictures stray from a clean, centred render; 0 none, 1 as trained."""

    framing: float = 1.0
    damage: float = 1.0
    occlusion: float = 1.0


TRAINING = Hardness()
SHARP_SIDE = 128
"""Sides of pictures beyond which most backgrounds are soft."""
FEATHER = 28
"""Pixels over which a render fades at its own border, where it cuts through hair and shoulders."""
MIRRORED = (*MIRROR, 69, 68)
"""Where each of the 68 landmarks and of the two pupils is in a mirrored picture."""


def augmented(
    pool: Pool,
    index: int,
    rng: np.random.Generator,
    side: int = CROP_SIDE,
    hardness: Hardness = TRAINING,
    dense: DensePoints | None = None,
) -> TrainingPicture:
    """A random training picture of one render, `side` pixels wide (4 % show no face at all)."""
    rgba, points = cut_out(pool, index)
    mirror = MIRRORED
    if dense is not None:
        points = np.concatenate([points, pool.surface(index, dense.vertices)])
        mirror = (*MIRRORED, *(len(MIRRORED) + dense.mirror))
    background = random_background(rng, side)
    background = _with_bystander(background, pool, rng)
    is_face = rng.random() > variation.FACELESS * hardness.damage
    if is_face:
        head, points = _framed(rgba, points.astype(np.float64), mirror, rng, side, hardness)
        head = exposed(head, rng)
        picture = _clothed(background, frame_from_points(points[:68]), rng)
        cover = head[..., 3:].astype(np.float32) / 255
        light = rng.normal(1, variation.HEAD_COLOUR, 3).astype(np.float32)
        picture = head[..., :3] * light + picture * (1 - cover)
        if rng.random() < variation.OCCLUDED * hardness.occlusion:
            picture = _occluded(picture, points[:68], rng)
    else:
        picture = background
    if rng.random() < variation.SHADOWED * hardness.damage:
        picture = shadowed(picture, rng)
    if hardness.damage > 0:
        picture = photographed(picture, rng, hardness.damage)
    points = points.astype(np.float32)
    known = len(MIRRORED)
    return TrainingPicture(np.clip(picture, 0, 255).astype(np.uint8), points[:known], is_face, points[known:])


def cut_out(pool: Pool, index: int) -> tuple[UInt8[np.ndarray, "s s 4"], Float[np.ndarray, "70 2"]]:
    """A render whose border is faded, so that no straight cut tells of a face, and its points."""
    rgba, points = pool.picture(index)
    rgba = np.array(rgba)
    fade = ((np.arange(FEATHER) + 0.5) / FEATHER)[:, None]
    for turned in (rgba, rgba[::-1], rgba.transpose(1, 0, 2), rgba[:, ::-1].transpose(1, 0, 2)):
        turned[:FEATHER] = turned[:FEATHER] * fade[:, None]
    return rgba, points


def random_background(rng: np.random.Generator, side: int = CROP_SIDE) -> Float[np.ndarray, "s s 3"]:
    """Walls, gradients, noise at several scales, and cluttered shapes, sharp or out of focus, most in muted colours."""
    if side > SHARP_SIDE and rng.random() < 0.6:
        return cv2.resize(random_background(rng, side // 2), (side, side), interpolation=cv2.INTER_LINEAR)
    unit = side / CROP_SIDE
    base = rng.uniform(0, 255, 3)
    picture = np.empty((side, side, 3), np.float32)
    picture[:] = base
    if rng.random() < 0.6:
        corners = np.clip(base + rng.normal(0, 60, (2, 2, 3)), 0, 255).astype(np.float32)
        picture = cv2.resize(corners, (side, side), interpolation=cv2.INTER_LINEAR)
    if rng.random() < 0.75:
        for _ in range(rng.integers(2, 25)):
            color = np.clip(base + rng.normal(0, 80, 3), 0, 255).tolist()
            centre, size = rng.uniform(0, side, 2), unit * np.exp(rng.uniform(np.log(4), np.log(160), 2))
            kind = rng.integers(4)
            if kind == 0:
                corners = cv2.boxPoints((tuple(centre), tuple(size), float(rng.choice([0, 90, rng.uniform(0, 180)]))))
                cv2.fillPoly(picture, [np.rint(corners).astype(np.int32)], color)
            elif kind == 1:
                cv2.ellipse(picture, (tuple(centre), tuple(size), float(rng.uniform(0, 180))), color, -1)
            elif kind == 2:
                end = centre + rng.normal(0, 120 * unit, 2)
                ends = [tuple(np.rint(p).astype(int).tolist()) for p in (centre, end)]
                cv2.line(picture, *ends, color, max(1, round(unit * rng.integers(1, 14))))
            else:
                outline = centre + rng.normal(0, size.mean() / 2, (rng.integers(3, 8), 2))
                cv2.fillPoly(picture, [np.rint(outline).astype(np.int32)], color)
    for cells in (4, 16, 64, 128):
        if rng.random() < 0.4:
            noise = rng.standard_normal((cells, cells, 1 if rng.random() < 0.7 else 3)).astype(np.float32)
            noise = cv2.resize(noise, (side, side), interpolation=cv2.INTER_CUBIC)
            picture = picture + rng.uniform(3, 40) * (noise if noise.ndim == 3 else noise[..., None])
    if rng.random() < 0.6:
        picture = cv2.GaussianBlur(picture, (0, 0), unit * float(np.exp(rng.uniform(np.log(0.6), np.log(12)))))
    if rng.random() < 0.6:
        grey = _grey(picture)
        picture = grey + np.float32(rng.uniform(0.1, 0.6)) * (picture - grey)
    return picture


def photographed(
    picture: Float[np.ndarray, "s s 3"], rng: np.random.Generator, amount: float = 1.0, unit: float | None = None
) -> Float[np.ndarray, "s s 3"]:
    """What lens, sensor and codec do: colour, contrast, blur, lost resolution, noise, compression.

    `unit`: pixels for one of a face's crop of `CROP_SIDE` pixels; by default the picture is such a crop.
    """
    side = picture.shape[0]
    unit = side / CROP_SIDE if unit is None else unit
    picture = np.clip(picture, 0, 255).astype(np.uint8)
    if rng.random() < variation.DEVELOPED * amount:
        curve = np.linspace(0, 1, 256)[:, None] ** np.exp(rng.normal(0, variation.GAMMA_LOGARITHM))
        curve = curve * np.exp(rng.normal(0, variation.GAIN_LOGARITHM)) + rng.normal(0, variation.BLACK)
        curve = curve * np.exp(rng.normal(0, variation.COLOUR_LOGARITHM, 3))
        picture = cv2.LUT(picture, curve.astype(np.float32)[None])
        grey = _grey(picture)
        saturation = 0.0 if rng.random() < variation.GREY else rng.uniform(*variation.SATURATION)
        picture = grey + np.float32(saturation) * (picture - grey)
        middle = np.float32(picture.mean())
        picture = middle + np.float32(np.exp(rng.normal(0, variation.CONTRAST_LOGARITHM))) * (picture - middle)
        picture = picture * np.float32(255)
    picture = np.clip(picture, 0, 255).astype(np.float32)
    if rng.random() < variation.DIM * amount:
        picture = _dim(picture, rng)
    if rng.random() < variation.OUT_OF_FOCUS * amount:
        picture = cv2.GaussianBlur(picture, (0, 0), unit * float(rng.uniform(*variation.FOCUS_PX)))
    if rng.random() < variation.MOVED * amount:
        picture = _moved(picture, rng, unit)
    if rng.random() < variation.COARSE * amount:
        crop_px = np.exp(rng.uniform(np.log(variation.LEAST_RESOLUTION_PX), np.log(CROP_SIDE)))
        small = min(side, max(int(crop_px * (side / unit / CROP_SIDE)), 4))
        down = cv2.resize(picture, (small, small), interpolation=cv2.INTER_AREA)
        if rng.random() < variation.COARSE_DAMAGED:
            down = down + rng.normal(0, rng.uniform(*variation.COARSE_NOISE), down.shape).astype(np.float32)
            down = _compressed(down, rng)
        way = cv2.INTER_LINEAR if rng.random() < variation.SMOOTHLY_ENLARGED else cv2.INTER_CUBIC
        picture = cv2.resize(down, (side, side), interpolation=way)
    if rng.random() < variation.NOISY * amount:
        noise = rng.standard_normal(picture.shape, np.float32)
        if rng.random() < variation.GRAINY:
            noise = 2 * cv2.GaussianBlur(noise, (0, 0), variation.GRAIN_PX)
        picture = picture + np.float32(np.exp(rng.uniform(*np.log(variation.NOISE)))) * noise
    if rng.random() < variation.COMPRESSED * amount:
        picture = _compressed(picture, rng)
    return picture


def _framed(rgba, points, mirror, rng, side, hardness):
    """The crop a detector would ask for, more or less; half of the pictures are mirrored."""
    if rng.random() < variation.MIRRORED_SHARE:
        rgba = rgba[:, ::-1]
        points = points[list(mirror)]
        points[:, 0] = rgba.shape[1] - 1 - points[:, 0]
    view = crop_frame(frame_from_points(points[:68]), side)
    upright = rng.random() < variation.NEARLY_UPRIGHT
    roll = _cut_off(rng, variation.UPRIGHT_ROLL_DEG) if upright else rng.uniform(*variation.ANY_ROLL_DEG)
    angle = np.radians(roll) * hardness.framing
    scale = np.exp(_cut_off(rng, variation.SCALE_LOGARITHM) * hardness.framing)
    shift = _cut_off(rng, variation.SHIFT, 2) * side * hardness.framing
    # The face's own roll stays in the picture, so undo the frame's before turning by a random angle.
    own = np.arctan2(view.matrix[1, 0], view.matrix[0, 0])
    matrix = view.matrix @ rolled(angle - own) * scale
    middle = view.to_image(np.full((1, 2), (side - 1) / 2) + shift)[0]
    to_image = FaceFrame(matrix, middle - matrix @ np.full(2, (side - 1) / 2))
    head = cv2.warpAffine(
        np.ascontiguousarray(rgba),
        np.column_stack([to_image.matrix, to_image.origin]),
        (side, side),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
    )
    return head, to_image.to_face(points)


def exposed(head: UInt8[np.ndarray, "h w 4"], rng: np.random.Generator) -> UInt8[np.ndarray, "h w 4"]:
    """The head as a camera exposes it: its mean brightness where the scene's is not kept."""
    cover = head[..., 3] > 127
    if rng.random() < variation.KEPT_LIGHT or not cover.any():
        return head
    grey = max(float(head[cover, :3].mean()), 1.0)
    gain = np.clip(rng.uniform(*variation.EXPOSED) / grey, 0.5, variation.MOST_GAIN)
    # Highlights roll off as they do in a camera: what would be beyond white ends close below it.
    lit = np.arange(256, dtype=np.float32) * (gain / 255)
    table = np.where(lit < 0.8, lit, 1 - 0.2 * np.exp(-(lit - 0.8) / 0.2))
    colors = cv2.LUT(np.ascontiguousarray(head[..., :3]), np.rint(255 * table).astype(np.uint8))
    return np.dstack([np.minimum(colors, head[..., 3:]), head[..., 3]])


def _with_bystander(background, pool, rng):
    """Now and then somebody else stands behind."""
    if rng.random() > variation.BYSTANDERS:
        return background
    rgba, _ = cut_out(pool, int(rng.integers(len(pool))))
    side = background.shape[0]
    size = int(rng.uniform(*variation.BYSTANDER_PX) * side / CROP_SIDE)
    small = cv2.resize(rgba, (size, size), interpolation=cv2.INTER_AREA).astype(np.float32)
    x, y = (int(rng.uniform(-0.5 * size, side - 0.5 * size)) for _ in range(2))
    left, top = max(x, 0), max(y, 0)
    right, bottom = min(x + size, side), min(y + size, side)
    part = small[top - y : bottom - y, left - x : right - x]
    window = background[top:bottom, left:right]
    background[top:bottom, left:right] = part[..., :3] + window * (1 - part[..., 3:] / 255)
    return background


def _clothed(background, frame, rng):
    """Shoulders below the chin."""
    if rng.random() < variation.BARE:
        return background
    cover = shoulders(frame, len(background), rng)[..., None]
    color = rng.uniform(0, 255, 3).astype(np.float32)
    grain = variation.CLOTH_GRAIN * rng.standard_normal((len(cover), 1, 1), np.float32)
    return background * (1 - cover) + cover * color * (1 + grain)


def shoulders(frame: FaceFrame, side: int, rng: np.random.Generator) -> Float[np.ndarray, "s s"]:
    """How far clothes cover each pixel, for a face that is there."""
    neck, shoulder, collar = rng.uniform(0.25, 0.4), rng.uniform(0.7, 1.3), rng.uniform(0.75, 0.95)
    lean = rng.normal(0, 0.06)
    outline = np.array([[-neck, collar], [-neck - 0.12, collar + 0.02], [-shoulder, collar + 0.3], [-shoulder - 0.2, 3],
                        [shoulder + 0.2, 3], [shoulder, collar + 0.3], [neck + 0.12, collar + 0.02], [neck, collar],
                        [0, collar + rng.uniform(0.05, 0.3)]])  # fmt: skip
    outline[:, 0] += lean
    cover = np.zeros((side, side), np.float32)
    cv2.fillPoly(cover, [np.rint(frame.to_image(outline)).astype(np.int32)], 1.0)
    return cv2.GaussianBlur(cover, (0, 0), 1.0)


def _occluded(picture, points, rng):
    layer, cover = occluder(picture, points, rng)
    return picture * (1 - cover) + cover * layer


def occluder(
    picture: Float[np.ndarray, "s s 3"], points: Float[np.ndarray, "68 2"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "s s 3"], Float[np.ndarray, "s s 1"]]:
    """Something before the face (fingers, a microphone, a bar, a patch, a mask), and how far it covers each pixel."""
    frame = frame_from_points(points)
    layer, cover = picture.copy(), np.zeros(picture.shape[:2], np.float32)
    kind = rng.choice(["hand", "hand", "microphone", "patch", "bar", "mask"], p=[0.25, 0.2, 0.15, 0.2, 0.12, 0.08])
    side = len(picture)
    target = points[rng.integers(68)] + rng.normal(0, 8, 2) * side / CROP_SIDE
    if kind == "hand":
        tone = np.array([rng.uniform(60, 240)] * 3) * [1.0, rng.uniform(0.7, 0.85), rng.uniform(0.5, 0.75)]
        angle, width = rng.uniform(0, 2 * np.pi), frame.side * rng.uniform(0.06, 0.1)
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]])
        for finger in range(rng.integers(1, 5)):
            tip = target + across * finger * width * 1.05 + along * rng.uniform(-0.15, 0.05) * frame.side
            bend = tip + along * frame.side * 0.35 + across * rng.normal(0, 0.04) * frame.side
            root = bend + along * frame.side * rng.uniform(0.3, 0.8)
            path = np.rint(np.stack([tip, bend, root])).astype(np.int32)
            for shrink, shade in ((1.0, 0.6), (0.85, 0.85), (0.55, 1.0), (0.25, 1.1)):
                cv2.polylines(layer, [path], False, (tone * shade).tolist(), max(1, round(width * shrink)), cv2.LINE_AA)
            cv2.polylines(cover, [path], False, 1.0, max(1, round(width)), cv2.LINE_AA)
    elif kind == "microphone":
        tone = rng.uniform(5, 90)
        radius = frame.side * rng.uniform(0.05, 0.14)
        centre = points[57] + rng.normal(0, 0.1, 2) * frame.side + [0, 0.1 * frame.side]
        stem = centre + np.array([rng.normal(0, 0.3), 1.0]) * frame.side
        ends = [tuple(np.rint(p).astype(int).tolist()) for p in (centre, stem)]
        for canvas, color in ((layer, (tone * 0.7,) * 3), (cover, 1.0)):
            cv2.line(canvas, *ends, color, max(2, round(radius * 0.9)), cv2.LINE_AA)
        for shrink, shade in ((1.0, 0.8), (0.7, 1.0), (0.35, 1.4)):
            cv2.circle(layer, ends[0], max(1, round(radius * shrink)), (tone * shade,) * 3, -1, cv2.LINE_AA)
        cv2.circle(cover, ends[0], max(1, round(radius)), 1.0, -1, cv2.LINE_AA)
    elif kind == "mask":
        lower = np.concatenate([points[1:16], points[[29]]])
        cv2.fillPoly(cover, [cv2.convexHull(np.rint(lower).astype(np.int32))[:, 0]], 1.0)
        layer[:] = rng.uniform(20, 250, 3) * (1 + 0.06 * rng.standard_normal((side, side, 1), np.float32))
    else:
        size = (
            frame.side * rng.uniform(0.1, 0.4, 2)
            if kind == "patch"
            else frame.side * np.array([3.0, rng.uniform(0.04, 0.2)])
        )
        corners = cv2.boxPoints((tuple(target), tuple(size), float(rng.uniform(0, 180))))
        cv2.fillPoly(cover, [np.rint(corners).astype(np.int32)], 1.0)
        layer[:] = random_background(rng, side) if rng.random() < 0.6 else rng.uniform(0, 255, 3)
    return layer, cv2.GaussianBlur(cover, (0, 0), 0.8)[..., None]


def shadowed(picture: Float[np.ndarray, "s s 3"], rng: np.random.Generator) -> Float[np.ndarray, "s s 3"]:
    """A soft or hard edge of shadow or light across the picture."""
    angle, place = rng.uniform(0, 2 * np.pi), rng.uniform(*variation.SHADOW_PLACE)
    x, y = np.meshgrid(*(np.linspace(-1, 1, len(picture), dtype=np.float32),) * 2)
    across = x * np.float32(np.cos(angle)) + y * np.float32(np.sin(angle)) - np.float32(place)
    steepness = np.float32(np.exp(rng.uniform(*variation.SHADOW_STEEPNESS_LOGARITHM)))
    share = 1 / (1 + np.exp(np.clip(across * steepness, -30, 30)))
    return picture * (1 + np.float32(rng.uniform(*variation.SHADOW_LIGHT)) * share)[..., None]


def _cut_off(rng, spread, *shape):
    deviation, largest = spread
    return np.clip(rng.normal(0, deviation, *shape), -largest, largest)


def _grey(picture):
    return cv2.transform(picture, np.full((1, 3), 1 / 3, np.float32))[..., None]


def _dim(picture, rng):
    """Too little light: few photons, noise by their square root, and brightened again."""
    full = np.exp(rng.uniform(*np.log(variation.WHITE_PHOTONS)))
    photons = np.clip(picture, 0, 255) * (full / 255)
    noisy = photons + np.sqrt(photons + 2.0) * rng.standard_normal(picture.shape, np.float32)
    return (noisy * (255 / full * rng.uniform(*variation.BRIGHTENED))).astype(np.float32)


def _moved(picture, rng, unit):
    """Motion blur."""
    length = max(3, round(rng.integers(*variation.MOTION_PX) * unit))
    angle = rng.uniform(0, np.pi)
    kernel = np.zeros((length, length), np.float32)
    half = (length - 1) / 2
    step = np.array([np.cos(angle), np.sin(angle)]) * half
    ends = [tuple(np.rint(half + s * step).astype(int).tolist()) for s in (-1, 1)]
    cv2.line(kernel, *ends, 1.0, 1)
    return cv2.filter2D(picture, -1, kernel / kernel.sum())


def _compressed(picture, rng):
    quality = int(rng.uniform(*variation.QUALITY))
    data = cv2.imencode(".jpg", np.clip(picture, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return cv2.imdecode(data, cv2.IMREAD_COLOR).astype(np.float32)
