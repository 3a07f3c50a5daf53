"""Boston University's head-tracking set (La Cascia et al., PAMI 2000), and the errors of FACE IT! Table 1.

Its part of uniform light is a folder of 45 sequences, nine each of five people: `jam1.avi` (200 frames of 320 × 240)
and `jam1.dat` beside it, the readings of a magnetic sensor on the head. A line of the text is seven numbers: the
frame's number, X, Y, Z in inches, then roll, yaw and pitch in degrees. The first line precedes the first frame. X
points to the picture's left, Y down and Z away from the camera, and the angles turn about these axes.

FACE IT! prints no protocol for the set. Columns, axes, camera and calibration here are those of the public evaluation
by Baltrušaitis et al. (`calcBUerror.m` and `run_bu_experiment.m` of CLM-framework and OpenFace).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.files import atomic_path
from workbench.frames import open_frames
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_matrix, yaw_pitch_roll_deg
from workbench.reading import checked_content, reading

NAMES = tuple(f"{person}{number}" for person in ("jam", "jim", "llm", "ssm", "vam") for number in range(1, 10))
"""The sequences of uniform light."""
FOLDER = "uniform-light"
"""What the part of uniform light is called in the set."""
SIZE = (320, 240)
"""Width and height of the pictures."""
INCH_MM = 25.4
COLUMNS = 7
AXES = np.array([-1.0, 1.0, 1.0])
"""X, Y, Z of the sensor as camera axes: to the right, down, away."""
TURNS = np.array([-1.0, -1.0, -1.0])
"""Yaw, pitch and roll of the sensor as the workbench's."""
LARGEST = 1e5
"""Beyond any frame's number, inch or degree."""
AS_TRUTH = ("a sequence's readings", "copy it from the set again")

PRINTED_DEG: Mapping[str, tuple[float, float, float, float]] = MappingProxyType({
    "Jeni et al.": (2.41, 2.66, 3.93, 3.0),
    "Wu et al.": (3.1, 5.3, 4.9, 4.43),
    "Gou et al.": (3.3, 4.8, 5.1, 4.4),
    "Diaz Barros et al.": (2.32, 3.41, 3.90, 3.21),
    "FACE IT!": (2.35, 3.62, 4.38, 3.45),
})  # fmt: skip
"""FACE IT! Table 1: mean absolute error of roll, pitch, yaw, and their average, degrees."""
PRINTED_INCHES = (2.27, 0.90, 2.04)
"""FACE IT! Sec. 5: mean absolute error of X, Y and Z."""


@dataclass(frozen=True)
class BostonSequence:
    """One sequence: its video, and where the sensor on the head is in each frame."""

    name: str
    video: Path
    angles_deg: Float[np.ndarray, "n 3"]
    """Yaw, pitch, roll of the sensor, signs as in `workbench.geometry`."""
    places_mm: Float[np.ndarray, "n 3"]
    """Of the sensor, along the camera's axes (right, down, away) from the transmitter."""


class PoseErrors(NamedTuple):
    """How far the poses of a sequence are from its truth, where a face was found; both from the first such frame on."""

    angles_deg: Float[np.ndarray, "k 3"]
    """Of yaw, pitch, roll."""
    places_in: Float[np.ndarray, "k 3"]
    """Of X, Y, Z, inches."""
    missed: int
    """Frames without a face, which no mean counts."""


class MeanErrors(NamedTuple):
    """A row of Table 1, over all frames of all sequences."""

    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    average_deg: float
    places_in: tuple[float, float, float]
    """X, Y, Z, inches."""
    frames: int
    missed: int


def boston_camera() -> Camera:
    """The camera that evaluations on the set use: 500 pixels of focal length, centred."""
    return camera_from_matrix(np.array([[500.0, 0.0, 160.0], [0.0, 500.0, 120.0], [0.0, 0.0, 1.0]]))


def read_set(folder: str | Path) -> tuple[tuple[BostonSequence, ...], tuple[str, ...]]:
    """The sequences in a folder (or in its `uniform-light`), and a sentence for each that is missing or damaged.

    Raises `InputError` if none can be read.
    """
    folder = Path(folder)
    if (folder / FOLDER).is_dir():
        folder = folder / FOLDER
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; name the one with {NAMES[0]}.avi, {NAMES[0]}.dat and the others.")
    found, problems = [], []
    for name in NAMES:
        try:
            found.append(read_sequence(folder, name))
        except InputError as problem:
            problems.append(str(problem))
    if not found:
        raise InputError(f"{folder} has no sequence that can be read; of {NAMES[0]}: {problems[0]}")
    return tuple(found), tuple(problems)


