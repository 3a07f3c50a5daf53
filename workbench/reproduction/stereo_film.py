"""A person who talks and nods before two cameras, every pose known: for Deep Energies Sec. 8.4."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.face import FaceModel
from workbench.geometry import Rig, View, axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.network_detector import NetworkDetector, bundled_landmark_network
from workbench.landmarks.observations import Landmarks2D
from workbench.pictures.lighting import Lighting
from workbench.reproduction.people import FilmStudio, Motion
from workbench.reproduction.study import Progress
from workbench.tracking import FrameObservation
from workbench.tracking.deep_target import photo_landmarks

SIZE = (720, 540)
"""Of the paper's pictures."""
FOV_DEG = 33.0
AWAY_MM = 700.0
APART_DEG = 30.0
"""Angle between the cameras, about the place where the head is."""
RATE = 12
"""Frames per second."""
SEED = 11


@dataclass(frozen=True, eq=False)
class StereoFilm:
    """What both cameras saw, and what was before them."""

    rig: Rig
    identity: Float[np.ndarray, "i"]
    motion: Motion
    """In the frame of the first camera."""
    observations: tuple[FrameObservation, ...]


def film_stereo(head: FaceModel, frames: int, progress: Progress) -> StereoFilm:
    """Film so many frames; the first one is nearly neutral. Landmarks are N(F*) in both views.

    Raises `InputError` where VTK cannot draw.
    """
    rng = np.random.default_rng(SEED)
    rig, motion = two_cameras(), talk_and_nod(head.expression_names, frames)
    camera = rig.views[0].camera
    seen: list[list[Landmarks2D | None]] = []
    with FilmStudio(head, camera, SIZE) as studio:
        who = studio.person(rng)
        for number, view in enumerate(rig.views):
            rotation, shift = view.rotation_view_world, view.translation_view_world_mm
            turned = replace(
                motion,
                rotation=(Rotation.from_matrix(rotation) * Rotation.from_rotvec(motion.rotation)).as_rotvec(),
                translation_mm=motion.translation_mm @ rotation.T + shift,
            )
            filmed = studio.film(replace(who, lighting=turned_lighting(who.lighting, rotation)), turned, rng)
            detector, found = NetworkDetector(), []
            for k, picture in enumerate(filmed):
                progress(f"film of camera {number + 1}", k, frames)
                found.append(_network_landmarks(detector, picture))
                if number == 0 and k == 0:
                    first = picture
            seen.append(found)
    observations = tuple(
        FrameObservation(k, one, SIZE, others=(other,), picture=first if k == 0 else None)
        for k, (one, other) in enumerate(zip(*seen, strict=True))
    )
    return StereoFilm(rig, who.identity, motion, observations)


def two_cameras() -> Rig:
    """One camera in front, and one `APART_DEG` to its side; the world's frame is that of the first."""
    camera, middle = camera_from_fov(SIZE, FOV_DEG), np.array([0.0, 0.0, AWAY_MM])
    views = []
    for name, angle in (("front", 0.0), ("side", APART_DEG)):
        rotation = Rotation.from_euler("y", angle, degrees=True).as_matrix()
        views.append(View(name, SIZE, camera, rotation, middle - rotation @ middle))
    return Rig(tuple(views))


def talk_and_nod(names: tuple[str, ...], frames: int) -> Motion:
    """A head that nods and turns while its mouth opens and shuts, smiles and purses; lids and brows stay."""
    time = np.arange(frames) / RATE
    angles = np.stack([8.0 * np.sin(1.3 * time), 9.0 * np.sin(4.1 * time), 3.0 * np.sin(2.2 * time)], axis=1)
    places = np.stack([9.0 * np.sin(0.9 * time), 5.0 * np.sin(2.6 * time), AWAY_MM + 14.0 * np.sin(1.1 * time)], axis=1)
    faces = np.zeros((frames, len(names)))
    for name, speed, size in (("jawOpen", 7.3, 0.55), ("mouthPucker", 5.1, 0.4), ("mouthSmileLeft", 3.7, 0.4)):
        faces[:, names.index(name)] = size * np.sin(0.5 * speed * time) ** 2
    faces[:, names.index("mouthSmileRight")] = faces[:, names.index("mouthSmileLeft")]
    return Motion(axis_angle_from_yaw_pitch_roll(angles), places, faces)


def turned_lighting(lighting: Lighting, rotation: Float[np.ndarray, "3 3"]) -> Lighting:
    """The same lights in the frame of a camera that is turned."""
    lights = (replace(one, direction=tuple(rotation @ np.array(one.direction))) for one in lighting.lights)
    return replace(lighting, lights=tuple(lights))


def _network_landmarks(detector: NetworkDetector, picture) -> Landmarks2D | None:
    faces = detector.detect_faces(picture)
    if not faces:
        return None
    return photo_landmarks(bundled_landmark_network(), picture, detector.align(picture, faces[0].box))
