"""What the persons of the sample clips do, second by second."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator

RATE = 25

VISEMES = {
    "aa": {"jawOpen": 0.42, "mouthLowerDownLeft": 0.25, "mouthLowerDownRight": 0.25, "mouthUpperUpLeft": 0.1,
           "mouthUpperUpRight": 0.1},
    "ee": {"jawOpen": 0.14, "mouthStretchLeft": 0.35, "mouthStretchRight": 0.35, "mouthSmileLeft": 0.25,
           "mouthSmileRight": 0.25, "mouthUpperUpLeft": 0.2, "mouthUpperUpRight": 0.2},
    "oh": {"jawOpen": 0.28, "mouthFunnel": 0.55, "mouthPucker": 0.15},
    "oo": {"jawOpen": 0.10, "mouthFunnel": 0.25, "mouthPucker": 0.65},
    "mm": {"jawOpen": 0.04, "mouthClose": 0.05, "mouthPressLeft": 0.35, "mouthPressRight": 0.35,
           "mouthRollLower": 0.25, "mouthRollUpper": 0.15},
    "ff": {"jawOpen": 0.08, "mouthRollLower": 0.4, "mouthUpperUpLeft": 0.25, "mouthUpperUpRight": 0.25,
           "mouthShrugUpper": 0.15},
    "ss": {"jawOpen": 0.06, "mouthStretchLeft": 0.25, "mouthStretchRight": 0.25, "mouthLowerDownLeft": 0.35,
           "mouthLowerDownRight": 0.35, "mouthUpperUpLeft": 0.15, "mouthUpperUpRight": 0.15},
}  # fmt: skip
VISEME_STEP_S = 0.15
BLINK_HALF_S = 0.11


@dataclass(frozen=True, eq=False)
class Timeline:
    """All that happens in a clip; times in seconds."""

    frames: int
    seed: int
    """Of the head's small unrest."""
    sentences: tuple[tuple[float, str], ...]
    """Start, and one viseme every `VISEME_STEP_S`."""
    expressions: tuple[tuple[float, float, dict[str, float]], ...]
    """Start, end, weights at full strength."""
    blinks: tuple[float, ...]
    poses: np.ndarray
    """Seconds, yaw, pitch, roll (degrees), x, y, z (millimetres)."""
    lights: np.ndarray
    """Seconds, and 0 for the warm window light, 1 for the dim blue light from the other side."""


