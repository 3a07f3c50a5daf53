"""Blendshapes (FACE IT! Eqs. 1-4), folders of OBJ targets, the landmark model, personal models."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workbench.errors import ModelError
from workbench.face import (
    absolute_form,
    align_targets,
    contour_blend,
    delta_form,
    landmark_model,
    load_default_head,
    model_landmarks,
    read_obj_folder,
    rigid_alignment,
    targets_to_deltas,
)

RNG = np.random.default_rng(0)
NEUTRAL = RNG.normal(size=(40, 3)) * 60
TARGETS = NEUTRAL + RNG.normal(size=(5, 40, 3))
vectors = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)


def test_the_delta_form_is_the_absolute_form_with_weights_that_sum_to_one():
    weights = np.array([0.3, 0.2, 0.0, 0.4, 0.05])
    absolute = absolute_form(np.concatenate([NEUTRAL[None], TARGETS]), np.concatenate([[1 - weights.sum()], weights]))
    np.testing.assert_allclose(delta_form(NEUTRAL, targets_to_deltas(NEUTRAL, TARGETS), weights), absolute)


def test_targets_of_another_mesh_are_refused():
    with pytest.raises(ModelError, match="40 vertices, got 39"):
        targets_to_deltas(NEUTRAL, TARGETS[:, :39])


@given(vectors, vectors)
def test_alignment_recovers_a_rigid_motion(rotation_vector, translation):
    rotation = Rotation.from_rotvec(rotation_vector).as_matrix()
    found_rotation, found_translation = rigid_alignment(NEUTRAL, NEUTRAL @ rotation.T + translation)
    np.testing.assert_allclose(found_rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(found_translation, translation, atol=1e-7)


def test_alignment_never_reflects_even_where_a_reflection_fits_better():
    mirrored = NEUTRAL * [-1.0, 1.0, 1.0]
    rotation, translation = rigid_alignment(NEUTRAL, mirrored)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    expected, _ = Rotation.align_vectors(mirrored - mirrored.mean(0), NEUTRAL - NEUTRAL.mean(0))
    np.testing.assert_allclose(rotation, expected.as_matrix(), atol=1e-8)
    np.testing.assert_allclose(translation, mirrored.mean(0) - rotation @ NEUTRAL.mean(0))


def test_alignment_on_a_flat_subset_keeps_the_handedness():
    flat = NEUTRAL * [1.0, 1.0, 0.0]
    rotation, _ = rigid_alignment(flat, flat)
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("points", [NEUTRAL[:2], np.outer(np.arange(5.0), [1.0, 2.0, 3.0])], ids=["two", "line"])
def test_alignment_refuses_points_that_leave_the_rotation_open(points):
    with pytest.raises(ModelError):
        rigid_alignment(points, points)


def test_targets_are_aligned_on_the_subset_and_keep_their_expression():
    back = np.arange(20)
    deltas = np.zeros((1, 40, 3))
    deltas[0, 20:] = RNG.normal(size=(20, 3))
    rotation = Rotation.from_rotvec([0.3, -0.2, 0.1]).as_matrix()
    moved = (NEUTRAL + deltas) @ rotation.T + [5.0, -3.0, 2.0]
    aligned = align_targets(NEUTRAL, moved, back)
    np.testing.assert_allclose(aligned - NEUTRAL, deltas, atol=1e-9)


@pytest.fixture
def obj_folder(tmp_path):
    """Six real OBJ files in correspondence and a landmark file."""
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=80.0)
    sphere.export(tmp_path / "neutral.obj")
    for name, scale in {"jawOpen": 1.1, "browInnerUp": 0.9}.items():
        target = sphere.copy()
        target.vertices[:, 1] *= scale
        target.export(tmp_path / f"{name}.obj")
    (tmp_path / "landmarks.toml").write_text(f"vertices = {list(range(68))}\n")
    return tmp_path


def test_a_folder_of_obj_targets_becomes_a_model(obj_folder):
    model = read_obj_folder(obj_folder)
    assert model.expression_names == ("browInnerUp", "jawOpen")
    expected = np.asarray(trimesh.load(obj_folder / "jawOpen.obj", process=False).vertices)
    np.testing.assert_allclose(model.vertices(np.array([0.0, 1.0])), expected, atol=1e-6)
    np.testing.assert_allclose(model.landmarks.of(model.neutral), model.neutral[:68])


def test_a_moved_target_is_aligned_where_asked(obj_folder):
    target = trimesh.load(obj_folder / "jawOpen.obj", process=False)
    straight = read_obj_folder(obj_folder)
    target.vertices += [30.0, 0.0, 0.0]
    target.export(obj_folder / "jawOpen.obj")
    aligned = read_obj_folder(obj_folder, align_on=np.arange(len(target.vertices)))
    np.testing.assert_allclose(aligned.expression_deltas[1].mean(0), 0.0, atol=1e-4)
    assert np.abs(aligned.expression_deltas[1] - straight.expression_deltas[1]).max() < 1.0


def damage_missing_neutral(folder):
    (folder / "neutral.obj").unlink()


def damage_no_targets(folder):
    for name in ("jawOpen", "browInnerUp"):
        (folder / f"{name}.obj").unlink()


def damage_other_mesh(folder):
    trimesh.creation.icosphere(subdivisions=1).export(folder / "jawOpen.obj")


def damage_reordered(folder):
    mesh = trimesh.load(folder / "jawOpen.obj", process=False)
    trimesh.Trimesh(mesh.vertices, mesh.faces[::-1], process=False).export(folder / "jawOpen.obj")


def damage_no_obj(folder):
    (folder / "jawOpen.obj").write_text("hello")


def damage_no_landmarks(folder):
    (folder / "landmarks.toml").unlink()


def damage_67_landmarks(folder):
    (folder / "landmarks.toml").write_text(f"vertices = {list(range(67))}\n")


def damage_landmark_beyond(folder):
    (folder / "landmarks.toml").write_text(f"vertices = {[*range(67), 9999]}\n")


def damage_toml(folder):
    (folder / "landmarks.toml").write_text("vertices = [")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (damage_missing_neutral, "needs neutral.obj"),
        (damage_no_targets, "no blendshape targets"),
        (damage_other_mesh, "all targets must come from one mesh"),
        (damage_reordered, "without reordering"),
        (damage_no_obj, "jawOpen.obj"),
        (damage_no_landmarks, "needs landmarks.toml"),
        (damage_67_landmarks, "68 vertex numbers"),
        (damage_landmark_beyond, "vertex 9999"),
        (damage_toml, "not valid TOML"),
    ],
)
def test_folders_out_of_correspondence_are_refused(damage, message, obj_folder):
    damage(obj_folder)
    with pytest.raises(ModelError, match=message):
        read_obj_folder(obj_folder)


def test_unknown_blendshapes_are_named(head):
    with pytest.raises(ModelError, match="jawOpne"):
        head.with_expressions(("jawOpne",))


def test_the_papers_44_are_the_52_without_gaze(head):
    every = load_default_head(gaze=True)
    assert len(head.expression_names) == 44
    assert set(every.expression_names) - set(head.expression_names) == {
        f"eyeLook{way}{side}" for way in ("Down", "In", "Out", "Up") for side in ("Left", "Right")
    }


def test_the_landmark_model_is_the_mesh_at_its_landmarks(head):
    identity, weights = RNG.normal(size=50) * 0.5, RNG.uniform(0, 1, 44)
    person = head.personal(identity)
    expected = person.landmarks.of(person.vertices(weights))
    model = landmark_model(head)
    points = model_landmarks(model, contour_blend(model.contour_yaw, 0.0, 0.0), jnp.asarray(identity))
    whole = points.neutral + jnp.tensordot(weights, points.expression, 1) + jnp.tensordot(identity, points.identity, 1)
    np.testing.assert_allclose(whole, expected, atol=1e-9)
    baked = model.personal(identity)
    np.testing.assert_allclose(baked.frontal_neutral(), person.landmarks.of(person.neutral), atol=1e-9)


@given(st.floats(-1.2, 1.2), st.floats(0.0, 1.0))
def test_contour_weights_sum_to_one_and_touch_two_neighbours(yaw, sliding):
    table = np.radians(np.concatenate([[0.0], np.arange(-40.0, 41.0, 10.0)]))
    blend = np.asarray(contour_blend(table, yaw, sliding))
    assert blend.sum() == pytest.approx(1.0)
    assert blend.min() >= 0.0
    assert (blend[1:] > 0).sum() <= 2
    mean_yaw = np.interp(yaw, table[1:], table[1:])
    assert blend[1:] @ table[1:] == pytest.approx(sliding * mean_yaw, abs=1e-12)


def test_the_contour_slides_towards_the_visible_silhouette(head):
    model = landmark_model(head)
    frontal = contour_blend(model.contour_yaw, 0.0, 1.0)
    turned = contour_blend(model.contour_yaw, np.radians(40.0), 1.0)
    difference = np.abs(np.tensordot(turned - frontal, model.contour_neutral, 1)).max()
    assert difference > 5.0


def test_a_person_has_its_own_blink_travel(head):
    narrow, wide = (sign * 2.0 * np.sign(head.blink_scale_identity[:, 0]) for sign in (-1, 1))
    assert head.blink_scale_for(narrow)[0] < head.blink_scale[0] < head.blink_scale_for(wide)[0]
    blink = head.expression_names.index("eyeBlinkLeft")
    ratio = head.blink_scale_for(wide)[0]
    np.testing.assert_allclose(head.personal(wide).expression_deltas[blink], head.expression_deltas[blink] * ratio)
    assert len(head.personal(wide).identity_deltas) == 0


def test_a_model_with_missing_parts_is_refused(tmp_path, head):
    np.savez(tmp_path / "head.npz", neutral=head.neutral)
    with pytest.raises(ModelError, match="has no"):
        load_default_head(tmp_path / "head.npz")


def test_the_fingerprint_changes_with_the_shape(head):
    assert head.fingerprint() == load_default_head().fingerprint()
    assert head.fingerprint() != head.personal(np.ones(50)).fingerprint()


def test_the_neck_ends_in_an_even_line_around_it(head):
    """Neighbours on the border below the chin are at nearly one height, and it has nothing pointed."""
    edges = np.sort(head.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    single, count = np.unique(edges, axis=0, return_counts=True)
    open_edges = single[count == 1]
    below = head.neutral[open_edges][..., 1].min(axis=1) > head.landmarks.of(head.neutral)[8, 1] + 15
    ends = head.neutral[open_edges[below]]
    along = ends[:, 1] - ends[:, 0]
    assert len(along) == 48
    assert np.abs(along[:, 1]).max() < 0.4 * np.linalg.norm(along, axis=1).max()
    assert np.ptp(ends[..., 1]) < 20