def read_sequence(folder: str | Path, name: str) -> BostonSequence:
    """One sequence of a folder: `NAME.dat`, and `NAME.avi` or a copy of it as `NAME.mp4`, whose frames are counted.

    Raises `InputError` for missing, incomplete or foreign files, and if the numbers of readings and frames differ.
    """
    video, truth = Path(folder) / f"{name}.avi", Path(folder) / f"{name}.dat"
    if not video.exists() and video.with_suffix(".mp4").exists():
        video = video.with_suffix(".mp4")
    angles_deg, places_mm = read_truth(truth)
    frames = open_frames(video)
    if frames.image_size != SIZE:
        width, height = frames.image_size
        raise InputError(f"{video} has {width} × {height} pixels, expected 320 × 240; supply the set's own files.")
    count = sum(1 for _ in frames.iterate())
    if len(angles_deg) != count:
        raise InputError(
            f"{truth} has {len(angles_deg) + 1} lines, expected {count + 1}, one before and one for each of the "
            f"{count} frames of {video.name}; copy both from the set again."
        )
    return BostonSequence(name, video, angles_deg, places_mm)


def read_truth(path: str | Path) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Angles and places of a sequence's readings, as in `BostonSequence`; the first line is left out.

    Raises `InputError` for a missing or damaged file.
    """
    content = checked_content(path, AS_TRUTH[0])
    with reading(path, *AS_TRUTH):
        lines = [line.split() for line in content.decode("ascii").splitlines() if line.strip()]
        for number, line in enumerate(lines, 1):
            if len(line) != COLUMNS:
                raise InputError(f"{path} has {len(line)} numbers in line {number}, expected {COLUMNS}; {AS_TRUTH[1]}.")
        readings = np.array(lines, float).reshape(-1, COLUMNS)[1:]
        if not len(readings):
            raise ValueError("it has nothing after its first line")
        if not (np.abs(readings) < LARGEST).all():
            raise ValueError("it holds numbers that no sensor reads")
    roll, yaw, pitch = readings[:, 4:].T
    return TURNS * np.stack([yaw, pitch, roll], axis=1), INCH_MM * AXES * readings[:, 1:4]


def write_truth(path: str | Path, angles_deg: Float[np.ndarray, "n 3"], places_mm: Float[np.ndarray, "n 3"]) -> None:
    """Readings in the set's layout, for simulated sequences; angles and places as in `BostonSequence`.

    Raises `OutputError` if the file cannot be written.
    """
    yaw, pitch, roll = (TURNS * angles_deg).T
    rows = np.column_stack([np.arange(1, len(angles_deg) + 1), AXES * places_mm / INCH_MM, roll, yaw, pitch])
    first = np.concatenate([[0.0], rows[0, 1:]])
    with atomic_path(path) as temporary:
        np.savetxt(temporary, np.vstack([first, rows]), fmt=["%d", *["%.6f"] * 6])


def pose_errors(
    sequence: BostonSequence, rotations: Float[np.ndarray, "n 3"], translations_mm: Float[np.ndarray, "n 3"]
) -> PoseErrors:
    """Absolute errors of head poses in the camera's frame (axis-angle in radians, millimetres; NaN without a face).

    Both sides are calibrated by the first frame with a face: R₁ᵀR_t is compared in yaw, pitch and roll, and t_t − t₁ in
    inches. A turn between the transmitter's axes and the camera's cancels. How the sensor sits on the head does not:
    its way about the head's origin counts as an error. Raises `InputError` for a different number of frames.
    """
    expected = sequence.angles_deg.shape
    if not rotations.shape == translations_mm.shape == expected:
        raise InputError(
            f"{sequence.name} has {expected[0]} frames, got rotations {rotations.shape} and translations "
            f"{translations_mm.shape}; give an axis-angle and a place for each, NaN where there is no face."
        )
    found = np.isfinite(rotations).all(axis=1) & np.isfinite(translations_mm).all(axis=1)
    truth = _from_first(axis_angle_from_yaw_pitch_roll(sequence.angles_deg[found]))
    missed_deg = _from_first(rotations[found]) - truth
    moved, truly = (places[found] - places[found][:1] for places in (translations_mm, sequence.places_mm))
    return PoseErrors(
        np.abs((missed_deg + 180.0) % 360.0 - 180.0), np.abs(moved - truly) / INCH_MM, int((~found).sum())
    )


def mean_errors(errors: Sequence[PoseErrors]) -> MeanErrors:
    """Mean absolute errors over all frames with a face. Raises `InputError` without any."""
    frames = sum(len(one.angles_deg) for one in errors)
    missed = sum(one.missed for one in errors)
    if not frames:
        raise InputError(f"No frame shows a face, so there is no mean error; {missed} frames were missed.")
    yaw, pitch, roll = (float(value) for value in np.concatenate([one.angles_deg for one in errors]).mean(axis=0))
    x, y, z = (float(value) for value in np.concatenate([one.places_in for one in errors]).mean(axis=0))
    return MeanErrors(roll, pitch, yaw, (roll + pitch + yaw) / 3.0, (x, y, z), frames, missed)


def _from_first(rotations: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
    """Yaw, pitch and roll in degrees from the first of some rotations on."""
    turned = Rotation.from_rotvec(rotations)
    return yaw_pitch_roll_deg((turned[:1].inv() * turned).as_rotvec()) if len(rotations) else np.zeros((0, 3))
