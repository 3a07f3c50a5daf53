"""The front door for one picture in memory: its landmarks are found, the head is fitted, all of it is one record."""

import threading
from collections.abc import Generator
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure

from workbench.config import DEFAULT_PRESET, Config, preset, read_config
from workbench.errors import InputError
from workbench.face import FaceModel, in_scheme, load_default_head, load_face_model, posed_vertices
from workbench.frames import Frame, read_picture
from workbench.landmarks.detection import LandmarkDetector
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.formats.records import check_size
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import LandmarkScheme
from workbench.pictures.mesh import to_camera
from workbench.pictures.overlay import ALL_BUT_MESH, draw_overlay
from workbench.pipeline import PictureSource, wanted_steps
from workbench.plots import close_up, pictures_in_a_row
from workbench.tracker import FaceTracker
from workbench.tracking import FrameFit, FrameObservation
from workbench.tracking.deep_target import energy_network, photo_landmarks

CLOSE_UP_PX, CLOSE_UP_MARGIN = 640, 2.0
"""Side of each picture of the figure, and how much of the picture it shows, in sides of the landmarks' box."""
POINTS = replace(ALL_BUT_MESH, text=False)
MESH = replace(POINTS, observed=False, model_points=False, residuals=False, lines=False, mesh=True, legend=False)
_ONE_AT_A_TIME = threading.Lock()
"""The detector and the tracker are kept between calls, and neither may be used by two threads at once."""


@dataclass(frozen=True, eq=False)
class PictureFit:
    """What `fit` found in one picture. Lengths in millimetres; +x right, +y down, +z forward from the camera."""

    picture: UInt8[np.ndarray, "h w 3"]
    """RGB."""
    model: FaceModel
    """The one that was fitted: in the landmarks' scheme, with the eyes' units where that shows them."""
    frame: FrameFit
    """Everything that a track keeps of a frame: camera, identity, jaw, energies, why the stages stopped."""

    @property
    def rotation(self) -> Float[np.ndarray, "3"]:
        """Axis-angle, head to camera, radians."""
        return self.frame.rotation

    @property
    def translation(self) -> Float[np.ndarray, "3"]:
        """Of the head frame's origin in the camera frame."""
        return self.frame.translation

    @property
    def yaw_pitch_roll(self) -> tuple[float, float, float]:
        """Degrees (`geometry.rotations` has the convention)."""
        return tuple(self.frame.angles_deg.tolist())

    @property
    def weights(self) -> dict[str, float]:
        """Expression weight of every blendshape by name."""
        return dict(zip(self.model.expression_names, self.frame.expression.tolist(), strict=True))

    @property
    def landmarks(self) -> Landmarks2D:
        """The points that were fitted, pixels."""
        return Landmarks2D(self.frame.observed, self.frame.confidence, self.frame.image_size)

    @property
    def triangles(self) -> np.ndarray:
        """Three vertices of each triangle, (t, 3)."""
        return self.model.triangles

    @cached_property
    def vertices_head(self) -> Float[np.ndarray, "v 3"]:
        """The person's mesh with this expression in the head frame: +x to the subject's left, +y down."""
        person = self.model.personal(self.frame.identity)
        return posed_vertices(person, self.frame.expression, self.frame.jaw, self.frame.scale)

    @property
    def vertices_camera(self) -> Float[np.ndarray, "v 3"]:
        """The same mesh in the camera frame."""
        return to_camera(self.vertices_head, self.rotation, self.translation)

    @property
    def error_px(self) -> float:
        """Mean distance of the model's landmarks from the observed ones."""
        return self.frame.errors[0]

    @property
    def error_percent(self) -> float:
        """The same in % of the distance between the outer eye corners."""
        return self.frame.errors[2]

    @property
    def failure(self) -> str:
        """Why the fit should not be used, empty if it may."""
        return self.frame.failure

    def figure(self) -> Figure:
        """The face close up: observed landmarks as rings with residuals and head axes, and the fitted mesh."""
        cut, frame = close_up(self.picture, self.frame, CLOSE_UP_PX, margin=CLOSE_UP_MARGIN)
        drawn = [draw_overlay(cut, frame, self.model, parts) for parts in (POINTS, MESH)]
        yaw, pitch, roll = np.rint(self.frame.angles_deg) + 0.0
        angles = f"yaw {yaw:+.0f}°, pitch {pitch:+.0f}°, roll {roll:+.0f}°".replace("-", "\u2212")
        error = f"error {self.error_px:.1f} px, {self.error_percent:.1f} % of the eye distance"
        return pictures_in_a_row(drawn, [f"{error}; {self.failure}" if self.failure else error, angles])


