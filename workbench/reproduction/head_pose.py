"""Head poses of Boston University's set by our presets, by PnP and by others: what FACE IT! Table 1 compares."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from workbench.config import Config, preset
from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.files import atomic_path, make_folder
from workbench.frames import open_frames
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll
from workbench.geometry.triangulation import camera_matrix
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.files import read_landmark_file, write_landmark_file
from workbench.landmarks.formats.records import LandmarkRecord
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.tracking import LandmarkTracker
from workbench.reading import checked_arrays, checked_content, reading
from workbench.reproduction.boston import SIZE, BostonSequence, PoseErrors, boston_camera, pose_errors
from workbench.tracker import FaceTracker
from workbench.tracking import FrameObservation

PNP = "PnP on the mean face"
POSE_COLUMNS = ("sequence", "frame", "yaw_deg", "pitch_deg", "roll_deg", "x_mm", "y_mm", "z_mm")
AS_POSES = ("a table of head poses", f"give the columns {', '.join(POSE_COLUMNS)}")

Poses = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]
"""Axis-angles (radians) and translations (mm) in the camera's frame; NaN without a face."""


def landmarks_of_sequence(
    sequence: BostonSequence, store: Path, detector: str = "auto"
) -> tuple[Landmarks2D | None, ...]:
    """The landmarks that a detector tracks through a sequence, kept in `store` and read from there the next time."""
    if not store.exists():
        tracker = LandmarkTracker(make_detector(detector))
        found = [tracker.step(frame.picture).landmarks for frame in open_frames(sequence.video).iterate()]
        make_folder(store.parent)
        write_landmark_file(store, [LandmarkRecord(k, "", each, SIZE) for k, each in enumerate(found)])
    return tuple(record.landmarks for record in read_landmark_file(store, SIZE))


def poses_by_preset(name: str, head: FaceModel, landmarks: Sequence[Landmarks2D | None]) -> Poses:
    """The poses that a preset finds, with the set's camera and everything else as the preset has it."""
    return poses_by_config(preset(name), head, landmarks)


def poses_by_config(config: Config, head: FaceModel, landmarks: Sequence[Landmarks2D | None]) -> Poses:
    """The poses that a configuration finds, with the set's camera in place of its own."""
    camera = boston_camera()
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_point_px
    matrix = [[float(fx), 0.0, float(cx)], [0.0, float(fy), float(cy)], [0.0, 0.0, 1.0]]
    tracker = FaceTracker(head, config.changed(camera={"matrix": matrix}))
    fits = tracker.fit_all(FrameObservation(k, each, SIZE) for k, each in enumerate(landmarks))
    poses = _without_any(len(landmarks))
    for fit in fits:
        if fit.found:
            poses[0][fit.index], poses[1][fit.index] = fit.rotation, fit.translation
    return poses


def poses_by_pnp(head: FaceModel, landmarks: Sequence[Landmarks2D | None]) -> Poses:
    """The poses at which the mean face's 68 points come closest to the landmarks, by SQPnP and refinement."""
    points = head.landmarks.of(head.neutral)
    rotations, translations = _without_any(len(landmarks))
    for k, each in enumerate(landmarks):
        if each is not None:
            rotations[k], translations[k] = pose_by_pnp(points, each.points, boston_camera())
    return rotations, translations


def pose_by_pnp(
    points_head: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"], camera: Camera
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Axis-angle and translation (mm) at which the points come closest to the pixels; NaN where OpenCV finds none."""
    matrix, distortion = camera_matrix(camera), np.asarray(camera.distortion, float)
    found, turn, place = cv2.solvePnP(points_head, pixels, matrix, distortion, flags=cv2.SOLVEPNP_SQPNP)
    if not found:
        return np.full(3, np.nan), np.full(3, np.nan)
    turn, place = cv2.solvePnPRefineLM(points_head, pixels, matrix, distortion, turn, place)
    return turn.ravel(), place.ravel()


def read_poses(path: str | Path, sequences: Sequence[BostonSequence]) -> dict[str, Poses]:
    """Poses of another program from a CSV file, by the sequence's name.

    A row is a frame (counted from 0) of a sequence: yaw, pitch and roll in degrees with the signs of
    `workbench.geometry`, and the head's place in the camera's frame in millimetres. Frames without a row count as
    missed. Raises `InputError` for missing columns, a table without rows, unknown sequences and frames that a sequence
    does not have.
    """
    content = checked_content(path, AS_POSES[0])
    counts = {one.name: len(one.angles_deg) for one in sequences}
    found: dict[str, Poses] = {}
    with reading(path, *AS_POSES):
        rows = csv.DictReader(content.decode("utf-8-sig").splitlines())
        missing = [name for name in POSE_COLUMNS if name not in (rows.fieldnames or ())]
        if missing:
            raise InputError(f"{path} has no column {missing[0]!r}; {AS_POSES[1]}.")
        for line, row in enumerate(rows, 2):
            name, frame = row["sequence"], int(row["frame"])
            if not 0 <= frame < counts.get(name, 0):
                raise InputError(f"{path} has frame {frame} of {name!r} in line {line}, which the set does not have.")
            rotations, translations = found.setdefault(name, _without_any(counts[name]))
            numbers = np.array([float(row[column]) for column in POSE_COLUMNS[2:]])
            if not np.isfinite(numbers).all():
                raise InputError(f"{path} has numbers in line {line} that are not finite; leave such rows out.")
            rotations[frame], translations[frame] = axis_angle_from_yaw_pitch_roll(numbers[:3]), numbers[3:]
    if not found:
        raise InputError(f"{path} has no rows; give a row for each frame with a pose.")
    return found


def errors_of(
    sequences: Sequence[BostonSequence], poses_of: Callable[[BostonSequence], Poses], store: Path
) -> list[PoseErrors]:
    """The errors of each sequence's poses; poses are kept in the folder `store` and read from there the next time."""
    found = []
    for sequence in sequences:
        path = store / f"{sequence.name}.npz"
        if not path.exists():
            rotations, translations = poses_of(sequence)
            make_folder(store)
            with atomic_path(path) as temporary, temporary.open("wb") as stream:
                np.savez_compressed(stream, rotations=rotations, translations_mm=translations)
        advice = f"delete {store} and run again"
        with reading(path, "poses", advice), path.open("rb") as stream, checked_arrays(stream) as stored:
            found.append(pose_errors(sequence, stored["rotations"], stored["translations_mm"]))
    return found


def _without_any(frames: int) -> Poses:
    return np.full((frames, 3), np.nan), np.full((frames, 3), np.nan)
