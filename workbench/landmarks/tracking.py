"""Follow one face through a video: optical flow carries the landmarks, the predictor corrects them, detection restarts.

Detecting a face costs 20 ms to a second, so it is done only at the start, after a loss and after a shot cut. From
frame to frame pyramidal Lucas-Kanade flow carries the points (steady, but it drifts), the predictor is run on the box
that the flow carried (no drift, but it jitters), and each point is a scalar Kalman filter of the two. FACE IT!
section 4, "Non-rigid tracking", names the same two parts.
"""

from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Literal

import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import InputError
from workbench.landmarks.alignment import frame_from_points
from workbench.landmarks.detection import Box, Effort, FaceDetection, LandmarkDetector
from workbench.landmarks.fusion import fused
from workbench.landmarks.named_face import named_faces
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.point_flow import CarriedPoints, FaceCrop, carried, crop_about
from workbench.landmarks.scheme import GROUPS, POINT_COUNT
from workbench.landmarks.schemes import SCHEMES
from workbench.landmarks.shot_cuts import correlation, thumbnail_of
from workbench.landmarks.tracker_options import TrackerOptions
from workbench.landmarks.turned_faces import shape_deviation, sureness

LONGEST_RETRY = 16
"""Times the retry interval: how rare thorough searches become in a long shot without a face."""
CANDIDATES = 5
"""Faces aligned, at most, when one is chosen."""


@dataclass(frozen=True, eq=False)
class TrackedLandmarks:
    """What one frame gave."""

    landmarks: Landmarks2D | None
    """None where no face was found."""
    source: Literal["detected", "tracked", "none"]
    """Found by a detector in this frame, carried from the last one, or neither."""
    cut: bool
    """True in the first frame of a new shot (not in the first frame of the video)."""
    box: Box | None
    """The upright face box around the landmarks, in pixels."""
    milliseconds: dict[str, float] = field(default_factory=dict)
    """Time spent: "detect" on finding faces, "landmarks" on everything else."""


