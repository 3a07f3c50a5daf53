"""Make the sample clip: a synthetic person who talks, grimaces and turns, with the exact truth beside it.

    python data_samples/make_performance.py [--sheet sheet.png]

writes performance.mp4 (9.6 s, 25 frames/s, 640 × 480), performance_truth.npz, performance_landmarks.csv and
astronaut_landmarks.csv. Run it again after the head has been baked anew; everything random is seeded. The landmark
files hold what the dlib tracker gives, so that a first run needs no detector; without dlib, they are left as they are.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from performance_look import Stage, albedo_of_person
from performance_timeline import FRAME_COUNT, RATE, performance

from workbench.energies import project_landmarks
from workbench.errors import MissingDependencyError
from workbench.face import FaceParameters, contour_blend, landmark_model, load_default_head, model_landmarks
from workbench.face.model import FaceModel
from workbench.files import atomic_path
from workbench.frames import VideoWriter, open_frames, write_picture
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.dlib_detector import DlibDetector
from workbench.landmarks.files import LandmarkRecord, write_landmark_file
from workbench.landmarks.tracking import LandmarkTracker
from workbench.pictures import HeadRenderer
from workbench.tracking.frame_solver import head_yaw

FOLDER = Path(__file__).resolve().parent
SIZE = (640, 480)
FOV_DEG = 33.0
IDENTITY_SEED = 11
QUALITY = 19
"""H.264's constant rate factor."""
LARGEST_GAZE_DEG = 22.0


def main() -> None:
    """Make all files."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--sheet", type=Path, help="also write a contact sheet of 24 frames (PNG)")
    sheet = arguments.parse_args().sheet
    model = load_default_head()
    truth = make_truth(model)
    write_truth(FOLDER / "performance_truth.npz", truth)
    pictures = write_clip(FOLDER / "performance.mp4", model, truth)
    if sheet is not None:
        write_picture(sheet, contact_sheet(pictures))
    for name in ("performance.mp4", "astronaut.png"):
        write_tracked_landmarks(FOLDER / name, FOLDER / f"{Path(name).stem}_landmarks.csv")


def make_truth(model: FaceModel) -> dict[str, np.ndarray]:
    """Pose, expression, identity, camera and landmarks of every frame, as stored in performance_truth.npz."""
    motion = performance(model.expression_names)
    identity = 0.8 * np.random.default_rng(IDENTITY_SEED).standard_normal(len(model.identity_deltas))
    camera = camera_from_fov(SIZE, FOV_DEG)
    rotation = axis_angle_from_yaw_pitch_roll(motion.angles_deg)
    truth = {
        "rotation": rotation,
        "translation": motion.translation,
        "expression": motion.expression,
        "expression_names": np.array(model.expression_names),
        "identity": identity,
        "focal_px": camera.focal_px,
        "principal_point_px": camera.principal_point_px,
        "distortion": camera.distortion,
        "image_size": np.array(SIZE),
        "rate": np.array(RATE),
        "light": motion.light,
    }
    truth["landmarks"] = exact_landmarks(model, truth)
    return truth


def exact_landmarks(model: FaceModel, truth: dict[str, np.ndarray]) -> np.ndarray:
    """The 68 projected landmarks of every frame, (n, 68, 2) in pixels, jaw contour sliding with the yaw."""
    points_of = landmark_model(model)
    camera = Camera(truth["focal_px"], truth["principal_point_px"], truth["distortion"])
    landmarks = []
    for rotation, translation, expression in zip(
        truth["rotation"], truth["translation"], truth["expression"], strict=True
    ):
        parameters = FaceParameters(rotation, translation, expression, truth["identity"])
        blend = contour_blend(points_of.contour_yaw, head_yaw(rotation), 1.0)
        points = model_landmarks(points_of, blend, truth["identity"])
        landmarks.append(np.asarray(project_landmarks(camera, points, parameters)))
    return np.stack(landmarks)


def write_truth(path: Path, truth: dict[str, np.ndarray]) -> None:
    """Store the arrays, whole or not at all."""
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **truth)


def write_clip(path: Path, model: FaceModel, truth: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Render and encode all frames; returns every tenth picture."""
    person = model.personal(truth["identity"])
    camera = Camera(truth["focal_px"], truth["principal_point_px"], truth["distortion"])
    stage = Stage(SIZE, camera)
    kept = []
    with (
        HeadRenderer(model, SIZE, texture=albedo_of_person(model)) as renderer,
        VideoWriter(path, RATE, QUALITY) as out,
    ):
        for k in range(FRAME_COUNT):
            rotation, translation = truth["rotation"][k], truth["translation"][k]
            vertices = looking_at_camera(person, truth["expression"][k], rotation, translation)
            lighting = stage.lighting(truth["light"][k])
            head, mask = renderer.render_with_mask(vertices, camera, rotation, translation, (0, 0, 0), lighting)
            picture = stage.compose(head, mask, truth["light"][k], translation, rotation)
            out.write(picture)
            if k % (FRAME_COUNT // 24) == 0:
                kept.append(picture)
    return kept


def looking_at_camera(
    person: FaceModel, expression: np.ndarray, rotation: np.ndarray, translation: np.ndarray
) -> np.ndarray:
    """Vertices with the eyeballs (only them: lids and landmarks stay) turned towards the camera, as far as eyes go."""
    vertices = person.vertices(expression)
    camera_head = -(cv2.Rodrigues(rotation)[0].T @ translation)
    for region, joint in (("eyeL", "leftEye"), ("eyeR", "rightEye")):
        centre = person.joints[joint]
        x, y, z = camera_head - centre
        limit = np.radians(LARGEST_GAZE_DEG)
        sideways = np.clip(np.arctan2(x, -z), -limit, limit)
        down = np.clip(np.arctan2(y, np.hypot(x, z)), -limit / 2, limit / 2)
        turn = cv2.Rodrigues(np.array([0.0, -sideways, 0.0]))[0] @ cv2.Rodrigues(np.array([down, 0.0, 0.0]))[0]
        eye = person.regions[region]
        vertices[eye] = (vertices[eye] - centre) @ turn.T + centre
    return vertices


def write_tracked_landmarks(source: Path, path: Path) -> None:
    """What the dlib tracker gives on a clip or a picture."""
    try:
        tracker = LandmarkTracker(DlibDetector())
    except MissingDependencyError as error:
        print(f"{path.name} is left as it is: {error}")
        return
    frames = open_frames(source)
    records = (
        LandmarkRecord(frame.index, frame.name, tracker.step(frame.picture).landmarks, frames.image_size)
        for frame in frames.iterate()
    )
    write_landmark_file(path, records)


def contact_sheet(pictures: list[np.ndarray]) -> np.ndarray:
    """24 frames in four rows."""
    small = [cv2.resize(picture, (320, 240), interpolation=cv2.INTER_AREA) for picture in pictures[:24]]
    return np.concatenate([np.concatenate(small[row : row + 6], axis=1) for row in range(0, 24, 6)])


if __name__ == "__main__":
    main()
