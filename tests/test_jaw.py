"""The jaw joint: linear blend skinning that meets the blendshapes where they mean the same."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.other_heads import half_open, hinged, resized, with_shapes
from workbench.energies.context import still
from workbench.energies.magnitude import magnitude_residual
from workbench.energies.stay import expression_residual
from workbench.face import (
    JAW_SHAPES,
    USUAL_JAW,
    FaceParameters,
    JawJoint,
    JawUnit,
    jaw_joint,
    jaw_of_weights,
    load_default_head,
    load_face_model,
    move_jaw,
    parameter_range,
    principal_expressions,
    typical_sizes,
    weights_with_jaw,
)
from workbench.face.jaw import in_blendshapes
from workbench.geometry import rotation_matrix
from workbench.rendering import face_vertices, render_model
from workbench.samples import sample

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
    np.testing.assert_allclose(MOVE(joint, head.neutral, rest, opened(26.5)), shape, atol=1e-9)


def test_half_open_it_swings_where_the_blendshape_goes_straight(head, joint, rest):
    """Both agree to 3 mm; only the hinge keeps every tooth's distance from its axis."""
    half = 0.5 * head.expression_deltas[head.expression_names.index("jawOpen")]
    moved = np.asarray(MOVE(joint, head.neutral, rest, opened(13.25)))
    assert 0.1 < np.linalg.norm(moved - head.neutral - half, axis=1).max() < 3.0
    hinge = joint._replace(corrective=np.zeros_like(joint.corrective))
    swung = np.asarray(MOVE(hinge, head.neutral, rest, opened(13.25)))
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
    one = face_vertices(model, FaceParameters(*place, expression, rest, opened(26.5), np.ones(1)))
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
    assert jaw[0] == pytest.approx(np.radians(26.5) * openness)
    assert jaw[3] == pytest.approx(8.0 * sideways)
    np.testing.assert_allclose(
        weights_with_jaw(head.expression_names, np.zeros_like(weights), jaw, head.jaw_unit), weights, atol=1e-12
    )


def test_a_whole_shapes_travel_counts_as_one_in_every_term(head):
    """λ and `stay` count the jaw in one unit: that of the blendshapes it replaces."""
    rest = FaceParameters(np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(0), np.zeros(6), np.ones(1))
    for unit in (head.jaw_unit, JawUnit(15.0, 4.0, 6.0)):
        moved = np.array([np.radians(unit.open_deg), 0.0, 0.0, unit.sideways_mm, 0.0, -unit.forward_mm])
        np.testing.assert_allclose(in_blendshapes(moved, unit), [1, 0, 0, 1, 0, -1], atol=1e-12)
        for residual in (magnitude_residual, expression_residual):
            jaw = residual(rest._replace(jaw=moved), still(rest)._replace(jaw_unit=unit))[2:]
            np.testing.assert_allclose(jaw, in_blendshapes(moved, unit), rtol=1e-12)


def test_weights_of_many_frames_are_made_at_once(head):
    weights = np.zeros((3, len(head.expression_names)))
    jaws = np.stack([opened(angle) for angle in (0.0, 13.25, 26.5)])
    column = head.expression_names.index("jawOpen")
    made = weights_with_jaw(head.expression_names, weights, jaws, head.jaw_unit)
    np.testing.assert_allclose(made[:, column], [0.0, 0.5, 1.0])
    assert not weights.any()


# The model's own unit.


def shape(model, name):
    return model.expression_deltas[model.expression_names.index(name)]


def one_shape(model, name):
    """Weights with this blendshape alone, whole."""
    return np.eye(len(model.expression_names))[model.expression_names.index(name)]


def test_the_default_head_keeps_its_numbers_to_the_last_bit(head, joint, rest):
    """What tracks and settings of the default head were made with: no fit to its shapes takes their place."""
    assert head.jaw_unit == load_default_head(gaze=True).jaw_unit == joint.unit == JawUnit(26.5, 8.0, 8.0)
    assert head.jaw_range.tolist() == [[-0.05, -0.25, -0.15, -12, -6, -12], [0.7, 0.25, 0.15, 12, 12, 12]]
    place = FaceParameters(np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(0), np.zeros(6), np.ones(1))
    sizes = typical_sizes(place, ("expression", "jaw"), head.jaw_unit)
    assert sizes.tolist() == [0.3, 0.3, 0.1, 0.1, 0.1, 3.0, 3.0, 3.0]
    jaw = np.array([0.3, 0.05, -0.02, 1.0, 2.0, -3.0])
    counted = jaw / np.repeat([np.radians(26.5), 8.0], 3)
    np.testing.assert_array_equal(in_blendshapes(jaw, head.jaw_unit), counted)
    turned = (head.neutral - joint.joint) @ rotation_matrix(jaw[:3]).T + joint.joint + jaw[3:]
    moved = head.neutral + joint.weights[:, None] * (turned - head.neutral) + counted[0] * joint.corrective
    np.testing.assert_array_equal(move_jaw(joint, head.neutral, np.zeros(0), jaw), moved)


def test_a_larger_head_travels_farther_and_opens_by_the_same_angle(head):
    same, large = resized(head, 1.0), resized(head, 1.3)
    assert large.jaw_unit.open_deg == pytest.approx(same.jaw_unit.open_deg, rel=1e-9)
    assert large.jaw_unit.sideways_mm == pytest.approx(1.3 * same.jaw_unit.sideways_mm, rel=1e-9)
    assert large.jaw_unit.forward_mm == pytest.approx(1.3 * same.jaw_unit.forward_mm, rel=1e-9)


