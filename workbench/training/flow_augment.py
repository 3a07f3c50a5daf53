"""From one rendered pair to endless training pairs: framing, background and occluders that move, light, lens, sensor.

Whatever moves is a layer with its own exact flow; the flow of a pixel is that of the foremost layer there.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from workbench.landmarks.alignment import rolled
from workbench.training.flow_pool import PairPool
from workbench.training.flow_scenes import FACE, SEEN, VISIBLE

SMALLEST_VIEW, LARGEST_VIEW = 110.0, 300.0
"""Pixels of a render that a training picture shows across."""
MIDDLE = 127.5
"""Of a render, pixels."""
STILL = 0.15
"""Share of heads that do not move by themselves: in a video most of the picture hardly does."""
LEAST_SHAKE, MOST_SHAKE = 0.0008, 0.03
"""Of the camera, as a share of the picture's side."""


@dataclass(frozen=True, eq=False)
class TrainingPair:
    """What the network sees, and what it should say."""

    first: UInt8[np.ndarray, "s s 3"]
    second: UInt8[np.ndarray, "s s 3"]
    flow: Float32[np.ndarray, "s s 2"]
    """From the first to the second, pixels."""
    known: Bool[np.ndarray, "s s"]
    """The flow is exact here; not along some outlines."""
    visible: Bool[np.ndarray, "s s"]
    """The second picture shows it too."""
    face: Bool[np.ndarray, "s s"]


@dataclass(frozen=True)
class PairHardness:
    """How far training pairs stray from clean renders before a moving ground; 0 not at all, 1 as trained."""

    motion: float = 1.0
    """Of camera and background."""
    damage: float = 1.0
    """By light, lens, sensor and codec."""
    occlusion: float = 1.0


TRAINING = PairHardness()
CLEAN = PairHardness(damage=0.0, occlusion=0.0)


@dataclass(frozen=True, eq=False)
class _Layer:
    """Something that moves: its looks in both pictures (colours multiplied by coverage), and its flow."""

    pictures: list[np.ndarray]
    coverages: list[np.ndarray]
    flow: np.ndarray
    known: np.ndarray
    visible: np.ndarray
    """False where it hides itself."""
    face: np.ndarray


def augmented_pair(
    pool: PairPool, index: int, rng: np.random.Generator, side: int, hardness: PairHardness = TRAINING
) -> TrainingPair:
    """A random training pair of one rendered pair, `side` pixels wide."""
    places = _places(side)
    layers = [_background(pool, rng, side, places, hardness), _head(pool, index, rng, side, places, hardness)]
    if rng.random() < 0.25 * hardness.occlusion:
        layers.append(_occluder(pool, rng, side, places))
    pictures = [_composed(layers, which) for which in (0, 1)]
    flow, known, visible, face = _truth(layers, places)
    pictures = photographed_pair(pictures, rng, hardness.damage)
    first, second = (np.clip(picture, 0, 255).astype(np.uint8) for picture in pictures)
    return TrainingPair(first, second, flow, known, visible, face)


def _head(pool, index, rng, side, places, hardness) -> _Layer:
    pair = pool.pair(index)
    here = int(rng.integers(2))
    rgba = [np.asarray(pair.rgba[k]) for k in (here, 1 - here)]
    flow, marks = pair.flow[here].astype(np.float32), np.asarray(pair.marks[here])
    if rng.random() < STILL:
        rgba, flow, marks = [rgba[0]] * 2, np.zeros_like(flow), np.where(marks & SEEN, marks | VISIBLE, marks)
    if rng.random() < 0.5:
        rgba, flow, marks = [picture[:, ::-1] for picture in rgba], flow[:, ::-1] * np.float32([-1, 1]), marks[:, ::-1]
    view = np.exp(rng.uniform(np.log(SMALLEST_VIEW), np.log(LARGEST_VIEW)))
    zoom = view / side
    start = _affine(
        zoom, np.radians(np.clip(rng.normal(0, 10), -35, 35)), side, MIDDLE + rng.normal(0, 0.1, 2) * view
    )  # fmt: skip
    end = start
    if rng.random() < 0.6:
        shake = np.exp(rng.uniform(np.log(LEAST_SHAKE), np.log(MOST_SHAKE)))
        end = start @ _motion(rng, side, float(shake) * hardness.motion)
    if zoom > 1.3:  # so that small pictures do not alias
        rgba = [cv2.GaussianBlur(picture, (0, 0), 0.35 * zoom) for picture in rgba]
    looks = [_warped(np.ascontiguousarray(picture), way, side) for picture, way in zip(rgba, (start, end), strict=True)]
    seen = (marks & SEEN > 0).astype(np.float32)
    share = _warped(seen, start, side)
    moved = _warped(flow * seen[..., None], start, side) / np.maximum(share, 1e-3)[..., None]
    target = _apply(np.linalg.inv(end), _apply(start, places) + moved)
    flags = _warped(np.ascontiguousarray(marks), start, side, cv2.INTER_NEAREST)
    coverages = [look[..., 3].astype(np.float32) / 255 for look in looks]
    return _Layer(
        [look[..., :3].astype(np.float32) for look in looks], coverages, target - places,
        known=share > 0.5, visible=(flags & VISIBLE) > 0, face=(flags & FACE) > 0,
    )  # fmt: skip


