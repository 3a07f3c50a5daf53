"""Make the sample clips: synthetic persons who talk, grimace, laugh and turn, with the exact truth beside each.

    python data_samples/make_performance.py [laugh glasses ...] [--sheets FOLDER]

writes for each clip NAME.mp4 (25 frames/s, 640 × 480), NAME_truth.npz and NAME_landmarks.csv, and
astronaut_landmarks.csv. `performance` is the plain head, which measurements are made with; `laugh` and `glasses` are
characters. Run it again after the head has been baked anew; everything random is seeded. The landmark files hold what
the dlib tracker gives, so that a first run needs no detector; without dlib, they are left as they are.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from glasses import glasses
from performance_look import Stage, albedo_of_person
from performance_timeline import LAUGH, LOOKS, PERFORMANCE, RATE, Timeline, performance

from workbench.energies import project_landmarks
from workbench.errors import MissingDependencyError
from workbench.face import (
    DressedHead,
    FaceParameters,
    contour_blend,
    find_character,
    landmark_model,
    load_character,
    load_default_head,
    model_landmarks,
)
from workbench.face.model import FaceModel
from workbench.files import atomic_path
from workbench.frames import VideoWriter, open_frames, write_picture
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.dlib_detector import DlibDetector
from workbench.landmarks.files import LandmarkRecord, write_landmark_file
from workbench.landmarks.tracking import LandmarkTracker
from workbench.pictures import HeadRenderer
from workbench.pictures.extras import Extras
from workbench.pictures.neck import BODY_SHARE
from workbench.tracking.frame_solver import head_yaw

FOLDER = Path(__file__).resolve().parent
SIZE = (640, 480)
FOV_DEG = 33.0
IDENTITY_SEED = 11
QUALITY = 19
"""H.264's constant rate factor."""
LARGEST_GAZE_DEG = 22.0
SHEET = 24
"""Frames of a contact sheet."""


@dataclass(frozen=True, eq=False)
class Clip:
    """A person and what happens to them."""

    name: str
    timeline: Timeline
    character: str = ""
    """Empty: the plain head with an identity of its own."""
    glasses: bool = False


CLIPS = {
    clip.name: clip
    for clip in (
        Clip("performance", PERFORMANCE),
        Clip("laugh", LAUGH, "ravi"),
        Clip("glasses", LOOKS, "edda", glasses=True),
    )
}


def main() -> None:
    """Make all files, or those of some clips."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("clips", nargs="*", metavar="CLIP", help=f"{', '.join(CLIPS)}; all of them if left out")
    arguments.add_argument("--sheets", type=Path, help=f"also write contact sheets of {SHEET} frames here (PNG)")
    options = arguments.parse_args()
    if unknown := set(options.clips) - set(CLIPS):
        arguments.error(f"there is no clip {', '.join(sorted(unknown))}; there are {', '.join(CLIPS)}")
    model = load_default_head()
    for clip in [CLIPS[name] for name in options.clips or CLIPS]:
        truth = make_truth(model, clip)
        write_truth(FOLDER / f"{clip.name}_truth.npz", truth)
        pictures = write_clip(FOLDER / f"{clip.name}.mp4", model, clip, truth)
        if options.sheets is not None:
            options.sheets.mkdir(parents=True, exist_ok=True)
            write_picture(options.sheets / f"{clip.name}.png", contact_sheet(pictures))
        write_tracked_landmarks(FOLDER / f"{clip.name}.mp4")
    write_tracked_landmarks(FOLDER / "astronaut.png")


def make_truth(model: FaceModel, clip: Clip) -> dict[str, np.ndarray]:
    """Pose, expression, identity, camera and landmarks of every frame, as stored in NAME_truth.npz."""
    motion = performance(clip.timeline, model.expression_names)
    camera = camera_from_fov(SIZE, FOV_DEG)
    rotation = axis_angle_from_yaw_pitch_roll(motion.angles_deg)
    truth = {
        "rotation": rotation,
        "translation": motion.translation,
        "expression": motion.expression,
        "expression_names": np.array(model.expression_names),
        "identity": identity_of(model, clip),
        "focal_px": camera.focal_px,
        "principal_point_px": camera.principal_point_px,
        "distortion": camera.distortion,
        "image_size": np.array(SIZE),
        "rate": np.array(RATE),
        "light": motion.light,
    }
    truth["landmarks"] = exact_landmarks(model, truth)
    return truth


def identity_of(model: FaceModel, clip: Clip) -> np.ndarray:
    """Identity coefficients of the clip's person."""
    if clip.character:
        return find_character(clip.character).identity
    return 0.8 * np.random.default_rng(IDENTITY_SEED).standard_normal(len(model.identity_deltas))


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


def write_clip(path: Path, model: FaceModel, clip: Clip, truth: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Render and encode all frames; returns the pictures of a contact sheet."""
    person = model.personal(truth["identity"])
    dressed: DressedHead | None = load_character(clip.character) if clip.character else None
    camera = Camera(truth["focal_px"], truth["principal_point_px"], truth["distortion"])
    stage = Stage(SIZE, camera, sweater=dressed is None)
    worn = (glasses(person.landmarks.of(person.neutral)),) if clip.glasses else ()
    texture = albedo_of_person(model) if dressed is None else True
    frames, kept = clip.timeline.frames, []
    with HeadRenderer(model, SIZE, texture, dressed=dressed) as renderer, VideoWriter(path, RATE, QUALITY) as out:
        for k in range(frames):
            rotation, translation, light = (truth[name][k] for name in ("rotation", "translation", "light"))
            vertices = looking_at_camera(person, truth["expression"][k], rotation, translation)
            body = None if dressed is None else BODY_SHARE * rotation
            extras = Extras(meshes=worn, rest=person.neutral, body=body)
            head, mask = renderer.render_with_mask(
                vertices, camera, rotation, translation, (0, 0, 0), stage.lighting(light), extras
            )
            picture = stage.compose(head, mask, light, translation)
            out.write(picture)
            if k % (frames // SHEET) == 0:
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


def write_tracked_landmarks(source: Path) -> None:
    """What the dlib tracker gives on a clip or a picture, beside it."""
    path = source.with_name(f"{source.stem}_landmarks.csv")
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
    """Frames in four rows."""
    small = [cv2.resize(picture, (320, 240), interpolation=cv2.INTER_AREA) for picture in pictures[:SHEET]]
    return np.concatenate([np.concatenate(small[row : row + 6], axis=1) for row in range(0, SHEET, 6)])


if __name__ == "__main__":
    main()
