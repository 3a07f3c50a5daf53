"""A track ready to leave: the person's head, the time of every frame, and the frame of reference of 3D files.

All 3D files (glTF, USD, OBJ, PLY) have one frame of reference: metres, +x to the picture's right, +y up, +z towards
the viewer, the camera in the origin. That is OpenCV's camera frame turned by half a turn about x.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.face import FaceModel, JawJoint, jaw_joint, posed_vertices, weights_with_jaw
from workbench.frames import RATE_OF_IMAGES
from workbench.geometry import Camera
from workbench.pictures.mesh import to_camera
from workbench.tracking import Track
from workbench.tracking.failures import failures_of
from workbench.tracking.records import ARRAYS
from workbench.tracking.track_layout import jaw_unit_of

MOST_RATE = 1000.0
METRES = 1e-3
FLIP = np.array([1.0, -1.0, -1.0])
"""Half a turn about x: from +y down, +z away to +y up, +z towards the viewer."""


@dataclass(frozen=True, eq=False)
class Clip:
    """A track with the one person who plays in it."""

    track: Track
    person: FaceModel
    """Identity baked in."""
    rate: float
    """Frames per second."""
    notes: tuple[str, ...] = ()
    """What a user should know."""

    @property
    def times_s(self) -> Float[np.ndarray, "n"]:
        """Seconds from the run's first frame."""
        return self.track.index / self.rate

    @property
    def camera(self) -> Camera:
        """The camera of the first frame with a face."""
        return self.track[int(np.argmax(self.track.found))].camera

    @property
    def image_size(self) -> tuple[int, int]:
        """(width, height) of that frame, pixels."""
        return self.track[int(np.argmax(self.track.found))].image_size

    @cached_property
    def joint(self) -> JawJoint:
        """The person's jaw joint; one that moves nothing for a head without it."""
        return jaw_joint(self.person)

    @property
    def moves_jaw(self) -> bool:
        """Whether the jaw joint moves, in addition to the blendshapes (Deep Energies)."""
        return bool(self.track.jaw[self.track.found].any())

    @property
    def moves_scale(self) -> bool:
        """Whether the head changes its size (views that do not tell its distance)."""
        return bool((self.track.scale[self.track.found] != 1.0).any())

    def vertices_head(self, position: int) -> Float[np.ndarray, "v 3"]:
        """The person's vertices in one frame with a face: head frame, millimetres."""
        track = self.track
        return posed_vertices(
            self.person, track.expression[position], track.jaw[position], float(track.scale[position])
        )

    def vertices_world(self, position: int) -> Float[np.ndarray, "v 3"]:
        """The same before the camera, in the coordinate frame of 3D files, metres."""
        track = self.track
        points = to_camera(self.vertices_head(position), track.rotation[position], track.translation[position])
        return to_world(points)


def make_clip(track: Track, model: FaceModel, shot: int | None = None, rate: float | None = None) -> Clip:
    """The track with its person; `model` is what it was fitted with, or what it was retargeted to.

    A file holds one face. If the shots of a track have different faces, the one with the most frames is used for all,
    unless `shot` takes one shot alone. `rate` replaces the track's frames per second. Raises `InputError` for a track
    without a face, for a shot that it does not have, for a model other than the track's and for a rate that is not
    between 0 and 1000.
    """
    check_model(track, model)
    check_rate(rate)
    if shot is not None:
        track = track_of_shot(track, shot)
    if not track.found.any():
        raise InputError("No frame of this track has a face, so there is nothing to export in 3D.")
    notes = []
    good = without_failures(track)
    if good is not track:
        notes.append(f"{int(track.found.sum() - good.found.sum())} of {len(track)} fits failed and have no key")
        track = good
    if len(np.unique(np.hstack([track.focal_px, track.image_size])[track.found], axis=0)) > 1:
        notes.append("the pictures have several lenses or sizes; the file has the camera of the first one with a face")
    stored = track.meta.get("rate")
    if rate is None:
        notes += note_on_rate(track)
    identity, others = main_identity(track)
    if others:
        notes.append(
            f"the shots have {others + 1} face shapes; the one with the most frames is used for all, or use --shot"
        )
    rate = float(rate or stored or RATE_OF_IMAGES)
    return Clip(track, model.personal(identity), rate, tuple(notes))


def note_on_rate(track: Track) -> tuple[str, ...]:
    """What a user should know of a track without a frame rate."""
    if track.meta.get("rate") or len(track) == 1:
        return ()
    return (f"the input has no frame rate; frames are written at {RATE_OF_IMAGES:g} per second",)


def without_failures(track: Track) -> Track:
    """The track with frames whose fit failed counted as frames without a face; unchanged if that leaves none."""
    good = failures_of(track) == ""
    return replace(track, found=good) if good.any() and (good != track.found).any() else track


def without_jaw(track: Track) -> Track:
    """The track with the jaw joint's motion in the blendshapes, for formats and characters without a joint."""
    if not track.jaw.any():
        return track
    weights = weights_with_jaw(track.expression_names, track.expression, track.jaw, jaw_unit_of(track.meta))
    return replace(track, expression=weights, jaw=np.zeros_like(track.jaw))


def track_of_shot(track: Track, shot: int) -> Track:
    """The frames of one shot. Raises `InputError` for one that the track does not have."""
    chosen = track.shot == shot
    if not chosen.any():
        raise InputError(f"This track has the shots 0 to {int(track.shot.max())}, got {shot}.")
    return replace(track, **{name: getattr(track, name)[chosen] for name in ARRAYS})


def check_rate(rate: float | None) -> None:
    """Raise `InputError` for frames per second that no clip has; None is the track's own."""
    if rate is not None and not 0.0 < rate <= MOST_RATE:
        raise InputError(f"A clip needs a rate between 0 and {MOST_RATE:g} frames per second, got {rate:g}.")


def check_model(track: Track, model: FaceModel) -> None:
    """Raise `InputError` where the track's columns are not those of the model."""
    if track.expression_names != model.expression_names:
        raise InputError(
            f"The track has {len(track.expression_names)} blendshapes that are not the {len(model.expression_names)} "
            f"of {model.name}; pass the model it was fitted with, or retarget it."
        )
    if track.identity.shape[1] != len(model.identity_deltas):
        raise InputError(
            f"The track has {track.identity.shape[1]} identity coefficients, {model.name} has "
            f"{len(model.identity_deltas)}; pass the model it was fitted with."
        )


def to_world(points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Millimetres with +y down and +z away to the metres of 3D files; for points of the camera and the head frame."""
    return points * (METRES * FLIP)


def quaternions(rotations: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """Axis-angles as unit quaternions (x, y, z, w) in the frame of reference of 3D files, without jumps of sign."""
    # Turning the frame by FLIP turns the axis; the angle stays.
    found = Rotation.from_rotvec(rotations * FLIP).as_quat()
    signs = np.where((found[1:] * found[:-1]).sum(1) < 0.0, -1.0, 1.0)
    found[1:] *= np.cumprod(signs)[:, None]
    return found


def main_identity(track: Track) -> tuple[Float[np.ndarray, "i"], int]:
    """The identity with the most frames, and how many others there are."""
    faces, counts = np.unique(track.identity[track.found], axis=0, return_counts=True)
    return faces[np.argmax(counts)], len(faces) - 1