PERFORMANCE = Timeline(
    frames=240,
    seed=3,
    sentences=(
        (0.7, "mm aa ee ss oo mm oh aa ff ee aa ss oo"),
        (5.75, "ee aa mm oh oo aa ss ee mm aa oh"),
    ),
    expressions=(
        # start, end (s), weights at full strength
        (2.80, 3.65, {"eyeBlinkRight": 1.0, "cheekSquintRight": 0.8, "mouthSmileRight": 0.85, "mouthDimpleRight": 0.4,
                      "eyeSquintLeft": 0.1, "browDownRight": 0.35}),
        (3.55, 4.40, {"browOuterUpLeft": 1.0, "browInnerUp": 0.15, "browDownRight": 0.55, "mouthLeft": 0.45,
                      "mouthSmileLeft": 0.35, "mouthPressRight": 0.3}),
        (4.35, 5.10, {"browInnerUp": 0.9, "browOuterUpLeft": 0.9, "browOuterUpRight": 0.9, "eyeWideLeft": 0.9,
                      "eyeWideRight": 0.9, "jawOpen": 0.42, "mouthFunnel": 0.3}),
        (5.00, 5.85, {"browDownLeft": 1.0, "browDownRight": 1.0, "noseSneerLeft": 0.75, "noseSneerRight": 0.75,
                      "eyeSquintLeft": 0.5, "eyeSquintRight": 0.5, "mouthFrownLeft": 0.55, "mouthFrownRight": 0.55,
                      "mouthPressLeft": 0.4, "mouthPressRight": 0.4, "jawForward": 0.3}),
        (7.35, 8.30, {"jawOpen": 0.95, "mouthStretchLeft": 0.3, "mouthStretchRight": 0.3, "browInnerUp": 0.4,
                      "eyeSquintLeft": 0.3, "eyeSquintRight": 0.3}),
        (8.25, 9.75, {"mouthSmileLeft": 0.85, "mouthSmileRight": 0.85, "cheekSquintLeft": 0.6, "cheekSquintRight": 0.6,
                      "eyeSquintLeft": 0.2, "eyeSquintRight": 0.2, "mouthUpperUpLeft": 0.2, "mouthUpperUpRight": 0.2,
                      "jawOpen": 0.06}),
    ),
    blinks=(0.45, 1.55, 2.45, 4.28, 5.95, 6.75, 8.35, 9.15),
    poses=np.array([
        # s, yaw, pitch, roll (degrees), x, y, z (mm)
        [0.0, 0, 0, 0, 0, 4, 640],
        [0.7, 2, 2, -1, 0, 4, 640],
        [1.3, 14, -3, 3, 4, 6, 636],
        [2.0, 24, 3, 4, 8, 6, 632],
        [2.7, 4, -4, -2, 0, 6, 630],
        [3.3, -5, 3, -8, -4, 4, 625],
        [4.0, 6, 6, 7, 3, 6, 630],
        [4.7, 0, 10, 0, 0, 2, 650],
        [5.4, 0, -12, 2, 0, 10, 600],
        [6.0, -10, -2, -2, -5, 6, 625],
        [6.6, -35, 2, -4, -14, 6, 640],
        [7.0, -30, 4, -2, -12, 6, 640],
        [7.7, 0, 8, 0, 0, 0, 645],
        [8.2, 16, 14, 5, 5, 2, 630],
        [8.7, 34, -2, 9, 12, 6, 615],
        [9.2, 10, -2, 4, 4, 10, 585],
        [9.6, 2, 1, 1, 0, 12, 560],
    ]),
    lights=np.array([[0.0, 0.0], [4.6, 0.0], [5.2, 1.0], [7.9, 1.0], [8.7, 0.25], [9.6, 0.0]]),
)  # fmt: skip
"""Talks, grimaces and turns, in a light that changes."""
LAUGHING = {
    "mouthSmileLeft": 0.85, "mouthSmileRight": 0.85, "mouthUpperUpLeft": 0.5, "mouthUpperUpRight": 0.5,
    "mouthLowerDownLeft": 0.4, "mouthLowerDownRight": 0.4, "cheekSquintLeft": 0.8, "cheekSquintRight": 0.8,
    "eyeSquintLeft": 0.45, "eyeSquintRight": 0.45, "browInnerUp": 0.3, "browOuterUpLeft": 0.25,
    "browOuterUpRight": 0.25,
}  # fmt: skip
LAUGH = Timeline(
    frames=150,
    seed=5,
    sentences=((0.4, "mm aa ee ss oh mm ee aa"), (4.75, "ee aa mm oo ss")),
    expressions=(
        (1.35, 2.10, {"mouthSmileLeft": 0.5, "mouthSmileRight": 0.6, "browInnerUp": 0.4, "browOuterUpLeft": 0.5,
                      "browOuterUpRight": 0.5}),
        (1.90, 4.60, LAUGHING),
        # Four breaths of the laugh open the jaw.
        (1.95, 2.65, {"jawOpen": 0.62}),
        (2.45, 3.10, {"jawOpen": 0.50}),
        (2.90, 3.55, {"jawOpen": 0.58, "browInnerUp": 0.3}),
        (3.40, 4.30, {"jawOpen": 0.42}),
        (4.40, 6.10, {"mouthSmileLeft": 0.35, "mouthSmileRight": 0.35, "cheekSquintLeft": 0.25,
                      "cheekSquintRight": 0.25}),
    ),
    blinks=(0.5, 1.45, 4.65, 5.6),
    poses=np.array([
        [0.0, 2, 1, 0, 0, 14, 700],
        [0.7, -8, -3, 2, -3, 14, 698],
        [1.4, -16, 2, 4, -6, 16, 696],
        [2.0, -6, -4, -2, -2, 16, 692],
        [2.5, 4, -15, -5, 2, 12, 700],
        [3.0, 10, -6, -8, 6, 16, 690],
        [3.5, 16, -13, -6, 8, 12, 700],
        [4.1, 26, -2, -9, 8, 16, 694],
        [4.8, 8, 3, -2, 2, 16, 698],
        [5.4, -8, -2, 2, -2, 14, 700],
        [6.0, 0, 0, 0, 0, 14, 700],
    ]),
    lights=np.array([[0.0, 0.0], [6.0, 0.0]]),
)  # fmt: skip
"""Talks, and laughs with an open mouth."""