def _background(pool, rng, side, places, hardness) -> _Layer:
    picture = pool.background(rng)
    zoom = np.exp(rng.uniform(np.log(0.6), np.log(1.6)))
    start = _affine(zoom, rng.uniform(-np.pi, np.pi), side, len(picture) / 2 + rng.normal(0, 60, 2))
    still = rng.random() < 0.35
    end = start if still else start @ _motion(rng, side, float(np.exp(rng.uniform(-7.2, -2.6))) * hardness.motion)
    whole = np.ones((side, side), bool)
    looks = [_warped(picture, way, side, border=cv2.BORDER_REFLECT).astype(np.float32) for way in (start, end)]
    flow = _apply(np.linalg.inv(end) @ start, places) - places
    return _Layer(looks, [whole.astype(np.float32)] * 2, flow, whole, whole, ~whole)


def _occluder(pool, rng, side, places) -> _Layer:
    """A textured patch or bar before the face, on its own way."""
    picture = pool.background(rng)
    size = side * (rng.uniform(0.08, 0.4, 2) if rng.random() < 0.6 else np.array([2.5, rng.uniform(0.03, 0.15)]))
    middle = len(picture) / 2 + rng.normal(0, 40, 2)
    shape = np.zeros(picture.shape[:2], np.float32)
    corners = cv2.boxPoints((tuple(middle), tuple(size), float(rng.uniform(0, 180))))
    if rng.random() < 0.5:
        corners = corners + rng.normal(0, 0.2, (4, 2)) * size.min()
    cv2.fillPoly(shape, [np.rint(corners * 16).astype(np.int32)], 1.0, cv2.LINE_AA, 4)
    start = _affine(1.0, 0.0, side, middle + rng.normal(0, 0.2, 2) * side)
    end = start @ _motion(rng, side, float(np.exp(rng.uniform(-4.5, -2.0))))
    covers = [_warped(shape, way, side) for way in (start, end)]
    looks = [
        _warped(picture, way, side, border=cv2.BORDER_REFLECT) * cover[..., None]
        for way, cover in zip((start, end), covers, strict=True)
    ]
    whole = np.ones((side, side), bool)
    return _Layer(looks, covers, _apply(np.linalg.inv(end) @ start, places) - places, whole, whole, ~whole)


def _composed(layers: list[_Layer], which: int) -> Float[np.ndarray, "s s 3"]:
    picture = layers[0].pictures[which]
    for layer in layers[1:]:
        picture = layer.pictures[which] + picture * (1 - layer.coverages[which][..., None])
    return picture


