"""Readers that do what no reader may, for the judge in `fuzzing`."""

import os
import time
from pathlib import Path

import numpy as np

from workbench.errors import InputError
from workbench.reading import reading


def accepting(folder: Path) -> None:
    """Takes anything."""


def refusing(folder: Path) -> None:
    raise InputError("This is no head; bake it again.")


def finding_one_file(folder: Path) -> None:
    assert len([path for path in folder.rglob("*") if path.is_file()]) == 1


def leaking(folder: Path) -> None:
    raise KeyError("jaw")


def making_no_sense(folder: Path) -> None:
    assert np.isfinite(np.nan), "a point that is not finite"


def rambling(folder: Path) -> None:
    raise InputError("first line\nsecond line")


def greedy(folder: Path) -> None:
    with reading(folder, "a head", "bake it again"):
        np.ones(3 * 1024**3, np.uint8)


def never_ready(folder: Path) -> None:
    time.sleep(60)


def crashing(folder: Path) -> None:
    os.abort()
