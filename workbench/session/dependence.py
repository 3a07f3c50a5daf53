"""What each result of a session depends on, as keys: equal keys mean equal numbers."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from workbench.config import Config
from workbench.energies.terms import TABLE

TIME_SECTIONS = ("flow", "infill", "refinement")
"""Sections of the configuration for what uses time."""


def fits_key(config: Config) -> str:
    """Key of the fits of single frames."""
    return config.model_dump_json(exclude=_unread(config))


def time_key(config: Config) -> str:
    """Key of the frames after infill and refinement."""
    return fits_key(config) + config.model_dump_json(include=set(TIME_SECTIONS))


def frame_key(config: Config) -> str:
    """Key of the fit of a single frame, not counting the points that were moved."""
    return config.model_dump_json(exclude={**dict.fromkeys(_unread(config), True), "landmarks": {"moved"}})


def _unread(config: Config) -> set[str]:
    """Sections that a single frame's fit does not depend on.

    On flow it does where a stage names a term of it, and on the head where renders show the character.
    """
    of_flow = any(TABLE[name].compares_pictures or TABLE[name].key.startswith("flow.") for name in config.summed_terms)
    unread = {"preset", "provenance", "head", *TIME_SECTIONS} - ({"flow"} if of_flow else set())
    return unread - ({"head"} if config.renders_character else set())


def stale_frames(fitted: Config, config: Config, shots: Sequence[range]) -> Bool[np.ndarray, "n"]:
    """Frames whose fits under the two configurations differ."""
    stale = np.zeros(sum(map(len, shots)), bool)
    if frame_key(fitted) != frame_key(config):
        return ~stale
    before, now = fitted.landmarks.moved, config.landmarks.moved
    frames = {int(key) for key in {*before, *now} if before.get(key) != now.get(key)}
    for shot in shots:
        # A moved point can affect every frame of its shot, through the identity and from frame to frame.
        stale[shot.start : shot.stop] = any(frame in frames for frame in shot)
    return stale
