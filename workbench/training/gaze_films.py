"""Films of people who look around, with the exact direction of each eye: what a fitted gaze is measured on."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from workbench.face.gaze import directions_deg, eye_centres
from workbench.face.model import BLINKS, FaceModel
from workbench.training.augment import exposed, random_background
from workbench.training.scenes import (
    BOX_SIDES,
    FaceStudio,
    Person,
    Posing,
    View,
    gaze_weights,
    random_expression,
)

FILM_SIDE = 512
FILM_VIEW = View((FILM_SIDE, FILM_SIDE), FILM_SIDE / BOX_SIDES)
SEEN = 4.0
"""Grey levels that an eye's picture must change by when it looks from one side to the other: dark or mirroring glasses
and hair hide where people look."""
OPEN = 0.3
"""Weight of a blink below which an eye counts as open."""
GLANCE_FRAMES, BLINK_FRAMES = 8, (20, 5)
"""How long eyes look at one thing; how often they blink, and for how long."""


@dataclass(frozen=True, eq=False)
class GazeFrame:
    """One frame of a film."""

    picture: UInt8[np.ndarray, "s s 3"]
    expression: Float[np.ndarray, "k"]
    gaze_deg: Float[np.ndarray, "2 2"]
    """Where the right and the left eye look, in the head: degrees to the subject's left and up."""
    eyes_open: bool


@dataclass(frozen=True, eq=False)
class GazeFilm:
    """A film, and the camera that took it."""

    frames: tuple[GazeFrame, ...]
    fov_deg: float
    glasses: bool


def gaze_films(studio: FaceStudio, glasses: bool, count: int, frames: int, seed: int) -> Iterator[GazeFilm]:
    """Films of random people, all with glasses or all without, whose eyes can be seen; the same for the same seed.

    `studio` has the view `FILM_VIEW`.
    """
    tried = 0
    while count > 0:
        rng = np.random.default_rng([seed, tried])
        who, takes = studio.cast(rng), [seed, tried, 1]
        if _wears_and_shows(studio, who, takes, glasses):
            yield _film(studio, who, takes, _performance(who.model, frames, rng))
            count -= 1
        tried += 1


def _wears_and_shows(studio: FaceStudio, who: Person, takes: list[int], glasses: bool) -> bool:
    """Whether this person has glasses as asked, and both eyes can be seen to turn."""
    shots = []
    for across in (-0.8, 0.8):
        looking = gaze_weights("Left", across, 0.0) | gaze_weights("Right", across, 0.0)
        expression = np.array([looking.get(name, 0.0) for name in who.model.expression_names])
        shots.append(studio.shoot(who, np.random.default_rng(takes), Posing(np.zeros(3), expression)))
        if shots[0].glasses != glasses:
            return False
    changed = np.abs(np.diff([shot.rgba[..., :3].astype(float) for shot in shots], axis=0))[0].mean(axis=-1)
    for start in (36, 42):
        lids = shots[0].points[start : start + 6]
        (left, top), (right, bottom) = lids.min(axis=0).astype(int), lids.max(axis=0).astype(int) + 1
        if changed[top:bottom, left:right].mean() < SEEN:
            return False
    return True


def _film(studio: FaceStudio, who: Person, takes: list[int], performance: list[Posing]) -> GazeFilm:
    # A shot draws its camera, lights and glasses from the seed: one seed makes a film of them.
    shots = [studio.shoot(who, np.random.default_rng(takes), posing) for posing in performance]
    background = random_background(np.random.default_rng(takes), FILM_SIDE)
    shut = [who.model.expression_names.index(name) for name in BLINKS]
    frames = []
    for shot in shots:
        head = exposed(shot.rgba, np.random.default_rng(takes))
        picture = head[..., :3] + background * (1.0 - head[..., 3:] / 255.0)
        vertices = who.model.vertices(shot.expression)
        pupils = vertices[studio.pupils].mean(axis=1)
        gaze = directions_deg(pupils - eye_centres(who.model))
        is_open = bool(shot.expression[shut].max() < OPEN)
        frames.append(GazeFrame(np.clip(picture, 0, 255).astype(np.uint8), shot.expression, gaze, is_open))
    fov = 2.0 * np.degrees(np.arctan(0.5 * FILM_SIDE / shots[0].focal_px))
    return GazeFilm(tuple(frames), float(fov), shots[0].glasses)


def _performance(person: FaceModel, frames: int, rng: np.random.Generator) -> list[Posing]:
    """A head that turns slowly, a mien that comes and goes, eyes that jump from place to place, and blinks."""
    names = person.expression_names
    mien = random_expression(names, rng) * [not name.startswith(("eyeLook", "eyeBlink")) for name in names]
    sway, phase = np.array([18.0, 7.0, 4.0]) * rng.uniform(0.5, 1.0, 3), rng.uniform(0, 2 * np.pi, 4)
    postures, towards = [], rng.uniform(-0.9, 0.9, 2)
    for frame in range(frames):
        time = 2 * np.pi * frame / 60.0
        blinks = (frame + 10) % BLINK_FRAMES[0] < BLINK_FRAMES[1]
        if frame % GLANCE_FRAMES == 0 and not blinks:
            towards = rng.uniform(-0.9, 0.9, 2)
        weights = dict(zip(names, (0.5 + 0.5 * np.sin(time + phase[3])) * mien, strict=True))
        for side in ("Left", "Right"):
            weights |= gaze_weights(side, *towards.tolist())
            weights[f"eyeBlink{side}"] = 1.0 if blinks else 0.0
        angles = sway * np.sin(time * np.array([1.0, 0.7, 0.5]) + phase[:3])
        postures.append(Posing(angles, np.array([weights[name] for name in names])))
    return postures
