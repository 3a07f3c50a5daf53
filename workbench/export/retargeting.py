"""A performance on another character: by the names of the blendshapes, or by least squares on the surface.

Both give a `Track` whose weights are the character's, so that everything that reads tracks plays the character.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from workbench.errors import InputError, ModelError
from workbench.export.clip import main_identity, without_jaw
from workbench.export.live_link import LIVE_LINK_SHAPES
from workbench.face import FaceModel, fits_as
from workbench.face.formats.raw import is_statistical
from workbench.face.formats.shape_names import arkit_name
from workbench.landmarks.scheme import POINT_COUNT
from workbench.reading import checked_file, reading, shortened, toml_tables
from workbench.tracking import Track
from workbench.tracking.track_layout import model_record


@dataclass(frozen=True, eq=False)
class ShapeMapping:
    """Weights of a character as sums of a performer's: character = performer @ matrix."""

    source_names: tuple[str, ...]
    target_names: tuple[str, ...]
    matrix: Float[np.ndarray, "s t"]

    @property
    def unused(self) -> tuple[str, ...]:
        """Blendshapes of the performer that move nothing."""
        return tuple(name for name, row in zip(self.source_names, self.matrix, strict=True) if not row.any())

    @property
    def still(self) -> tuple[str, ...]:
        """Blendshapes of the character that nothing moves."""
        return tuple(name for name, column in zip(self.target_names, self.matrix.T, strict=True) if not column.any())


def mapping_by_names(source_names: tuple[str, ...], target_names: tuple[str, ...]) -> ShapeMapping:
    """Equal names mapped to each other, ARKit's in whatever spelling: `jawOpen`, `JawOpen`, `jaw_open`, `Face.JawOpen`.

    `_L` and `_R` at the end are Left and Right. Components of statistical bases are named by numbers, which mean
    nothing in another basis: they are not mapped. Raises `InputError` where no name is found in both.
    """
    matrix = np.zeros((len(source_names), len(target_names)))
    columns = {arkit_name(name) or name: column for column, name in reversed(list(enumerate(target_names)))}
    for row, name in enumerate(source_names):
        column = None if is_statistical(name) else columns.get(arkit_name(name) or name)
        if column is not None:
            matrix[row, column] = 1.0
    if not matrix.any():
        raise InputError(
            f"The character has none of the track's blendshapes by name ({', '.join(target_names[:4])} …); "
            "write a mapping file."
        )
    return ShapeMapping(source_names, target_names, matrix)


def mapping_of_track(track: Track, character: FaceModel) -> ShapeMapping:
    """Each blendshape of the model that was tracked to itself, those of another character by their names.

    Raises `InputError` as `mapping_by_names` does.
    """
    names = track.expression_names, character.expression_names
    tracked = (track.meta.get("model") or {}).get("sha256")
    if names[0] == names[1] and tracked is not None and fits_as(character, tracked):
        return ShapeMapping(*names, np.eye(len(names[0])))
    return mapping_by_names(*names)


def read_mapping(path: str | Path, source_names: tuple[str, ...], target_names: tuple[str, ...]) -> ShapeMapping:
    """A mapping file (TOML): below `[shapes]`, each of the character's blendshapes as one of ours, or a sum of some.

        [shapes]
        Mouth_Open = "jawOpen"
        Smile = { mouthSmileLeft = 0.5, mouthSmileRight = 0.5 }

    Raises `InputError` for a file that cannot be read, and for names and factors that do not exist. ARKit's names are
    accepted where the track lacks them: they are 0.
    """
    absent = f"The mapping file {path} does not exist; it names the character's blendshapes."
    path = checked_file(path, "a mapping file", absent=absent)
    with reading(path, "a mapping file", "name each of the character's blendshapes below [shapes]"):
        return _mapping(path, toml_tables(path).get("shapes"), source_names, target_names)


def _mapping(path: Path, shapes: Any, source_names: tuple[str, ...], target_names: tuple[str, ...]) -> ShapeMapping:
    if not isinstance(shapes, dict) or not shapes:
        raise InputError(f'{path} needs a table [shapes] with lines such as Mouth_Open = "jawOpen".')
    matrix = np.zeros((len(source_names), len(target_names)))
    for target, parts in shapes.items():
        if target not in target_names:
            raise InputError(f"{path} names {_quoted(target)}, the character has {_listed(target_names)}.")
        for source, factor in _parts(parts, target, path).items():
            if source in source_names:
                matrix[source_names.index(source), target_names.index(target)] = factor
            elif source not in LIVE_LINK_SHAPES:
                raise InputError(f"{path} names {_quoted(source)}, the track has {_listed(source_names)}.")
    return ShapeMapping(source_names, target_names, matrix)


