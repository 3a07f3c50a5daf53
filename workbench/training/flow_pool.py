"""The pool of pairs on disk, made once; every training pair is an augmentation of one of them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float16, UInt8

from workbench.errors import InputError
from workbench.face import load_default_head
from workbench.files import atomic_path
from workbench.training.augment import random_background
from workbench.training.flow_scenes import PairStudio, RenderedPair
from workbench.training.pool import array_on_disk, make_shards
from workbench.training.skin import skin_painter

SHARD = 120
"""Pairs in one set of files."""
PAIRS_OF_A_PERSON = 6
BACKGROUNDS, BACKGROUND_SIDE = 40, 384
PARTS = ("pictures", "flows", "marks", "backgrounds")


@dataclass(frozen=True, eq=False)
class PairPool:
    """Rendered pairs, memory-mapped."""

    pictures: list[UInt8[np.ndarray, "n 2 s s 4"]]
    flows: list[Float16[np.ndarray, "n 2 s s 2"]]
    marks: list[UInt8[np.ndarray, "n 2 s s"]]
    backgrounds: list[UInt8[np.ndarray, "m b b 3"]]

    def __len__(self) -> int:
        return SHARD * len(self.pictures)

    def pair(self, index: int) -> RenderedPair:
        """One pair."""
        shard, place = divmod(index, SHARD)
        return RenderedPair(self.pictures[shard][place], self.flows[shard][place], self.marks[shard][place])

    def background(self, rng: np.random.Generator) -> UInt8[np.ndarray, "b b 3"]:
        """A random one."""
        shard = self.backgrounds[rng.integers(len(self.backgrounds))]
        return shard[rng.integers(len(shard))]


def make_pair_shard(folder: Path, seed: int, shard: int) -> None:
    """Render one shard unless it is there: the same seed gives the same pairs."""
    paths = shard_files(folder, shard)
    if all(path.is_file() for path in paths.values()):
        return
    model = load_default_head()
    studio = PairStudio(model, skin_painter(model))
    pairs = []
    try:
        for person in range(SHARD // PAIRS_OF_A_PERSON):
            rng = np.random.default_rng([seed, shard, person])
            who = studio.cast(rng)
            pairs += [studio.shoot(who, rng) for _ in range(PAIRS_OF_A_PERSON)]
    finally:
        studio.close()
    rng = np.random.default_rng([seed, shard, SHARD])
    backgrounds = [random_background(rng, BACKGROUND_SIDE) for _ in range(BACKGROUNDS)]
    arrays = {
        "pictures": np.stack([pair.rgba for pair in pairs]),
        "flows": np.stack([pair.flow for pair in pairs]),
        "marks": np.stack([pair.marks for pair in pairs]),
        "backgrounds": np.clip(np.stack(backgrounds), 0, 255).astype(np.uint8),
    }
    for name, path in paths.items():
        with atomic_path(path) as temporary:
            np.save(temporary, arrays[name])


def make_pair_pool(
    folder: Path, pairs: int, seed: int, workers: int = 1, progress: Callable[[int, int], None] | None = None
) -> None:
    """Render what is missing of a pool of (at least) this many pairs; may be interrupted and called again."""
    make_shards(make_pair_shard, folder, -(-pairs // SHARD), seed, SHARD, workers, progress)


def open_pair_pool(folder: Path, pairs: int | None = None) -> PairPool:
    """The finished shards of a pool, or the first ones, which hold (at least) this many pairs.

    Raises `InputError` if there are none.
    """
    shards = [int(path.stem.split("_")[1]) for path in sorted(folder.glob("marks_*.npy"))]
    files = [shard_files(folder, shard) for shard in shards]
    files = [paths for paths in files if all(path.is_file() for path in paths.values())]
    if pairs is not None:
        files = files[: -(-pairs // SHARD)]
    if not files:
        raise InputError(f"{folder} holds no pool of rendered pairs: `workbench train flow FOLDER` makes one")
    return PairPool(**{
        name: [array_on_disk(paths[name], None if name == "backgrounds" else SHARD) for paths in files]
        for name in PARTS
    })  # fmt: skip


def shard_files(folder: Path, shard: int) -> dict[str, Path]:
    """The files of one shard by part."""
    return {name: folder / f"{name}_{shard:04d}.npy" for name in PARTS}
