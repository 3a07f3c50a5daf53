"""Frames with one planted fault each, built on the sample clip whose truth is known.

Every fault is planted where it happens in life: in the landmarks, in the pictures, in the configuration or in the
face that is fitted. The whole clip is then tracked with it, and one frame is handed over as a `FrameCase`, which holds
nothing of the truth. Each variant has its own frame, size, direction and landmark noise. Thresholds are chosen on the
stream "develop" (odd frames, other seeds); "test" is what is reported.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from workbench.config import Config, preset
from workbench.diagnosis import FrameCase
from workbench.energies import project_landmarks
from workbench.face import (
    FaceModel,
    FaceParameters,
    LandmarkModel,
    contour_blend,
    in_scheme,
    landmark_model,
    load_default_head,
    model_landmarks,
)
from workbench.frames import open_frames, read_picture
from workbench.geometry import Camera
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import GROUPS, IBUG68, outer_eye_distance
from workbench.landmarks.schemes import PUPILS, detector_scheme, scheme_named, scheme_of_count
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.tracking import FaceItFitter, FrameContext, FrameFit, FrameObservation
from workbench.tracking.fitting import Calibrated
from workbench.tracking.frame_solver import head_yaw
from workbench.tracking.walk import Walk

NOISE_PX = 0.5
STREAMS = {"develop": 1, "test": 0}
"""Parity of the frames; the seeds differ too."""
WORST_PART = 0.15
"""Faults of the configuration are looked at where they hurt: one of this part of the frames, by the error they add."""


@dataclass(frozen=True)
class Clip:
    """The truth of the clip and its pictures."""

    head: FaceModel
    size: tuple[int, int]
    camera: Camera
    fov_deg: float
    parameters: list[FaceParameters]
    landmarks: Float[np.ndarray, "n points 2"]
    pictures: list[UInt8[np.ndarray, "h w 3"]]

    def noisy(self, rng: np.random.Generator) -> Float[np.ndarray, "n points 2"]:
        """The landmarks as a good detector gives them."""
        return self.landmarks + NOISE_PX * rng.standard_normal(self.landmarks.shape)

    def projected(self, parameters: FaceParameters) -> Float[np.ndarray, "points 2"]:
        """The exact landmarks of these parameters in the clip's camera."""
        return landmarks_of(landmark_model(self.head), self.camera, parameters)


@dataclass(frozen=True)
class Planted:
    """A case and what is wrong with it."""

    fault: str
    code: str
    case: FrameCase


def clip(config: Config | None = None) -> Clip:
    """The sample clip with the landmarks that a configuration's detector finds; the 68 without one."""
    return _clip("ibug68" if config is None else detector_scheme(config.landmarks.detector).name)


@cache
def _clip(scheme: str) -> Clip:
    truth = np.load(sample("performance-truth"), allow_pickle=False)
    camera = Camera(truth["focal_px"], truth["principal_point_px"], truth["distortion"])
    size = tuple(int(length) for length in truth["image_size"])
    head, known = in_scheme(load_default_head(), scheme_named(scheme)), load_default_head().expression_names
    expression = np.zeros((len(truth["expression"]), len(head.expression_names)))
    expression[:, [head.expression_names.index(name) for name in known]] = truth["expression"]
    rows = zip(truth["rotation"], truth["translation"], expression, strict=True)
    parameters = [FaceParameters(*row, truth["identity"]) for row in rows]
    model, known_points = landmark_model(head), truth["landmarks"]
    if head.scheme is not IBUG68:
        known_points = np.stack([landmarks_of(model, camera, each) for each in parameters])
    return Clip(
        head=head,
        size=size,
        camera=camera,
        fov_deg=float(np.degrees(2 * np.arctan(0.5 * size[0] / camera.focal_px[0]))),
        parameters=parameters,
        landmarks=known_points,
        pictures=[frame.picture for frame in open_frames(sample("performance")).iterate()],
    )


def landmarks_of(model: LandmarkModel, camera: Camera, parameters: FaceParameters) -> Float[np.ndarray, "points 2"]:
    """The exact landmarks of a face in a camera."""
    blend = contour_blend(model.contour_yaw, head_yaw(np.asarray(parameters.rotation)), 1.0)
    points = model_landmarks(model, blend, np.asarray(parameters.identity))
    return np.asarray(project_landmarks(camera, points, parameters))


def good_config(name: str = "joint") -> Config:
    """The configuration that fits the clip well, with its true field of view: then a planted fault is the only one.

    The preset `calibrated` solves pose and expression in turn and is off by two degrees in the median on this clip.
    """
    return preset(name).changed(camera={"fov_deg": clip().fov_deg})


