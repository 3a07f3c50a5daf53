"""Optical flow: the exact flow of a moving head, estimators, colours, consistency and errors."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workbench.errors import ConfigError, InputError
from workbench.face import FaceParameters
from workbench.flow import (
    DisFlow,
    FarnebackFlow,
    FlowEstimator,
    NetworkFlow,
    bundled_flow,
    choose_points,
    color_wheel,
    end_point_error,
    flow_estimator,
    flow_picture,
    geometric_flow,
    occluded,
    point_flow,
    points_in_camera,
    round_trip,
    sample,
    seen_surface,
    surface_points,
    warp,
    wheel_picture,
)
from workbench.flow.estimators import check_pair
from workbench.flow.network_flow import seen_size
from workbench.geometry import Camera, camera_from_fov
from workbench.rendering import (
    ambient_light,
    directional_light,
    face_vertices,
    orthographic_camera,
    render_face,
    render_model,
)
from workbench.rendering.camera import to_screen

SIZE = (96, 80)
FLAT = orthographic_camera((16, 12), 1.0)
"""One pixel per millimetre; the camera frame's origin between the middle pixels of a 16 × 12 picture."""
QUADS = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.int32)
ESTIMATORS = (DisFlow(), DisFlow("fast"), FarnebackFlow())


def quad(low, high, depth):
    """Corners of an axis-parallel rectangle that faces the camera, millimetres."""
    (x0, y0), (x1, y1) = low, high
    return np.array([[x0, y0, depth], [x0, y1, depth], [x1, y1, depth], [x1, y0, depth]], np.float32)


def texture(height=72, width=96, seed=0):
    """A picture with detail at several scales."""
    rng = np.random.default_rng(seed)
    noise = [cv2.resize(rng.random((n, n, 3)), (width, height), interpolation=cv2.INTER_CUBIC) for n in (6, 12, 24)]
    return np.clip(255 * (np.mean(noise, axis=0) * 1.6 - 0.3), 0, 255).astype(np.uint8)


