"""The landmark schemes there are: iBUG's 68 points, those with the two pupils, and dense ones over the whole face.

`dense` continues the 68 and the pupils with some 300 vertices of the default head, which one rule has chosen on its
mesh (`workbench.training.dense_points` states it and writes the table that is read here).
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Int

from workbench.errors import InputError
from workbench.landmarks.scheme import (
    GROUPS,
    IBUG68,
    MIRROR,
    POINT_COUNT,
    POINT_NAMES,
    POLYLINES,
    LandmarkScheme,
)

DENSE_TABLE = Path(__file__).resolve().parent / "dense_points.json"
PUPILS = (POINT_COUNT, POINT_COUNT + 1)
"""The person's right and left one, after the 68."""
PUPIL_NAMES = ("right pupil", "left pupil")


@dataclass(frozen=True, eq=False)
class DensePoints:
    """Vertices of the default head that are landmarks, the surface's first and the irises' last."""

    vertices: Int[np.ndarray, "n"]
    mirror: Int[np.ndarray, "n"]
    """Which of these points each becomes when left and right are swapped; its own inverse."""
    parts: tuple[str, ...]
    """The part of the face of each: eyes, mouth, brows, nose, ears, face or irises."""
    sides: tuple[str, ...]
    """right, left (the subject's) or middle."""

    def __len__(self) -> int:
        return len(self.vertices)


def _read_table() -> DensePoints:
    table = json.loads(DENSE_TABLE.read_text(encoding="utf-8"))
    numbers = (np.array(table[name]) for name in ("vertices", "mirror"))
    return DensePoints(*numbers, tuple(table["parts"]), tuple(table["sides"]))


DENSE_POINTS = _read_table()
FIRST_DENSE = POINT_COUNT + len(PUPILS)
"""The first of the points that `dense` chooses itself."""


def _whole(count: int) -> dict[str, tuple[int, ...]]:
    """The groups of a scheme of so many points that have all of them, or all but the jaw's."""
    return {"all": tuple(range(count)), "non_jaw": tuple(range(len(GROUPS["jaw"]), count))}


def _dense_groups(points: DensePoints) -> Mapping[str, tuple[int, ...]]:
    """The groups of the 68 with the dense points of the same part, and those that only dense points have."""

    def of(part: str, *sides: str) -> tuple[int, ...]:
        both = enumerate(zip(points.parts, points.sides, strict=True), FIRST_DENSE)
        return tuple(k for k, found in both if found[0] == part and (not sides or found[1] in sides))

    count = FIRST_DENSE + len(points)
    grown = {name: GROUPS[name] + of(name) for name in ("brows", "nose", "eyes", "mouth")}
    for side in ("right", "left"):
        grown |= {f"{side}_{part}": GROUPS[f"{side}_{part}"] + of(f"{part}s", side) for part in ("brow", "eye")}
    added = {"dense": tuple(range(FIRST_DENSE, count)), "pupils": PUPILS, "irises": PUPILS + of("irises")}
    added |= {part: of(part) for part in ("ears", "face")}
    return MappingProxyType({**GROUPS, **grown, **_whole(count), **added})


def _dense_names(points: DensePoints) -> tuple[str, ...]:
    kinds = zip(points.sides, points.parts, strict=True)
    chosen = (f"{side} {part}, dense point {number}" for number, (side, part) in enumerate(kinds, FIRST_DENSE))
    return (*POINT_NAMES, *PUPIL_NAMES, *chosen)


def _with_pupils() -> LandmarkScheme:
    count = POINT_COUNT + len(PUPILS)
    return LandmarkScheme(
        name="ibug68+pupils",
        point_names=(*POINT_NAMES, *PUPIL_NAMES),
        groups=MappingProxyType({**GROUPS, **_whole(count), "pupils": PUPILS, "irises": PUPILS}),
        polylines=POLYLINES,
        mirror=(*MIRROR, *PUPILS[::-1]),
    )


def _dense_scheme(points: DensePoints) -> LandmarkScheme:
    groups = _dense_groups(points)
    borders = groups["irises"][len(PUPILS) :]
    rings = borders[: len(borders) // 2], borders[len(borders) // 2 :]
    return LandmarkScheme(
        name="dense",
        point_names=_dense_names(points),
        groups=groups,
        polylines=(*POLYLINES, *((*ring, ring[0]) for ring in rings)),
        mirror=(*MIRROR, *PUPILS[::-1], *(FIRST_DENSE + points.mirror).tolist()),
        has_covariances=True,
    )


IBUG68_PUPILS = _with_pupils()
DENSE = _dense_scheme(DENSE_POINTS)
SCHEMES: Mapping[str, LandmarkScheme] = MappingProxyType(
    {scheme.name: scheme for scheme in (IBUG68, IBUG68_PUPILS, DENSE)}
)
"""By name."""
OF_DETECTORS: Mapping[str, LandmarkScheme] = MappingProxyType({"network+pupils": IBUG68_PUPILS, "dense": DENSE})
"""By the detector's name; all others answer the 68."""
MOST_POINTS = max(len(scheme) for scheme in SCHEMES.values())
_COUNTS = [f"{len(scheme)} points ({scheme.name})" for scheme in SCHEMES.values()]
_LISTED = f"{', '.join(_COUNTS[:-1])} or {_COUNTS[-1]}"


def detector_scheme(name: str) -> LandmarkScheme:
    """What the points of a detector are called."""
    return OF_DETECTORS.get(name, IBUG68)


def scheme_of_count(count: int) -> LandmarkScheme:
    """The scheme with this many points: no two have the same number. Raises `InputError` for other numbers."""
    for scheme in SCHEMES.values():
        if len(scheme) == count:
            return scheme
    raise InputError(f"a face has {_LISTED}, got {count}: convert other schemes first")


def scheme_named(name: str) -> LandmarkScheme:
    """The scheme that a file names. Raises `InputError` for one that is not known."""
    if name not in SCHEMES:
        raise InputError(f"there is no landmark scheme {name!r}: the schemes are {', '.join(SCHEMES)}")
    return SCHEMES[name]
