"""The workbench's own face finder: one look at the whole picture, and the boxes of the faces in it."""

import math
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import ModelError
from workbench.networks.encoder import network_size
from workbench.networks.frozen import FrozenNetwork
from workbench.networks.landmark_network import LandmarkNetwork, empty_landmark_network
from workbench.networks.weights import Weights, fill, read_weights
from workbench.reading import shortened

NAME = "face-energy-finder-1"
"""Value of the metadata key `architecture`."""
INPUT_SIDE = 256
"""A picture's longer side is brought to this; the rest of the square is filled up with grey."""
STRIDE = 4
OUTPUTS = 4
UNIT_SIDE = 64.0
"""Box side in input pixels whose logarithm is 0."""
PADDING_GREY = 114
MAX_ENLARGEMENT = 4.0
SMALLEST_PART = 192
"""Side in pixels of the smallest parts that are looked at, where faces of 16 pixels are seen."""
OVERLAP = 1 / 3
"""Of neighbouring parts: larger faces show in the larger parts."""
LEAST_SCORE = 0.2
"""Low, because the landmark network rejects what is not a face, and a face that is not proposed is lost."""
SAME_FACE = 0.35
"""Boxes that share more of their union than this are one face."""

FoundFace = tuple[tuple[float, float, float, float], float]
"""(left, top, right, bottom) in pixels, and the score 0..1."""


class FaceFinder:
    """Finds faces with boxes as `landmarks.alignment` draws them: brows to chin, cheek to cheek, square, upright."""

    def __init__(self, network: LandmarkNetwork) -> None:
        self._maps = FrozenNetwork(network)

    def find(self, picture: UInt8[np.ndarray, "h w 3"], least_score: float = LEAST_SCORE) -> list[FoundFace]:
        """The faces in a picture, surest first; a face of less than a twelfth of its longer side may be missed."""
        square, scale = padded_square(picture)
        faces = [(_unscaled(box, scale), score) for box, score in boxes_of(self._maps(square), least_score)]
        return without_doubles(faces)

    def find_smaller(
        self, picture: UInt8[np.ndarray, "h w 3"], least_score: float = LEAST_SCORE
    ) -> Iterator[list[FoundFace]]:
        """What `find` finds in overlapping parts of the picture: first of half its longer side, then of a quarter, …"""
        height, width = picture.shape[:2]
        for side in part_sides(max(height, width)):
            faces = []
            for top, left in product(starts(height, side), starts(width, side)):
                part = np.ascontiguousarray(picture[top : top + side, left : left + side])
                for (x0, y0, x1, y1), score in self.find(part, least_score):
                    faces.append(((x0 + left, y0 + top, x1 + left, y1 + top), score))
            yield without_doubles(faces)


def read_face_finder(path: str | Path) -> FaceFinder:
    """The finder of a safetensors file.

    Raises `InputError` for a file that cannot be read and `ModelError` for weights of another network.
    """
    return face_finder_from(read_weights(path))


def face_finder_from(weights: Weights) -> FaceFinder:
    """As `read_face_finder`, of weights in memory."""
    if weights.architecture != NAME:
        raise ModelError(
            f"{weights.origin} should hold the weights of {NAME}, but its metadata names "
            f"{shortened(weights.architecture)}"
        )
    widths, blocks = network_size(weights)
    return FaceFinder(fill(lambda: empty_landmark_network(widths, blocks, outputs=OUTPUTS), weights))


def part_sides(longest: int, smallest: int = SMALLEST_PART) -> Iterator[int]:
    """Sides of the parts of a picture with this longer side, in pixels, ever smaller."""
    side = longest
    while side > smallest:
        side = max(-(-side // 2), smallest)
        yield side


def starts(length: int, side: int) -> list[int]:
    """Where parts of this side begin that cover a length and overlap by `OVERLAP`, evenly spaced."""
    count = 1 + max(0, math.ceil((length - side) / ((1 - OVERLAP) * side)))
    return [round(start) for start in np.linspace(0, max(0, length - side), count)]


def padded_square(picture: UInt8[np.ndarray, "h w 3"]) -> tuple[UInt8[np.ndarray, "s s 3"], float]:
    """The picture in the upper left of the finder's input, and how many input pixels one of its pixels became."""
    height, width = picture.shape[:2]
    scale = min(INPUT_SIDE / max(height, width), MAX_ENLARGEMENT)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    square = np.full((INPUT_SIDE, INPUT_SIDE, 3), PADDING_GREY, np.uint8)
    square[: size[1], : size[0]] = cv2.resize(picture, size, interpolation=way)
    return square, scale


def boxes_of(maps: Float[np.ndarray, "4 m m"], least_score: float) -> list[FoundFace]:
    """The maxima of the score map as boxes in input pixels, surest first."""
    score = 1 / (1 + np.exp(-maps[0].astype(np.float64)))
    highest = cv2.dilate(score, np.ones((3, 3)))
    rows, columns = np.nonzero((score >= highest) & (score > least_score))
    faces = []
    for row, column in zip(rows, columns, strict=True):
        _, log_side, across, down = (float(value) for value in maps[:, row, column])
        half = UNIT_SIDE * np.exp(np.clip(log_side, -3, 3)) / 2
        x, y = ((cell + 0.5) * STRIDE - 0.5 + UNIT_SIDE * shift for cell, shift in ((column, across), (row, down)))
        faces.append(((float(x - half), float(y - half), float(x + half), float(y + half)), float(score[row, column])))
    return sorted(faces, key=lambda face: -face[1])


def _unscaled(box, scale: float):
    # Edges, not centres, are what scales.
    left, top, right, bottom = ((edge + 0.5) / scale - 0.5 for edge in box)
    return left, top, right, bottom


def without_doubles(faces: list[FoundFace]) -> list[FoundFace]:
    """The surest of each group of boxes that overlap."""
    kept: list[FoundFace] = []
    for face in sorted(faces, key=lambda face: -face[1]):
        if all(_shared(face[0], other[0]) < SAME_FACE for other in kept):
            kept.append(face)
    return kept


def _shared(a, b) -> float:
    """Intersection over union."""
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    both = width * height
    return both / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - both)
