"""Results: the objectives of a part of a clip under one configuration, stored once under the hash of what made them."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from workbench import __version__
from workbench.config import Config
from workbench.objectives import TABLE, FittedClip, ObservedClip, SecondView, Truth, measured_by, observed_clip
from workbench.reading import content_hash
from workbench.sweeps.clips import SweptClip, frames_of
from workbench.sweeps.solving import ClipSolver
from workbench.sweeps.storage import Storage, packed, unpacked
from workbench.tracking.fitting import corrected

FORMAT = 1
UNREAD = {"version", "preset", "provenance", "head", "infill", "refinement", "flow", "deep"}
"""Sections that no fit of a sweep depends on."""


def settings_read(config: Config, unread: set[str]) -> dict[str, Any]:
    """A configuration without some sections, for keys: in place of the rig's path what its file holds."""
    settings = config.model_dump(mode="json", exclude=unread)
    settings["camera"]["rig"] = content_hash(Path(config.camera.rig)) if config.camera.rig else ""
    return settings


def result_key(config: Config, digest: str, windows: Sequence[range], objectives: Sequence[str], model: str) -> str:
    """SHA-256 of configuration, input and version: equal keys mean equal numbers.

    The order of the weights counts, and what the rig's file holds, wherever that is.
    """
    read = {
        "config": settings_read(config, UNREAD),
        "clip": digest,
        "windows": [[window.start, window.stop] for window in windows],
        "objectives": list(objectives),
        "model": model,
        "version": __version__,
        "format": FORMAT,
    }
    return hashlib.sha256(json.dumps(read).encode()).hexdigest()


def folds_needed(objectives: Sequence[str]) -> tuple[str, ...]:
    """The kinds of folds that some objectives look at."""
    return tuple(dict.fromkeys(TABLE[name].folds for name in objectives if TABLE[name].folds))


def objectives_of(
    solver: ClipSolver, configs: Sequence[Config], clip: SweptClip, windows: Sequence[range], names: Sequence[str]
) -> list[Float[np.ndarray, "m n"]]:
    """The objectives of some windows of a clip, a row each, under every configuration.

    Raises `InputError` where the clip lacks what an objective needs.
    """
    fits = solver.fits(
        configs, clip, windows, folds_needed(names), any(TABLE[name].needs == "surface" for name in names)
    )
    seen, found = None, []
    for k, each in enumerate(fits):
        if seen is None or configs[k].landmarks.moved != configs[k - 1].landmarks.moved:
            seen = clip_in(clip, windows, configs[k])
        found.append(_rows(names, seen, each))
    return found


def clip_in(clip: SweptClip, windows: Sequence[range], config: Config) -> ObservedClip:
    """What objectives look at of some windows of a clip, with the points that a configuration moves by hand."""
    rows = np.concatenate([np.arange(window.start, window.stop) for window in windows])
    truth = Truth(*(None if part is None else part[rows] for part in clip.truth))
    second = None
    if clip.second is not None:
        second = SecondView(clip.second.placed, clip.second.points[rows])
    frames = [corrected(frame, config.moved_points(frame.index)) for frame in frames_of(clip, windows)]
    seen = observed_clip(frames, truth)
    return seen._replace(flow=None if clip.flow is None else clip.flow[rows], second=second)


def _rows(names: Sequence[str], clip: ObservedClip, fits: FittedClip) -> Float[np.ndarray, "m n"]:
    measured = measured_by(names, clip, fits)
    return np.stack([np.asarray(measured[name], float) for name in names])


def store_result(storage: Storage, key: str, values: Float[np.ndarray, "m n"]) -> None:
    """Write a result under its key. Raises `OutputError`."""
    storage.write(_name(key), packed({"values": values}))


def stored_result(storage: Storage, key: str) -> Float[np.ndarray, "m n"] | None:
    """The result of a key; None if it is not there, or torn."""
    content = storage.read(_name(key))
    return None if content is None else unpacked(content)["values"]


def _name(key: str) -> str:
    return f"results/{key[:2]}/{key}.npz"
