"""The pool: many renders on disk, made once; every training picture is an augmentation of one of them."""

import multiprocessing
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from workbench.errors import InputError
from workbench.face import load_default_head
from workbench.files import atomic_path, make_folder
from workbench.pictures.gl_probe import gl_available
from workbench.reading import reading
from workbench.training.expressions import partly_fitted
from workbench.training.scenes import EYES_VIEW, FACE_VIEW, FaceStudio, looking_around, random_expression
from workbench.training.skin import skin_painter

SHARD = 240
"""Pictures in one file pair."""
NUMBERS = ("points", "vertices", "angles", "expressions", "glasses")
"""What is known of each picture."""
PICTURES_OF_A_PERSON = 4
DAMAGED = "a part of a training's pool", "delete it and repeat the command, which renders it again"
"""What a file of a pool should be, and what to do where it is not."""


@dataclass(frozen=True, eq=False)
class Pool:
    """Rendered heads, memory-mapped."""

    pictures: list[UInt8[np.ndarray, "n h w 4"]]
    points: list[Float[np.ndarray, "n 70 2"]]
    vertices: list[Float[np.ndarray, "n v 2"]]
    angles_deg: list[Float[np.ndarray, "n 3"]]
    expressions: list[Float[np.ndarray, "n k"]]
    worn_glasses: list[Bool[np.ndarray, "n"]]

    def __len__(self) -> int:
        return SHARD * len(self.pictures)

    def picture(self, index: int) -> tuple[UInt8[np.ndarray, "h w 4"], Float[np.ndarray, "70 2"]]:
        """RGBA (colours multiplied by coverage), and the 68 landmarks with the two pupils."""
        shard, place = divmod(index, SHARD)
        return self.pictures[shard][place], self.points[shard][place]

    def surface(self, index: int, vertices: Int[np.ndarray, "m"]) -> Float[np.ndarray, "m 2"]:
        """Where these vertices of the head are, pixels."""
        shard, place = divmod(index, SHARD)
        return self.vertices[shard][place][vertices]

    def angles(self, index: int) -> Float[np.ndarray, "3"]:
        """Yaw, pitch, roll in degrees."""
        shard, place = divmod(index, SHARD)
        return self.angles_deg[shard][place]

    def expression(self, index: int) -> Float[np.ndarray, "k"]:
        """Blendshape weights in the default head's order."""
        shard, place = divmod(index, SHARD)
        return self.expressions[shard][place]

    def glasses(self, index: int) -> bool:
        """Whether the person wears some."""
        shard, place = divmod(index, SHARD)
        return bool(self.worn_glasses[shard][place])


KINDS = {"faces": (FACE_VIEW, random_expression), "eyes": (EYES_VIEW, looking_around)}
"""What a pool's pictures show, and how expressions are drawn."""


