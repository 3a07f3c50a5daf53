"""Blinks: lids that the network reads, on dlib's face; how they pass the tracker and what the fit makes of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.optional_parts import needs_dlib
from workbench.config import preset
from workbench.face import load_default_head
from workbench.landmarks.alignment import MEAN_SHAPE, FaceFrame
from workbench.landmarks.detection import FaceDetection, LandmarkDetector
from workbench.landmarks.lids import seen_openings, true_lids, with_lids
from workbench.landmarks.mixed_detector import MixedDetector
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import GROUPS
from workbench.pipeline import track
from workbench.samples import sample

REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
CORNERS, UPPER, LOWER = ([36, 39, 42, 45], [37, 38, 43, 44], [41, 40, 47, 46])
EYES, LIDS = list(GROUPS["eyes"]), sorted(UPPER + LOWER)
SIZE = (640, 480)


def face(opening: float, confidence: float = 0.95, shift=(0.0, 0.0)) -> Landmarks2D:
    """An average face whose eyes are open by `opening` eye widths; `shift` moves the eyes, pixels."""
    points = FaceFrame(np.eye(2) * 200.0, np.array([320.0, 240.0])).to_image(MEAN_SHAPE)
    for first, last, upper, lower in ((36, 39, UPPER[:2], LOWER[:2]), (42, 45, UPPER[2:], LOWER[2:])):
        width = points[last, 0] - points[first, 0]
        points[last, 1] = points[first, 1]
        points[upper, 1] = points[first, 1] - opening * width + 0.1 * width
        points[lower, 1] = points[first, 1] + 0.1 * width
    points[EYES] += shift
    return Landmarks2D(points, np.full(68, confidence), SIZE)


def opening(points) -> float:
    """Mean opening of the lids in eye widths."""
    width = np.linalg.norm(points[[39, 45]] - points[[36, 42]], axis=1).mean()
    return float((points[LOWER, 1] - points[UPPER, 1]).mean() / width)


def test_a_look_says_how_far_eyes_are_open_and_how_much_that_counts():
    own, seen = face(0.3), face(0.1, shift=(4.0, -3.0))
    openings, shares = seen_openings(own.points, seen)
    assert openings == pytest.approx([0.1, 0.1])
    assert shares.tolist() == [1.0, 1.0]
    unsure = seen_openings(own.points, face(0.1, confidence=0.2))
    assert [each.tolist() for each in unsure] == [[0.0, 0.0], [0.0, 0.0]]
    lost = seen.points.copy()
    lost[36:42] = lost[36]
    openings, shares = seen_openings(own.points, replace(seen, points=lost))
    assert openings == pytest.approx([0.0, 0.1])
    assert shares.tolist() == [0.0, 1.0]


class Always:
    """A detector that always finds the same face."""

    def __init__(self, name: str, found: Landmarks2D, faces=()):
        self.name, self.found, self.faces, self.asked = name, found, list(faces), []

    def detect_faces(self, picture, effort="full"):
        return self.faces

    def align(self, picture, box):
        return self.found

    def refine(self, picture, points):
        self.asked.append(points)
        return self.found


# --- one detector's lids on another's face ---


def test_lids_are_those_of_the_other_detector_and_all_else_stays():
    mixed = with_lids(face(0.3), face(0.05, confidence=0.8))
    assert opening(mixed.points) == pytest.approx(0.05)
    others = np.setdiff1d(np.arange(68), LIDS)
    np.testing.assert_allclose(mixed.points[others], face(0.3).points[others])
    assert mixed.confidence[LIDS] == pytest.approx(np.full(8, 0.8))


def test_lids_are_brought_to_the_corners_of_the_face():
    mixed = with_lids(face(0.3), face(0.05, shift=(4.0, -6.0)))
    np.testing.assert_allclose(mixed.points[LIDS], face(0.05).points[LIDS])


def test_an_eye_that_the_face_is_unsure_of_is_taken_over_with_its_corners():
    other = face(0.05, shift=(4.0, -6.0))
    mixed = with_lids(face(0.3, confidence=0.2), other)
    np.testing.assert_allclose(mixed.points[EYES], other.points[EYES])


def test_an_eye_that_the_other_detector_is_unsure_of_stays():
    mixed = with_lids(face(0.3), face(0.05, confidence=0.3))
    np.testing.assert_allclose(mixed.points, face(0.3).points)
    between = with_lids(face(0.3), face(0.05, confidence=0.45))
    assert opening(between.points) == pytest.approx(0.175)


@pytest.mark.parametrize("width", [0.0, 0.2, 4.0])
def test_eyes_of_another_size_are_not_mixed(width):
    strange = face(0.05).points.copy()
    for eye in (GROUPS["right_eye"], GROUPS["left_eye"]):
        middle = strange[list(eye)].mean(axis=0)
        strange[list(eye)] = middle + width * (strange[list(eye)] - middle)
    mixed = with_lids(face(0.3), Landmarks2D(strange, np.ones(68), SIZE))
    np.testing.assert_allclose(mixed.points, face(0.3).points)


def test_the_mixed_detector_finds_faces_by_the_first_and_lets_the_second_look_at_its_landmarks():
    """On a face that faces the camera; `test_profiles.py` has the others."""
    found = [FaceDetection((220.0, 140.0, 420.0, 340.0), 1.0)]
    lids = Always("network", face(0.05), faces=[])
    mixed = MixedDetector(Always("dlib", face(0.3), found), lids)
    picture = np.zeros((480, 640, 3), np.uint8)
    assert isinstance(mixed, LandmarkDetector)
    assert mixed.name == "dlib+network"
    assert mixed.detect_faces(picture) == found
    for landmarks in (mixed.align(picture, found[0].box), mixed.refine(picture, face(0.3).points)):
        assert opening(landmarks.points) == pytest.approx(0.05)
    np.testing.assert_allclose(lids.asked, [face(0.3).points] * 2)


# --- what the network reads too open ---


@pytest.mark.parametrize("read", [0.22, 0.3, 0.45])
def test_open_eyes_are_left_as_the_network_reads_them(read):
    np.testing.assert_array_equal(true_lids(face(read).points), face(read).points)


@pytest.mark.parametrize(("read", "true"), [(0.125, 0.055), (0.08, 0.03), (0.04, -0.01), (0.0, -0.01)])
def test_the_upper_lids_of_narrow_eyes_are_lowered(read, true):
    points = true_lids(face(read).points)
    assert opening(points) == pytest.approx(true, abs=1e-6)
    others = np.setdiff1d(np.arange(68), UPPER)
    np.testing.assert_array_equal(points[others], face(read).points[others])


def test_an_eye_without_width_is_left_alone():
    points = np.tile([[5.0, 5.0]], (68, 1))
    np.testing.assert_array_equal(true_lids(points), points)


# --- whole clips ---

SHUT = {"performance": ((50, 68), (61, 62)), "carphone": ((0, 95), (42, 92)), "obama": ((0, 45), (39, 40))}
"""Frames to track, and those in it in which both eyes are shut: by the clip's exact weights, and by looking.