def fit(
    picture: UInt8[np.ndarray, "h w 3"] | str | Path,
    *,
    landmarks: Landmarks2D | np.ndarray | str | Path | None = None,
    model: FaceModel | str | Path | None = None,
    config: Config | str | Path = DEFAULT_PRESET,
    detector: LandmarkDetector | str | None = None,
) -> PictureFit:
    """Fit the head in one picture: RGB as 8-bit integers (h, w, 3), or an image file.

    `landmarks` (a scheme's points in pixels, or a landmark file) replace the detector. `model` is a face model or its
    file, the default head if left out; `config` a configuration, the name of a preset, or a TOML file. Of several faces
    the largest is fitted, or the one at `landmarks.face` of the configuration. Detector and solver are kept for the
    next call with the same model, so load a model's file once. The numbers are those of `workbench track`. Raises
    `InputError` for a picture without a face, and for anything that cannot be used.
    """
    picture, config, model = _picture(picture), _config(config), _model(model)
    with _ONE_AT_A_TIME:
        observation = _observation(picture, landmarks, config, detector)
        seen = cast("Landmarks2D", observation.landmarks)  # given, or else found: no face is an error
        try:
            tracker = _tracker(_Task(model, config, seen.scheme))
            frame = tracker.push(observation)[-1]
        except BaseException:
            _tracker.cache_clear()  # it still holds the picture that could not be fitted
            raise
    return PictureFit(picture, tracker.model, replace(frame, shot=0))


@dataclass(frozen=True, eq=False)
class _Task:
    """The same model under an equal configuration: arrays are not compared."""

    model: FaceModel
    config: Config
    scheme: LandmarkScheme

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Task):
            return False
        return self.model is other.model and self.config == other.config and self.scheme is other.scheme

    def __hash__(self) -> int:
        return id(self.model)


@lru_cache(maxsize=2)
def _tracker(task: _Task) -> FaceTracker:
    return FaceTracker(in_scheme(task.model, task.scheme), task.config, stills=True)


@cache
def _detector(name: str, face_landmarker: str) -> LandmarkDetector:
    return make_detector(name, face_landmarker)


def _model(model: FaceModel | str | Path | None) -> FaceModel:
    if isinstance(model, FaceModel):
        return model
    return load_default_head() if model is None else load_face_model(model)


def _config(config: Config | str | Path) -> Config:
    if isinstance(config, str) and not config.endswith(".toml"):
        config = preset(config)
    config = config if isinstance(config, Config) else read_config(config)
    if wanted_steps(config):
        raise InputError(
            "A single picture has no neighbours in time; leave infill and refinement out of the configuration."
        )
    if config.camera.rig:
        raise InputError("A single picture has one view; leave the rig (camera.rig) out of the configuration.")
    return config


def _picture(picture: np.ndarray | str | Path) -> np.ndarray:
    if isinstance(picture, str | Path):
        return read_picture(picture)
    picture = np.asarray(picture)
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or 0 in picture.shape:
        raise InputError(
            f"A picture is RGB as 8-bit integers (uint8) of shape (height, width, 3), got {picture.dtype} of shape "
            f"{picture.shape}; convert it, or name its file."
        )
    return picture


def _observation(picture, landmarks, config: Config, detector) -> FrameObservation:
    size = (picture.shape[1], picture.shape[0])
    if landmarks is not None:
        observation = FrameObservation(0, _given(landmarks, size), size, "given", True, picture=picture)
    else:
        observation = _found(picture, config, detector)
    if config.traits.renders:
        network = energy_network(config.deep.network)
        begin = cast("Landmarks2D", observation.landmarks)
        return replace(observation, landmarks=photo_landmarks(network, picture, begin))
    return observation


def _found(picture: np.ndarray, config: Config, detector: LandmarkDetector | str | None) -> FrameObservation:
    if detector is None or isinstance(detector, str):
        detector = _detector(detector or config.landmarks.detector, config.landmarks.face_landmarker)
    source = PictureSource(_OnePicture(picture), detector, config, keep_pictures=True)
    observation = next(source.observations(0, {}, stills=True))
    if observation.landmarks is None:
        raise InputError(
            config.landmarks.missed_face
            or f"No face was found by the detector {detector.name!r}; turn the picture so that the face is upright, or "
            "enlarge it until the face is 60 pixels wide, try another detector, or give the landmarks."
        )
    return observation


def _given(landmarks: Landmarks2D | np.ndarray | str | Path, size: tuple[int, int]) -> Landmarks2D:
    if isinstance(landmarks, str | Path):
        landmarks = _read_landmarks(landmarks, size)
    if not isinstance(landmarks, Landmarks2D):
        landmarks = Landmarks2D(np.asarray(landmarks), np.ones(len(landmarks)), size)
    if not landmarks.shows_face:
        raise InputError(
            "All landmarks coincide or have no confidence, as some programs write if they find no face; "
            "give those of a face."
        )
    check_size(landmarks, size, "the picture")
    return landmarks


def _read_landmarks(path: str | Path, size: tuple[int, int]) -> Landmarks2D:
    records = list(read_landmark_file(path, size))
    if len(records) != 1:
        raise InputError(f"{path} must hold the landmarks of one face in one picture, it has {len(records)} frames.")
    if records[0].landmarks is None:
        raise InputError(f"{path} has no face in its frame; name the landmarks of one, or leave them to the detector.")
    return records[0].landmarks


class _OnePicture:
    """A picture in memory as a stream of one frame."""

    kind, name = "images", "picture"

    def __init__(self, picture: np.ndarray) -> None:
        self._picture = picture
        self.rate: float | None = None
        self.announced_count: int | None = 1
        self.image_size = (picture.shape[1], picture.shape[0])
        self.notes: list[str] = []

    def iterate(self, start: int = 0) -> Generator[Frame]:
        yield from [Frame(0, self._picture, 0.0, self.name)][start:]