def _truth(layers: list[_Layer], places):
    """Flow, known, visible and face of the foremost layer at each pixel."""
    flow, known, visible, face = (
        part.copy() for part in (layers[0].flow, layers[0].known, layers[0].visible, layers[0].face)
    )
    order = np.zeros(known.shape, int)
    for depth, layer in enumerate(layers[1:], 1):
        front = layer.coverages[0] > 0.5
        flow[front], order[front] = layer.flow[front], depth
        known[front], visible[front], face[front] = layer.known[front], layer.visible[front], layer.face[front]
    target = (places + flow).astype(np.float32)
    for depth, layer in enumerate(layers[1:], 1):
        cover = cv2.remap(layer.coverages[1], target, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        visible &= ~((cover > 0.5) & (order < depth))
    visible &= ((target >= 0) & (target <= len(places) - 1)).all(axis=-1)
    return flow.astype(np.float32), known, visible, face


def photographed_pair(
    pictures: list[Float[np.ndarray, "s s 3"]], rng: np.random.Generator, amount: float = 1.0
) -> list[Float[np.ndarray, "s s 3"]]:
    """What light, lens, sensor and codec do to both pictures, mostly alike, with a little of its own for each."""
    if amount == 0:
        return pictures
    alike = rng.random() < 0.9 * amount
    gamma, gain, lift = np.exp(rng.normal(0, 0.25)), np.exp(rng.normal(0, 0.2)), rng.normal(0, 0.05)
    tint, saturation = np.exp(rng.normal(0, 0.08, 3)), 0.0 if rng.random() < 0.12 else rng.uniform(0.4, 1.4)
    own = 0.05 * (rng.random() < 0.6) * amount
    blur = rng.uniform(0.4, 1.6) if rng.random() < 0.35 * amount else 0.0
    noise = np.exp(rng.uniform(np.log(0.7), np.log(12))) if rng.random() < 0.6 * amount else 0.0
    quality = int(rng.uniform(25, 95)) if rng.random() < 0.4 * amount else None
    shadow = _shadow(rng, len(pictures[0])) if rng.random() < 0.15 * amount else None
    made = []
    for picture in pictures:
        picture = np.clip(picture, 0, 255).astype(np.float32) * np.float32(1 / 255)
        if shadow is not None:
            picture = picture * shadow
        if alike:
            picture = picture ** np.float32(gamma) * (gain * tint).astype(np.float32) + np.float32(lift)
            grey = picture.mean(axis=2, keepdims=True)
            picture = grey + np.float32(saturation) * (picture - grey)
        picture = picture * np.float32(np.exp(rng.normal(0, own))) + np.float32(0.4 * rng.normal(0, own))
        picture = np.clip(picture * 255, 0, 255)
        own_blur = blur * np.exp(rng.normal(0, 0.15)) + (rng.uniform(0, 0.8) if rng.random() < 0.1 * amount else 0)
        if own_blur > 0.2:
            picture = cv2.GaussianBlur(picture, (0, 0), float(own_blur))
        if noise:
            picture = picture + np.float32(noise) * rng.standard_normal(picture.shape, np.float32)
        if quality is not None:
            data = cv2.imencode(".jpg", np.clip(picture, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
            picture = cv2.imdecode(data[1], cv2.IMREAD_COLOR).astype(np.float32)
        made.append(picture)
    return made


def _shadow(rng, side: int) -> Float32[np.ndarray, "s s 1"]:
    """An edge of shadow that stays where it is while the head moves under it."""
    angle, place = rng.uniform(0, 2 * np.pi), rng.uniform(-0.5, 0.5)
    x, y = np.meshgrid(*(np.linspace(-1, 1, side, dtype=np.float32),) * 2)
    across = x * np.float32(np.cos(angle)) + y * np.float32(np.sin(angle)) - np.float32(place)
    share = 1 / (1 + np.exp(-across * np.float32(np.exp(rng.uniform(0.5, 3)))))
    return (1 + np.float32(rng.uniform(-0.6, 0.4)) * share)[..., None]


def _places(side: int) -> Float32[np.ndarray, "s s 2"]:
    y, x = np.indices((side, side)).astype(np.float32)
    return np.stack([x, y], axis=-1)


def _affine(zoom, angle, side, middle) -> Float[np.ndarray, "3 3"]:
    """From a training picture's pixels to a source's: its middle shows the source's `middle`."""
    turn = zoom * rolled(angle)
    made = np.eye(3)
    made[:2, :2] = turn
    made[:2, 2] = middle - turn @ np.full(2, (side - 1) / 2)
    return made


def _motion(rng, side, size: float) -> Float[np.ndarray, "3 3"]:
    """A small random shift, turn and zoom about the picture's middle; `size` is the shift's share of the side."""
    angle, zoom = rng.normal(0, size), np.exp(rng.normal(0, 0.7 * size))
    middle = np.full(2, (side - 1) / 2)
    return _affine(zoom, angle, side, middle + rng.normal(0, size, 2) * side)


def _apply(matrix, places):
    return places @ matrix[:2, :2].T.astype(np.float32) + matrix[:2, 2].astype(np.float32)


def _warped(picture, to_source, side, way=cv2.INTER_LINEAR, border=cv2.BORDER_CONSTANT):
    return cv2.warpAffine(picture, to_source[:2], (side, side), flags=way | cv2.WARP_INVERSE_MAP, borderMode=border)