def observations_of(points: Float[np.ndarray, "n points 2"]) -> list[FrameObservation]:
    """Landmarks of the clip as the tracker takes them; dense ones with the covariance of their noise."""
    size, sure, covariance = clip().size, np.ones(points.shape[1]), None
    if scheme_of_count(points.shape[1]).has_covariances:
        covariance = np.tile(NOISE_PX**2 * np.eye(2), (points.shape[1], 1, 1))
    return [FrameObservation(k, Landmarks2D(row, sure, size, covariance), size) for k, row in enumerate(points)]


def follow(
    observations: Sequence[FrameObservation],
    config: Config,
    identity: np.ndarray | None = None,
    until: int | None = None,
) -> list[tuple[FrameFit, FrameContext]]:
    """Track the clip as `FaceTracker` does, up to and with frame `until`; `identity` replaces the calibrated one."""
    head = clip(config).head
    walk = Walk(FaceItFitter(head, plan_of(config, head.scheme)))
    if identity is None:
        walk.begin_shot(walk.fitter.calibrate(observations[: config.identity.window], config.identity.frames))
    else:
        walk.begin_shot(Calibrated(identity, {}))
    return [walk.step(observation) for observation in observations[: None if until is None else until + 1]]
    if identity is None:
        walk.begin_shot(walk.fitter.calibrate(observations[: config.identity.window], config.identity.frames))
    else:
        walk.begin_shot(Calibrated(identity, {}))
    return [walk.step(observation) for observation in observations[: None if until is None else until + 1]]


def case_at(
    index: int,
    points: Float[np.ndarray, "n points 2"],
    config: Config,
    identity: np.ndarray | None = None,
    pictures: Sequence[np.ndarray] | None = None,
) -> FrameCase:
    """Frame `index` of the clip with these landmarks, as a session would hand it over."""
    observations = observations_of(points)
    _, context = follow(observations, config, identity, until=index)[index]
    pictures = clip().pictures if pictures is None else pictures
    previous = pictures[index - 1] if len(pictures) else None
    case = FrameCase(observations[index], context, config, observations)
    if not len(pictures):
        return case
    return replace(case, picture=pictures[index], previous_picture=previous, pictures=pictures.__getitem__)


def swapped(rng, frame, config) -> FrameCase:
    """Two points farther apart than a tenth of the eye distance carry each other's number."""
    index, points = frame(), clip(config).noisy(rng)
    while True:
        first, second = rng.choice(np.arange(17, 68), 2, replace=False)
        if np.linalg.norm(points[index, first] - points[index, second]) > 0.1 * outer_eye_distance(points[index]):
            break
    points[index, [first, second]] = points[index, [second, first]]
    return case_at(index, points, config)


def shifted_jaw(rng, frame, config) -> FrameCase:
    """The detector takes a shadow for the jaw line, from some frames before on."""
    index, points = frame(), clip(config).noisy(rng)
    points[index - rng.integers(0, 4) : index + 2, :17] += _direction(rng) * rng.uniform(10.0, 16.0)
    return case_at(index, points, config)


def focal_twice_or_half(rng, frame, config) -> FrameCase:
    """The field of view is set for a focal length that is wrong by a factor of two."""
    index, factor = frame(), float(rng.choice([0.5, 2.0]))
    fov = float(np.degrees(2 * np.arctan(np.tan(np.radians(clip(config).fov_deg) / 2) / factor)))
    return case_at(index, clip(config).noisy(rng), config.changed(camera={"fov_deg": fov}))


def occluded_mouth(rng, frame, config) -> FrameCase:
    """Something is before the mouth for a while, and a confused detector scatters its points."""
    index, points = frame(), clip(config).noisy(rng)
    start, mouth = index - int(rng.integers(0, 3)), list(clip(config).head.scheme.groups["mouth"])
    pictures, colour = list(clip(config).pictures), rng.integers(20, 230, 3)
    for k in range(start, min(index + 3, len(pictures))):
        hull = points[k][mouth]
        centre, half = hull.mean(0), 0.7 * np.ptp(hull, axis=0) + 6.0
        picture = pictures[k].copy()
        cv2.ellipse(picture, tuple(map(int, centre)), tuple(map(int, half)), 0, 0, 360, tuple(map(int, colour)), -1)
        pictures[k] = picture
        points[k, mouth] += rng.normal(0.0, rng.uniform(7.0, 12.0), (len(mouth), 2))
    return case_at(index, points, config, pictures=pictures)