Not every blink comes out as clearly: in frame 38 of obama, shut and blurred, the network sees 0.44.
`benchmarks/blinks.py` measures all of them.
"""


@pytest.mark.parametrize("detector", ["auto", pytest.param("dlib+network", marks=[needs_dlib, pytest.mark.long])])
@pytest.mark.parametrize("clip", SHUT)
def test_shut_eyes_of_a_clip_are_fitted_as_shut_and_open_ones_as_open(clip, detector, tmp_path):
    path = sample("performance") if clip == "performance" else REAL_DATA / f"{clip}.mp4"
    if not path.is_file():
        pytest.skip("the real clips are not part of the project")
    part, shut = SHUT[clip]
    head = load_default_head()
    config = preset("joint").changed(landmarks={"detector": detector})
    result = track(path, tmp_path, head, config, pictures=False, frames=part)
    blinks = result.track.expression[:, [head.expression_names.index(f"eyeBlink{side}") for side in ("Left", "Right")]]
    rows = np.array(shut) - part[0]
    assert blinks[rows].mean(axis=1).min() >= 0.6
    assert blinks[rows].min() >= 0.5
    away = [row for row in range(len(blinks)) if np.abs(rows - row).min() > 4]
    assert np.median(blinks[away], axis=0).max() < 0.05
