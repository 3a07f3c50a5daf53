"""A person who talks and nods before two cameras, every pose known: for Deep Energies Sec. 8.4."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from workbench.face import FaceModel
from workbench.geometry import Rig, View, axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.network_detector import NetworkDetector
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.surroundings import seen_around
from workbench.pictures.lighting import STUDIO, Lighting
from workbench.reproduction.people import FilmStudio, Motion, SimulatedPerson
from workbench.reproduction.study import NETWORK, Progress
from workbench.tracking import FrameObservation
from workbench.tracking.deep_target import energy_network, photo_landmarks

SIZE = (720, 540)
"""Of the paper's pictures."""
FOV_DEG = 33.0
AWAY_MM = 700.0
APART_DEG = 30.0
"""Angle between the cameras, about the place where the head is."""
AXES = ("yaw, °", "pitch, °", "roll, °", "x, mm", "y, mm", "z, mm")
"""Of the rigid parameters."""
RATE = 12
"""Frames per second."""
SEED = 11
WALL = 0.55
"""Grey of a stage's wall; 1 is white."""


@dataclass(frozen=True, eq=False)
class StereoFilm:
    """What both cameras saw, and what was before them."""

    rig: Rig
    identity: Float[np.ndarray, "i"]
    motion: Motion
    """In the frame of the first camera."""
    observations: tuple[FrameObservation, ...]
    pictures: tuple[UInt8[np.ndarray, "h w 3"], ...]
    """Of the first camera."""


def as_they_are(who: SimulatedPerson) -> SimulatedPerson:
    """No make-up."""
    return who


def on_stage(who: SimulatedPerson) -> SimulatedPerson:
    """In even light before a grey wall; elsewhere both are random."""
    return replace(who, lighting=STUDIO, background=np.full_like(who.background, WALL))


def film_stereo(
    head: FaceModel,
    frames: int,
    progress: Progress,
    seed: int = SEED,
    made_up: Callable[[SimulatedPerson], SimulatedPerson] = as_they_are,
) -> StereoFilm:
    """Film so many frames; the first one is nearly neutral. Landmarks are N(F*) in both views.

    `seed` chooses the person, and `made_up` changes them. Raises `InputError` where VTK cannot draw.
    """
    rig, motion = two_cameras(), talk_and_nod(head.expression_names, frames)
    seen, pictures, detector = np.empty((len(rig), frames), object), [], NetworkDetector()
    around = np.empty((len(rig), frames), object)
    for shot in film_views(head, rig, motion, seed, made_up):
        progress(f"film of camera {shot.view + 1}", shot.frame, frames)
        landmarks = network_landmarks(detector, shot.picture)
        seen[shot.view, shot.frame] = landmarks
        around[shot.view, shot.frame] = seen_around(shot.picture, landmarks)
        identity = shot.identity
        if shot.view == 0:
            pictures.append(shot.picture)
    observations = tuple(
        FrameObservation(
            k, one, SIZE, others=(other,), surroundings=tuple(around[:, k]), picture=pictures[0] if k == 0 else None
        )
        for k, (one, other) in enumerate(seen.T)
    )
    return StereoFilm(rig, identity, motion, observations, tuple(pictures))


class Shot(NamedTuple):
    """One picture of a film, and who is on it."""

    view: int
    frame: int
    picture: UInt8[np.ndarray, "h w 3"]
    identity: Float[np.ndarray, "i"]


def film_views(
    head: FaceModel,
    rig: Rig,
    motion: Motion,
    seed: int,
    made_up: Callable[[SimulatedPerson], SimulatedPerson] = as_they_are,
) -> Iterator[Shot]:
    """A random person who does this before the cameras of a rig: all pictures of the first one, then of the next.

    `motion` is in the frame of the first camera. Raises `InputError` where VTK cannot draw.
    """
    rng = np.random.default_rng(seed)
    with FilmStudio(head, rig.views[0].camera, rig.views[0].image_size) as studio:
        who = made_up(studio.person(rng))
        for number, view in enumerate(rig.views):
            rotation, shift = view.rotation_view_world, view.translation_view_world_mm
            turned = replace(
                motion,
                rotation=(Rotation.from_matrix(rotation) * Rotation.from_rotvec(motion.rotation)).as_rotvec(),
                translation_mm=motion.translation_mm @ rotation.T + shift,
            )
            filmed = studio.film(replace(who, lighting=turned_lighting(who.lighting, rotation)), turned, rng)
            for k, picture in enumerate(filmed):
                yield Shot(number, k, picture, who.identity)


def two_cameras(size: tuple[int, int] = SIZE) -> Rig:
    """One camera in front, and one `APART_DEG` to its side; the world's frame is that of the first."""
    camera, middle = camera_from_fov(size, FOV_DEG), np.array([0.0, 0.0, AWAY_MM])
    views = []
    for name, angle in (("front", 0.0), ("side", APART_DEG)):
        rotation = Rotation.from_euler("y", angle, degrees=True).as_matrix()
        views.append(View(name, size, camera, rotation, middle - rotation @ middle))
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


def network_landmarks(detector: NetworkDetector, picture: UInt8[np.ndarray, "h w 3"]) -> Landmarks2D | None:
    """N(F*) of the face that the detector finds; None without one."""
    faces = detector.detect_faces(picture)
    if not faces:
        return None
    return photo_landmarks(energy_network(NETWORK), picture, detector.align(picture, faces[0].box))
