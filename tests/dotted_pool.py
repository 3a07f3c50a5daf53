"""A pool of training pictures whose landmarks can be seen."""

import os
from pathlib import Path

import cv2
import numpy as np

from workbench.landmarks.alignment import MEAN_SHAPE
from workbench.pictures.gl_probe import WINDOW_VARIABLE
from workbench.training.pool import SHARD, shard_paths

SIDE = 96
"""Pixels of its pictures."""


def write_dotted_pool(folder: Path) -> Path:
    """Grey discs with a white dot at each landmark of a face that stands upright, in three sizes."""
    pictures = np.zeros((SHARD, SIDE, SIDE, 4), np.uint8)
    points = np.zeros((SHARD, 70, 2), np.float32)
    for k in range(SHARD):
        middle, side = np.array([SIDE / 2, SIDE / 2]) + (k % 5 - 2), (36, 42, 48)[k % 3]
        points[k, :68] = MEAN_SHAPE * side + middle
        points[k, 68:] = points[k, 36:42].mean(0), points[k, 42:48].mean(0)
        cv2.circle(pictures[k], tuple(np.rint(middle).astype(int).tolist()), side, (120, 110, 100, 255), -1)
        for x, y in np.rint(points[k, :68]).astype(int):
            pictures[k, y, x, :3] = 255
    pictures_path, numbers_path = shard_paths(folder, 0)
    np.save(pictures_path, pictures)
    vertices = np.broadcast_to(points[:, :1], (SHARD, 4, 2))
    numbers = {"angles": np.zeros((SHARD, 3)), "expressions": np.zeros((SHARD, 52)), "glasses": np.zeros(SHARD, bool)}
    np.savez(numbers_path, points=points, vertices=vertices, **numbers)
    return folder


def write_window(folder: Path, seed: int, shard: int) -> None:
    """A shard that says which kind of window its process would draw in."""
    (folder / f"window_{shard}").write_text(os.environ.get(WINDOW_VARIABLE, "VTK's own choice"))