def frozen(rng, frame, config) -> FrameCase:
    """The detector repeats the landmarks of five frames ago while the picture moves on."""
    landmarks = clip(config).landmarks
    index = frame(lambda k: np.linalg.norm(landmarks[k] - landmarks[k - 5], axis=1).mean() > 6.0)
    points = clip(config).noisy(rng)
    points[index - 5 : index + int(rng.integers(1, 4))] = points[index - 5]
    return case_at(index, points, config)


def biased_brow(rng, frame, config) -> FrameCase:
    """All points of one brow lie 10 px off, from this frame or one or two before on."""
    index, points = frame(), clip(config).noisy(rng)
    brow = list(clip(config).head.scheme.groups[str(rng.choice(["right_brow", "left_brow"]))])
    points[index - int(rng.integers(0, 3)) : index + 5, brow] += 10.0 * _direction(rng)
    return case_at(index, points, config)


def one_expression_iteration(rng, frame, config) -> FrameCase:
    """ε = 1 on a slow camera: every sixth frame of the clip, so that the expression of the last frame is no help.

    At 25 frames/s a single iteration from the frame before is nearly enough.
    """
    stages = [
        {**stage.model_dump(), "limit": 1 if "expression" in stage.free else stage.limit} for stage in config.stages
    ]
    return _where_it_hurts(rng, frame, config, config.changed(stages=stages), stride=6)


def heavy_tau(rng, frame, config) -> FrameCase:
    """ω_τ × 1000."""
    return _where_it_hurts(rng, frame, config, config.changed(weights={"tau": 1000.0 * config.weights.tau}))


def mirrored(rng, frame, config) -> FrameCase:
    """The order of the points is that of the flipped picture in this frame."""
    index, points = frame(), clip(config).noisy(rng)
    points[index] = points[index, list(clip(config).head.scheme.mirror)]
    return case_at(index, points, config)


def mirrored_throughout(rng, frame, config) -> FrameCase:
    """The order of the points is that of the flipped picture in the whole shot."""
    points = clip(config).noisy(rng)[:, list(clip(config).head.scheme.mirror)]
    return case_at(frame(), points, config)


def leaving_the_picture(rng, frame, config) -> FrameCase:
    """The head moves out of the picture; a detector puts the points that it cannot see on the edge or beyond it."""
    index, truth = frame(), clip(config)
    axis = int(rng.integers(0, 2))
    side = rng.choice([-1.0, 1.0])
    size = np.array(truth.size, float)
    # So far that the chosen part of the points is outside at the frame.
    inside = truth.landmarks[index, :, axis]
    edge = 0.0 if side < 0 else size[axis] - 1.0
    reach_px = edge - np.quantile(inside, rng.uniform(0.12, 0.35) if side < 0 else rng.uniform(0.65, 0.88))
    depth = truth.parameters[index].translation[2]
    reach_mm = reach_px * depth / truth.camera.focal_px[0]
    points = clip(config).noisy(rng)
    for k in range(max(index - 15, 0), min(index + 4, len(points))):
        part = 1.0 - max(index - k, 0) / 16.0
        moved = np.array(truth.parameters[k].translation)
        moved[axis] += part * reach_mm
        points[k] = truth.projected(truth.parameters[k]._replace(translation=moved)) + rng.normal(
            0.0, NOISE_PX, points[k].shape
        )
        hidden = ((points[k] < 0.0) | (points[k] > size - 1.0)).any(axis=1)
        guess = points[k] + rng.normal(0.0, 5.0, points[k].shape)
        points[k] = np.where(hidden[:, None], np.clip(guess, -3.0, size + 2.0), points[k])
    return case_at(index, points, config, pictures=())


def other_person(rng, frame, config) -> FrameCase:
    """The identity of someone else is fitted."""
    identity = 0.8 * rng.standard_normal(len(clip(config).head.identity_deltas))
    return case_at(frame(), clip(config).noisy(rng), config, identity=identity)


def blurred(rng, frame, config) -> FrameCase:
    """The picture is smeared along a direction, and the landmarks are uncertain along it."""
    index, points, direction = frame(), clip(config).noisy(rng), _direction(rng)
    length = rng.uniform(16.0, 26.0)
    pictures = list(clip(config).pictures)
    pictures[index] = smeared(pictures[index], direction, length)
    points[index] += rng.normal(0.0, 0.25 * length, (points.shape[1], 1)) * direction
    return case_at(index, points, config, pictures=pictures)