def retarget(track: Track, character: FaceModel, mapping: ShapeMapping | None = None) -> Track:
    """The track played by the character's blendshapes, on its own neutral face; the pose is the performer's.

    Without `mapping`, names that mean the same are mapped (`mapping_by_names`), and all of them to the model that was
    tracked. Raises `InputError` for a mapping between other blendshapes.
    """
    mapping = mapping or mapping_of_track(track, character)
    if mapping.source_names != track.expression_names or mapping.target_names != character.expression_names:
        raise InputError("The mapping was made for other blendshapes; make it for this track and this character.")
    return _played(track, character, without_jaw(track).expression @ mapping.matrix)


def retarget_surface(track: Track, performer: FaceModel, character: FaceModel, smoothness: float | int = 1e-3) -> Track:
    """The track played by the weights in range with which the character's surface moves most like the performer's.

    Each frame minimises ‖Σ w_k c_k − s·Σ v_j p_j‖² + λ‖w‖² over all vertices, for a performer and a character in
    vertex correspondence whose blendshapes may differ in number, name and travel. s is the ratio of their sizes, λ
    `smoothness` of the mean energy of the character's shapes. Shapes whose range is one weight keep it. Raises
    `ModelError` for meshes out of correspondence.
    """
    if performer.neutral.shape != character.neutral.shape or not np.array_equal(
        performer.triangles, character.triangles
    ):
        raise ModelError(
            f"A retargeting over the surface needs two meshes with the same vertices and triangles, got "
            f"{len(performer.neutral)} and {len(character.neutral)} vertices; retarget by names."
        )
    if not track.found.any():
        raise InputError("No frame of this track has a face, so there is nothing to retarget.")
    person = performer.personal(main_identity(track)[0])
    moves = _size(character) / _size(person) * person.expression_deltas.reshape(len(person.expression_names), -1)
    shapes = character.expression_deltas.reshape(len(character.expression_names), -1)
    low, high = character.weight_range().T
    free = low < high
    weights = np.where(track.found[:, None], low, np.nan)
    if not free.any():
        return _played(track, character, weights)
    fixed, shapes = low[~free] @ shapes[~free], shapes[free]
    gram = shapes @ shapes.T
    gram += max(float(smoothness), 1e-12) * np.trace(gram) / len(gram) * np.eye(len(gram))
    # The Cholesky factor L of the Gram matrix turns a problem over all vertices into one as small as the weights.
    factor = np.linalg.cholesky(gram)
    wanted, reached = np.linalg.solve(factor, shapes @ moves.T), np.linalg.solve(factor, shapes @ fixed)
    bounds, expression = (low[free], high[free]), without_jaw(track).expression
    for position in np.flatnonzero(track.found):
        goal = wanted @ expression[position] - reached
        weights[position, free] = lsq_linear(factor.T, goal, bounds=bounds, method="bvls", tol=1e-12).x.clip(*bounds)
    return _played(track, character, weights)


def _played(track: Track, character: FaceModel, weights: Float[np.ndarray, "n t"]) -> Track:
    meta: dict[str, Any] = json.loads(json.dumps(track.meta))
    meta["expression_names"] = list(character.expression_names)
    meta["model"] = model_record(character)
    meta["retargeted_from"] = track.meta.get("model")
    identity = np.where(track.found[:, None], 0.0, np.nan) * np.ones((1, len(character.identity_deltas)))
    return replace(track, expression=weights, identity=identity, jaw=np.zeros_like(track.jaw), meta=meta)


def _size(model: FaceModel) -> float:
    """Spread of the 68 landmarks, millimetres."""
    points = model.landmarks.of(model.neutral)[:POINT_COUNT]
    return float(np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean()))


def _parts(parts: Any, target: str, path: Path) -> Mapping[str, float]:
    if isinstance(parts, str):
        return {parts: 1.0}
    numbers = isinstance(parts, dict) and all(
        isinstance(factor, int | float) and not isinstance(factor, bool) and math.isfinite(factor)
        for factor in parts.values()
    )
    if not numbers:
        raise InputError(f"{path}: {target} is a name or a table of names with factors, got {_quoted(parts)}.")
    return {name: float(factor) for name, factor in parts.items()}


def _quoted(value: Any) -> str:
    return shortened(repr(value))


def _listed(names: tuple[str, ...]) -> str:
    return shortened(", ".join(names))
