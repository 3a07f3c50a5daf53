"""From two photos to places: the cut-out about the face, flow in it, and the way back to pixels of the picture."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workbench.config import preset
from workbench.face import FaceParameters
from workbench.flow import flow_estimator
from workbench.geometry import Rig, View, camera_from_fov, project
from workbench.planning import plan_of
from workbench.tracking.flow_fitter import FlowFitter
from workbench.tracking.photo_flow import Cutout, cutout_about, photo_flow, read_at
from workbench.tracking.point_links import Neighbour, flow_views


def texture(width=320, height=240):
    rng = np.random.default_rng(0)
    noise = sum(
        cv2.resize(rng.uniform(0, 1, (cells, cells + 2, 3)).astype(np.float32), (width, height))
        for cells in (9, 24, 60)
    )
    return np.uint8(255 * (noise - noise.min()) / np.ptp(noise))


@given(st.floats(20, 300), st.floats(20, 200), st.floats(30, 400), st.sampled_from([64, 128, 384]))
def test_the_middle_of_a_cutout_is_its_centre_and_its_scale_counts(x, y, side, pixels):
    cutout = Cutout(np.array([x, y]), side, pixels)
    assert cutout.inside(np.array([x, y])) == pytest.approx([(pixels - 1) / 2] * 2)
    apart = cutout.inside(np.array([x + 3.0, y])) - cutout.inside(np.array([x, y]))
    assert apart == pytest.approx([3.0 * pixels / side, 0.0])


def test_a_cutout_shows_what_it_says():
    picture = texture()
    cutout = Cutout(np.array([160.0, 120.0]), 100.0, 200)
    cut = cutout.cut(picture)
    for place in ([150.0, 100.0], [180.0, 130.0]):
        x, y = cutout.inside(np.array(place)).round().astype(int)
        assert np.abs(cut[y, x].astype(int) - picture[int(place[1]), int(place[0])]).max() < 20


def test_the_cutout_holds_the_face_in_both_frames():
    points = np.array([[[100.0, 80.0], [160.0, 140.0]], [[120.0, 90.0], [180.0, 150.0]]])
    cutout = cutout_about(points, 128)
    inside = cutout.inside(points)
    assert (inside > 10).all()
    assert (inside < 118).all()


@pytest.mark.parametrize("name", ["dis", "farneback", "network"])
def test_a_shifted_picture_puts_points_where_it_was_shifted(name):
    first = texture()
    shift = np.array([4.0, -3.0])
    second = cv2.warpAffine(first, np.array([[1, 0, shift[0]], [0, 1, shift[1]]]), (320, 240))
    places = np.random.default_rng(1).uniform([110, 80], [210, 160], (50, 2))
    found = photo_flow(flow_estimator(name, 192), first, second, places, cutout_about(places, 192))
    assert np.linalg.norm(found.places - places - shift, axis=1).mean() < 0.6
    assert found.consistent.mean() > 0.9


def test_places_beyond_the_picture_are_not_trusted():
    first = texture()
    places = np.array([[160.0, 120.0], [-5.0, 120.0], [200.0, 250.0]])
    found = photo_flow(flow_estimator("dis"), first, first, places, Cutout(np.array([160.0, 120.0]), 400.0, 192))
    assert found.consistent.tolist() == [True, False, False]
    assert found.inside.tolist() == [True, False, False]


@pytest.mark.parametrize("renders", ["exact", "estimated"])
def test_points_of_the_face_that_are_outside_the_photo_never_count(head, renders):
    config = preset("joint").changed(flow={"estimator": "dis", "renders": renders, "points": 300})
    fitter = FlowFitter(head, plan_of(config))
    picture, views = texture(), flow_views(None, camera_from_fov((320, 240), 45.0))
    there = frontal(head, (-230.0, 0.0, 600.0))
    links = fitter.links(Neighbour(there, (picture,)), (picture,), there, views)
    outside = links.starts[0, :, 0] < 0.0
    assert outside.sum() > 20
    assert not links.weights[0][outside].any()
    assert links.weights[0].any()


def frontal(head, translation, scale=1.0):
    counts = (3, len(head.expression_names), len(head.identity_deltas), 6)
    rotation, expression, identity, jaw = map(np.zeros, counts)
    return FaceParameters(rotation, np.array(translation), expression, identity, jaw, np.full(1, scale))


def test_a_percent_is_that_of_the_eyes_in_each_views_picture(head):
    """A camera twice as far sees them half as large, as does one a head of half the scale."""
    camera = camera_from_fov((640, 480), 45.0)
    poses = (np.zeros(3), np.array([0.0, 0.0, 600.0]))
    rig = Rig(tuple(View(f"{place[2]}", (640, 480), camera, np.eye(3), place) for place in poses))
    linker = FlowFitter(head, plan_of(preset("joint").changed(flow={"estimator": "dis", "points": 300}))).linker
    near, far = linker.unit_px(frontal(head, (0.0, 0.0, 600.0)), flow_views(rig, camera))
    eyes = project(camera, head.landmarks.of(head.neutral)[[36, 45]] + [0.0, 0.0, 600.0])
    assert near == pytest.approx(0.01 * float(np.linalg.norm(eyes[0] - eyes[1])), rel=0.1)
    assert far == pytest.approx(near / 2)
    smaller = linker.unit_px(frontal(head, (0.0, 0.0, 600.0), 0.5), flow_views(rig, camera))
    np.testing.assert_allclose(smaller, [near / 2, far / 2])


def test_fields_are_read_between_pixels():
    y, x = np.mgrid[0:6, 0:8].astype(np.float32)
    field = np.stack([2 * x, x + y], axis=-1)
    assert read_at(field, np.array([[2.5, 1.0], [0.0, 0.0]])) == pytest.approx(np.array([[5.0, 3.5], [0.0, 0.0]]))
