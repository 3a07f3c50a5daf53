"""The CSV file that Epic's Live Link Face writes on a phone: ARKit's 52 weights and three rotations per frame.

Importers for Unreal, Blender, Maya, Houdini and MotionBuilder read it. The app's angles are radians. Their signs are
documented nowhere; these are the ones that senders of the same data to Unreal use: yaw > 0 turns the face to the
subject's own left, pitch > 0 up, roll > 0 lowers the subject's right ear. Eyes turn in the head, by the same signs.
"""

import csv
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.export.clip import FLIP, without_failures, without_jaw
from workbench.face import in_scheme, load_default_head
from workbench.face.gaze import eye_turns
from workbench.files import atomic_path
from workbench.frames import RATE_OF_IMAGES
from workbench.landmarks.schemes import DENSE
from workbench.reading import shortened
from workbench.tracking import Track

_EYE = ("eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp", "eyeSquint", "eyeWide")
_SIDES = ("Left", "Right")
LIVE_LINK_SHAPES = (
    *(f"{name}Left" for name in _EYE),
    *(f"{name}Right" for name in _EYE),
    *("jawForward", "jawRight", "jawLeft", "jawOpen"),
    *("mouthClose", "mouthFunnel", "mouthPucker", "mouthRight", "mouthLeft"),
    *(f"{name}{side}" for name in ("mouthSmile", "mouthFrown", "mouthDimple", "mouthStretch") for side in _SIDES),
    *("mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper"),
    *(f"{name}{side}" for name in ("mouthPress", "mouthLowerDown", "mouthUpperUp", "browDown") for side in _SIDES),
    *("browInnerUp", "browOuterUpLeft", "browOuterUpRight", "cheekPuff"),
    *(f"{name}{side}" for name in ("cheekSquint", "noseSneer") for side in _SIDES),
    "tongueOut",
)
"""ARKit's 52 blendshapes in the order of the app's columns."""
ROTATIONS = tuple(f"{part}{angle}" for part in ("Head", "LeftEye", "RightEye") for angle in ("Yaw", "Pitch", "Roll"))
HEADER = ("Timecode", "BlendShapeCount", *(name[0].upper() + name[1:] for name in LIVE_LINK_SHAPES), *ROTATIONS)
VALUES = len(LIVE_LINK_SHAPES) + len(ROTATIONS)


def write_live_link_csv(track: Track, path: str | Path, rate: float | None = None) -> None:
    """One row per frame: timecode HH:MM:SS:FF.mmm, 61, the weights, then yaw, pitch, roll of head and eyes in radians.

    Blendshapes that the track does not have are 0; the eyes turn by as much as their weights turn the default head's,
    which in a track of 68 landmarks, that do not see them, is 0. The motion of a jaw joint is in the jaw's blendshapes.
    A frame without a face, or with a failed fit, has the count 0 and no values, as in the app's files.
    Raises `InputError` for a track that has none of ARKit's blendshapes.
    """
    track = without_jaw(without_failures(track))
    names = track.expression_names
    if not set(names) & set(LIVE_LINK_SHAPES):
        raise InputError(
            f"Live Link Face knows ARKit's blendshapes only, the track has {shortened(', '.join(names) or 'none')}; "
            "map them with --character and --map, or write .csv."
        )
    weights = np.zeros((len(track), len(LIVE_LINK_SHAPES)))
    for column, name in enumerate(LIVE_LINK_SHAPES):
        if name in names:
            weights[:, column] = track.expression[:, names.index(name)]
    rotations = np.zeros((len(track), len(ROTATIONS)))
    rotations[:, :3], rotations[:, 3:] = head_angles(track), eye_angles(weights)
    rate = float(rate or track.meta.get("rate") or RATE_OF_IMAGES)
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(HEADER)
        for index, found, row in zip(track.index, track.found, np.hstack([weights, rotations]), strict=True):
            cells = [f"{cell:.9f}" for cell in row] if found else [""] * VALUES
            writer.writerow([timecode(int(index), rate), VALUES if found else 0, *cells])


def head_angles(track: Track) -> Float[np.ndarray, "n 3"]:
    """HeadYaw, HeadPitch, HeadRoll as the app counts them, radians, of the head before the camera; NaN without a face.

    The head turns by yaw about the upright axis, then by pitch, then by roll: another order than that of
    `Track.angles_deg`, and other signs of yaw and roll.
    """
    angles = np.full((len(track), 3), np.nan)
    if track.found.any():
        about_y, about_x, about_z = Rotation.from_rotvec(track.rotation[track.found] * FLIP).as_euler("YXZ").T
        angles[track.found] = np.stack([about_y, -about_x, about_z], axis=1)
    return angles


def eye_angles(weights: Float[np.ndarray, "n 52"]) -> Float[np.ndarray, "n 6"]:
    """Yaw, pitch and roll (0) of the left eye and then of the right one in the head, radians.

    `weights` in the order of `LIVE_LINK_SHAPES`.
    """
    head = in_scheme(load_default_head(), DENSE)
    order = [head.expression_names.index(name) for name in LIVE_LINK_SHAPES]
    turned = np.radians(weights @ eye_turns(head)[:, order].T).reshape(-1, 2, 2)[:, ::-1]
    return np.concatenate([turned, np.zeros((len(weights), 2, 1))], axis=2).reshape(-1, 6)


def timecode(index: int, rate: float) -> str:
    """HH:MM:SS:FF.mmm: whole seconds of real time, then frames and thousandths of a frame of the nearest whole rate.

    At a whole rate the thousandths are 0; at 29.97 they keep the time true where a count of frames would drift.
    """
    base = max(1, round(rate))
    thousandths = round(index / rate * base * 1000.0)
    seconds, rest = divmod(thousandths, base * 1000)
    frames, fraction = divmod(rest, 1000)
    return f"{seconds // 3600 % 24:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}:{frames:02d}.{fraction:03d}"
