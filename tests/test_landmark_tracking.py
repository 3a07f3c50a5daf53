"""Tracking: a portrait moved by known affine maps is followed; cuts, occlusion, several faces, no face, resuming."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.optional_parts import needs_dlib
from workbench.errors import ConfigError, InputError
from workbench.frames import open_frames, read_picture
from workbench.landmarks.alignment import MEAN_SHAPE, FaceFrame, frame_from_points
from workbench.landmarks.detection import FaceDetection
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.tracker_options import TrackerOptions, options_for
from workbench.landmarks.tracking import LandmarkTracker

ASTRONAUT = Path(__file__).resolve().parents[1] / "data_samples" / "astronaut.png"
REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
SIZE = (480, 360)


FACE_IN_ASTRONAUT = FaceFrame(np.eye(2) * 92.0, np.array([222.0, 124.0]))


@dataclass(frozen=True)
class Scene:
    """A picture and where its faces are."""

    picture: np.ndarray
    faces: tuple[np.ndarray, ...]


def affine(t: float) -> np.ndarray:
    """A head that drifts, turns in the picture and comes closer; t in frames."""
    angle, scale = np.deg2rad(12 * np.sin(t / 9)), 1.1 + 0.15 * np.sin(t / 13)
    matrix = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = np.array([240 + 60 * np.sin(t / 11), 180 + 25 * np.cos(t / 8)])
    return np.column_stack([matrix, middle - matrix @ FACE_IN_ASTRONAUT.origin])


def scene(t: float, points: np.ndarray | None = None) -> Scene:
    """The moved portrait, with `points` (in the portrait) moved along; by default an average face on the face."""
    points = FACE_IN_ASTRONAUT.to_image(MEAN_SHAPE) if points is None else points
    warp = affine(t)
    picture = cv2.warpAffine(read_picture(ASTRONAUT), warp, SIZE, borderMode=cv2.BORDER_REFLECT)
    return Scene(picture, (points @ warp[:, :2].T + warp[:, 2],))


def beside(first: Scene, second: Scene) -> Scene:
    offset = (first.picture.shape[1], 0)
    moved = tuple(face + offset for face in second.faces)
    return Scene(np.hstack([first.picture, second.picture]), first.faces + moved)


def without_face(seed: int = 0) -> Scene:
    noise = np.random.default_rng(seed).integers(0, 256, (SIZE[1], SIZE[0], 3), np.uint8)
    return Scene(cv2.convertScaleAbs(cv2.GaussianBlur(noise, (0, 0), 12), alpha=4, beta=-380), ())


class KnownFaces:
    """A detector that knows the scenes: exact boxes, landmarks with a deterministic error of about half a pixel."""

    name = "known"

    def __init__(self, scenes: list[Scene], quick_finds: bool = True) -> None:
        self.faces = {scene.picture.tobytes(): scene.faces for scene in scenes}
        self.quick_finds = quick_finds
        self.searches: list[bool] = []

    def detect_faces(self, picture, effort="full"):
        self.searches.append(effort)
        if effort == "quick" and not self.quick_finds:
            return []
        frames = [frame_from_points(face) for face in self.faces[picture.tobytes()]]
        return sorted((FaceDetection(f.box(), 1.0) for f in frames), key=lambda found: -found.area)

    def align(self, picture, box):
        return self._near(picture, FaceFrame(np.eye(2) * (box[2] - box[0]), (np.array(box[:2]) + box[2:]) / 2))

    def refine(self, picture, points):
        return self._near(picture, frame_from_points(points))

    def _near(self, picture, frame):
        size = (picture.shape[1], picture.shape[0])
        for face in self.faces[picture.tobytes()]:
            if np.linalg.norm(frame_from_points(face).origin - frame.origin) < 0.5 * frame.side:
                error = 0.5 * np.sin(np.arange(136).reshape(68, 2) + face[0, 0] * 7)
                return Landmarks2D(face + error, np.full(68, 0.9), size)
        return Landmarks2D(frame.to_image(MEAN_SHAPE), np.full(68, 0.01), size)


class InWholePictures(KnownFaces):
    """The same, and in parts of the pictures there is nothing."""

    def detect_faces(self, picture, effort="full"):
        return super().detect_faces(picture, effort) if picture.tobytes() in self.faces else []


def run(scenes: list[Scene], detector=None, **options):
    detector = detector or KnownFaces(scenes)
    tracker = LandmarkTracker(detector, TrackerOptions(**options))
    return [tracker.step(scene.picture) for scene in scenes], detector


def error_in_sides(result, face: np.ndarray) -> float:
    distance = np.linalg.norm(result.landmarks.points - face, axis=1).mean()
    return float(distance / frame_from_points(face).side)


# --- what the tracker decides, with a detector that knows the truth ---


def test_a_moving_face_is_detected_once_and_then_tracked():
    scenes = [scene(t) for t in range(30)]
    results, detector = run(scenes)
    assert [r.source for r in results] == ["detected"] + ["tracked"] * 29
    assert len(detector.searches) == 1
    assert not any(r.cut for r in results)
    assert max(error_in_sides(r, s.faces[0]) for r, s in zip(results, scenes, strict=True)) < 0.01
    assert all(set(r.milliseconds) == {"detect", "landmarks"} for r in results)


@pytest.mark.parametrize(("name", "believed"), [("network", True), ("dense", True), ("dlib", False), ("mine", False)])
def test_a_network_is_believed_with_less_confidence_than_others(name, believed, monkeypatch):
    faces = KnownFaces([still := scene(0)])
    monkeypatch.setattr(faces, "align", lambda *_: Landmarks2D(still.faces[0], np.full(68, 0.27), SIZE))
    tracker = LandmarkTracker(faces, options_for(name))
    assert (tracker.step(still.picture).landmarks is not None) == believed


def test_flow_and_predictor_together_are_steadier_than_the_predictor_alone():
    scenes = [scene(t) for t in range(30)]
    results, detector = run(scenes)
    fused = np.array([r.landmarks.points - s.faces[0] for r, s in zip(results, scenes, strict=True)])
    alone = np.array([detector.refine(s.picture, s.faces[0]).points - s.faces[0] for s in scenes])
    assert np.abs(np.diff(fused[1:], 2, axis=0)).mean() < 0.7 * np.abs(np.diff(alone[1:], 2, axis=0)).mean()


def test_a_sudden_expression_is_followed_within_two_frames():
    opened = FACE_IN_ASTRONAUT.to_image(MEAN_SHAPE)
    opened[55:60, 1] += 14  # the predictor sees an open mouth; the pixels do not move, so flow cannot
    scenes = [scene(t, opened if t >= 10 else None) for t in range(14)]
    results, _ = run(scenes)
    lip = np.linalg.norm(results[11].landmarks.points[55:60] - scenes[11].faces[0][55:60], axis=1)
    assert lip.max() < 4


def test_the_box_surrounds_the_landmarks_and_is_none_without_a_face():
    results, _ = run([scene(0), without_face()])
    left, top, right, bottom = results[0].box
    inside = results[0].landmarks.points[17:]
    assert (inside >= (left, top)).all()
    assert (inside <= (right, bottom)).all()
    assert (results[1].landmarks, results[1].box, results[1].source) == (None, None, "none")


def test_a_cut_restarts_detection_and_picks_the_largest_face_of_the_new_shot():
    first = [scene(t) for t in range(4)]
    large = scene(3)
    small = Scene(
        cv2.resize(scene(0).picture, (240, 180), interpolation=cv2.INTER_AREA), ((scene(0).faces[0] + 0.5) / 2 - 0.5,)
    )
    small = Scene(np.vstack([small.picture, without_face().picture[:180, :240]]), small.faces)
    two = beside(small, large)
    second = [Scene(255 - two.picture, two.faces)] * 3
    results, _ = run(first + second)
    assert [r.cut for r in results] == [False] * 4 + [True] + [False] * 2
    assert [r.source for r in results[3:]] == ["tracked", "detected", "tracked", "tracked"]
    assert error_in_sides(results[5], two.faces[1]) < 0.02


def test_an_unrelated_picture_in_between_gives_none_not_the_old_pose():
    scenes = [scene(0), scene(1), without_face(), scene(3), scene(4)]
    results, _ = run(scenes)
    assert [r.source for r in results] == ["detected", "tracked", "none", "detected", "tracked"]
    assert [r.cut for r in results] == [False, False, True, True, False]


def covered(s: Scene) -> Scene:
    """The face behind a board: the detector knows no face there."""
    picture = s.picture.copy()
    middle = frame_from_points(s.faces[0]).origin.astype(int)
    picture[max(0, middle[1] - 70) : middle[1] + 80, max(0, middle[0] - 70) : middle[0] + 70] = (90, 70, 50)
    return Scene(picture, ())


def test_an_occluded_face_is_lost_and_found_again():
    scenes = [covered(scene(t)) if 5 <= t < 15 else scene(t) for t in range(18)]
    results, _ = run(scenes)
    assert all(r.landmarks is None for r in results[10:15])
    assert all(r.landmarks is not None for r in results[:5] + results[15:])
    assert all(np.median(r.landmarks.confidence) <= 0.1 for r in results[5:10] if r.landmarks is not None)


def test_patience_bridges_a_short_failure_of_the_predictor_with_low_confidence():
    scenes = [scene(t) for t in range(14)]
    detector = KnownFaces(scenes)
    for t in (6, 7):
        detector.faces[scenes[t].picture.tobytes()] = ()
    results, _ = run(scenes, detector)
    assert all(r.source == "tracked" for r in results[1:])
    assert [float(np.median(r.landmarks.confidence)) <= 0.1 for r in results[5:9]] == [False, True, True, False]
    assert error_in_sides(results[7], scenes[7].faces[0]) < 0.01
    impatient, _ = run(scenes, detector, patience=0)
    assert [r.source for r in impatient[6:9]] == ["none", "none", "detected"]


def test_the_face_nearest_to_where_it_was_is_found_again_not_the_largest():
    near, far = scene(0), scene(30)
    both = beside(near, far)
    one = Scene(both.picture, both.faces[:1])
    none = Scene(both.picture.copy(), ())
    none.picture[0, 0] ^= 255  # another picture for the detector, the same for the eye
    start = Scene(one.picture.copy(), one.faces)
    start.picture[1, 1] ^= 255
    results, _ = run([start, none, both], patience=0)
    assert [r.source for r in results] == ["detected", "none", "detected"]
    assert error_in_sides(results[2], both.faces[0]) < 0.02
    assert frame_from_points(both.faces[1]).side > frame_from_points(both.faces[0]).side


def test_a_given_point_chooses_the_face():
    both = beside(scene(0), scene(30))
    for face in both.faces:
        x, y = face.mean(axis=0)
        results, _ = run([both], face=(float(x) + 10, float(y)))
        assert error_in_sides(results[0], face) < 0.02


def test_without_a_face_at_the_given_point_none_is_taken_until_there_is_one():
    """The detector is sure of a face elsewhere in every picture."""
    away, there = (scene(t) for t in (0, 17))
    x, y = there.faces[0].mean(axis=0)
    results, _ = run([away, away, there], InWholePictures([away, there]), face=(float(x) + 70, float(y)))
    assert [result.source for result in results] == ["none", "none", "detected"]


def test_a_point_on_the_forehead_is_the_faces():
    still = scene(0)
    left, top, right, _ = frame_from_points(still.faces[0]).box()
    point = ((left + right) / 2, top - 0.2 * (right - left))
    results, _ = run([still], InWholePictures([still]), face=point)
    assert results[0].source == "detected"


def test_a_point_on_the_forehead_counts_at_once_also_where_the_face_appears_later():
    """At first there is nobody, and the next thorough search is frames away."""
    away, there = (scene(t) for t in (0, 17))
    away = Scene(away.picture, ())
    left, top, right, _ = frame_from_points(there.faces[0]).box()
    point = ((left + right) / 2, top - 0.2 * (right - left))
    results, _ = run([away, away, there], InWholePictures([away, there]), face=point)
    assert [result.source for result in results] == ["none", "none", "detected"]


def test_a_larger_face_does_not_take_the_place_of_a_lost_one_that_was_named():
    large = cv2.resize(scene(0).picture, None, fx=3, fy=3)
    small = scene(0)
    picture = np.hstack([large, cv2.copyMakeBorder(small.picture, 0, 2 * SIZE[1], 0, 0, cv2.BORDER_CONSTANT)])
    faces = (3 * small.faces[0], small.faces[0] + (3 * SIZE[0], 0))
    seen, hidden, again = (Scene(picture.copy(), shown) for shown in (faces, faces[:1], faces))
    hidden.picture[0, 0] ^= 255  # another picture for the detector, the same for the eye
    again.picture[1, 1] ^= 255
    x, y = faces[1].mean(axis=0)
    detector = InWholePictures([seen, hidden, again])
    results, _ = run([seen, hidden, hidden, again], detector, face=(float(x), float(y)), patience=0)
    assert [result.source for result in results] == ["detected", "none", "none", "detected"]
    assert error_in_sides(results[3], faces[1]) < 0.02


def test_after_a_cut_the_face_nearest_to_the_given_point_is_taken():
    first, second = scene(0), scene(30)
    second = Scene(255 - np.roll(second.picture, 200, axis=1), (second.faces[0] + (200, 0),))
    x, y = first.faces[0].mean(axis=0)
    results, _ = run([first, second], InWholePictures([first, second]), face=(float(x), float(y)))
    assert [(result.source, result.cut) for result in results] == [("detected", False), ("detected", True)]


@pytest.mark.parametrize("name", ["network", pytest.param("dlib", marks=needs_dlib)])
def test_a_given_point_chooses_a_small_face_beside_a_large_one(name):
    large = cv2.resize(read_picture(ASTRONAUT), (720, 720), interpolation=cv2.INTER_LINEAR)
    small = cv2.resize(read_picture(ASTRONAUT), (128, 128), interpolation=cv2.INTER_AREA)
    picture = np.full((720, 1000, 3), 90, np.uint8)
    picture[:, :720], picture[400:528, 800:928] = large, small
    middle = FACE_IN_ASTRONAUT.origin / 4 + (800, 400)
    detector = make_detector(name)
    found = LandmarkTracker(detector, options_for(name, tuple(middle.tolist()))).step(picture)
    assert np.linalg.norm(frame_from_points(found.landmarks.points).origin - middle) < 5


def test_a_full_search_starts_each_shot_and_thorough_ones_back_off():
    scenes = [without_face()] * 35
    _, detector = run(scenes, retry_interval=10)
    slow = {i: effort for i, effort in enumerate(detector.searches) if effort != "quick"}
    # Frames 0, 10 and 30: each follows a quick search that found nothing.
    assert slow == {1: "full", 12: "thorough", 33: "thorough"}
    _, detector = run([scene(0)], KnownFaces([scene(0)], quick_finds=False))
    assert detector.searches == ["quick", "full"]


def test_a_face_that_moves_out_of_the_picture_is_lost():
    wide = np.pad(scene(0).picture, ((0, 0), (0, 400), (0, 0)), mode="reflect")
    scenes = []
    for step in range(14):
        moved = np.roll(wide, -25 * step, axis=1)[:, :480].copy()
        moved[0, 0] = step  # distinct for the detector
        visible = scene(0).faces[0] - (25 * step, 0)
        scenes.append(Scene(moved, (visible,)))
    results, _ = run(scenes)
    shown = [(s.faces[0][17:, 0] > 0).mean() for s in scenes]
    assert all(r.landmarks is not None for r, part in zip(results, shown, strict=True) if part > 0.7)
    assert all(r.landmarks is None for r, part in zip(results, shown, strict=True) if part < 0.5)


def test_the_regular_check_drops_what_alignment_does_not_confirm():
    still = [Scene(scene(0).picture.copy(), scene(0).faces) for _ in range(12)]

    class FollowsAnything(KnownFaces):
        def refine(self, picture, points):
            return Landmarks2D(points, np.full(68, 0.9), (picture.shape[1], picture.shape[0]))

    detector = FollowsAnything(still)
    tracker = LandmarkTracker(detector, TrackerOptions(check_interval=8, patience=0))
    sources = [tracker.step(still[0].picture).source]
    detector.faces[still[0].picture.tobytes()] = ()  # from now on it was a wall all along
    sources += [tracker.step(s.picture).source for s in still[1:]]
    assert sources == ["detected"] + ["tracked"] * 7 + ["none"] * 4


# --- resuming ---


@pytest.mark.parametrize("stop", [0, 1, 7, 9, 14])
def test_a_restored_tracker_continues_with_identical_results(stop):
    scenes = [covered(scene(t)) if 8 <= t < 16 else scene(t) for t in range(20)]
    whole, detector = run(scenes, check_interval=5)
    tracker = LandmarkTracker(detector, TrackerOptions(check_interval=5))
    for s in scenes[:stop]:
        tracker.step(s.picture)
    state = {name: np.array(value) for name, value in tracker.state().items()}
    resumed = LandmarkTracker(detector, TrackerOptions(check_interval=5))
    resumed.restore(state, scenes[stop - 1].picture if stop else None)
    for s, expected in zip(scenes[stop:], whole[stop:], strict=True):
        result = resumed.step(s.picture)
        assert (result.source, result.cut) == (expected.source, expected.cut)
        if expected.landmarks is not None:
            np.testing.assert_array_equal(result.landmarks.points, expected.landmarks.points)
            np.testing.assert_array_equal(result.landmarks.confidence, expected.landmarks.confidence)


def test_a_state_survives_npz_and_a_wrong_one_is_refused(tmp_path):
    scenes = [scene(t) for t in range(3)]
    detector = KnownFaces(scenes)
    tracker = LandmarkTracker(detector)
    tracker.step(scenes[0].picture)
    np.savez(tmp_path / "state.npz", **tracker.state())
    with np.load(tmp_path / "state.npz", allow_pickle=False) as stored:
        state = dict(stored)
    LandmarkTracker(detector).restore(state, scenes[0].picture)
    with pytest.raises(InputError, match="pass that picture"):
        LandmarkTracker(detector).restore(state, None)
    with pytest.raises(InputError, match="variance is missing or has a different shape"):
        LandmarkTracker(detector).restore({**state, "variance": np.zeros(67)}, scenes[0].picture)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"check_interval": 0}, "check_interval must be at least 1"),
        ({"keep_confidence": 1.5}, "keep_confidence must be in"),
        ({"surprise": 0.0}, "surprise must be positive"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        replace(TrackerOptions(), **options)


def test_a_blink_passes_at_once_though_flow_does_not_see_it():
    upper, lower = [37, 38, 43, 44], [41, 40, 47, 46]
    shut = FACE_IN_ASTRONAUT.to_image(MEAN_SHAPE)
    shut[upper] = shut[lower]
    scenes = [scene(t, shut if t in (10, 11) else None) for t in range(14)]
    results, _ = run(scenes)
    side = frame_from_points(results[0].landmarks.points).side
    gaps = [np.linalg.norm(r.landmarks.points[upper] - r.landmarks.points[lower], axis=1).mean() for r in results]
    opened = np.mean(gaps[5:9])
    assert max(gaps[10:12]) < 0.25 * opened
    assert min(gaps[12:]) > 0.75 * opened
    assert opened > 0.03 * side
    assert min(results[10].landmarks.confidence[upper]) > 0.8


# --- with dlib ---


@pytest.fixture(scope="module")
def dlib():
    return make_detector("dlib")


@needs_dlib
def test_dlib_follows_the_moved_portrait_to_a_hundredth_of_its_size(dlib):
    portrait = read_picture(ASTRONAUT)
    truth = dlib.align(portrait, dlib.detect_faces(portrait)[0].box).points
    scenes = [scene(t, truth) for t in range(50)]
    results, _ = run(scenes, dlib)
    assert [r.source for r in results] == ["detected"] + ["tracked"] * 49
    errors = [error_in_sides(r, s.faces[0]) for r, s in zip(results, scenes, strict=True)]
    assert np.mean(errors) < 0.012
    assert np.max(errors) < 0.025


@needs_dlib
def test_dlib_gives_none_for_pictures_without_a_face(dlib):
    hog = make_detector("dlib-hog")
    results, _ = run([scene(0), without_face(1), without_face(2), without_face(3), scene(1)], hog)
    assert [r.source for r in results] == ["detected", "none", "none", "none", "detected"]


@needs_dlib
@pytest.mark.skipif(not REAL_DATA.is_dir(), reason="the real clips are not part of the project")
def test_dlib_follows_the_face_of_a_real_clip_through_every_frame(dlib):
    tracker = LandmarkTracker(dlib)
    results = [tracker.step(frame.picture) for frame in open_frames(REAL_DATA / "carphone.mp4").iterate()]
    assert [r.source for r in results] == ["detected"] + ["tracked"] * 119
    assert tracker.detections == 1
    assert min(np.median(r.landmarks.confidence) for r in results) > 0.4
