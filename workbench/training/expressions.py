"""Expressions of fits: how expressions usually are, learned from them, and training pictures that show them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from workbench.errors import InputError
from workbench.face import load_default_head
from workbench.face.gaze import GAZE_NAMES
from workbench.face.usual_expressions import Moments, other_side, write_moments
from workbench.reading import shortened
from workbench.tracking import Track
from workbench.tracking.track_writer import PARTS_SUFFIX, UNREFINED
from workbench.training.report import write_tables
from workbench.training.scenes import random_expression

SEED = 3
TRACKS = "tracks"
"""The subfolder whose tracks are learned from, too."""
FITTED = 0.3
"""Share of the training pictures that show the expression of a fit, where there are tracks."""
AMOUNT = (0.7, 2.0)
"""How much of it they show: fits make expressions weaker than they are."""
Mien = Callable[[tuple[str, ...], np.random.Generator], Float[np.ndarray, "k"]]
"""Draws the weights of an expression."""


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
    process, whatever `workers` and `device` are. Raises as `fitted_weights` does.
    """
    names = load_default_head(gaze=True).expression_names
    rng = np.random.default_rng(SEED)
    drawn = second_moment(np.array([random_expression(names, rng) for _ in range(recipe.drawn)]))
    fitted = [second_moment(weights) for weights in fitted_weights(folder, names)]
    report(f"learned from {recipe.drawn} random expressions and from {counted_tracks(fitted)}")
    second = 0.5 * (drawn + np.mean(fitted, axis=0)) if fitted else drawn
    path = folder / "expressions.safetensors"
    notes = {"licence": "Apache-2.0", "expressions": str(recipe.drawn), "tracks": str(len(fitted))}
    moments = Moments(names, second)
    write_moments(path, moments, notes)
    write_tables(folder, "expressions", together(moments))
    return path


def second_moment(weights: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k k"]:
    """The mean of w wᵀ over expressions."""
    return weights.T @ weights / len(weights)


def fitted_weights(folder: Path, names: Sequence[str]) -> list[Float[np.ndarray, "n k"]]:
    """The weights of the fitted frames of each track in `folder/tracks`; none without that folder.

    Of a run's folder its track alone counts. Raises `InputError` for a track without a fitted frame or without any of
    the blendshapes.
    """
    found = sorted((folder / TRACKS).rglob("*.npz"))
    tracks = [path for path in found if path.name != UNREFINED and not path.parent.name.endswith(PARTS_SUFFIX)]
    return [weights_of(Track.load(path), path, names) for path in tracks]


def counted_tracks(fits: Sequence[Float[np.ndarray, "n k"]]) -> str:
    """How many tracks these are the weights of, in words."""
    return f"{len(fits)} track{'' if len(fits) == 1 else 's'}"


def weights_of(track: Track, path: Path, names: Sequence[str]) -> Float[np.ndarray, "n k"]:
    """The weights of a track's fits, 0 for blendshapes that it lacks. Raises `InputError` if it has no fits or none
    of the blendshapes.
    """
    fits = track.expression[track.seen]
    if len(fits) == 0:
        raise InputError(f"{path} has no fitted frame to learn expressions from; take it out of {path.parent}.")
    known = [name for name in names if name in track.expression_names]
    if not known:
        first = shortened(", ".join(track.expression_names[:3]))
        raise InputError(
            f"{path} has none of the head's blendshapes (its first are {first}); take it out of {path.parent}."
        )
    weights = np.zeros((len(fits), len(names)))
    columns = [track.expression_names.index(name) for name in known]
    weights[:, [names.index(name) for name in known]] = fits[:, columns]
    return weights


def partly_fitted(mien: Mien, fits: Sequence[Float[np.ndarray, "n k"]]) -> Mien:
    """Draws as `mien` does, but for a share (`FITTED`) that are fits: more or less of one, as it is or mirrored.

    Every track comes equally often, whatever its length. The eyes look where `mien` has them look.
    """
    if not fits:
        return mien

    def draw(names: tuple[str, ...], rng: np.random.Generator) -> Float[np.ndarray, "k"]:
        drawn = mien(names, rng)
        if rng.random() >= FITTED:
            return drawn
        track = fits[rng.integers(len(fits))]
        fit = np.clip(rng.uniform(*AMOUNT) * track[rng.integers(len(track))], 0.0, 1.0)
        if rng.random() < 0.5:
            fit = fit[[names.index(other_side(name)) for name in names]]
        return np.where([name in GAZE_NAMES for name in names], drawn, fit)

    return draw


def together(moments: Moments, most: int = 24) -> dict[str, dict[str, float]]:
    """The pairs of blendshapes that go together most: the cosine between the weights of each."""
    size = np.sqrt(np.diag(moments.second)).clip(min=1e-9)
    cosines = np.triu(moments.second / np.outer(size, size), 1)
    rows, columns = np.unravel_index(np.argsort(cosines, axis=None)[::-1][:most], cosines.shape)
    return {
        f"{moments.names[row]}, {moments.names[column]}": {"cosine": float(cosines[row, column])}
        for row, column in zip(rows, columns, strict=True)
    }
