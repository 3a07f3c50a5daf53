"""What each result of a session depends on: equal keys, equal numbers."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from workbench.config import Config
from workbench.tracking import FrameObservation

TIME_SECTIONS = ("flow", "infill", "refinement")
"""Sections of the configuration that a single frame's fit does not depend on."""


def fits_key(config: Config) -> str:
    """What the fits of single frames depend on."""
    return config.model_dump_json(exclude={"preset", "provenance", *TIME_SECTIONS})


def time_key(config: Config) -> str:
    """What the frames after infill and refinement depend on."""
    return fits_key(config) + config.model_dump_json(include=set(TIME_SECTIONS))


def frame_key(config: Config) -> str:
    """What the fit of a single frame depends on, but for the points that were moved."""
    left_out = dict.fromkeys(("preset", "provenance", *TIME_SECTIONS), True)
    return config.model_dump_json(exclude={**left_out, "landmarks": {"moved"}})


def identity_key(config: Config, window: Sequence[FrameObservation]) -> str:
    """What the identity of a shot depends on, `window` being the frames that it comes from."""
    moved = {key: config.landmarks.moved[key] for item in window if (key := str(item.index)) in config.landmarks.moved}
    kept = {"system", "camera", "identity", "contour", "subsets"}
    kept |= {"deep"} if config.traits.reads("deep") else set()
    sections = config.model_dump_json(include=kept)
    return f"{sections}{config.point_weights()}{moved}"


def stale_frames(fitted: Config, config: Config, shots: Sequence[range]) -> Bool[np.ndarray, "n"]:
    """Frames whose fits under one configuration are not those of another."""
    stale = np.zeros(sum(map(len, shots)), bool)
    if frame_key(fitted) != frame_key(config):
        return ~stale
    before, now = fitted.landmarks.moved, config.landmarks.moved
    frames = {int(key) for key in {*before, *now} if before.get(key) != now.get(key)}
    for shot in shots:
        # A moved point can reach every frame of its shot: through the identity, and from frame to frame.
        stale[shot.start : shot.stop] = any(frame in frames for frame in shot)
    return stale
