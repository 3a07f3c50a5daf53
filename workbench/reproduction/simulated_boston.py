"""A simulated head-tracking set in the layout of Boston University's, for those who do not have the real one.

Five random people with nine sequences each: 320 × 240, the camera that evaluations on the set take, soft light. Three
sequences move the head along the camera's axes, three turn it about them, and three do everything at once. The ranges
of motion, faces, blinks and the picture's quality are our choice; the poses are exact. The sensor is on the crown.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import av
import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from workbench.face import FaceModel
from workbench.files import atomic_path, make_folder
from workbench.geometry import axis_angle_from_yaw_pitch_roll
from workbench.pictures.lighting import Light, Lighting
from workbench.reproduction.boston import NAMES, SIZE, boston_camera, write_truth
from workbench.reproduction.people import FilmStudio, Motion, SimulatedPerson
from workbench.reproduction.study import Progress
from workbench.tracking.unwatched import silent

FRAMES = 200
RATE = 30
DISTANCE_MM = 750.0
UNIFORM = Lighting((Light((0.2, -0.4, -1.0), 0.55),), 0.5)
TURN_DEG = np.array([35.0, 20.0, 25.0])
"""Largest yaw, pitch and roll."""
SHIFT_MM = np.array([110.0, 60.0, 150.0])
"""Largest way to the side, upwards and in depth."""
FULL, FREE, STILL = 1.0, 0.7, 0.06
"""Shares of these ranges: of the motion that a sequence shows, of each where all are free, and of the others."""
PERIOD_S = 5.0
TILL_MOVING_S = 0.7
"""The person begins near frontal: the first frame calibrates."""
BLINK_EVERY_S, BLINK_S = 2.7, 0.2
SMILE = 0.25


def simulate_set(
    folder: str | Path,
    head: FaceModel,
    names: Sequence[str] = NAMES,
    frames: int = FRAMES,
    progress: Progress = silent,
) -> None:
    """Write the sequences in `names` that the folder does not have yet, a video and its readings each.

    The same names and number of frames give the same sequences. Raises `MissingDependencyError` without OpenGL and
    `OutputError` where a file cannot be written.
    """
    folder = make_folder(folder)
    wanted = [name for name in names if not (folder / f"{name}.dat").exists()]
    done = len(names) - len(wanted)
    if not wanted:
        return
    with FilmStudio(head, boston_camera(), SIZE) as studio:

        @cache
        def person(number: int) -> SimulatedPerson:
            return replace(studio.person(np.random.default_rng([number])), lighting=UNIFORM)

        for k, name in enumerate(wanted):
            progress("simulate", done + k, len(names))
            number, place = divmod(NAMES.index(name), 9)
            _simulate(studio, person(number), folder / name, frames, (number, place + 1))
    progress("simulate", len(names), len(names))


def sensor_head_mm(head: FaceModel) -> Float[np.ndarray, "3"]:
    """The crown, where the sensor sits, in the head frame."""
    scalp = head.neutral[head.regions["scalp"]]
    return scalp[scalp[:, 1].argmin()]


def motion_of(
    number: int, frames: int, names: Sequence[str], rng: np.random.Generator
) -> tuple[Motion, Float[np.ndarray, "n 3"]]:
    """What a person does in the sequence of this number (1 to 9), and its yaw, pitch and roll in degrees.

    `names` are the head's blendshapes.
    """
    time = np.arange(frames) / RATE
    begun = np.clip(time / TILL_MOVING_S, 0.0, 1.0)
    begun = begun * begun * (3.0 - 2.0 * begun)
    # Columns: X, Y, Z, roll, yaw, pitch, as in the set's files.
    shares = np.where(np.arange(1, 7) == number, FULL, STILL if number <= 6 else FREE)
    waves = np.stack([_wave(time, rng) for _ in range(6)], axis=1) * shares * begun[:, None]
    angles_deg = waves[:, [4, 5, 3]] * TURN_DEG
    places = waves[:, :3] * SHIFT_MM + np.array([0.0, 0.0, DISTANCE_MM])
    motion = Motion(axis_angle_from_yaw_pitch_roll(angles_deg), places, _faces(time, names, rng))
    return motion, angles_deg


def _simulate(studio: FilmStudio, who: SimulatedPerson, path: Path, frames: int, number: tuple[int, int]) -> None:
    """Film the sequence whose person (from 0) and place (from 1) `number` holds."""
    rng = np.random.default_rng(number)
    motion, angles_deg = motion_of(number[1], frames, studio.head.expression_names, rng)
    _write_video(path.with_suffix(".avi"), studio.film(who, motion, rng))
    sensor = Rotation.from_rotvec(motion.rotation).apply(sensor_head_mm(who.model)) + motion.translation_mm
    # Last: a sequence with readings is whole.
    write_truth(path.with_suffix(".dat"), angles_deg, sensor)


def _wave(time: Float[np.ndarray, "n"], rng: np.random.Generator) -> Float[np.ndarray, "n"]:
    """A smooth motion between −1 and 1 that is 0 at the start."""
    first, second = PERIOD_S * rng.uniform(0.8, 1.25), PERIOD_S * rng.uniform(0.4, 0.6)
    side = rng.choice([-1.0, 1.0])
    return side * (0.8 * np.sin(2.0 * np.pi * time / first) + 0.2 * np.sin(2.0 * np.pi * time / second))


def _faces(time: Float[np.ndarray, "n"], names: Sequence[str], rng: np.random.Generator) -> Float[np.ndarray, "n k"]:
    """Faces of somebody who blinks, and smiles a little now and then."""
    faces = np.zeros((len(time), len(names)))
    since = (time + rng.uniform(0.0, BLINK_EVERY_S)) % BLINK_EVERY_S
    shut = np.clip(1.0 - np.abs(since - BLINK_S) / BLINK_S, 0.0, 1.0)
    smile = SMILE * 0.5 * (1.0 - np.cos(2.0 * np.pi * time / PERIOD_S + rng.uniform(0.0, 6.0)))
    for side in ("Left", "Right"):
        faces[:, names.index(f"eyeBlink{side}")] = shut
        faces[:, names.index(f"mouthSmile{side}")] = smile
    return faces


def _write_video(path: Path, pictures: Iterable[UInt8[np.ndarray, "h w 3"]]) -> None:
    """A Motion JPEG video, as the set's files can be read back frame by frame."""
    with atomic_path(path) as temporary, av.open(str(temporary.absolute()), "w", format="avi") as container:
        stream = container.add_stream("mjpeg", rate=RATE, options={"qscale": "2"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuvj420p"
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