LOOKS = Timeline(
    frames=150,
    seed=9,
    sentences=((0.3, "mm oh ee ss aa mm oo ff"), (3.9, "aa ss oo mm ee")),
    expressions=(
        (1.5, 2.5, {"browInnerUp": 0.8, "browOuterUpLeft": 0.8, "browOuterUpRight": 0.8, "eyeWideLeft": 0.5,
                    "eyeWideRight": 0.5}),
        (2.4, 3.4, {"browDownLeft": 0.8, "browDownRight": 0.8, "eyeSquintLeft": 0.6, "eyeSquintRight": 0.6,
                    "mouthPressLeft": 0.4, "mouthPressRight": 0.4, "mouthLeft": 0.3}),
        (3.3, 4.0, {"jawOpen": 0.5, "mouthFunnel": 0.3, "browInnerUp": 0.3}),
        (4.6, 6.2, {"mouthSmileLeft": 0.65, "mouthSmileRight": 0.7, "cheekSquintLeft": 0.5, "cheekSquintRight": 0.5,
                    "mouthUpperUpLeft": 0.25, "mouthUpperUpRight": 0.25}),
    ),
    blinks=(0.35, 1.4, 2.45, 3.45, 4.6, 5.5),
    poses=np.array([
        [0.0, 0, 2, 0, 0, 14, 700],
        [0.6, 8, 4, 1, 2, 14, 698],
        [1.3, 24, -2, 3, 8, 16, 692],
        [2.0, 6, -6, -2, 2, 16, 694],
        [2.7, -4, 10, -3, -2, 12, 690],
        [3.4, -20, 4, -6, -6, 14, 694],
        [4.1, -32, -2, -4, -10, 16, 700],
        [4.8, -10, -4, 5, -4, 16, 694],
        [5.4, 4, 1, 7, 2, 14, 690],
        [6.0, 0, 0, 2, 0, 14, 690],
    ]),
    lights=np.array([[0.0, 0.0], [1.5, 0.0], [2.6, 0.8], [4.4, 0.8], [5.4, 0.2], [6.0, 0.1]]),
)  # fmt: skip
"""Talks, looks through glasses from both sides, and smiles, in a light that changes."""


class Performance(NamedTuple):
    """One row a frame."""

    angles_deg: np.ndarray
    """(n, 3) yaw, pitch, roll."""
    translation: np.ndarray
    """(n, 3) mm."""
    expression: np.ndarray
    """(n, k)."""
    light: np.ndarray
    """(n,) 0 to 1."""


def performance(timeline: Timeline, names: tuple[str, ...]) -> Performance:
    """The motion of a clip for blendshapes in this order."""
    times = np.arange(timeline.frames) / RATE
    pose = PchipInterpolator(timeline.poses[:, 0], timeline.poses[:, 1:])(times) + _sway(times, timeline.seed)
    expression = np.zeros((timeline.frames, len(names)))
    for start, end, weights in timeline.expressions:
        strength = _plateau(times, start, end)
        for name, weight in weights.items():
            expression[:, names.index(name)] += weight * strength
    for start, sentence in timeline.sentences:
        for k, viseme in enumerate(sentence.split()):
            strength = _bump(times, start + k * VISEME_STEP_S, VISEME_STEP_S)
            for name, weight in VISEMES[viseme].items():
                expression[:, names.index(name)] += weight * strength
    for centre in timeline.blinks:
        for side in ("eyeBlinkLeft", "eyeBlinkRight"):
            column = names.index(side)
            expression[:, column] = np.maximum(expression[:, column], _bump(times, centre, BLINK_HALF_S))
    light = PchipInterpolator(timeline.lights[:, 0], timeline.lights[:, 1])(times)
    return Performance(pose[:, :3], pose[:, 3:], np.clip(expression, 0.0, 1.0), light)


def _bump(times: np.ndarray, centre: float, half: float) -> np.ndarray:
    """One at the centre, zero `half` seconds away, smooth."""
    return np.where(np.abs(times - centre) < half, 0.5 + 0.5 * np.cos(np.pi * (times - centre) / half), 0.0)


def _plateau(times: np.ndarray, start: float, end: float, ramp: float = 0.22) -> np.ndarray:
    """Zero outside start..end, one in the middle, with soft flanks of `ramp` seconds."""
    place = np.clip(np.minimum(times - start, end - times) / ramp, 0.0, 1.0)
    return place * place * (3 - 2 * place)


def _sway(times: np.ndarray, seed: int) -> np.ndarray:
    """Small unrest of a living head: three slow sines for each of the six numbers."""
    rng = np.random.default_rng(seed)
    size = np.array([0.8, 0.7, 0.5, 0.8, 0.8, 1.5])
    sway = np.zeros((len(times), 6))
    for _ in range(3):
        rate_hz, phase = rng.uniform(0.3, 1.4, 6), rng.uniform(0, 2 * np.pi, 6)
        sway += size / 3 * np.sin(2 * np.pi * rate_hz * times[:, None] + phase)
    return sway
