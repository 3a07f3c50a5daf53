"""A second camera, which judges the fits that were made to the first one's pictures."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from workbench.config import Config
from workbench.errors import InputError
from workbench.geometry import Camera, PlacedCamera, read_rig, resized_view
from workbench.landmarks.scheme import first_68
from workbench.objectives import SecondView
from workbench.pipeline import open_source
from workbench.sweeps.storage import local_file


@dataclass(frozen=True)
class SecondCamera:
    """Where its landmarks come from: paths or URLs."""

    clip: str
    """A video, a folder or a landmark file, frame by frame beside the first camera's."""
    view: str
    """Its name in the rig."""
    rig: str
    """The rig file; its first view is the camera that is fitted."""


def in_first_view(config: Config, rig: str) -> Config:
    """The configuration with the lens of a rig's first camera in place of its own.

    Raises `InputError` for a rig that cannot be read.
    """
    lens = read_rig(local_file(rig)).views[0].camera
    matrix = np.array([[lens.focal_px[0], 0.0, 0.0], [0.0, lens.focal_px[1], 0.0], [0.0, 0.0, 1.0]])
    matrix[:2, 2] = lens.principal_point_px
    return config.changed(camera={"matrix": matrix.tolist(), "distortion": lens.distortion.tolist(), "rig": ""})


def seen_by_second(
    camera: SecondCamera, config: Config, frames: int, image_size: tuple[int, int], stills: bool
) -> SecondView:
    """What a second camera sees of so many frames of a clip with pictures of `image_size`; NaN beyond its own end.

    Raises `InputError` for a view that the rig does not have or that is the first one, and for pictures of another
    size than the rig was calibrated at.
    """
    rig = read_rig(camera.rig)
    first, place = rig.views[0], rig.index(camera.view)
    if place == 0:
        raise InputError(f"{camera.view!r} is the rig's first view, which is fitted; name another for --view.")
    if tuple(image_size) != first.image_size:
        raise InputError(
            f"The clip's pictures are {_size(image_size)}, and the rig's first view {first.name!r} is calibrated at "
            f"{_size(first.image_size)}; calibrate it at the size that is used."
        )
    # The face is chosen by a pixel of the first view.
    source = open_source([Path(camera.clip)], config.changed(landmarks={"face": None}), None)
    lens = resized_view(rig.views[place], source.image_size).camera
    points = np.full((frames, 68, 2), np.nan)
    for row, observation in zip(points, source.observations(0, {}, stills), strict=False):
        if observation.landmarks is not None:
            row[:] = first_68(observation.landmarks.points)
    return SecondView(PlacedCamera(lens, *rig.placed_view(place)[1:]), points)


def arrays_of(second: SecondView) -> dict[str, np.ndarray]:
    """A second camera and what it sees as arrays by name."""
    placed, points = second
    flat = (*placed.camera, placed.rotation_view_reference, placed.translation_view_reference_mm, points)
    return dict(zip(_ARRAYS, map(np.asarray, flat), strict=True))


def second_of_arrays(arrays: dict[str, np.ndarray]) -> SecondView | None:
    """The inverse of `arrays_of`; None where the arrays tell of none."""
    if not set(_ARRAYS) <= set(arrays):
        return None
    *lens, rotation, translation, points = (arrays[name] for name in _ARRAYS)
    return SecondView(PlacedCamera(Camera(*lens), rotation, translation), points)


_ARRAYS = tuple(
    f"second_{name}" for name in (*Camera._fields, "rotation_view_reference", "translation_view_reference_mm", "points")
)


def _size(image_size: tuple[int, int]) -> str:
    return f"{image_size[0]} × {image_size[1]}"
