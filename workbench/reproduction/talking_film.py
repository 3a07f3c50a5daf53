"""A person who talks, snaps the mouth shut, blinks and nods before two cameras, and a detector that fails now and then.

For what Deep Energies Sec. 6 to 8.5 and Appendices A and B do over time. Every parameter of every frame is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from workbench.face import FaceModel
from workbench.files import atomic_path, make_folder
from workbench.frames import Frames, open_frames, write_picture
from workbench.geometry import Rig, axis_angle_from_yaw_pitch_roll, write_rig
from workbench.landmarks.network_detector import NetworkDetector
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.surroundings import seen_around
from workbench.reading import checked_arrays, reading
from workbench.reproduction.people import Motion
from workbench.reproduction.stereo_film import AWAY_MM, SIZE, film_views, network_landmarks, on_stage, two_cameras
from workbench.reproduction.study import Study
from workbench.tracking import FrameObservation

RATE = 24
"""Frames per second, the paper's."""
SEED = 31
QUICK_SIZE = (360, 270)


class Timeline(NamedTuple):
    """What happens when, in frames."""

    frames: int
    size: tuple[int, int]
    """Width and height of the pictures."""
    opened: int
    """First frame with the mouth wide open."""
    shut: int
    """First frame with the mouth shut again; two frames before, it was still wide open."""
    blink: int
    nod: int
    lost: range
    """Frames in which the detector finds nothing."""
    stuck: range
    """Frames in which it says what it said in the last frame before."""

    @property
    def gap(self) -> range:
        """Frames about the mouth's snap, as the paper's 1143 to 1145: open, open, nearly shut."""
        return range(self.shut - 3, self.shut)


FULL = Timeline(32, SIZE, opened=8, shut=15, blink=20, nod=26, lost=range(19, 22), stuck=range(25, 27))
QUICK = Timeline(9, QUICK_SIZE, opened=1, shut=4, blink=5, nod=7, lost=range(5, 6), stuck=range(7, 8))


@dataclass(frozen=True, eq=False)
class TalkingFilm:
    """What both cameras saw, and what was before them."""

    timeline: Timeline
    folder: Path
    """Holds `rig.toml` and the pictures of each camera."""
    rig: Rig
    identity: Float[np.ndarray, "i"]
    motion: Motion
    """In the frame of the first camera."""
    seen: tuple[tuple[Landmarks2D | None, ...], ...]
    """N(F*) of every frame in each view, by a detector that does not fail."""

    @property
    def views(self) -> tuple[Frames, ...]:
        """The pictures of each camera."""
        return tuple(open_frames(self.folder / name) for name in self.rig.names)

    def observations(self) -> tuple[FrameObservation, ...]:
        """What the failing detector has, both views; the first frame comes with its picture."""
        found = zip(*(self._failing(view) for view in self.seen), strict=True)
        shown = zip(*(view.iterate() for view in self.views), strict=True)
        frames = enumerate(zip(found, shown, strict=True))
        return tuple(self._observation(k, seen, [each.picture for each in views]) for k, (seen, views) in frames)

    def _observation(
        self, number: int, seen: Sequence[Landmarks2D | None], pictures: Sequence[UInt8[np.ndarray, "h w 3"]]
    ) -> FrameObservation:
        return FrameObservation(
            number,
            seen[0],
            self.timeline.size,
            picture=None if number else pictures[0],
            others=tuple(seen[1:]),
            surroundings=tuple(map(seen_around, pictures, seen)),
        )

    def _failing(self, seen: Sequence[Landmarks2D | None]) -> list[Landmarks2D | None]:
        lost, stuck = self.timeline.lost, self.timeline.stuck
        return [None if k in lost else seen[stuck.start - 1] if k in stuck else seen[k] for k in range(len(seen))]


def talking_film(head: FaceModel, study: Study) -> TalkingFilm:
    """The film of a study, kept in its folder. Raises `InputError` where VTK cannot draw."""
    timeline = QUICK if study.quick else FULL
    folder, rig = study.folder / "film", two_cameras(timeline.size)
    motion = performance(head.expression_names, timeline)
    stored = folder / "film.npz"
    if not stored.exists():
        _film(head, rig, motion, folder, study)
    advice = f"delete {folder} and run again"
    with reading(stored, "a film", advice), stored.open("rb") as stream, checked_arrays(stream) as arrays:
        points, confidence, identity = arrays["points"], arrays["confidence"], arrays["identity"]
    seen = tuple(
        tuple(Landmarks2D(*pair, timeline.size) if pair[1].any() else None for pair in zip(*view, strict=True))
        for view in zip(points, confidence, strict=True)
    )
    return TalkingFilm(timeline, folder, rig, identity, motion, seen)


def performance(names: tuple[str, ...], timeline: Timeline) -> Motion:
    """What the person does; `names` are the head's blendshapes."""
    time = np.arange(timeline.frames, dtype=float)
    shut, since = timeline.shut, np.maximum(time - timeline.shut - 2.0, 0.0)
    wide = np.interp(time, [0.0, timeline.opened, shut - 2, shut - 1, shut], [0.0, 1.0, 1.0, 0.25, 0.0])
    closed = np.clip(1.5 - np.abs(time - timeline.blink) / 1.5, 0.0, 1.0)
    nod = np.exp(-0.5 * ((time - timeline.nod) / 1.6) ** 2)
    smile = 0.3 * np.sin(0.14 * time) ** 2
    weights = {
        "jawOpen": 0.6 * wide + 0.3 * np.sin(0.33 * since) ** 2,
        "mouthFunnel": 0.2 * wide + 0.2 * np.sin(0.21 * since) ** 2,
        **{f"mouthSmile{side}": smile for side in ("Left", "Right")},
        **{f"eyeBlink{side}": closed for side in ("Left", "Right")},
    }
    faces = np.zeros((timeline.frames, len(names)))
    for name, values in weights.items():
        faces[:, names.index(name)] = values
    angles = np.stack([8.0 * np.sin(0.17 * time), 3.0 * np.sin(0.13 * time) - 14.0 * nod, 2.5 * np.sin(0.2 * time)], 1)
    places = np.stack([9.0 * np.sin(0.12 * time), 5.0 * np.sin(0.15 * time), AWAY_MM + 14.0 * np.sin(0.1 * time)], 1)
    return Motion(axis_angle_from_yaw_pitch_roll(angles), places, faces)


def _film(head: FaceModel, rig: Rig, motion: Motion, folder: Path, study: Study) -> None:
    count, detector = len(motion), NetworkDetector()
    points, confidence = np.zeros((len(rig), count, 68, 2)), np.zeros((len(rig), count, 68))
    for name in rig.names:
        make_folder(folder / name)
    write_rig(rig, folder / "rig.toml")
    for shot in film_views(head, rig, motion, SEED, on_stage):
        study.progress(f"film of camera {shot.view + 1}", shot.frame, count)
        write_picture(folder / rig.names[shot.view] / f"{shot.frame:04d}.png", shot.picture)
        if (found := network_landmarks(detector, shot.picture)) is not None:
            points[shot.view, shot.frame], confidence[shot.view, shot.frame] = found.points, found.confidence
        identity = shot.identity
    # Last: a film with landmarks is whole.
    with atomic_path(folder / "film.npz") as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, points=points, confidence=confidence, identity=identity)
