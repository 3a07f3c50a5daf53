"""What Deep Energies learns of a person once, it learns from several looks of its network at each photo."""

from dataclasses import replace

import numpy as np
import pytest

from workbench.config import preset
from workbench.frames import open_frames
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import MIRROR
from workbench.landmarks.schemes import DENSE
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.tracking import FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_target import energy_network, photo_landmarks, steadied

FRAMES = (0, 12, 24)
JAW_POINT = 3
"""One that no crop depends on."""


@pytest.fixture(scope="module")
def photos() -> list[np.ndarray]:
    return [next(iter(open_frames(sample("performance")).iterate(frame))).picture for frame in FRAMES]


@pytest.fixture(scope="module")
def detected() -> list[Landmarks2D]:
    stored = list(read_landmark_file(sample("performance-landmarks")))
    return [stored[frame].landmarks for frame in FRAMES]


def swapped(landmarks: Landmarks2D, mirror: tuple[int, ...]) -> Landmarks2D:
    """The same points in the mirrored picture."""
    points = landmarks.points[list(mirror)] * [-1.0, 1.0] + [landmarks.image_size[0] - 1.0, 0.0]
    return replace(landmarks, points=points, confidence=landmarks.confidence[list(mirror)], covariance=None)


@pytest.mark.parametrize(("name", "mirror"), [("heat-maps", MIRROR), ("dense", DENSE.mirror)])
def test_a_mirrored_photo_has_the_mirrored_landmarks(photos, detected, name, mirror):
    """One look answers both otherwise; several, each with its mirror image, nearly alike."""
    network, photo, given = energy_network(name), photos[0], detected[0]
    mirrored = np.ascontiguousarray(photo[:, ::-1])
    one, other = photo_landmarks(network, photo, given), photo_landmarks(network, mirrored, swapped(given, MIRROR))

    def apart(left: Landmarks2D, right: Landmarks2D) -> float:
        return float(np.linalg.norm(swapped(left, mirror).points - right.points, axis=1).mean())

    several = apart(steadied(network, photo, one), steadied(network, mirrored, other))
    assert several < apart(one, other) / 3


def test_a_point_that_was_moved_by_hand_stays_moved(photos, detected):
    network = energy_network("heat-maps")
    seen = photo_landmarks(network, photos[0], detected[0])
    moved = seen.points.copy()
    moved[JAW_POINT] += [7.0, -4.0]
    before, after = (
        steadied(network, photos[0], replace(seen, points=points)).points for points in (seen.points, moved)
    )
    difference = after - before
    np.testing.assert_allclose(difference[JAW_POINT], [7.0, -4.0], atol=1e-9)
    np.testing.assert_allclose(np.delete(difference, JAW_POINT, axis=0), 0.0, atol=1e-9)


@pytest.mark.long
def test_a_person_is_calibrated_on_several_looks(head, photos, detected):
    """With pictures as on what several looks at them tell; without, on the landmarks as they are."""
    network = energy_network("heat-maps")
    seen = [photo_landmarks(network, photo, given) for photo, given in zip(photos, detected, strict=True)]
    looked_at = [steadied(network, photo, landmarks) for photo, landmarks in zip(photos, seen, strict=True)]
    fitter = DeepFitter(head, plan_of(preset("deep").changed(deep={"appearance": "model", "network": "heat-maps"})))

    def shape(landmarks, pictures):
        frames = [
            FrameObservation(index, points, points.image_size, picture=picture)
            for index, points, picture in zip(FRAMES, landmarks, pictures, strict=True)
        ]
        return fitter.calibrate(frames, len(frames)).identity

    without = [None] * len(FRAMES)
    with_pictures = shape(seen, photos)
    np.testing.assert_array_equal(with_pictures, shape(looked_at, without))
    assert np.abs(with_pictures - shape(seen, without)).max() > 0.01
