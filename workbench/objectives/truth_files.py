"""What is known of a clip, from a file: a rendered clip's numbers, a track, or labelled landmarks."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.formats.records import by_pictures
from workbench.landmarks.scheme import first_68
from workbench.objectives.evidence import surface_points
from workbench.objectives.records import Truth
from workbench.reading import checked_arrays, checked_file, reading
from workbench.tracking import Track


def read_truth(
    path: str | Path,
    model: FaceModel,
    frames: Sequence[int],
    image_size: tuple[int, int] | None = None,
    pictures: Sequence[str] = (),
    first: int = 0,
) -> Truth:
    """What a file says of these frames of a clip; NaN for those that it does not have.

    A `.npz` holds any of `rotation` (n, 3), `translation` (n, 3), `expression` (n, k) with `expression_names` (k),
    `identity` and `landmarks` (n, 68, 2), one row per frame, like `data_samples/performance_truth.npz`; or it is a
    track, whose fits then count as true. A landmark file has labels; those that name a picture are of that one, by the
    file names of all `pictures`, of which frame 0 is the `first`. Raises `InputError` for anything else.
    """
    path = checked_file(path, "a truth")
    if path.suffix.lower() != ".npz":
        records = read_landmark_file(path, image_size)
        if pictures and path.suffix.lower() != ".csv":  # a CSV names no pictures
            # With all names: those of a part do not tell labels of other photos from labels without names.
            records = by_pictures(records, pictures, first)
        labels = {record.frame: record.landmarks for record in records}
        found = [labels.get(frame) for frame in frames]
        return Truth(labels=np.stack([_NO_LABELS if each is None else first_68(each.points) for each in found]))
    with (
        reading(path, "a truth", "a track or an archive of rotation, translation, expression, identity, landmarks"),
        path.open("rb") as stream,
        checked_arrays(stream) as stored,
    ):
        arrays = {name: stored[name] for name in stored.files if name in _KNOWN}
        is_track = "meta" in stored.files
    if is_track:
        track = Track.load(path)
        arrays = {name: getattr(track, name) for name in ("rotation", "translation", "expression", "identity")}
        arrays |= {"expression_names": np.array(track.expression_names), "index": track.index}
    return _of_arrays(path, arrays, model, frames)


_NO_LABELS = np.full((68, 2), np.nan)
_KNOWN = ("rotation", "translation", "expression", "expression_names", "identity", "landmarks")


def _of_arrays(path: Path, arrays: dict[str, np.ndarray], model: FaceModel, frames: Sequence[int]) -> Truth:
    if not {"rotation", "translation", "expression", "landmarks"} & set(arrays):
        raise InputError(f"{path} says nothing about a face; expected one of rotation, expression, landmarks.")
    rows = next(len(arrays[name]) for name in ("rotation", "translation", "expression", "landmarks") if name in arrays)
    row_of = {int(frame): row for row, frame in enumerate(arrays.get("index", range(rows)))}

    def of_frames(name: str, *shape: int) -> np.ndarray | None:
        if name not in arrays:
            return None
        if arrays[name].shape != (rows, *shape):
            wanted = ", ".join(map(str, (rows, *shape)))
            raise InputError(f"{path}: {name} has shape {arrays[name].shape}, expected ({wanted}).")
        known = [row_of.get(frame, -1) for frame in frames]
        found = arrays[name][known].astype(float)
        found[np.array(known) < 0] = np.nan
        return found

    rotation, translation = of_frames("rotation", 3), of_frames("translation", 3)
    expression = _by_name(path, arrays, model, of_frames)
    surface = None
    if rotation is not None and translation is not None and expression is not None and "identity" in arrays:
        identity = arrays["identity"]
        identity = of_frames("identity", identity.shape[-1]) if identity.ndim == 2 else identity
        identity = np.broadcast_to(identity, (len(frames), identity.shape[-1])).astype(float)
        if identity.shape[1] == len(model.identity_deltas):
            surface = surface_points(model, rotation, translation, expression, identity)
    return Truth(rotation, translation, expression, surface, of_frames("landmarks", 68, 2))


def _by_name(path: Path, arrays: dict[str, np.ndarray], model: FaceModel, of_frames) -> np.ndarray | None:
    """The weights in the order of the model's blendshapes; 0 for those that the file does not have."""
    if "expression" not in arrays:
        return None
    names = [str(name) for name in arrays.get("expression_names", model.expression_names)]
    stored = of_frames("expression", len(names))
    if not set(names) & set(model.expression_names):
        raise InputError(f"{path} has weights for none of the model's blendshapes; name the model with --model.")
    columns = [
        stored[:, names.index(name)] if name in names else np.zeros(len(stored)) for name in model.expression_names
    ]
    return np.stack(columns, axis=1)