def make_shard(
    folder: Path, seed: int, shard: int, kind: str = "faces", fits: Sequence[Float[np.ndarray, "n k"]] = ()
) -> None:
    """Render one shard unless it is there: the same seed gives the same people.

    A share of them shows expressions of `fits` (`partly_fitted`), the weights of one track each.
    """
    pictures_path, numbers_path = shard_paths(folder, shard)
    if pictures_path.is_file() and numbers_path.is_file():
        return
    model = load_default_head(gaze=True)
    view, mien = KINDS[kind]
    studio = FaceStudio(model, skin_painter(model), view, partly_fitted(mien, fits))
    faces = []
    try:
        for person in range(SHARD // PICTURES_OF_A_PERSON):
            rng = np.random.default_rng([seed, shard, person])
            who = studio.cast(rng)
            faces += [studio.shoot(who, rng) for _ in range(PICTURES_OF_A_PERSON)]
    finally:
        studio.close()
    with atomic_path(numbers_path) as path:
        np.savez(
            path,
            points=np.stack([face.points for face in faces]).astype(np.float32),
            vertices=np.stack([face.vertices for face in faces]).astype(np.float32),
            angles=np.stack([face.yaw_pitch_roll_deg for face in faces]).astype(np.float32),
            expressions=np.stack([face.expression for face in faces]).astype(np.float32),
            glasses=np.array([face.glasses for face in faces]),
        )
    with atomic_path(pictures_path) as path:
        np.save(path, np.stack([face.rgba for face in faces]))


def make_pool(
    folder: Path,
    pictures: int,
    seed: int,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
    kind: str = "faces",
    fits: Sequence[Float[np.ndarray, "n k"]] = (),
) -> None:
    """Render what is missing of a pool of (at least) this many pictures; may be interrupted and called again.

    `kind` and `fits` as in `make_shard`.
    """
    make_shards(
        partial(make_shard, kind=kind, fits=fits), folder, -(-pictures // SHARD), seed, SHARD, workers, progress
    )


def make_shards(
    make: Callable[[Path, int, int], None],
    folder: Path,
    count: int,
    seed: int,
    size: int,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """`make(folder, seed, shard)` for each shard of `size` entries, over processes; progress counts entries."""
    make_folder(folder)
    gl_available()  # names the window that needs no display, also to the processes
    # A fresh process now and then: a GL context does not survive a fork, and nothing piles up in memory.
    with multiprocessing.get_context("spawn").Pool(workers, maxtasksperchild=4) as processes:
        for done, _ in enumerate(processes.imap(partial(make, folder, seed), range(count)), 1):
            if progress is not None:
                progress(done * size, count * size)


def open_pool(folder: Path, pictures: int | None = None) -> Pool:
    """The finished shards of a pool, or the first ones, which hold (at least) this many pictures.

    A pool may be larger than one training asks for, where another one shares it. Raises `InputError` if there are none.
    """
    shards = [
        (folder / f"numbers_{path.stem.split('_')[1]}.npz", path) for path in sorted(folder.glob("pictures_*.npy"))
    ]
    shards = [paths for paths in shards if paths[0].is_file()]
    if pictures is not None:
        shards = shards[: -(-pictures // SHARD)]
    if not shards:
        raise InputError(f"{folder} holds no pool of rendered heads: `workbench train landmarks FOLDER` makes one")
    numbers = [_numbers_in(path) for path, _ in shards]
    return Pool(
        pictures=[array_on_disk(path, SHARD) for _, path in shards],
        points=[shard["points"] for shard in numbers],
        vertices=[shard["vertices"] for shard in numbers],
        angles_deg=[shard["angles"] for shard in numbers],
        expressions=[shard["expressions"] for shard in numbers],
        worn_glasses=[shard["glasses"] for shard in numbers],
    )


def array_on_disk(path: Path, rows: int | None) -> np.ndarray:
    """An array of a pool, read as it is used, with so many rows; None: as many as there are.

    Raises `InputError` for a damaged file, and for one of another number of rows.
    """
    with reading(path, *DAMAGED):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if rows is not None:
            _check_rows(path.stem, array, rows)
        return array


def _numbers_in(path: Path) -> dict[str, np.ndarray]:
    with reading(path, *DAMAGED), path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
        numbers = dict(stored)
        if missing := [name for name in NUMBERS if name not in numbers]:
            raise ValueError(f"it lacks {', '.join(missing)}")
        for name in NUMBERS:
            _check_rows(name, numbers[name], SHARD)
        return numbers


def _check_rows(name: str, array: np.ndarray, rows: int) -> None:
    if np.shape(array)[:1] != (rows,):
        raise ValueError(f"{name} should have {rows} rows, got the shape {np.shape(array)}")


def halves(pool: Pool) -> tuple[Pool, Pool]:
    """Two pools of other people; one of a single shard is both."""
    middle = len(pool.pictures) // 2
    parts = (slice(None, middle), slice(middle, None)) if middle else (slice(None), slice(None))
    return tuple(Pool(**{name: shards[part] for name, shards in vars(pool).items()}) for part in parts)


def shard_paths(folder: Path, shard: int) -> tuple[Path, Path]:
    """The files of one shard: pictures and numbers."""
    return folder / f"pictures_{shard:04d}.npy", folder / f"numbers_{shard:04d}.npz"
