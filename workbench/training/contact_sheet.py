"""Contact sheets of training pictures: what to look at before hours are spent on them."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.flow.coloring import flow_picture
from workbench.frames import write_picture
from workbench.training import flow_augment
from workbench.training.augment import TRAINING, augmented
from workbench.training.evaluation import CLEAN
from workbench.training.eye_pictures import eye_picture
from workbench.training.flow_pool import open_pair_pool
from workbench.training.pool import open_pool

SHEET = "contact_sheet.jpg"
"""The name of a pool's."""
COLUMNS, CLEAN_ROWS, TRAINING_ROWS = 9, 2, 4
"""Of a sheet: rows of pictures without damage and occluders, and of pictures as the training sees them."""
TILE_PX = 192
PAIR_SIDE = 256
DOT_PX, DOT_COLOR = 1.5, (40, 220, 90)
NO_POINTS = np.zeros((0, 2))


class Sample(NamedTuple):
    """A picture, and the points that a network should find in it."""

    picture: UInt8[np.ndarray, "s s 3"]
    points: Float[np.ndarray, "n 2"] = NO_POINTS


def shown_early(
    report: Callable[[str], None], folder: Path, samples: Callable[[Path], Iterable[Sample]]
) -> Callable[[int, int], None]:
    """The progress of rendering a pool; once a part is done, the folder has a contact sheet of `samples(folder)`."""

    def progress(done: int, total: int) -> None:
        report(f"rendered {done} of {total}")
        if not (folder / SHEET).is_file():
            write_picture(folder / SHEET, contact_sheet(samples(folder)))
            report(f"what the network will see: {folder / SHEET}")

    return progress


def contact_sheet(samples: Iterable[Sample]) -> UInt8[np.ndarray, "h w 3"]:
    """Pictures in rows of `COLUMNS`, the last one full, each of them `TILE_PX` wide and with dots on its points."""
    tiles = [_tile(sample) for sample in samples]
    rows = [np.concatenate(tiles[first : first + COLUMNS], axis=1) for first in range(0, len(tiles), COLUMNS)]
    return np.concatenate(rows)


def face_samples(folder: Path) -> Iterator[Sample]:
    """A sheet of random faces of a pool: the 68 landmarks and the pupils; some pictures show no face."""
    pool, dice = open_pool(folder), np.random.default_rng(0)
    for hardness in _rows(CLEAN, TRAINING, COLUMNS):
        made = augmented(pool, int(dice.integers(len(pool))), dice, hardness=hardness)
        yield Sample(made.picture, made.points if made.is_face else NO_POINTS)


def eye_samples(folder: Path) -> Iterator[Sample]:
    """A sheet of random eyes of a pool: pupil and iris."""
    pool, dice = open_pool(folder), np.random.default_rng(0)
    for hardness in _rows(CLEAN, TRAINING, COLUMNS):
        made = eye_picture(pool, int(dice.integers(len(pool))), int(dice.integers(2)), dice, hardness)
        yield Sample(made.picture, made.points)


def pair_samples(folder: Path) -> Iterator[Sample]:
    """A sheet of random pairs of a pool, three in a row: both pictures, and the flow in Baker's colours."""
    pool, dice = open_pair_pool(folder), np.random.default_rng(0)
    for hardness in _rows(flow_augment.CLEAN, flow_augment.TRAINING, COLUMNS // 3):
        made = flow_augment.augmented_pair(pool, int(dice.integers(len(pool))), dice, PAIR_SIDE, hardness)
        yield from (Sample(made.first), Sample(made.second), Sample(flow_picture(made.flow)))


def _rows(clean, training, columns: int) -> list:
    return [clean] * (CLEAN_ROWS * columns) + [training] * (TRAINING_ROWS * columns)


def _tile(sample: Sample) -> UInt8[np.ndarray, "t t 3"]:
    scale = TILE_PX / len(sample.picture)
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    tile = cv2.resize(sample.picture, (TILE_PX, TILE_PX), interpolation=way)
    for x, y in (sample.points + 0.5) * scale - 0.5:
        sixteenths = (round(16 * float(x)), round(16 * float(y)))
        cv2.circle(tile, sixteenths, round(16 * DOT_PX), DOT_COLOR, cv2.FILLED, cv2.LINE_AA, shift=4)
    return tile
