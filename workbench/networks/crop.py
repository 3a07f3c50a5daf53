"""S(C(F, D), D) of Deep Energies Sec. 4: the part of a picture that a landmark network sees, and the way back.

C takes the square box D out of the picture, S resizes it to the network's input by bilinear interpolation. Both are
linear in the picture's pixels, so the derivative is exact; the box is constant (∂D/∂F = 0). Here the two are one
resampling, without rounding the box to whole pixels.

Beyond the picture the crop is black. The published 3D-FAN was trained on crops with such borders, and a captured
picture and its render of the same size get the same border, so that it cancels in N(F*) − N(F).
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from workbench.arrays import AnyArray, Scalar
from workbench.errors import InputError

INPUT_SIDE = 256
"""Side of the network's input, pixels."""

FAN_REFERENCE, FAN_PIXELS, FAN_RAISE = 195.0, 200.0, 0.12
"""Width plus height of a face box at scale 1, side of the crop at that scale, rise of the centre in box heights:
`reference_scale`, `SCALE_FACTOR` and `CENTER_Y_OFFSET` of Bulat's face-alignment."""


Edges = tuple[float | int, float | int, float | int, float | int] | Float[np.ndarray, "4"]
"""(left, top, right, bottom) of a face box in pixels."""


class CropBox(NamedTuple):
    """A square in the picture, upright or turned in its plane; all traced, so that another box compiles nothing."""

    centre: Float[AnyArray, "2"]
    """Pixels; (0, 0) is the centre of the top-left pixel."""
    side: Float[AnyArray, ""]
    """Pixels from edge to edge."""
    roll: Float[AnyArray, ""]
    """Radians by which the crop's upright is turned clockwise in the picture, as a head with that roll is."""


def crop_box(edges: Edges, roll: float = 0.0) -> CropBox:
    """The square about a face box (left, top, right, bottom) in pixels: same centre, the mean of its sides.

    Raises `InputError` for an empty box and for numbers that are not finite.
    """
    left, top, right, bottom = _checked_edges(edges)
    if not math.isfinite(roll):
        raise InputError(f"the roll of a crop is an angle in radians, got {roll}")
    return _box((left + right) / 2, (top + bottom) / 2, (right - left + bottom - top) / 2, roll)


def fan_box(edges: Edges, roll: float = 0.0) -> CropBox:
    """The crop that 3D-FAN expects for a face detection (left, top, right, bottom), as in `face_alignment.api`.

    The centre rises by 0.12 box heights (along the roll), and the side is 200 · (width + height) / 195: about twice
    the detector's box. Raises `InputError` as `crop_box` does.
    """
    left, top, right, bottom = _checked_edges(edges)
    box = crop_box(edges, roll)
    rise = FAN_RAISE * (bottom - top)
    x, y = float(box.centre[0]) + rise * math.sin(roll), float(box.centre[1]) - rise * math.cos(roll)
    return _box(x, y, FAN_PIXELS * (right - left + bottom - top) / FAN_REFERENCE, roll)


def fan_box_from_landmarks(points: Float[np.ndarray, "n 2"], roll: float = 0.0) -> CropBox:
    """The crop that 3D-FAN expects of a face whose landmarks (pixels) are known: `fan_box` of their bounding box.

    As `face_alignment.utils.create_bounding_box` without expansion. With a roll the bounding box is taken in the
    turned axes. Raises `InputError` where the points span no box.
    """
    turn = _rotation(np.float64(roll))
    upright = np.asarray(points, np.float64) @ np.asarray(turn)
    low, high = upright.min(axis=0), upright.max(axis=0)
    left, top, right, bottom = _checked_edges((*low, *high))
    rise = FAN_RAISE * (bottom - top)
    x, y = np.asarray(turn) @ np.array([(left + right) / 2, (top + bottom) / 2 - rise])
    return _box(x, y, FAN_PIXELS * (right - left + bottom - top) / FAN_REFERENCE, roll)


def fan_box_of(points: Float[AnyArray, "n 2"]) -> CropBox:
    """`fan_box_from_landmarks` without a roll, traceable."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low
    centre = (low + high) / 2 - jnp.stack([jnp.zeros_like(size[1]), FAN_RAISE * size[1]])
    return CropBox(centre, FAN_PIXELS * size.sum() / FAN_REFERENCE, jnp.zeros_like(size[0]))


def reduction_for(box: CropBox, side: int = INPUT_SIDE) -> int:
    """The `reduction` at which a crop's neighbouring samples lie less than two pixels apart: it skips no pixel."""
    return int(float(box.side) / (2 * side)) + 1


def crop_and_resize(
    picture: Float[AnyArray, "h w c"], box: CropBox, side: int = INPUT_SIDE, reduction: int = 1
) -> Float[Array, "c side side"]:
    """S(C(F, D), D): the picture inside the box as `side` × `side` samples, channels first as networks take it.

    Bilinear as in the paper. A sample reads four pixels: where the box has more than twice the crop's pixels per side,
    plain sampling skips some; the crop aliases and the skipped pixels have no derivative. `reduction` > 1 first
    averages blocks of that many pixels squared, still linear in the picture; `reduction_for` tells which. It is
    static: another one compiles again. Root mean square distance from exact area averages on three photographs, in grey
    levels of 255: 0.9–4.3 at 1.75 pixels a sample (no reduction); at 3, plain 2.1–6.1, reduced 1.0–3.1; at 5, plain
    3.6–11.4, reduced 1.0–3.6.
    """
    if reduction > 1:
        picture = _block_means(jnp.asarray(picture), reduction)
        # A block's centre in the reduced picture's pixels: edges scale, centres lie half a pixel inside.
        box = CropBox((box.centre + 0.5) / reduction - 0.5, box.side / reduction, box.roll)
    return _bilinear(jnp.asarray(picture), _sample_places(box, side))


