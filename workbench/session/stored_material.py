"""The material of a stored run."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from workbench.config import Config, config_of_track
from workbench.errors import InputError
from workbench.export.sources import (
    gone_pictures,
    input_hashes,
    landmark_file,
    reference_inputs,
    tracked_part,
    view_clips,
)
from workbench.frames import open_frames
from workbench.pipeline import is_landmark_file
from workbench.session.material import Material, PictureStore
from workbench.session.opened_files import OpenedFiles
from workbench.tracking import FrameObservation, Track
from workbench.tracking.records import SOURCES

A_CLIP = Path("CLIP")
"""Stands for another camera's clip that is gone, in the command line that tells how a track is made."""


def material_of_track(track: Track) -> Material:
    """The landmarks of a stored run, with its pictures if they are still there as they were tracked.

    Inputs that are gone, or have since been replaced, are not part of the material. Of several cameras the frames are
    those of the rig's first view. Points that the run's configuration moved by hand keep those positions.
    """
    try:
        inputs, views = tuple(reference_inputs(track.meta)), view_clips(track.meta)
    except InputError:  # the rig of an older track is gone, and with it which inputs are the first camera's
        inputs, views = (), {}
    gone = gone_pictures(track.meta, (*inputs, *views.values()))
    config = config_of_track(track.meta)
    observations = []
    for k in range(len(track)):
        fit = track[k]
        landmarks = fit.landmarks
        cut = k > 0 and bool(track.shot[k] != track.shot[k - 1])
        source, times = SOURCES[int(track.source[k])], (float(fit.milliseconds[0]), float(fit.milliseconds[1]))
        observations.append(FrameObservation(fit.index, landmarks, fit.image_size, source, cut, times))
    frames = None
    if inputs and not any(path in gone or is_landmark_file(path) for path in inputs):
        frames = tracked_part(open_frames(inputs if len(inputs) > 1 else inputs[0]), track.meta)
    sizes = [observation.image_size for observation in observations]
    name = inputs[0].stem if inputs else "track"
    stills = bool(track.meta.get("stills", False))
    part, landmarks = track.meta.get("frames"), landmark_file(track.meta)
    opened = OpenedFiles([*inputs, *views.values(), landmarks], input_hashes(track.meta))
    return Material(
        name,
        tuple(observations),
        PictureStore(frames, sizes),
        stills,
        () if gone.keys() & set(inputs) else inputs,
        landmarks,
        None if part is None else tuple(part),
        {view: A_CLIP if path in gone else path for view, path in views.items()},
        _moved(config),
        track.meta.get("rate"),
        config.deep.network if config is not None and config.traits.renders else None,
        track.meta.get("detector"),
        opened,
    )


def check_default_head(meta: Mapping[str, Any]) -> None:
    """Raise `InputError` for the metadata of a track of another model; older tracks do not name theirs and pass."""
    name = (meta.get("model") or {}).get("name", "default-head")
    if name != "default-head":
        raise InputError(
            f"This track was fitted with the model {name}; open it from code with that one, for example "
            "open_session(track, "
            "model=load_face_model(FILE)), or with model=load_default_head() to fit the default head to its landmarks."
        )


def _moved(config: Config | None) -> frozenset[tuple[int, int]]:
    """(frame, point) of the landmarks that a run's configuration moved."""
    moved = {} if config is None else config.landmarks.moved
    return frozenset((int(frame), int(point)) for frame, places in moved.items() for point in places)