def test_a_jaw_shape_that_opens_half_as_far_is_half_the_angle(head):
    whole, half = resized(head, 1.0).jaw_unit, half_open(head).jaw_unit
    assert half.open_deg == pytest.approx(0.5 * whole.open_deg, rel=0.02)  # an arc is not quite half as long
    assert (half.sideways_mm, half.forward_mm) == (whole.sideways_mm, whole.forward_mm)


@settings(max_examples=10)
@given(open_deg=st.floats(5.0, 45.0), sideways=st.floats(2.0, 15.0), forward=st.floats(2.0, 15.0))
def test_the_unit_of_shapes_that_a_joint_made_is_the_joints(head, open_deg, sideways, forward):
    model = hinged(head, open_deg, sideways, forward)
    found = model.jaw_unit
    np.testing.assert_allclose([found.open_deg, found.sideways_mm, found.forward_mm], [open_deg, sideways, forward])
    np.testing.assert_allclose(jaw_joint(model).corrective, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    "make", [half_open, lambda head: resized(head, 1.3), lambda head: half_open(resized(head, 0.8))]
)
def test_a_whole_shape_is_the_joint_at_the_models_own_angle(make, head, rest):
    model = make(head)
    joint = jaw_joint(model)
    jaw = jaw_of_weights(model, one_shape(model, "jawOpen"))
    np.testing.assert_allclose(
        MOVE(joint, model.neutral, rest, jaw), model.neutral + shape(model, "jawOpen"), atol=1e-9
    )
    assert in_blendshapes(jaw, model.jaw_unit).tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    back = weights_with_jaw(model.expression_names, np.zeros(len(model.expression_names)), jaw, model.jaw_unit)
    np.testing.assert_array_equal(back, one_shape(model, "jawOpen"))


@pytest.mark.parametrize(("name", "axis"), [("jawLeft", 0), ("jawRight", 0), ("jawForward", 2)])
def test_a_shift_moves_the_chin_as_far_as_its_shape(name, axis, head, rest):
    model = resized(head, 1.3)
    moved = np.asarray(MOVE(jaw_joint(model), model.neutral, rest, jaw_of_weights(model, one_shape(model, name))))
    chin, wanted = (model.landmarks.of(way)[8, axis] for way in (moved - model.neutral, shape(model, name)))
    assert chin == pytest.approx(wanted, rel=0.02)


def test_bounds_and_typical_sizes_of_the_six_unknowns_follow_the_unit(head):
    model = hinged(head, 13.25, 12.0, 4.0)
    factors = np.array([0.5, 0.5, 0.5, 1.5, 1.0, 0.5])
    for limit, usual in zip(parameter_range(model, bounded=True), head.jaw_range, strict=True):
        np.testing.assert_allclose(limit.jaw, factors * usual)
    place = FaceParameters(np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(0), np.zeros(6), np.ones(1))
    sizes = [typical_sizes(place, jaw_unit=unit) for unit in (model.jaw_unit, USUAL_JAW)]
    np.testing.assert_allclose(sizes[0][-7:-1], factors * sizes[1][-7:-1])
    np.testing.assert_array_equal(np.delete(sizes[0], np.s_[-7:-1]), np.delete(sizes[1], np.s_[-7:-1]))


def test_what_no_shape_tells_is_the_default_heads_in_proportion_to_the_size(head):
    large, nothing = resized(head, 1.3), np.zeros_like(head.neutral)
    others = tuple(name for name in head.expression_names if not name.startswith("jaw"))
    unmoved = dict.fromkeys(JAW_SHAPES, nothing)
    closing = {name: -shape(large, name) for name in JAW_SHAPES}
    for model in (
        replace(large, joints={}),
        replace(large, jaw_weights=np.zeros(len(large.neutral))),
        replace(large, expression_names=others, expression_deltas=large.expression_deltas[: len(others)]),
        with_shapes(large, **unmoved),
        with_shapes(large, **closing),
    ):
        unit = model.jaw_unit
        assert unit.open_deg == 26.5
        np.testing.assert_allclose([unit.sideways_mm, unit.forward_mm], 1.3 * 8.0, rtol=1e-3)


def test_a_person_and_a_choice_of_shapes_keep_the_models_unit(head):
    model = half_open(head)
    person = model.personal(np.linspace(-1.0, 1.0, len(head.identity_deltas)))
    for made in (person, model.with_expressions(("mouthSmileLeft",)), principal_expressions(model, 3)):
        assert made.jaw_unit == model.jaw_unit
        assert jaw_joint(made).unit == model.jaw_unit


def test_a_head_in_our_format_brings_its_unit_or_has_that_of_its_shapes(head, tmp_path):
    with np.load(sample("head")) as stored:
        arrays = dict(stored)
    np.savez(tmp_path / "told.npz", **(arrays | {"jaw_unit": np.array([20.0, 6.0, 5.0])}))
    assert load_face_model(tmp_path / "told.npz").jaw_unit == JawUnit(20.0, 6.0, 5.0)
    del arrays["jaw_unit"]
    np.savez(tmp_path / "untold.npz", **arrays)
    assert load_face_model(tmp_path / "untold.npz").jaw_unit == resized(head, 1.0).jaw_unit
