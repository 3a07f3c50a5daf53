"""How expressions usually are, learned: the second moment of the weights that training pictures show, and of fits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from workbench.errors import InputError
from workbench.face import load_default_head
from workbench.face.usual_expressions import Moments, write_moments
from workbench.tracking import Track
from workbench.training.report import write_tables
from workbench.training.scenes import random_expression

SEED = 3
TRACKS = "tracks"
"""The subfolder whose tracks are learned from, too."""


@dataclass(frozen=True)
class ExpressionRecipe:
    """Sizes of one learning; the defaults made the bundled moments."""

    drawn: int = 20_000
    """Expressions of the kind that training pictures show."""


QUICK_EXPRESSIONS = ExpressionRecipe(drawn=500)


def learn_expressions(
    folder: Path,
    recipe: ExpressionRecipe = ExpressionRecipe(),
    workers: int = 1,
    device: str = "cpu",
    report: Callable[[str], None] = print,
) -> Path:
    """Learn `folder/expressions.safetensors`: half of random expressions, half of the tracks in `folder/tracks`.

    Without tracks, of random expressions alone. Each track counts alike, whatever its length. It takes seconds, by one
    process, whatever `workers` and `device` are. Raises `InputError` for a track without a fitted frame.
    """
    names = load_default_head(gaze=True).expression_names
    rng = np.random.default_rng(SEED)
    drawn = second_moment(np.array([random_expression(names, rng) for _ in range(recipe.drawn)]))
    paths = sorted((folder / TRACKS).rglob("*.npz"))
    fitted = [moment_of(Track.load(path), path, names) for path in paths]
    report(f"learned from {recipe.drawn} random expressions and from {len(paths)} tracks")
    second = 0.5 * (drawn + np.mean(fitted, axis=0)) if fitted else drawn
    path = folder / "expressions.safetensors"
    notes = {"licence": "Apache-2.0", "expressions": str(recipe.drawn), "tracks": str(len(paths))}
    moments = Moments(names, second)
    write_moments(path, moments, notes)
    write_tables(folder, "expressions", together(moments))
    return path


def second_moment(weights: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k k"]:
    """The mean of w wᵀ over expressions."""
    return weights.T @ weights / len(weights)


def moment_of(track: Track, path: Path, names: Sequence[str]) -> Float[np.ndarray, "k k"]:
    """The second moment of a track's fits, 0 for blendshapes that it lacks. Raises `InputError` if there are none."""
    fits = track.expression[track.seen]
    if len(fits) == 0:
        raise InputError(f"{path} has no fitted frame to learn expressions from; take it out of {path.parent}.")
    known = [name for name in names if name in track.expression_names]
    weights = np.zeros((len(fits), len(names)))
    columns = [track.expression_names.index(name) for name in known]
    weights[:, [names.index(name) for name in known]] = fits[:, columns]
    return second_moment(weights)


def together(moments: Moments, most: int = 24) -> dict[str, dict[str, float]]:
    """The pairs of blendshapes that go together most: the cosine between the weights of each."""
    size = np.sqrt(np.diag(moments.second)).clip(min=1e-9)
    cosines = np.triu(moments.second / np.outer(size, size), 1)
    rows, columns = np.unravel_index(np.argsort(cosines, axis=None)[::-1][:most], cosines.shape)
    return {
        f"{moments.names[row]}, {moments.names[column]}": {"cosine": float(cosines[row, column])}
        for row, column in zip(rows, columns, strict=True)
    }