def out_of_focus(rng, frame, config) -> FrameCase:
    """The focus is lost for two frames, in all directions, and the landmarks scatter with it."""
    index, points = frame(), clip(config).noisy(rng)
    pictures = list(clip(config).pictures)
    for k in (index - 1, index):
        pictures[k] = cv2.GaussianBlur(pictures[k], (0, 0), rng.uniform(5.0, 9.0))
        points[k] += rng.normal(0.0, 2.0, points[k].shape)
    return case_at(index, points, config, pictures=pictures)


def lights_out(rng, frame, config) -> FrameCase:
    """The light fails for two frames, and a detector hardly finds the points."""
    index, points = frame(), clip(config).noisy(rng)
    pictures = list(clip(config).pictures)
    for k in (index - 1, index):
        pictures[k] = np.uint8(pictures[k] * rng.uniform(0.08, 0.18))
        points[k] += rng.normal(0.0, 2.5, points[k].shape)
    return case_at(index, points, config, pictures=pictures)


def hand_before_the_mouth(rng, frame, config) -> FrameCase:
    """A hand of the face's own colour is before mouth and chin; the detector draws a mouth there, and doubts it."""
    index, points = frame(), clip(config).noisy(rng)
    lower = [*clip(config).head.scheme.groups["mouth"], *range(5, 12)]
    pictures, confidence = list(clip(config).pictures), np.ones(points.shape[:2])
    for k in range(index - int(rng.integers(0, 3)), index + 3):
        hull = points[k][lower]
        centre, half = hull.mean(0), 0.62 * np.ptp(hull, axis=0)
        skin = np.median(pictures[k][tuple(points[k][[29, 31, 35]].astype(int).T[::-1])], axis=0)
        covered = np.zeros(pictures[k].shape[:2], np.uint8)
        cv2.ellipse(covered, tuple(map(int, centre)), tuple(map(int, half)), 0, 0, 360, 1, -1)
        fingers = 18.0 * np.sin(np.arange(len(covered)) / max(half[1] / 5.0, 1.0))[:, None, None]
        pictures[k] = np.where(covered[..., None], np.clip(0.9 * skin + fingers, 0, 255), pictures[k]).astype(np.uint8)
        points[k, lower] += rng.normal(0.0, 4.0, (len(lower), 2))
        confidence[k, lower] = rng.uniform(0.2, 0.45, len(lower))
    case = case_at(index, points, config, pictures=pictures)
    shot = [
        replace(item, landmarks=replace(item.landmarks, confidence=sure))
        for item, sure in zip(case.shot, confidence, strict=True)
    ]
    return replace(case, observation=shot[index], shot=shot)


def jump_aside(rng, frame, config) -> FrameCase:
    """All points lie somewhere else for one frame, on another face or a poster, while the picture stays calm."""
    index, points = frame(), clip(config).noisy(rng)
    points[index] += rng.uniform(40.0, 70.0) * _direction(rng)
    return case_at(index, points, config, pictures=clip(config).pictures)


def turned_to_profile(rng, frame, config) -> FrameCase:
    """The head turns to the side within a second; the points that it hides are guesses."""
    index, truth = frame(), clip(config)
    points, yaw_deg = truth.noisy(rng), float(rng.choice([-1.0, 1.0]) * rng.uniform(55.0, 65.0))
    for k in range(index - 18, index + 6):
        part = min(1.0, (k - index + 19) / 16.0)
        turn = Rotation.from_rotvec([0.0, np.radians(part * yaw_deg), 0.0])
        rotation = (turn * Rotation.from_rotvec(np.asarray(truth.parameters[k].rotation))).as_rotvec()
        points[k] = truth.projected(truth.parameters[k]._replace(rotation=rotation)) + rng.normal(
            0.0, NOISE_PX, points[k].shape
        )
    return case_at(index, points, config, pictures=())


def pupil_on_a_reflection(rng, frame, config) -> FrameCase:
    """The detector takes a reflection for a pupil, from this frame or one or two before on."""
    index, points, groups = frame(), clip(config).noisy(rng), clip(config).head.scheme.groups
    side, irises, seen = int(rng.integers(0, 2)), np.array(groups["irises"]), points[index]
    nearest = np.linalg.norm(seen[irises, None] - seen[None, list(PUPILS)], axis=2).argmin(axis=1)
    wide = np.ptp(seen[list(GROUPS[("right_eye", "left_eye")[side]]), 0])
    away = rng.choice([-1.0, 1.0]) * rng.uniform(0.18, 0.28) * wide * np.array([1.0, 0.0])
    points[index - int(rng.integers(0, 3)) : index + 3, irises[nearest == side]] += away
    return case_at(index, points, config)