def shifted(picture, by):
    """The picture moved by (x, y) pixels."""
    matrix = np.array([[1, 0, by[0]], [0, 1, by[1]]], float)
    size = picture.shape[1::-1]
    return cv2.warpAffine(picture, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


@pytest.fixture(scope="module")
def model(head):
    return render_model(head)


@pytest.fixture(scope="module")
def camera():
    return Camera(*(np.asarray(part, np.float32) for part in camera_from_fov(SIZE, 30.0)))


@pytest.fixture(scope="module")
def states(head):
    """Two states of the face a frame apart: turned, moved, mouth opened."""
    weights = np.zeros((2, len(head.expression_names)))
    weights[1, head.expression_names.index("jawOpen")] = 0.4
    weights[:, head.expression_names.index("mouthSmileLeft")] = 0.3
    identity = np.random.default_rng(4).normal(0.0, 0.7, len(head.identity_deltas))
    return (
        FaceParameters(np.array([0.05, -0.1, 0.02]), np.array([4.0, 20.0, 560.0]), weights[0], identity),
        FaceParameters(np.array([0.07, 0.02, -0.03]), np.array([9.0, 14.0, 540.0]), weights[1], identity),
    )


class TestGeometricFlow:
    def test_a_moving_rectangle_carries_its_pixels_and_covers_others(self):
        near, far = quad((-2, -2), (2, 2), 40.0), quad((-6, -5), (6, 5), 50.0)
        first = np.concatenate([near, far])
        moved = np.concatenate([near + np.float32([3, 1, 0]), far])
        result = geometric_flow(first, moved, QUADS, FLAT, size=(16, 12))
        assert np.allclose(result.flow[4:8, 6:10], [3, 1], atol=1e-4)
        assert np.allclose(result.flow[2, 2:14], 0, atol=1e-4)
        assert not np.asarray(result.seen)[0].any()
        assert result.visible[5, 7]
        assert result.seen[6, 11]
        assert not result.visible[6, 11]  # the far one, where the near one comes to lie
        assert result.visible[6, 3]

    def test_what_leaves_the_picture_is_seen_but_not_visible(self):
        first = np.concatenate([quad((-6, -5), (6, 5), 40.0), quad((100, 100), (101, 101), 40.0)])
        result = geometric_flow(first, first + np.float32([5, 0, 0]), QUADS, FLAT, size=(16, 12))
        assert result.visible[6, 8]
        assert result.seen[6, 12]
        assert not result.visible[6, 12]

    def test_it_is_the_finite_displacement_of_projected_points(self, model, states, camera):
        first, second = (face_vertices(model, state) for state in states)
        triangles = model.topology.triangles
        result = geometric_flow(first, second, triangles, camera, size=SIZE)
        seen = seen_surface(first, triangles, camera, size=SIZE)
        rows, columns = np.nonzero(np.asarray(result.seen))
        corners = np.asarray(triangles)[np.asarray(seen.triangle)[rows, columns]]
        shares = np.asarray(seen.barycentric)[rows, columns][..., None]
        before, after = ((np.asarray(part)[corners] * shares).sum(axis=1) for part in (first, second))
        start, end = (np.asarray(to_screen(camera, points).pixels) for points in (before, after))
        assert np.allclose(start, np.stack([columns, rows], axis=1), atol=2e-3)
        assert np.allclose(np.asarray(result.flow)[rows, columns], end - start, atol=3e-3)
        assert np.abs(end - start).max() > 5

    def test_there_and_back_is_consistent_where_both_pictures_show_it(self, model, states, camera):
        first, second = (face_vertices(model, state) for state in states)
        there, back = (
            geometric_flow(a, b, model.topology.triangles, camera, size=SIZE)
            for a, b in ((first, second), (second, first))
        )
        inner = cv2.erode(np.asarray(there.visible).astype(np.uint8), np.ones((5, 5))) > 0
        missed = np.linalg.norm(round_trip(np.asarray(there.flow), np.asarray(back.flow)), axis=-1)
        assert np.median(missed[inner]) < 0.03
        assert np.quantile(missed[inner], 0.95) < 0.5

    @pytest.mark.parametrize("moves", ["first", "second"])
    def test_its_derivative_agrees_with_finite_differences(self, model, states, camera, moves):
        step = 0.02
        way = states[1]._replace(translation=np.array([1.0, -2.0, 3.0]), rotation=np.array([0.01, 0.02, -0.01]))

        def flow(amount):
            def moved(state):
                return state._replace(
                    translation=state.translation + amount * way.translation,
                    rotation=state.rotation + amount * way.rotation,
                )

            first, second = states
            first, second = (moved(first), second) if moves == "first" else (first, moved(second))
            return geometric_flow(
                face_vertices(model, first), face_vertices(model, second), model.topology.triangles, camera, size=SIZE
            )

        tangent = jax.jvp(lambda amount: flow(amount).flow, (jnp.float32(0.0),), (jnp.float32(1.0),))[1]
        plus, minus = flow(jnp.float32(step)), flow(jnp.float32(-step))
        numeric = np.asarray(plus.flow - minus.flow) / (2 * step)
        inner = cv2.erode(np.asarray(plus.seen & minus.seen).astype(np.uint8), np.ones((7, 7))) > 0
        difference = np.linalg.norm(np.asarray(tangent) - numeric, axis=-1)[inner]
        assert np.abs(numeric[inner]).max() > 0.5
        assert np.quantile(difference, 0.9) < 0.1


class TestSurfacePoints:
    def test_points_lie_where_the_picture_shows_them(self, model, states, camera):
        first, second = states
        seen = seen_surface(face_vertices(model, first), model.topology.triangles, camera, size=SIZE)
        triangle, barycentric, pixels = choose_points(seen, step=5)
        points = surface_points(model, triangle, barycentric)
        start, flow = point_flow(points, first, second, camera)
        dense = geometric_flow(
            face_vertices(model, first), face_vertices(model, second), model.topology.triangles, camera, size=SIZE
        )
        assert len(pixels) > 50
        assert np.allclose(start, pixels, atol=5e-3)
        assert np.allclose(flow, np.asarray(dense.flow)[pixels[:, 1], pixels[:, 0]], atol=1e-2)

    def test_only_wanted_triangles_are_chosen(self, model, states, camera, head):
        seen = seen_surface(face_vertices(model, states[0]), model.topology.triangles, camera, size=SIZE)
        lips = np.isin(head.triangles, head.regions["lips"]).all(axis=1)
        triangle, _, _ = choose_points(seen, lips, step=2)
        assert len(triangle) > 5
        assert lips[triangle].all()

    def test_they_move_with_the_jaw_joint_as_the_head_does(self, model, states):
        state = states[0]._replace(jaw=np.array([0.3, 0.0, 0.05, 1.0, 0.0, -2.0]), scale=np.array([1.1]))
        triangle = np.arange(0, len(model.topology.triangles), 97)
        points = surface_points(model, triangle, np.tile([0.2, 0.3, 0.5], (len(triangle), 1)))
        vertices = np.asarray(face_vertices(model, state))
        expected = np.einsum("ncd,c->nd", vertices[np.asarray(model.topology.triangles)[triangle]], [0.2, 0.3, 0.5])
        assert np.allclose(points_in_camera(points, state), expected, atol=1e-3)

    def test_the_derivative_by_the_parameters_agrees_with_finite_differences(self, model, states, camera):
        first, second = states
        triangle = np.arange(0, len(model.topology.triangles), 397)
        points = surface_points(model, triangle, np.full((len(triangle), 3), 1 / 3))

        def flow(weights):
            return point_flow(points, first, second._replace(expression=weights), camera)[1]

        way = np.random.default_rng(0).normal(0, 1, len(second.expression))
        tangent = jax.jvp(flow, (jnp.asarray(second.expression),), (jnp.asarray(way),))[1]
        numeric = (flow(second.expression + 0.05 * way) - flow(second.expression - 0.05 * way)) / 0.1
        assert np.abs(numeric).max() > 1
        assert np.allclose(tangent, numeric, atol=0.02 * float(np.abs(numeric).max()))

    def test_pixels_without_a_face_are_refused(self, model):
        with pytest.raises(InputError, match="leave out pixels"):
            surface_points(model, np.array([3, -1]), np.full((2, 3), 1 / 3))


class TestEstimators:
    @pytest.mark.parametrize("estimator", ESTIMATORS, ids=str)
    def test_a_known_translation_is_recovered(self, estimator):
        first = texture()
        flow = estimator(first, shifted(first, (3.0, -2.0)))
        assert isinstance(estimator, FlowEstimator)
        assert np.allclose(np.median(flow[12:-12, 12:-12], axis=(0, 1)), [3.0, -2.0], atol=0.15)

    @pytest.mark.parametrize("estimator", ESTIMATORS, ids=str)
    def test_bytes_and_numbers_give_the_same(self, estimator):
        first, second = texture(), shifted(texture(), (1.5, 1.0))
        assert np.array_equal(estimator(first, second), estimator(first / 255.0, second / 255.0))

    def test_pictures_that_do_not_belong_together_are_refused(self):
        with pytest.raises(InputError, match="one size"):
            DisFlow()(texture(40, 40), texture(40, 48))
        with pytest.raises(InputError, match="at least 16"):
            FarnebackFlow()(texture(12, 40), texture(12, 40))

    @pytest.mark.parametrize("kind", ["uint16", "float64", "int32"])
    def test_pictures_of_another_range_are_refused(self, kind):
        picture = texture(40, 40).astype(kind)
        with pytest.raises(InputError, match=f"numbers in 0..1, got {kind} up to "):
            check_pair(picture, picture)


class Constant:
    """A network that always sees the same flow in its own pixels, plus the pictures' mean difference."""

    multiple, smallest_side = 32, 64

    def __init__(self, flow):
        self.flow = jnp.asarray(flow, jnp.float32)

    def __call__(self, first, second):
        return self.flow[:, None, None] + jnp.broadcast_to((second - first).mean(), (2, *first.shape[1:]))


class TestNetworkFlow:
    @pytest.mark.parametrize(
        ("size", "seen"), [((96, 128), (96, 128)), ((90, 160), (64, 128)), ((300, 200), (128, 96))]
    )
    def test_the_flow_is_brought_back_to_the_pictures_pixels(self, size, seen):
        flow = NetworkFlow(Constant([2.0, -1.0]), side=128)
        answer = flow(texture(*size), texture(*size))
        assert seen_size(flow.network, *size, flow.side) == seen
        assert answer.shape == (*size, 2)
        assert np.allclose(answer, [2.0 * size[1] / seen[1], -1.0 * size[0] / seen[0]], atol=1e-4)

    def test_it_is_differentiable_through_the_resizing(self):
        flow = NetworkFlow(Constant([0.0, 0.0]), side=64)
        first = np.zeros((80, 100, 3))
        way = np.ones_like(first)
        tangent = jax.jvp(lambda picture: flow.traced(first, picture), (first,), (way,))[1]
        assert np.allclose(tangent, [100 / 64, 80 / 64], atol=1e-3)

    def test_sides_that_make_no_sense_are_refused(self):
        for side in (32, 5000):
            with pytest.raises(InputError, match="64 to 2048"):
                NetworkFlow(Constant([0.0, 0.0]), side)

    def test_estimators_are_chosen_by_name(self):
        assert [flow_estimator(name).name for name in ("network", "dis", "farneback")] == [
            "network",
            "dis",
            "farneback",
        ]
        with pytest.raises(ConfigError, match="network, dis, farneback or a weights file"):
            flow_estimator("lucas-kanade")
        with pytest.raises(InputError, match="no weights file"):
            flow_estimator("nowhere/raft_small.pth")


@pytest.fixture(scope="module")
def network():
    return bundled_flow(128)


class TestBundledNetwork:
    def test_a_known_translation_is_recovered(self, network):
        first = texture(96, 128)
        flow = network(first, shifted(first, (3.0, -2.0)))
        assert np.allclose(np.median(flow[12:-12, 12:-12], axis=(0, 1)), [3.0, -2.0], atol=0.3)

    def test_what_does_not_move_has_hardly_any_flow(self, network):
        assert np.median(np.linalg.norm(network(texture(96, 128), texture(96, 128)), axis=-1)) < 0.2

    @pytest.mark.long
    def test_renders_go_through_it_with_a_derivative(self, network, head, model, camera):
        """A head that moves to the right: the network sees it, and that it would see more if it moved on."""
        light = ambient_light(0.4) + directional_light((-0.5, -0.6, -1.0), 0.7)
        rest = FaceParameters(
            np.zeros(3), np.array([0.0, 20.0, 500.0]), np.zeros(len(head.expression_names)), np.zeros(0)
        )

        def at(right):
            return rest._replace(translation=rest.translation + np.array([right, 0.0, 0.0]))

        def picture(right):
            # Size, camera and kinds of arrays as in tests/test_rendering.py, for one program.
            ground = np.full((*SIZE[::-1], 3), 0.3)
            return render_face(model, at(right), camera, model.colors, light, ground, size=SIZE).color

        first, second = picture(0.0), picture(8.0)
        change = (picture(8.3) - picture(7.7)) / 0.6
        answer = jax.jit(lambda moved, way: jax.jvp(lambda x: network.traced(first, x), (moved,), (way,)))
        moved, slope = answer(second, change)
        vertices = (face_vertices(model, at(right)) for right in (0.0, 8.0))
        exact = geometric_flow(*vertices, model.topology.triangles, camera, size=SIZE)
        face = cv2.erode(np.asarray(exact.seen).astype(np.uint8), np.ones((9, 9))) > 0
        expected = np.median(np.asarray(exact.flow)[face, 0])
        assert expected > 2.5
        assert np.isclose(np.median(np.asarray(moved)[face, 0]), expected, atol=0.4)
        assert np.median(np.asarray(slope)[face, 0]) > 0.15


class TestMeasures:
    def test_the_error_is_the_length_of_the_difference(self):
        truth = np.zeros((4, 5, 2))
        flow = truth + np.array([3.0, 4.0])
        where = np.zeros((4, 5), bool)
        where[1:3] = True
        flow[0] = 1000.0
        error = end_point_error(flow, truth, where)
        assert (error.mean, error.median, error.p90, error.over_3px, error.count) == (5.0, 5.0, 5.0, 1.0, 10)

    def test_nothing_counted_is_no_number(self):
        assert np.isnan(end_point_error(np.zeros((2, 2, 2)), np.zeros((2, 2, 2)), np.zeros((2, 2), bool)).mean)

    @given(st.floats(-6, 6), st.floats(-6, 6))
    def test_opposite_translations_are_consistent_inside(self, x, y):
        forward = np.broadcast_to(np.array([x, y]), (20, 24, 2)).copy()
        assert np.allclose(round_trip(forward, -forward), 0, atol=1e-5)
        assert not occluded(forward, -forward)[7:-7, 7:-7].any()

    def test_what_is_covered_and_what_leaves_is_occluded(self):
        """A block moves eight pixels to the right over a background that stands still."""
        forward, backward = np.zeros((30, 40, 2)), np.zeros((30, 40, 2))
        forward[10:20, 5:15] = [8, 0]
        backward[10:20, 13:23] = [-8, 0]
        mask = occluded(forward, backward)
        assert mask[12:18, 17:22].all()
        assert not mask[10:20, 6:14].any()
        assert not mask[:8].any()
        leaving = np.broadcast_to(np.array([5.0, 0.0]), (30, 40, 2))
        assert occluded(leaving, -leaving)[:, -4:].all()

    def test_warping_by_the_flow_brings_the_second_picture_back(self):
        first = texture().astype(np.float32)
        second = shifted(first, (4, 3))
        flow = np.broadcast_to(np.float32([4, 3]), (*first.shape[:2], 2))
        assert np.allclose(warp(second, flow)[5:-5, 5:-5], first[5:-5, 5:-5], atol=1e-3)

    def test_samples_between_pixels_are_linear_and_held_at_the_border(self):
        y, x = np.mgrid[0:5, 0:7].astype(np.float32)
        field = np.stack([2 * x + 3 * y, x], axis=-1)
        places = np.float32([[1.25, 2.5], [6.0, 4.0], [9.0, -3.0]])
        expected = [[2 * 1.25 + 3 * 2.5, 1.25], [24, 6], [12, 6]]
        assert np.allclose(sample(field, places), expected, atol=1e-5)
        slope = jax.jacfwd(lambda point: sample(field, point))(jnp.float32([1.25, 2.5]))
        assert np.allclose(slope, [[2, 3], [1, 0]], atol=1e-5)


class TestColors:
    def test_the_key_colours_of_bakers_wheel(self):
        wheel = color_wheel()
        assert len(wheel) == 55
        ends = {0: (255, 0, 0), 15: (255, 255, 0), 21: (0, 255, 0), 25: (0, 255, 255), 36: (0, 0, 255),
                49: (255, 0, 255)}  # fmt: skip
        for place, color in ends.items():
            assert tuple(wheel[place]) == color

    def test_red_is_right_yellow_down_blue_left_violet_up(self):
        vectors = np.array([[[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]])
        right, down, left, up = flow_picture(vectors, 1.0)[0].astype(int)
        assert right[0] == 255
        assert max(right[1:]) < 10
        assert min(down[:2]) > 200
        assert down[2] == 0
        assert left[2] == 255
        assert left[0] == 0
        assert up[2] > 200
        assert up[1] == 0
        assert up[0] > 60

    def test_standing_still_is_white_and_unknown_is_black(self):
        flow = np.zeros((2, 3, 2))
        flow[0, 0] = np.nan
        picture = flow_picture(flow, 4.0)
        assert (picture[0, 0] == 0).all()
        assert (picture[1] == 255).all()

    def test_colours_fade_with_length_and_darken_beyond_the_longest(self):
        whole, half, beyond = flow_picture(np.array([[[4.0, 0.0], [2.0, 0.0], [9.0, 0.0]]]), 4.0)[0].astype(int)
        assert whole[1] < half[1] < 255
        assert beyond[0] < whole[0]

    def test_the_key_is_a_disc_on_white(self):
        key = wheel_picture(41)
        assert (key[0, 0] == 255).all()
        assert (key[20, 20] == 255).all()
        assert key[20, 39, 0] > 200
        assert key[20, 39, 1] < 60
