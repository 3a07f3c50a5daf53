"""The jaw joint: linear blend skinning that meets the blendshapes where they mean the same."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workbench.energies.context import still
from workbench.energies.magnitude import magnitude_residual
from workbench.energies.stay import expression_residual
from workbench.face import FaceParameters, parameter_range
from workbench.face.jaw import (
    JAW_SHAPES,
    OPEN_DEG,
    TRAVEL_MM,
    JawJoint,
    in_blendshapes,
    jaw_joint,
    jaw_of_weights,
    move_jaw,
    weights_with_jaw,
)
from workbench.rendering import face_vertices, render_model

MOVE = jax.jit(move_jaw)
SIDEWAYS = np.array([0.0, 0.2, 0.1, 3.0, 0.0, 0.0])
"""A motion without opening: no corrective."""


@pytest.fixture(scope="module")
def joint(head):
    return jaw_joint(head)


@pytest.fixture(scope="module")
def rest(head):
    return np.zeros(len(head.identity_deltas))


def opened(degrees):
    return np.array([np.radians(degrees), 0, 0, 0, 0, 0])


def test_a_resting_joint_moves_nothing(head, joint, rest):
    np.testing.assert_array_equal(MOVE(joint, head.neutral, rest, np.zeros(6)), head.neutral)


def test_opened_by_26_and_a_half_degrees_it_is_the_blendshape(head, joint, rest):
    shape = head.neutral + head.expression_deltas[head.expression_names.index("jawOpen")]
    np.testing.assert_allclose(MOVE(joint, head.neutral, rest, opened(OPEN_DEG)), shape, atol=1e-9)


def test_half_open_it_swings_where_the_blendshape_goes_straight(head, joint, rest):
    """Both agree to 3 mm; only the hinge keeps every tooth's distance from its axis."""
    half = 0.5 * head.expression_deltas[head.expression_names.index("jawOpen")]
    moved = np.asarray(MOVE(joint, head.neutral, rest, opened(OPEN_DEG / 2)))
    assert 0.1 < np.linalg.norm(moved - head.neutral - half, axis=1).max() < 3.0
    hinge = joint._replace(corrective=np.zeros_like(joint.corrective))
    swung = np.asarray(MOVE(hinge, head.neutral, rest, opened(OPEN_DEG / 2)))
    solid = joint.weights == 1.0
    distance = np.linalg.norm((head.neutral - joint.joint)[solid, 1:], axis=1)
    np.testing.assert_allclose(np.linalg.norm((swung - joint.joint)[solid, 1:], axis=1), distance, rtol=1e-9)
    straight = np.linalg.norm((head.neutral + half - joint.joint)[solid, 1:], axis=1)
    assert np.abs(straight / distance - 1.0).max() > 0.01


def test_only_vertices_with_a_weight_move(head, joint, rest):
    way = np.linalg.norm(np.asarray(MOVE(joint, head.neutral, rest, SIDEWAYS)) - head.neutral, axis=1)
    assert (way[joint.weights == 0.0] == 0.0).all()
    assert (way[joint.weights > 0.9] > 0.0).all()
    assert (joint.weights == 0.0).mean() > 0.3


def test_vertices_of_full_weight_move_as_one_solid(head, joint, rest):
    solid = np.flatnonzero(joint.weights == 1.0)
    assert len(solid) > 20
    moved = np.asarray(MOVE(joint, head.neutral, rest, SIDEWAYS))[solid]
    turned = Rotation.from_rotvec(SIDEWAYS[:3]).apply(head.neutral[solid] - joint.joint) + joint.joint + SIDEWAYS[3:]
    np.testing.assert_allclose(moved, turned, atol=1e-9)


def test_a_shift_to_the_left_moves_the_chin_to_the_subjects_left(head, joint, rest):
    chin = head.landmarks.vertices[8]
    shifted = np.asarray(MOVE(joint, head.neutral, rest, np.array([0, 0, 0, 5.0, 0, 0])))
    assert (shifted[chin] - head.neutral[chin])[:, 0].mean() > 4.0
    assert head.neutral[head.landmarks.vertices[45], 0].mean() > 0.0


