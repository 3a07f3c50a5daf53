"""Blendshape names in ARKit's spelling, whatever separators and sides a file writes."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from jaxtyping import Float

from workbench.face.default_head import load_default_head

SIDES = {"l": "left", "r": "right"}


@cache
def _spellings() -> dict[str, str]:
    """ARKit's names by their letters in lower case."""
    return {name.lower(): name for name in load_default_head(gaze=True).expression_names}


def arkit_name(name: str) -> str | None:
    """ARKit's spelling of a name such as `JawOpen`, `eyeBlink_L`, `Face.browDown.R`; None for any other."""
    words = "".join(letter if letter.isalnum() else " " for letter in name).split()
    for start in range(len(words)):
        rest = words[start:]
        if len(rest) > 1 and rest[-1].lower() in SIDES:
            rest = [*rest[:-1], SIDES[rest[-1].lower()]]
        if (found := _spellings().get("".join(rest).lower())) is not None:
            return found
    return None


def arkit_shapes(
    names: Sequence[str], deltas: Float[np.ndarray, "k v 3"], bounds: Float[np.ndarray, "k 2"]
) -> tuple[tuple[str, ...], Float[np.ndarray, "n v 3"], Float[np.ndarray, "n 2"]]:
    """The shapes under ARKit's names where these are known.

    Halves of a shape that ARKit has in one, as ICT-FaceKit's `browInnerUp_L` and `_R`, are added up to it; beside the
    whole shape they keep their own names.
    """
    renamed: list[str] = []
    known = [arkit_name(name) for name in names]
    for name, own in zip(names, known, strict=True):
        whole = _whole(name, names)
        whole = None if whole in known else whole
        found = own or whole
        free = found is not None and (found not in renamed or whole is not None)
        renamed.append(found if found is not None and free else name)
    order = list(dict.fromkeys(renamed))
    joined = np.zeros((len(order), *deltas.shape[1:]), deltas.dtype)
    for name, delta in zip(renamed, deltas, strict=True):
        joined[order.index(name)] += delta
    return tuple(order), joined, np.stack([bounds[renamed.index(name)] for name in order]) if order else bounds


def _whole(name: str, names: Sequence[str]) -> str | None:
    """ARKit's name of the shape that `name` is one side of, if the other side is there too and ARKit has no sides."""
    for side, other in (("_L", "_R"), ("_R", "_L")):
        stem = name.removesuffix(side)
        if stem != name and stem + other in names and arkit_name(name) is None:
            return arkit_name(stem)
    return None
