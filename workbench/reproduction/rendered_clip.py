"""The bundled clip of a rendered head, with the landmarks of a detector and the exact truth of every frame."""

from collections.abc import Iterable, Mapping
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from workbench.config import Config, preset
from workbench.face import FaceParameters, load_default_head
from workbench.frames import open_frames
from workbench.geometry import yaw_pitch_roll_deg
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.observations import Landmarks2D
from workbench.samples import sample

SIZE = (640, 480)
"""Of the clip, and of FACE IT!'s camera."""
FOV_DEG = 33.0
"""The clip's lens."""
CLIP = "the bundled clip of a rendered head (240 frames of 640 × 480) with landmarks by dlib"
NEUTRAL_FRAME = 0
OPEN_MOUTH = 200
"""A frame with the mouth as wide open as the clip has it."""
SEVEN_FRAMES = (24, 60, 100, 140, 180, OPEN_MOUTH, 220)


class ClipTruth(NamedTuple):
    """What was rendered, frame by frame."""

    rotation: Float[np.ndarray, "n 3"]
    """Angle-axis, camera frame."""
    translation_mm: Float[np.ndarray, "n 3"]
    expression: Float[np.ndarray, "n 44"]
    jaw_deg: Float[np.ndarray, "n"]
    """Angle of a jaw joint that opens the mouth as far as the blendshape `jawOpen` does."""
    identity: Float[np.ndarray, "i"]
    camera_matrix: Float[np.ndarray, "3 3"]
    landmarks: Float[np.ndarray, "n 68 2"]
    """Exact, pixels."""

    @property
    def angles_deg(self) -> Float[np.ndarray, "n 3"]:
        """Yaw, pitch and roll."""
        return yaw_pitch_roll_deg(self.rotation)


@cache
def clip_truth() -> ClipTruth:
    """The truth of the clip."""
    with np.load(sample("performance-truth"), allow_pickle=False) as stored:
        names = list(stored["expression_names"])
        matrix = np.eye(3)
        matrix[[0, 1], [0, 1]], matrix[:2, 2] = stored["focal_px"], stored["principal_point_px"]
        return ClipTruth(
            stored["rotation"],
            stored["translation"],
            stored["expression"],
            load_default_head().jaw_unit.open_deg * stored["expression"][:, names.index("jawOpen")],
            stored["identity"],
            matrix,
            stored["landmarks"],
        )


@cache
def clip_landmarks() -> tuple[Landmarks2D | None, ...]:
    """The landmarks of all frames."""
    return tuple(record.landmarks for record in read_landmark_file(sample("performance-landmarks")))


def clip_pictures(frames: Iterable[int]) -> Mapping[int, UInt8[np.ndarray, "480 640 3"]]:
    """The pictures of some frames, by number."""
    clip = open_frames(sample("performance"))
    return {k: next(clip.iterate(k)).picture for k in frames}


def true_parameters(frame: int) -> FaceParameters:
    """The truth of a frame as parameters; the jaw opens by its blendshape."""
    truth = clip_truth()
    parts = truth.rotation[frame], truth.translation_mm[frame], truth.expression[frame], truth.identity
    return FaceParameters(*parts, np.zeros(6), np.ones(1))


def with_clip_lens(name: str) -> Config:
    """A preset of FACE IT! with the clip's lens."""
    return preset(name).changed(camera={"fov_deg": FOV_DEG})


def errors_of_pose_and_jaw(parameters: FaceParameters, frame: int) -> tuple[float, float, float, float]:
    """Errors of rotation (°), position across and along the view (mm), and the jaw's angle (°)."""
    truth = clip_truth()
    off = np.asarray(parameters.translation) - truth.translation_mm[frame]
    jaw = np.degrees(float(parameters.jaw[0])) - truth.jaw_deg[frame]
    turn = Rotation.from_rotvec(np.array(parameters.rotation)) * Rotation.from_rotvec(truth.rotation[frame]).inv()
    return float(np.degrees(turn.magnitude())), float(np.linalg.norm(off[:2])), abs(float(off[2])), abs(jaw)