def test_a_mirrored_motion_moves_the_mirrored_vertices(head, joint, rest):
    symmetric = np.asarray(head.mirror)
    flip = np.array([-1.0, 1.0, 1.0])
    motion = np.array([0.1, 0.15, -0.05, 2.0, 1.0, -1.5])
    mirrored = motion * [1, -1, -1, -1, 1, 1]
    joint = joint._replace(joint=joint.joint * [0.0, 1.0, 1.0])
    one, other = (np.asarray(MOVE(joint, head.neutral, rest, way)) - head.neutral for way in (motion, mirrored))
    apart = np.linalg.norm(other - (one * flip)[symmetric], axis=1)
    assert np.median(apart) < 0.02
    assert apart.max() < 0.5


def test_the_joint_moves_with_the_identity(joint, rest):
    """A point in the person's own joint stays while the jaw turns about it."""
    identity = rest.copy()
    identity[:3] = 1.5, -1.0, 0.5
    own = joint.joint + identity @ joint.joint_identity
    assert np.linalg.norm(own - joint.joint) > 0.1
    alone = JawJoint(np.ones(1), joint.joint, joint.joint_identity, np.zeros((1, 3)))
    turned = move_jaw(alone, own[None], identity, np.array([0.3, 0.2, 0.1, 0, 0, 0]))
    np.testing.assert_allclose(turned, own[None], atol=1e-12)


def test_a_model_without_a_jaw_keeps_still(head, rest):
    jawless = jaw_joint(replace(head, joints={}))
    np.testing.assert_array_equal(MOVE(jawless, head.neutral, rest, opened(20)), head.neutral)


def test_the_renderer_opens_the_mouth_by_joint_as_by_blendshape(head, rest):
    model = render_model(head)
    expression = np.zeros(len(head.expression_names))
    by_shape = expression.copy()
    by_shape[head.expression_names.index("jawOpen")] = 1.0
    place = jnp.array([0.1, -0.2, 0.05]), jnp.array([10.0, -5.0, 600.0])
    one = face_vertices(model, FaceParameters(*place, expression, rest, opened(OPEN_DEG), np.ones(1)))
    other = face_vertices(model, FaceParameters(*place, by_shape, rest))
    np.testing.assert_allclose(one, other, atol=1e-3)


weight = st.floats(0.0, 1.0)


@settings(max_examples=20)
@given(openness=weight, forward=weight, sideways=st.floats(-1.0, 1.0))
def test_weights_and_joint_say_the_same(head, openness, forward, sideways):
    weights = np.zeros(len(head.expression_names))
    values = (openness, forward, max(sideways, 0.0), max(-sideways, 0.0))
    for name, value in zip(JAW_SHAPES, values, strict=True):
        weights[head.expression_names.index(name)] = value
    jaw = jaw_of_weights(head, weights)
    assert jaw[0] == pytest.approx(np.radians(OPEN_DEG) * openness)
    assert jaw[3] == pytest.approx(TRAVEL_MM * sideways)
    np.testing.assert_allclose(
        weights_with_jaw(head.expression_names, np.zeros_like(weights), jaw), weights, atol=1e-12
    )


def test_a_whole_shapes_travel_counts_as_one_in_every_term(head):
    """λ and `stay` count the jaw in one unit: that of the blendshapes it replaces."""
    moved = np.array([np.radians(OPEN_DEG), 0.0, 0.0, TRAVEL_MM, 0.0, -TRAVEL_MM])
    np.testing.assert_allclose(in_blendshapes(moved), [1, 0, 0, 1, 0, -1], atol=1e-12)
    rest = FaceParameters(np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(0), np.zeros(6), np.ones(1))
    for residual in (magnitude_residual, expression_residual):
        jaw = residual(rest._replace(jaw=moved), still(rest))[2:]
        np.testing.assert_allclose(jaw, in_blendshapes(moved), rtol=1e-12)


def test_the_range_of_the_jaw_is_the_models_own(head):
    assert [limit.jaw.tolist() for limit in parameter_range(head, bounded=True)] == head.jaw_range.tolist()
    stiff = replace(head, jaw_range=0.5 * head.jaw_range)
    assert parameter_range(stiff, bounded=False)[1].jaw[0] == 0.5 * head.jaw_range[1, 0]


def test_weights_of_many_frames_are_made_at_once(head):
    weights = np.zeros((3, len(head.expression_names)))
    jaws = np.stack([opened(angle) for angle in (0.0, 13.25, 26.5)])
    column = head.expression_names.index("jawOpen")
    np.testing.assert_allclose(weights_with_jaw(head.expression_names, weights, jaws)[:, column], [0.0, 0.5, 1.0])
    assert not weights.any()