def within_picture(box: CropBox, image_size: Float[AnyArray, "2"], side: int = INPUT_SIDE) -> Float[Array, "side side"]:
    """How much of each of the crop's samples lies in a picture of `image_size` (width, height): what `crop_and_resize`
    makes of a white one. A render of the crop alone, times this, gets the border that the photo's crop has."""
    places = _sample_places(box, side)
    before, after = 1 + places, jnp.asarray(image_size) - places
    return jnp.clip(jnp.minimum(before, after), 0.0, 1.0).prod(axis=-1)


def seen_in_crop(
    seen: Float[AnyArray, "n n c"],
    matrix: Float[AnyArray, "2 2"],
    origin: Float[AnyArray, "2"],
    box: CropBox,
    side: int = INPUT_SIDE,
) -> Float[Array, "side side c"]:
    """What a square part of a picture shows of a crop: bilinear; beyond the part, its border goes on.

    The picture's pixels lie in the part at points @ matrix.T + origin.
    """
    places = _sample_places(box, side) @ jnp.asarray(matrix).T + jnp.asarray(origin)
    return _bilinear(jnp.asarray(seen), jnp.clip(places, 0, len(seen) - 1)).transpose(1, 2, 0)


def to_picture(points: Float[AnyArray, "n 2"], box: CropBox, side: int) -> Float[Array, "n 2"]:
    """C⁻¹(S⁻¹(m)): from pixels of a map of `side` × `side` pixels that spans the box (the crop, or a heat map) to the
    picture's pixels."""
    unit = (points + 0.5) / side - 0.5
    return (box.side * unit) @ _rotation(box.roll).T + box.centre


def to_crop(points: Float[AnyArray, "n 2"], box: CropBox, side: int | Scalar) -> Float[Array, "n 2"]:
    """The inverse of `to_picture`: from the picture's pixels to those of the crop or heat map."""
    unit = ((points - box.centre) @ _rotation(box.roll)) / box.side
    return (unit + 0.5) * side - 0.5


def whitening_in_picture(whitening: Float[AnyArray, "n 2 2"], box: CropBox, side: int) -> Float[Array, "n 2 2"]:
    """What whitens errors in the picture's pixels, of what whitens them in those of a crop of `side` pixels."""
    return (side / box.side) * whitening @ _rotation(box.roll).T


def _checked_edges(edges: Edges) -> tuple[float, float, float, float]:
    left, top, right, bottom = (float(edge) for edge in edges)
    if not (right > left and bottom > top and np.isfinite([left, top, right, bottom]).all()):
        raise InputError(
            "a face box is (left, top, right, bottom) in pixels with right > left and bottom > top, "
            f"got ({left}, {top}, {right}, {bottom})"
        )
    return left, top, right, bottom


def _box(x: float, y: float, side: float, roll: float) -> CropBox:
    return CropBox(jnp.array([x, y], jnp.float64), jnp.asarray(side, jnp.float64), jnp.asarray(roll, jnp.float64))


def _rotation(roll: Scalar) -> Float[Array, "2 2"]:
    """Clockwise in the picture, since y points down."""
    cosine, sine = jnp.cos(roll), jnp.sin(roll)
    return jnp.stack([jnp.stack([cosine, -sine]), jnp.stack([sine, cosine])])


def _sample_places(box: CropBox, side: int) -> Float[Array, "side side 2"]:
    """Where in the picture the crop's pixel centres lie."""
    rows, columns = np.mgrid[:side, :side].reshape(2, -1)
    return to_picture(np.stack([columns, rows], axis=-1).astype(np.float64), box, side).reshape(side, side, 2)


def _bilinear(picture: Float[Array, "h w c"], places: Float[Array, "m n 2"]) -> Float[Array, "c m n"]:
    """The picture's values between pixel centres; black beyond it, fading over the last pixel."""
    height, width, channels = picture.shape
    corner = jnp.floor(jax.lax.stop_gradient(places))
    x, y = ((places - corner)[..., axis].astype(picture.dtype) for axis in (0, 1))
    column, row = (corner[..., axis].astype(jnp.int32) for axis in (0, 1))
    flat = picture.reshape(height * width, channels)

    def corner_values(down: int, right: int, weight: Float[Array, "m n"]) -> Float[Array, "m n c"]:
        inside = (row + down >= 0) & (row + down < height) & (column + right >= 0) & (column + right < width)
        read = jnp.clip(row + down, 0, height - 1) * width + jnp.clip(column + right, 0, width - 1)
        return jnp.where(inside, weight, 0)[..., None] * flat[read]

    sampled = (
        corner_values(0, 0, (1 - y) * (1 - x))
        + corner_values(0, 1, (1 - y) * x)
        + corner_values(1, 0, y * (1 - x))
        + corner_values(1, 1, y * x)
    )
    return jnp.moveaxis(sampled, -1, 0)


def _block_means(picture: Float[Array, "h w c"], size: int) -> Float[Array, "h2 w2 c"]:
    """Means of size × size blocks; black is added to complete the last ones, as there is black beyond the picture."""
    height, width, channels = picture.shape
    rows, columns = -(-height // size), -(-width // size)
    padded = jnp.pad(picture, ((0, rows * size - height), (0, columns * size - width), (0, 0)))
    return padded.reshape(rows, size, columns, size, channels).mean(axis=(1, 3))