def unseen_cut(rng, frame, config) -> FrameCase:
    """Another person in another place comes before this scene, and no cut is marked between them."""
    index, points, pictures = frame(), clip(config).noisy(rng), list(clip(config).pictures)
    portrait = next(iter(read_landmark_file(sample("astronaut-landmarks")))).landmarks
    scale = np.array(clip(config).size) / portrait.image_size
    shown = cv2.resize(read_picture(sample("astronaut")), clip(config).size)
    for k in range(index):
        pictures[k] = shown
        points[k] = scale * portrait.points + rng.normal(0.0, NOISE_PX, portrait.points.shape)
    return case_at(index, points, config, pictures=pictures)


FAULTS: dict[str, tuple[str, Callable]] = {
    "swapped points": ("points_swapped", swapped),
    "shifted jaw": ("jaw_disagrees", shifted_jaw),
    "wrong focal ×2": ("wrong_focal", focal_twice_or_half),
    "occluded mouth": ("occluded", occluded_mouth),
    "frozen detector": ("frozen_detector", frozen),
    "10-px bias of a brow": ("group_biased", biased_brow),
    "ε = 1": ("not_converged", one_expression_iteration),
    "ω_τ × 1000": ("tau_fights_data", heavy_tau),
    "mirrored order": ("mirrored_order", mirrored),
    "face out of frame": ("face_outside", leaving_the_picture),
    "wrong identity": ("wrong_identity", other_person),
    "motion blur": ("motion_blur", blurred),
    "out of focus": ("blurred_face", out_of_focus),
    "lights out": ("dark_face", lights_out),
    "hand before the mouth": ("occluded", hand_before_the_mouth),
    "jump aside": ("jump", jump_aside),
}
"""Fault → the code of the right reason, and what plants it."""
UNMENDED: dict[str, tuple[str, Callable]] = {
    "head turned to profile": ("turned_away", turned_to_profile),
    "unseen cut": ("unseen_cut", unseen_cut),
    "mirrored shot": ("mirrored_order", mirrored_throughout),
}
"""The same of faults for which there is a reason, but no change that mends them; the benchmark does not count them."""


OF_PUPILS: dict[str, tuple[str, Callable]] = {"pupil on a reflection": ("stray_pupil", pupil_on_a_reflection)}
"""The same of faults that only schemes with pupils can have."""


def planted(fault: str, variant: int, stream: str = "test", config: Config | None = None) -> Planted:
    """One variant of a fault, in a run with this configuration (`good_config` if not given)."""
    known, config = FAULTS | UNMENDED | OF_PUPILS, config or good_config()
    code, plant = known[fault]
    rng = np.random.default_rng([list(known).index(fault), variant, STREAMS[stream]])

    def frame(suits: Callable[[int], bool] = lambda index: True) -> int:
        allowed = range(20 + STREAMS[stream], len(clip(config).landmarks) - 10, 2)
        return int(rng.choice([index for index in allowed if suits(index)]))

    return Planted(fault, code, plant(rng, frame, config))


def smeared(picture: UInt8[np.ndarray, "h w 3"], direction: np.ndarray, length: float) -> UInt8[np.ndarray, "h w 3"]:
    """The picture moved along a line of `length` pixels while the shutter was open."""
    reach = int(np.ceil(length / 2.0))
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    for step in np.linspace(-length / 2.0, length / 2.0, 8 * reach):
        x, y = np.round(reach + step * direction).astype(int)
        kernel[y, x] += 1.0
    return cv2.filter2D(picture, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)


def _where_it_hurts(rng, frame, good: Config, config: Config, stride: int = 1) -> FrameCase:
    points = clip(config).noisy(rng)
    first = frame() % stride
    observations = observations_of(points[first::stride])
    errors = [np.array([fit.errors[2] for fit, _ in follow(observations, each)]) for each in (config, good)]
    added = errors[0] - errors[1]
    enough = np.quantile(added, 1.0 - WORST_PART)
    index = frame(lambda k: k % stride == first and added[k // stride] >= enough)
    return case_at(index // stride, points[first::stride], config, pictures=clip(config).pictures[first::stride])


def _direction(rng) -> Float[np.ndarray, "2"]:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def without_pictures(case: FrameCase) -> FrameCase:
    """The same case as seen through a landmark file."""
    return replace(case, picture=None, previous_picture=None, pictures=None)