class LandmarkTracker:
    """Follows one face, one picture at a time.

    Confidence in tracked frames is the predictor's own (scatter under moved boxes) times the agreement of flow and
    predictor, times how far the last alignment from scratch confirmed it. The same pictures give the same results, also
    after `state` / `restore` at any frame.
    """

    def __init__(self, detector: LandmarkDetector, options: TrackerOptions | None = None) -> None:
        self.detector = detector
        self.options = options or TrackerOptions()
        self.detections = 0
        """Calls of the face detector so far."""
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next picture is the first."""
        self._face: FaceCrop | None = None
        self._variance = np.zeros(POINT_COUNT)
        self._place: np.ndarray | None = None  # where the face was, within this shot
        self._side = 0.0
        self._trust = 1.0
        self._since_check = 0
        self._bridged = 0
        self._search_at_once()
        self._thumbnail: np.ndarray | None = None

    def step(self, picture: UInt8[np.ndarray, "h w 3"]) -> TrackedLandmarks:
        """Find or follow the face in the next picture."""
        started = perf_counter()
        self._detect_seconds = 0.0
        thumbnail = thumbnail_of(picture)
        cut = self._is_cut(thumbnail)
        self._thumbnail = thumbnail
        self._since_search += 1
        if cut:
            self._face = self._place = None
            self._search_at_once()
        landmarks = self._follow(picture) if self._face is not None else None
        source: Literal["detected", "tracked", "none"] = "tracked"
        if landmarks is None:
            landmarks = self._find(picture)
            source = "detected" if landmarks is not None else "none"
        self._keep(picture, landmarks)
        box = frame_from_points(landmarks.points).box() if landmarks is not None else None
        detect = self._detect_seconds
        times = {"detect": 1e3 * detect, "landmarks": 1e3 * (perf_counter() - started - detect)}
        return TrackedLandmarks(landmarks, source, cut, box, times)

    # --- following ---

    def _follow(self, picture: np.ndarray) -> Landmarks2D | None:
        """Flow, predictor and their fusion; None when the face is lost. Updates the filter's variances."""
        flow = carried(self._face, picture, self.options.flow_window, self.options.round_trip_sides)
        refined = self.detector.refine(picture, flow.points)
        side = frame_from_points(flow.points).side
        difference = np.linalg.norm(refined.points - flow.points, axis=1) / side
        if np.median(difference) > 2 * self.options.predictor_noise_sides * self.options.surprise:
            refined = self.detector.refine(picture, refined.points)  # the flow's box was off: start from a better one
        self._since_check += 1
        if not self._plausible(picture, refined):
            return self._realign(picture, flow.points) or self._bridge(picture, flow, refined)
        self._bridged = 0
        doubtful = sureness(refined) * self._trust < self.options.accept_confidence
        due = self.options.patience if doubtful else self.options.check_interval
        if self._since_check >= due and self._realign(picture, refined.points) is None:
            return None
        landmarks, self._variance = fused(flow, refined, self._variance, side, self.options)
        return replace(landmarks, confidence=landmarks.confidence * self._trust)

    def _realign(self, picture: np.ndarray, points: Float[np.ndarray, "points 2"]) -> Landmarks2D | None:
        """Align the face near `points` as if it had just been detected; None where there is none."""
        self._since_check = 0
        landmarks = self.detector.align(picture, frame_from_points(points).box())
        accepted = sureness(landmarks) >= self.options.accept_confidence
        if not accepted or not self._plausible(picture, landmarks):
            return None
        self._trust_from(picture, landmarks)
        return landmarks

    def _trust_from(self, picture: np.ndarray, aligned: Landmarks2D) -> None:
        """`refine` judges less well than `align`: until the next alignment its confidence is scaled to agree here."""
        quick = sureness(self.detector.refine(picture, aligned.points))
        self._trust = min(1.0, sureness(aligned) / max(quick, 1e-6))

    def _bridge(self, picture: np.ndarray, flow: CarriedPoints, refined: Landmarks2D) -> Landmarks2D | None:
        """Flow alone, for a few frames, if most points are followed surely; with the predictor's low confidence."""
        self._bridged += 1
        carried = replace(refined, points=flow.points, confidence=refined.confidence.clip(max=0.1))
        steady = flow.valid.mean() >= 0.7 and self._bridged <= self.options.patience
        return carried if steady and self._is_face(picture, carried) else None

    def _plausible(self, picture: np.ndarray, landmarks: Landmarks2D) -> bool:
        """Does the predictor see a face here that can be the one of the last frame?"""
        ratio = frame_from_points(landmarks.points).side / self._side
        # What was lost for a moment must convince again.
        needed = self.options.accept_confidence if self._bridged else self.options.keep_confidence
        return bool(sureness(landmarks) >= needed and 0.7 < ratio < 1.4 and self._is_face(picture, landmarks))

    def _is_face(self, picture: np.ndarray, landmarks: Landmarks2D) -> bool:
        inner = landmarks.points[list(GROUPS["inner"])]
        inside = ((inner >= -0.5) & (inner <= np.array([picture.shape[1], picture.shape[0]]) - 0.5)).all(axis=1)
        if inside.mean() < self.options.smallest_visible:
            return False
        return shape_deviation(landmarks.points) <= self.options.largest_deviation_sides

    # --- finding ---

    def _find(self, picture: np.ndarray) -> Landmarks2D | None:
        """Look for the face where it was, then with the detector; slower searches at intervals only."""
        self._since_check = self._bridged = 0
        landmarks = self._choose(picture, self._detect(picture, "quick"))
        doubtful = landmarks is None or sureness(landmarks) < self.options.sure_confidence
        if doubtful and self._since_search >= self._retry_after:
            self._since_search = 0
            effort: Effort = "full" if self._retry_after == 0 else "thorough"
            found = self._choose(picture, self._detect(picture, effort))
            interval = self.options.retry_interval
            in_vain = min(max(interval, 2 * self._retry_after), LONGEST_RETRY * interval)
            self._retry_after = interval if found else in_vain
            landmarks = found if found is not None else landmarks
        count = POINT_COUNT if landmarks is None else len(landmarks.points)
        self._variance = np.full(count, self.options.predictor_noise_sides**2)
        if landmarks is not None:
            self._trust_from(picture, landmarks)
        return landmarks

    def _search_at_once(self) -> None:
        self._since_search = self._retry_after = 0

    def _detect(self, picture: np.ndarray, effort: Effort) -> list[FaceDetection]:
        started = perf_counter()
        self.detections += 1
        if self.options.face is None:
            found = self.detector.detect_faces(picture, effort)
        else:
            found = named_faces(self.detector, picture, self.options.face, effort, self._place, self._side)
        self._detect_seconds += perf_counter() - started
        return found

    def _choose(self, picture: np.ndarray, faces: list[FaceDetection]) -> Landmarks2D | None:
        """The face nearest to where it was (or to the point asked for), else the largest; only where landmarks fit.

        Faces of one picture differ in how surely their landmarks fit: area counts times sureness.
        """
        wanted = self._place if self._place is not None else self.options.face
        if wanted is not None:
            faces = sorted(faces, key=lambda face: _distance(face.box, wanted))
        best: tuple[float, Landmarks2D] | None = None
        for face in faces[:CANDIDATES]:
            landmarks = self.detector.align(picture, face.box)
            sure = sureness(landmarks)
            if sure < self.options.accept_confidence or not self._is_face(picture, landmarks):
                continue
            if wanted is not None:
                return landmarks
            if best is None or sure * face.area > best[0]:
                best = (sure * face.area, landmarks)
        return best[1] if best else None

    # --- memory ---

    def _is_cut(self, thumbnail: np.ndarray) -> bool:
        if self._thumbnail is None:
            return False
        return correlation(self._thumbnail, thumbnail) < self.options.cut_correlation

    def _keep(self, picture: np.ndarray, landmarks: Landmarks2D | None) -> None:
        """Remember what the next frame needs: the points, and a crop of this picture to measure flow from."""
        self._face = None if landmarks is None else crop_about(picture, landmarks.points)
        if self._face is not None:
            self._place, self._side = self._face.frame.origin, self._face.frame.side

    def state(self) -> dict[str, np.ndarray]:
        """Everything that the next step depends on, except the last picture, as plain arrays."""
        empty = np.zeros((0, 2))
        return {
            "points": empty if self._face is None else self._face.points.copy(),
            "variance": self._variance.copy(),
            "place": empty[0:0, 0] if self._place is None else self._place.copy(),
            "side": np.array(self._side),
            "trust": np.array(self._trust),
            "counters": np.array(
                [
                    self._since_check,
                    self._bridged,
                    self._since_search,
                    self._retry_after,
                    self._thumbnail is not None,
                    self.detections,
                ]
            ),
        }

    def restore(self, state: dict[str, np.ndarray], previous_picture: UInt8[np.ndarray, "h w 3"] | None) -> None:
        """Continue as if `previous_picture` had just been stepped; None only for the state before the first picture.

        Raises `InputError` for a state with missing or misshapen arrays.
        """
        counts = [len(scheme) for scheme in SCHEMES.values()]
        expected = {
            "points": (*((count, 2) for count in counts), (0, 2)),
            "variance": tuple((count,) for count in counts),
            "place": ((2,), (0,)),
            "side": ((),),
            "trust": ((),),
        }
        for name, shapes in {**expected, "counters": ((6,),)}.items():
            if name not in state or np.shape(state[name]) not in shapes:
                raise InputError(f"not a tracker state: {name} is missing or has a different shape from {shapes[0]}")
        self.reset()
        check, bridged, search, retry, started, detections = (int(value) for value in state["counters"])
        if started and previous_picture is None:
            raise InputError("a tracker state is restored with the last picture before it: pass that picture")
        if started:
            self._thumbnail = thumbnail_of(previous_picture)
            height, width = previous_picture.shape[:2]
            if len(state["points"]):
                points = np.array(state["points"], np.float64)
                self._keep(previous_picture, Landmarks2D(points, np.ones(len(points)), (width, height)))
        self._variance = np.array(state["variance"], np.float64)
        self._place = np.array(state["place"], np.float64) if len(state["place"]) else None
        self._side, self._trust = float(state["side"]), float(state["trust"])
        self._since_check, self._bridged, self._since_search, self._retry_after = check, bridged, search, retry
        self.detections = detections


def _distance(box: Box, point: np.ndarray | tuple[float, float]) -> float:
    return float(np.hypot((box[0] + box[2]) / 2 - point[0], (box[1] + box[3]) / 2 - point[1]))
