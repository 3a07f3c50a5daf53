"""Parameters between and over frames: linear, splines, averages."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.face import FaceParameters
from workbench.tracking.interpolation import averaged, between, splined


def frame(rotation=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 600.0), weights=(0.0, 0.0), jaw=0.0, scale=1.0):
    parts = (rotation, translation, weights, (0.3,), (jaw, 0, 0, 0, 0, 0), (scale,))
    return FaceParameters(*(np.asarray(part, float) for part in parts))


vectors = st.tuples(*(st.floats(-1.0, 1.0) for _ in range(3)))


@given(vectors, vectors, st.floats(0.0, 1.0))
def test_the_way_between_two_poses_is_the_shortest_at_even_speed(first, second, share):
    middle = between(frame(first), frame(second), share)
    start, end, here = (Rotation.from_rotvec(vector) for vector in (first, second, middle.rotation))
    whole = (start.inv() * end).magnitude()
    assert (start.inv() * here).magnitude() == pytest.approx(share * whole, abs=1e-6)
    assert (here.inv() * end).magnitude() == pytest.approx((1 - share) * whole, abs=1e-6)


def test_translation_weights_jaw_and_scale_are_linear():
    before, after = (
        frame(translation=(0, 0, 600), weights=(0.0, 1.0), jaw=0.2, scale=1.0),
        frame(translation=(8, 4, 640), weights=(0.4, 0.0), jaw=0.0, scale=1.2),
    )
    quarter = between(before, after, 0.25)
    assert quarter.translation == pytest.approx([2, 1, 610])
    assert quarter.expression == pytest.approx([0.1, 0.75])
    assert quarter.jaw[0] == pytest.approx(0.15)
    assert quarter.scale == pytest.approx([1.05])
    assert np.array_equal(quarter.identity, before.identity)


def test_a_spline_goes_through_what_it_knows_and_on_between():
    times = [-2, -1, 4, 5]
    known = [frame((0.1 * t, 0.0, 0.0), (t**2, 0.0, 600.0), (0.1 + 0.02 * t, 0.0), scale=1 + 0.1 * t) for t in times]
    found = splined(times, known, [-1, 1.5, 4])
    assert found[0].rotation == pytest.approx(known[1].rotation, abs=1e-9)
    assert found[2].translation == pytest.approx(known[2].translation)
    assert found[1].translation[0] == pytest.approx(1.5**2, abs=1e-9)
    assert found[1].rotation == pytest.approx([0.15, 0.0, 0.0], abs=1e-9)
    assert found[1].scale == pytest.approx([1.15])


def test_a_spline_keeps_weights_in_the_range_of_its_frames():
    times = [-3, -2, -1, 5, 6, 7]
    known = [frame(weights=(w, 0.0)) for w in (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)]
    weights = np.array([item.expression[0] for item in splined(times, known, list(np.linspace(-1, 5, 40)))])
    assert weights.min() >= 0.0
    assert weights.max() <= 1.0


def test_two_known_frames_make_a_line_and_one_none():
    line = splined([0, 4], [frame((0.4, 0, 0)), frame((0.0, 0, 0))], [1])
    assert line[0].rotation == pytest.approx([0.3, 0, 0], abs=1e-9)
    with pytest.raises(InputError, match="at least two known frames, got 1"):
        splined([0], [frame()], [1])


@given(vectors, vectors)
def test_the_mean_of_a_rotation_and_its_mirror_image_is_the_middle(middle, away):
    base, turn = Rotation.from_rotvec(middle), Rotation.from_rotvec(away)
    three = [frame((base * turn.inv()).as_rotvec()), frame(base.as_rotvec()), frame((base * turn).as_rotvec())]
    mean = Rotation.from_rotvec(averaged(three, (0.25, 0.5, 0.25)).rotation)
    assert (mean.inv() * base).magnitude() < 1e-6


def test_weighted_means_of_everything_else():
    three = [frame(weights=(0.0, 1.0)), frame(weights=(0.4, 1.0), jaw=0.2, scale=1.4), frame(weights=(0.0, 1.0))]
    mean = averaged(three, (0.25, 0.5, 0.25))
    assert mean.expression == pytest.approx([0.2, 1.0])
    assert mean.jaw[0] == pytest.approx(0.1)
    assert mean.scale == pytest.approx([1.2])
