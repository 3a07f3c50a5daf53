"""Twelve cases like those of FACE IT! Fig. 3: people, large poses, expressions, low light, something in the way."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import UInt8

from workbench import plots
from workbench.config import preset
from workbench.face import FaceModel, load_default_head
from workbench.geometry import axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.detectors import chosen_detector, make_detector
from workbench.landmarks.tracking import LandmarkTracker
from workbench.pictures.lighting import STUDIO
from workbench.reproduction.people import FilmStudio, Motion
from workbench.reproduction.study import Progress, Result, Study, Table
from workbench.tracker import FaceTracker
from workbench.tracking import FrameFit, FrameObservation

SIZE = (640, 480)
FOV_DEG = 45.0
AWAY_MM = 560.0
WALL = np.full((SIZE[1], SIZE[0], 3), 0.55, np.float32)
A_ROW = 6
Picture = UInt8[np.ndarray, "h w 3"]


def as_it_is(picture: Picture, rng: np.random.Generator) -> Picture:
    """Nothing in the way."""
    return picture


def in_the_dark(picture: Picture, rng: np.random.Generator) -> Picture:
    """A fifth of the light, and the noise that comes with it."""
    return np.clip(picture / 5.0 + rng.normal(0.0, 5.0, picture.shape), 0, 255).astype(np.uint8)


def mouth_covered(picture: Picture, rng: np.random.Generator) -> Picture:
    """A patch over the mouth."""
    return _covered(picture, (0.5, 0.7), (0.1, 0.06))


def eye_covered(picture: Picture, rng: np.random.Generator) -> Picture:
    """The same over one eye."""
    return _covered(picture, (0.44, 0.47), (0.045, 0.05))


@dataclass(frozen=True)
class Case:
    """One person in one moment."""

    says: str
    person: int
    """Seed of skin, hair and shape."""
    angles_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Yaw, pitch, roll."""
    expression: Mapping[str, float] = field(default_factory=dict)
    spoilt: Callable[[Picture, np.random.Generator], Picture] = as_it_is


SMILE = {"mouthSmileLeft": 0.8, "mouthSmileRight": 0.8, "cheekSquintLeft": 0.4, "cheekSquintRight": 0.4}
OPEN = {"jawOpen": 0.8, "browInnerUp": 0.6}
CASES = (
    Case("at rest", 19),
    Case("smile", 22, (8.0, 0.0, 0.0), SMILE),
    Case("open mouth", 17, (-6.0, 4.0, 0.0), OPEN),
    Case("pursed lips", 15, (0.0, -6.0, 3.0), {"mouthPucker": 0.9}),
    Case("raised brows", 31, (4.0, 0.0, 0.0), {"browInnerUp": 0.9, "browOuterUpLeft": 0.9, "browOuterUpRight": 0.9}),
    Case("mouth to the side", 19, (0.0, 0.0, -8.0), {"mouthLeft": 0.9, "jawLeft": 0.4}),
    Case("turned by 40°", 22, (40.0, 0.0, 0.0)),
    Case("turned by −35°, smile", 17, (-35.0, 5.0, 0.0), SMILE),
    Case("looking up", 15, (5.0, 25.0, 0.0)),
    Case("low light", 31, (-10.0, 0.0, 0.0), OPEN, in_the_dark),
    Case("mouth covered", 19, (10.0, 0.0, 0.0), SMILE, mouth_covered),
    Case("one eye covered", 22, (0.0, 0.0, 5.0), OPEN, eye_covered),
)
QUICK_CASES = (CASES[1], CASES[9])


def sheet(study: Study) -> Result:
    """Fig. 3: the cases, and what the published preset and ours make of them."""
    head, cases = load_default_head(), QUICK_CASES if study.quick else CASES
    pictures = photographed(head, cases, study.progress)
    observations = []
    for k, picture in enumerate(pictures):
        found = LandmarkTracker(make_detector("auto")).step(picture)
        observations.append(FrameObservation(k + 1, found.landmarks, SIZE, found.source))
    fits = {
        name: list(
            FaceTracker(head, preset(name).changed(camera={"fov_deg": FOV_DEG}), stills=True).fit_all(observations)
        )
        for name in ("face-it", "joint")
    }
    rows = tuple(
        (str(k + 1), case.says, *(text for name in fits for text in _errors(fits[name][k], case)))
        for k, case in enumerate(cases)
    )
    unseen = [str(k + 1) for k, observation in enumerate(observations) if observation.landmarks is None]
    seen = [k for k, observation in enumerate(observations) if observation.landmarks is not None]
    figures = {
        f"Cases {', '.join(str(k + 1) for k in some)}: what the camera sees, and both presets' faces over it.": (
            plots.film_strip(
                head, [pictures[k] for k in some], {name: [each[k] for k in some] for name, each in fits.items()}
            )
        )
        for some in (seen[first : first + A_ROW] for first in range(0, len(seen), A_ROW))
    }
    header = ("", "case", *(f"{name}: {what}" for name in fits for what in ("landmarks, %", "angles, °")))
    return Result(
        data=f"{len(cases)} rendered pictures of five people, 640 × 480, each alone; landmarks by {chosen_detector()}.",
        figures=figures,
        tables=(Table("Errors", header, rows),),
        notes=(
            "The paper shows photos of real people, and a character that has their expressions; these people are "
            "rendered, so that the angles are known, and the face over them is the default head.",
            *((f"The detector finds no face in {', '.join(unseen)}: these are not pictured.",) if unseen else ()),
        ),
    )


def photographed(head: FaceModel, cases: tuple[Case, ...], progress: Progress) -> list[Picture]:
    """The picture of each case."""
    made = []
    with FilmStudio(head, camera_from_fov(SIZE, FOV_DEG), SIZE) as studio:
        for k, case in enumerate(cases):
            progress("pictures", k, len(cases))
            who = replace(studio.person(np.random.default_rng([case.person])), lighting=STUDIO, background=WALL)
            rng = np.random.default_rng([7, k])
            expression = np.zeros((1, len(head.expression_names)))
            for name, weight in case.expression.items():
                expression[0, head.expression_names.index(name)] = weight
            turn = axis_angle_from_yaw_pitch_roll(np.array([case.angles_deg]))
            motion = Motion(turn, np.array([[0.0, 0.0, AWAY_MM]]), expression)
            made.append(case.spoilt(next(studio.film(who, motion, rng)), rng))
    return made


def _covered(picture: Picture, middle: tuple[float, float], half: tuple[float, float]) -> Picture:
    width, height = SIZE
    centre, axes = ((round(x * width), round(y * height)) for x, y in (middle, half))
    return cv2.ellipse(picture.copy(), centre, axes, 0, 0, 360, (96, 104, 112), -1, cv2.LINE_AA)


def _errors(fit: FrameFit, case: Case) -> tuple[str, str]:
    if not fit.found:
        return "no face", ""
    return f"{fit.errors[2]:.2f}", f"{np.abs(fit.angles_deg - case.angles_deg).mean():.1f}"
