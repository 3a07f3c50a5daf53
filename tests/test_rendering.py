"""The differentiable renderer: what is seen, how it is lit, smooth contours, and derivatives of all of it."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from tests.optional_parts import needs_gl
from workbench.errors import InputError
from workbench.face import FaceParameters, load_default_head
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_fov, project
from workbench.pictures import Light, Lighting
from workbench.pictures.mesh import corner_sum
from workbench.pictures.mesh import vertex_normals as picture_normals
from workbench.pictures.render_thread import RenderThread
from workbench.rendering import (
    Texture,
    ambient_light,
    directional_light,
    face_vertices,
    mesh_topology,
    model_at,
    orthographic_camera,
    render,
    render_face,
    render_model,
    shading,
    spherical_harmonics,
    turned_light,
)
from workbench.rendering.head import lip_sides
from workbench.rendering.renderer import _render

SIZE = (96, 80)
WHITE, BLACK = np.ones(3), np.zeros(3)
AMBIENT = ambient_light()
LIGHT = ambient_light(0.35) + directional_light((-0.5, -0.6, -1.0), 0.7)
FLAT = orthographic_camera((16, 12), 1.0)
"""One pixel per millimetre; the camera frame's origin between the middle pixels of a 16 × 12 picture."""


QUADS = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
ASIDE = np.array([[100.0, 100.0, 50.0], [100.0, 101.0, 50.0], [101.0, 101.0, 50.0], [101.0, 100.0, 50.0]])
"""A quad that the picture does not show."""
RED_GREEN = np.repeat([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 4, axis=0)


def quad(low, high, depth):
    """Corners of an axis-parallel rectangle that faces the camera, from (x, y) to (x, y), millimetres."""
    (x0, y0), (x1, y1) = low, high
    return np.array([[x0, y0, depth], [x0, y1, depth], [x1, y1, depth], [x1, y0, depth]], float)


def flat(vertices, triangles=QUADS, albedo=RED_GREEN, background=BLACK, **options):
    """Render eight vertices in the flat camera under light from everywhere."""
    mesh = mesh_topology(triangles, 8)
    return render(vertices, mesh, FLAT, albedo, AMBIENT, background, size=(16, 12), **options)


@jax.jit
@partial(jax.vmap, in_axes=(0, None))
def motions(vertices, way):
    """Colour with coverage of two quads, and its derivative as they move, from forward and from reverse mode.

    Of three scenes at once, so that these tests and that of batches share one program.
    """

    def picture(vertices):
        rendering = flat(vertices)
        return jnp.concatenate([rendering.color, rendering.coverage[..., None]], axis=-1)

    value, pullback = jax.vjp(picture, vertices)
    total = jnp.zeros_like(value).at[..., 3].set(1.0)
    return value, jax.jvp(picture, (vertices,), (way,))[1], (pullback(total)[0] * way).sum()


def flat_motion(vertices, way):
    """`motions` of one scene."""
    return (np.asarray(of_three)[0] for of_three in motions(np.stack([vertices] * 3), way))


@pytest.fixture(scope="module")
def model(head):
    return render_model(head)


@pytest.fixture(scope="module")
def camera():
    return Camera(*(np.asarray(part, np.float32) for part in camera_from_fov(SIZE, 30.0)))


@pytest.fixture(scope="module")
def parameters(head):
    expression = np.zeros(len(head.expression_names))
    expression[head.expression_names.index("jawOpen")] = 0.3
    return FaceParameters(
        *(
            np.asarray(part, np.float32)
            for part in (axis_angle_from_yaw_pitch_roll(np.array([20.0, 5.0, -4.0])), [3.0, 2.0, 540.0], expression, [])
        )
    )


@pytest.fixture(scope="module")
def rendering(model, parameters, camera):
    return head_picture(model, parameters, camera, model.colors, LIGHT, BLACK)


def traced(*parts):
    """Parts of a scene as arrays in single precision, a background as a picture."""
    *parts, background = jax.tree.map(lambda part: np.asarray(part, np.float32), parts)
    return (*parts, np.broadcast_to(background, (*SIZE[::-1], 3)))


def head_picture(model, parameters, camera, albedo, light, background, **options):
    """A picture of the head; backgrounds are always pictures, so that all of these tests share one program."""
    behind = jnp.broadcast_to(jnp.asarray(background, jnp.float32), (*SIZE[::-1], 3))
    return render_face(model, parameters, camera, albedo, jnp.asarray(light, jnp.float32), behind, size=SIZE, **options)


@jax.jit
def head_motion(model, parts, way, weights):
    """The head's colours with two samples a side, and their derivative from forward and from reverse mode.

    `parts` are face, camera, albedo, light and background. Returns the picture, its change along the way and what
    each part changes of the weighted sum of its colours. One program for all tests of the head's derivatives.
    """

    def picture(parts):
        return head_picture(model, *parts, samples=2).color

    value, pullback = jax.vjp(picture, parts)
    return value, jax.jvp(picture, (parts,), (way,))[1], pullback(weights)[0]


def supersampled(model, face, camera):
    """The mean of 36 rough pictures before white, each a part of a pixel aside."""
    grid = (np.arange(6) + 0.5) / 6 - 0.5
    vertices, white = face_vertices(model, face), np.ones((*SIZE[::-1], 3), np.float32)

    def at(offset):
        aside = camera._replace(principal_point_px=camera.principal_point_px - np.float32(offset))
        options = {"size": SIZE, "antialias": False}
        return np.asarray(render(vertices, model.topology, aside, model.colors, LIGHT, white, **options).color)

    return np.mean([at((x, y)) for x in grid for y in grid], axis=0)


# --- what is seen ---


def test_a_pixel_shows_what_is_at_its_centre():
    """x = -3.4..0.6 mm is 4.1..8.1 px, y = -2.4..2.6 mm is 3.1..8.1 px: the centres 5 to 8 and 4 to 8."""
    seen = np.asarray(flat(np.concatenate([quad((-3.4, -2.4), (0.6, 2.6), 10.0), ASIDE])).triangle) >= 0
    assert np.flatnonzero(seen.any(axis=0)).tolist() == [5, 6, 7, 8]
    assert np.flatnonzero(seen.any(axis=1)).tolist() == [4, 5, 6, 7, 8]


def test_the_nearer_surface_is_seen_whatever_the_order():
    vertices = np.concatenate([quad((-4, -4), (4, 4), 10.0), quad((-6, -3), (6, 3), 20.0)])
    for order in (QUADS, QUADS[::-1]):
        color = np.asarray(flat(vertices, order).color)
        assert color[6, 8] == pytest.approx([1, 0, 0], abs=1e-5)
        assert color[6, 2] == pytest.approx([0, 1, 0], abs=1e-5)
        assert color[0, 0] == pytest.approx([0, 0, 0], abs=1e-5)


def test_triangles_larger_than_the_picture_fill_it():
    rendering = flat(np.concatenate([quad((-4000, -5000), (6000, 5000), 10.0), ASIDE]))
    assert (np.asarray(rendering.triangle) >= 0).all()
    assert np.asarray(rendering.coverage) == pytest.approx(np.ones((12, 16)), abs=1e-5)


@pytest.mark.long
def test_shared_edges_leave_no_gap_and_no_seam(model, parameters):
    """A close-up of the cheek, triangles many pixels wide: every pixel is covered."""
    camera = Camera(np.full(2, 1600.0, np.float32), np.full(2, 50.0, np.float32), np.zeros(8, np.float32))
    rendering = head_picture(model, parameters, camera, model.colors, LIGHT, WHITE)
    assert (np.asarray(rendering.triangle) >= 0).all()
    assert np.asarray(rendering.coverage) == pytest.approx(np.ones((80, 96)), abs=1e-5)


def test_backs_are_not_seen_unless_asked_for():
    vertices, turned = np.concatenate([quad((-4, -4), (4, 4), 10.0), ASIDE]), QUADS[:, ::-1]
    assert (np.asarray(flat(vertices, turned).triangle) == -1).all()
    both = flat(vertices, turned, antialias=False, cull_backfaces=False)
    assert (np.asarray(both.triangle) >= 0).sum() == 64


def test_what_lies_behind_the_camera_or_is_not_a_number_is_left_out(model, parameters, camera):
    behind = parameters._replace(translation=np.float32([0.0, 0.0, -500.0]))
    for place in (behind, parameters._replace(translation=np.float32([np.nan, 0.0, 500.0]))):
        rendering = head_picture(model, place, camera, model.colors, LIGHT, [0.2, 0.3, 0.4])
        assert np.asarray(rendering.color) == pytest.approx(np.broadcast_to([0.2, 0.3, 0.4], (80, 96, 3)))


def test_depth_and_barycentrics_give_back_the_point_of_each_pixel(model, parameters, camera, rendering):
    vertices = np.asarray(face_vertices(model, parameters), float)
    seen = np.asarray(rendering.triangle) >= 0
    corners = vertices[np.asarray(model.topology.triangles)[np.asarray(rendering.triangle)[seen]]]
    points = (corners * np.asarray(rendering.barycentric, float)[seen][..., None]).sum(axis=1)
    rows, columns = np.nonzero(seen)
    pixels = np.asarray(project(camera, points))
    assert pixels == pytest.approx(np.stack([columns, rows], axis=1), abs=2e-3)
    assert points[:, 2] == pytest.approx(np.asarray(rendering.depth)[seen], abs=1e-2)
    assert np.isinf(np.asarray(rendering.depth)[~seen]).all()


def test_normals_are_those_of_the_pictures_package(head, model, parameters, rendering):
    """A second route: NumPy's vertex normals at the barycentric points."""
    vertices = np.asarray(face_vertices(model, parameters), float)
    normals = picture_normals(vertices, head.triangles, corner_sum(head.triangles, len(vertices)))
    seen = np.asarray(rendering.triangle) >= 0
    corners = normals[head.triangles[np.asarray(rendering.triangle)[seen]]]
    expected = (corners * np.asarray(rendering.barycentric, float)[seen][..., None]).sum(axis=1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.asarray(rendering.normals)[seen] == pytest.approx(expected, abs=1e-3)


def test_some_vertices_alone_are_where_the_whole_model_has_them(model, parameters):
    chosen = np.array([40, 7, 7, 3000])
    alone = jax.jit(lambda model: face_vertices(model_at(model, chosen), parameters))(model)
    np.testing.assert_array_equal(alone, np.asarray(face_vertices(model, parameters))[chosen])


def test_lens_distortion_moves_the_head_as_opencv_does(model, parameters, camera):
    lens = camera._replace(distortion=np.float32([-0.3, 0.1, 0.01, -0.02, 0, 0, 0, 0]))
    rendering = head_picture(model, parameters, lens, model.colors, LIGHT, BLACK)
    vertices = np.asarray(face_vertices(model, parameters), float)
    seen = np.asarray(rendering.triangle) >= 0
    corners = vertices[np.asarray(model.topology.triangles)[np.asarray(rendering.triangle)[seen]]]
    points = (corners * np.asarray(rendering.barycentric, float)[seen][..., None]).sum(axis=1)
    rows, columns = np.nonzero(seen)
    # Edges stay straight between projected vertices, so points inside of large triangles differ a little.
    error = np.linalg.norm(np.asarray(project(lens, points)) - np.stack([columns, rows], axis=1), axis=1)
    assert np.median(error) < 0.01
    assert error.max() < 0.2


# --- contours ---


def test_a_pixel_at_a_border_has_the_share_that_is_covered():
    coverage = np.asarray(flat(np.concatenate([quad((-3.2, -2.7), (2.6, 1.9), 10.0), ASIDE])).coverage)
    assert coverage[5, [4, 10]] == pytest.approx([0.2, 0.6], abs=1e-3)
    assert coverage[[3, 7], 7] == pytest.approx([0.7, 0.9], abs=1e-3)
    # Corners are approximate.
    assert coverage[3, [4, 10]] == pytest.approx([0.14, 0.42], abs=0.06)
    assert coverage.sum() == pytest.approx(5.8 * 4.6, abs=0.15)


@pytest.mark.long
def test_smooth_pictures_come_close_to_supersampled_ones(model, parameters, camera):
    truth = supersampled(model, parameters, camera)
    parts = traced(parameters, camera, model.colors, LIGHT, WHITE)
    two_samples, _, _ = head_motion(model, parts, jax.tree.map(np.zeros_like, parts), np.zeros_like(truth))
    plain = (head_picture(model, *parts, **options).color for options in ({"antialias": False}, {}))
    rough, smooth, smoother = (np.abs(np.asarray(color) - truth).mean() for color in (*plain, two_samples))
    assert smooth < 0.5 * rough
    assert smoother < 0.75 * smooth


def test_two_borders_in_one_pixel_keep_to_themselves():
    """Red ends at x = 0.3 before green, which ends at x = 0.8: pixel 8 spans 0 to 1."""
    vertices = np.concatenate([quad((-4, -4), (0.3, 4), 10.0), quad((-4, -4), (0.8, 4), 20.0)])
    rendering = flat(vertices, background=WHITE)
    assert np.asarray(rendering.coverage)[6, 8] == pytest.approx(0.8, abs=1e-3)
    assert np.asarray(rendering.coverage).max() <= 1.0 + 1e-5
    assert np.asarray(rendering.color)[6, 8] == pytest.approx([0.5, 0.7, 0.2], abs=1e-3)


def test_where_many_edges_meet_no_colour_leaves_the_range_of_what_meets(model, camera):
    """Both eyes half closed, a mouth hardly open: lids, eyeballs and teeth cross in single pixels."""
    names = load_default_head().expression_names
    expression = np.isin(names, ["eyeBlinkLeft", "eyeBlinkRight"]) * 0.5 + np.isin(names, ["jawOpen"]) * 0.05
    pose = np.zeros(3), np.array([0.0, 0.0, 420.0])
    face = FaceParameters(*(np.asarray(part, np.float32) for part in (*pose, expression, [])))
    color = np.asarray(head_picture(model, face, camera, model.colors, AMBIENT, BLACK).color)
    assert color.min() >= 0.0
    assert color.max() <= float(model.colors.max()) + 1e-4


@pytest.mark.long
def test_a_moving_border_changes_coverage_by_its_length():
    """Widening a 6 mm high rectangle to the right covers 6 pixels per pixel of motion, wherever the border lies."""
    way = np.zeros((8, 3))
    way[2:4, 0] = 1.0
    scenes = [np.concatenate([quad((-4, -3), (right, 3), 10.0), ASIDE]) for right in (2.3, 2.71, 3.6)]
    _, forward, reverse = motions(np.stack(scenes), way)
    assert np.asarray(forward)[..., 3].sum(axis=(1, 2)) == pytest.approx(np.full(3, 6.0), abs=1e-3)
    assert np.asarray(reverse) == pytest.approx(np.full(3, 6.0), abs=1e-3)


def covered(corners, fine=96):
    """Share of each pixel of the flat camera that lies inside a convex polygon, by a grid of points in each."""
    x, y = (np.arange(size * fine) / fine + 0.5 / fine - 0.5 for size in (16, 12))
    points = np.stack(np.meshgrid(x, y), axis=-1) - (7.5, 5.5)
    along = np.roll(corners, -1, axis=0) - corners
    away = points[..., None, :] - corners
    side = along[:, 0] * away[..., 1] - along[:, 1] * away[..., 0]
    inside = (side > 0).all(axis=-1) | (side < 0).all(axis=-1)
    return inside.reshape(12, fine, 16, fine).mean(axis=(1, 3))


@pytest.mark.long
def test_slanted_borders_move_by_the_exact_share():
    """Coverage of every pixel along slanted borders against central differences of a fine grid of points."""
    slanted = np.array([[-5.0, -4.0, 10.0], [-3.0, 4.0, 10.0], [4.0, 3.0, 10.0], [3.0, -4.5, 10.0]])
    vertices, way, step = np.concatenate([slanted, ASIDE]), np.tile([0.8, 0.6, 0.0], (8, 1)), 0.05
    ahead, behind = (covered((slanted + sign * step * way[:4])[:, :2]) for sign in (1.0, -1.0))
    reference = (ahead - behind) / (2 * step)
    _, forward, _ = flat_motion(vertices, way)
    derivative = forward[..., 3]
    assert (derivative * reference).sum() > 0.995 * np.linalg.norm(derivative) * np.linalg.norm(reference)
    assert np.linalg.norm(derivative - reference) < 0.08 * np.linalg.norm(reference)


def test_an_inner_border_blends_what_is_in_front_and_behind():
    vertices = np.concatenate([quad((-4, -4), (0.3, 4), 10.0), quad((-7, -5), (7, 5), 20.0)])
    assert np.asarray(flat(vertices).color)[6, 8] == pytest.approx([0.3, 0.7, 0.0], abs=1e-3)


@pytest.mark.long
def test_a_hidden_border_changes_nothing():
    way = np.zeros((8, 3))
    way[4:, 0] = 1.0
    vertices = np.concatenate([quad((-6, -5), (6, 5), 10.0), quad((-2, -2), (1.3, 2), 20.0)])
    _, forward, _ = flat_motion(vertices, way)
    assert forward == pytest.approx(np.zeros((12, 16, 4)))


def test_parts_that_pass_through_each_other_have_a_moving_border():
    """A red plane that tilts through a green one meets it at x = 0.3; moved back by 1 mm at slope 1 it recedes 1 px."""
    tilted, upright = quad((-6, -4), (6, 4), 20.0), quad((-6, -5), (6, 5), 20.0)
    tilted[:, 2] += tilted[:, 0] - 0.3
    way = np.zeros((8, 3))
    way[:4, 2] = 1.0
    value, forward, _ = flat_motion(np.concatenate([tilted, upright]), way)
    assert value[6, 8, :3] == pytest.approx([0.3, 0.7, 0.0], abs=0.02)
    assert forward[6, 8, :3] == pytest.approx([-1.0, 1.0, 0.0], abs=0.05)


# --- light and colours ---


def test_the_nine_functions_are_orthonormal():
    random = np.random.default_rng(0).normal(size=(200_000, 3))
    functions = np.stack(spherical_harmonics(*(random / np.linalg.norm(random, axis=1, keepdims=True)).T))
    assert 4 * np.pi * functions @ functions.T / len(random) == pytest.approx(np.eye(9), abs=0.03)


def test_ambient_light_shows_the_albedo():
    assert np.stack(
        shading(ambient_light((0.2, 0.5, 1.0)), tuple(np.float32([[0.6], [0.0], [-0.8]])))
    ) == pytest.approx(np.array([[0.2], [0.5], [1.0]]), abs=1e-5)


def test_a_directional_light_is_the_cosine_within_the_bounds_of_nine_functions():
    directions = np.random.default_rng(1).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    shown = np.stack(shading(directional_light((0.0, 0.0, -2.0)), tuple(directions.T.astype(np.float32))))[0]
    assert np.abs(shown - np.clip(-directions[:, 2], 0.0, None)).max() < 0.1


def test_a_light_needs_a_direction():
    with pytest.raises(InputError, match="direction"):
        directional_light((0.0, 0.0, 0.0))


def vectors(*shape):
    return hnp.arrays(float, shape, elements=st.floats(-2.0, 2.0))


UNIT = (
    vectors(3).filter(lambda vector: np.linalg.norm(vector) > 0.1).map(lambda vector: vector / np.linalg.norm(vector))
)


@settings(max_examples=15)
@given(vectors(9, 3), vectors(3))
def test_a_turned_light_shades_a_turned_surface_as_before(light, turn):
    normals = np.random.default_rng(0).normal(size=(40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rotation = Rotation.from_rotvec(turn).as_matrix()
    before, after = (
        np.stack(shading(shown, tuple(np.float32(facing).T)))
        for shown, facing in ((light, normals), (turned_light(light, rotation), normals @ rotation.T))
    )
    np.testing.assert_allclose(after, before, atol=1e-5)


@given(UNIT, vectors(3))
def test_a_lamp_that_is_turned_shines_from_the_turned_direction(direction, turn):
    rotation = Rotation.from_rotvec(turn)
    lamp = ambient_light(0.3) + directional_light(tuple(direction), 0.7)
    expected = ambient_light(0.3) + directional_light(tuple(rotation.apply(direction)), 0.7)
    np.testing.assert_allclose(turned_light(lamp, rotation.as_matrix()), expected, atol=1e-9)


def test_a_picture_is_linear_in_light_albedo_and_background(model, parameters, camera):
    def color(albedo, light, background):
        return np.asarray(head_picture(model, parameters, camera, albedo, light, background).color)

    albedo, half = model.colors, 0.5 * model.colors
    full = color(albedo, LIGHT, BLACK)
    assert color(half, LIGHT, BLACK) == pytest.approx(0.5 * full, abs=1e-5)
    assert color(albedo, 0.5 * LIGHT, BLACK) == pytest.approx(0.5 * full, abs=1e-5)
    behind = np.random.default_rng(0).uniform(size=(*SIZE[::-1], 3)).astype(np.float32)
    backdrop = color(albedo, LIGHT, behind) - full
    seen = np.asarray(head_picture(model, parameters, camera, albedo, LIGHT, BLACK).coverage)
    # But for single pixels where several edges meet: there the sum of their changes is kept in range.
    assert np.isclose(backdrop, (1.0 - seen[..., None]) * behind, atol=1e-4).mean() > 0.999


def test_a_texture_is_seen_the_right_way_up():
    """v points up in the OBJ convention: the picture's first row belongs to v = 1."""
    vertices = np.concatenate([quad((-4, -4), (4, 4), 10.0), ASIDE])
    texels = np.zeros((2, 2, 3))
    texels[0, :, 0], texels[1, :, 1] = 1.0, 1.0
    uv = np.stack([(vertices[:, 0] + 4) / 8, 1.0 - (vertices[:, 1] + 4) / 8], axis=1)
    color = np.asarray(flat(vertices, albedo=Texture(texels, uv, QUADS), antialias=False).color)
    assert color[2, 8] == pytest.approx([1, 0, 0], abs=0.1)
    assert color[9, 8] == pytest.approx([0, 1, 0], abs=0.1)


# --- derivatives ---


def test_a_texture_changes_with_vertices_places_texels_and_light_as_differences_do():
    """A tilted quad in perspective, inside of its outline: all that the picture shows there is the texture."""
    u, v = np.meshgrid((np.arange(12) + 0.5) / 12, (np.arange(12) + 0.5) / 12)
    texels = 0.5 + 0.4 * np.stack([np.sin(5.0 * u + v), np.cos(3.0 * v - 2.0 * u), u * v], axis=-1)
    vertices = np.concatenate(
        [quad((-30, -30), (30, 30), 200.0) + np.float32([[0, 0, 12], [0, 0, 0], [0, 0, -9], [0, 0, 3]]), ASIDE]
    )
    uv = np.float32([[0, 1], [0, 0], [1, 0], [1, 1]] + [[0, 0]] * 4)
    camera = Camera(*(np.asarray(part, np.float32) for part in camera_from_fov((24, 24), 14.0)))
    mesh = mesh_topology(QUADS, 8)

    @jax.jit
    def inside(vertices, uv, texels, light):
        texture = Texture(texels, uv, QUADS)
        return render(vertices, mesh, camera, texture, light, BLACK, size=(24, 24), antialias=False).color[4:20, 4:20]

    random = np.random.default_rng(4)
    scene = tuple(np.asarray(part, np.float32) for part in (vertices, uv, texels, LIGHT))
    assert inside(*scene).min() > 0.0
    for part, step in enumerate((0.2, 2e-3, 0.05, 0.05)):
        way = [np.zeros_like(value) for value in scene]
        way[part] = random.normal(size=scene[part].shape).astype(np.float32)
        there, here = (
            inside(*(value + sign * step * d for value, d in zip(scene, way, strict=True))) for sign in (1.0, -1.0)
        )
        change = np.asarray(there - here) / (2.0 * step)
        derivative = np.asarray(jax.jvp(inside, scene, tuple(way))[1])
        # Bilinear look-ups have a kink at each texel's centre, so that single pixels may differ.
        assert np.linalg.norm(derivative - change) < 0.06 * np.linalg.norm(change)
        assert np.median(np.abs(derivative - change)) < 5e-3 * np.abs(change).max()


@pytest.mark.long
def test_forward_and_reverse_agree(model, parameters, camera):
    random = np.random.default_rng(0)
    weights = random.normal(size=(*SIZE[::-1], 3)).astype(np.float32)
    parts = traced(parameters, camera, model.colors, LIGHT, BLACK)
    way = jax.tree.map(lambda x: random.normal(size=x.shape).astype(np.float32), parts)
    still = jax.tree.map(np.zeros_like, parts)
    # One direction for vertices, camera, albedo and light each.
    for k in range(4):
        along = tuple(way[part] if part == k else still[part] for part in range(len(parts)))
        _, forward, gradient = head_motion(model, parts, along, weights)
        pairs = zip(jax.tree.leaves(gradient[k]), jax.tree.leaves(way[k]), strict=True)
        reverse = sum(float((a * b).sum()) for a, b in pairs)
        assert float((forward * weights).sum()) == pytest.approx(reverse, rel=2e-3, abs=1e-2)
        assert abs(reverse) > 0.0


@pytest.mark.long
def test_a_moving_head_changes_the_picture_as_differences_do(model, parameters, camera):
    """One small case of benchmarks/rendering_gradient.py, which has twenty scenes of 256 px."""
    start, *others = traced(parameters, camera, model.colors, LIGHT, WHITE)
    still, unweighed = jax.tree.map(np.zeros_like, others), np.zeros((*SIZE[::-1], 3), np.float32)
    ways = {"translation": np.float32([1.0, 0.5, 0.0]), "rotation": np.float32([0.006, 0.01, 0.0])}
    for name, direction in ways.items():
        way = jax.tree.map(np.zeros_like, start)._replace(**{name: direction})
        moved = [jax.tree.map(lambda value, d, s=s: value + np.float32(s) * d, start, way) for s in
                 (-1.0, 1.0, *((np.arange(12) + 0.5) / 6 - 1.0))]  # fmt: skip
        reference = 0.5 * (supersampled(model, moved[1], camera) - supersampled(model, moved[0], camera))
        along = [head_motion(model, (face, *others), (way, *still), unweighed)[1] for face in moved[2:]]
        derivative = np.mean(np.asarray(along), axis=0)
        cosine = (derivative * reference).sum() / (np.linalg.norm(derivative) * np.linalg.norm(reference))
        assert cosine > 0.97
        assert np.linalg.norm(derivative - reference) < 0.25 * np.linalg.norm(reference)


def test_new_values_compile_nothing(model, parameters, camera, rendering):
    programs = _render._cache_size()
    for k in range(3):
        face = parameters._replace(translation=np.float32([3.0 * k, 0.0, 500.0 + 60.0 * k]))
        view = camera._replace(focal_px=np.float32([170.0 + k, 170.0]), distortion=np.full(8, 0.01 * k, np.float32))
        head_picture(model, face, view, model.colors, LIGHT * (1.0 + k), [0.1 * k] * 3)
    assert _render._cache_size() == programs


def test_the_precision_of_the_arguments_does_not_matter(model, parameters, camera, rendering):
    programs = _render._cache_size()
    size = {"size": SIZE, "antialias": True}
    wide = [np.asarray(array, np.float64) for array in (face_vertices(model, parameters), model.colors, LIGHT)]
    view = type(camera)(*(np.asarray(part, np.float64) for part in camera))
    again = render(wide[0], model.topology, view, wide[1], wide[2], np.zeros((*SIZE[::-1], 3)), **size)
    assert _render._cache_size() == programs
    assert np.asarray(again.color) == pytest.approx(np.asarray(rendering.color), abs=1e-5)


def test_a_batch_is_its_pictures_one_by_one():
    low, high = np.array([-4.3, -2.2]), np.array([2.6, 3.1])
    scenes = [
        np.concatenate([quad(low + k, high + k, 10.0), quad((-7, -1.4), (7, 1.7), 20.0 - 15 * k)]) for k in (0, 1, 2)
    ]
    batch, _, _ = motions(np.stack(scenes), np.zeros((8, 3)))
    for vertices, picture in zip(scenes, np.asarray(batch), strict=True):
        assert picture[..., :3] == pytest.approx(np.asarray(flat(vertices).color), abs=1e-5)


def test_single_precision_goes_in_and_out(rendering):
    assert {str(array.dtype) for array in rendering} == {"float32", "int32"}
    assert int(rendering.lost_contours) == 0


# --- against VTK ---


def vtk_view(head, points_camera, camera, lighting):
    """Colours 0 to 1, coverage and depth (mm, infinite where nothing is) of a matte head drawn by VTK."""
    # Where there is no GL these cannot even be imported.
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkFloatArray

    from workbench.pictures.head_scene import HeadScene

    thread = RenderThread(lambda: HeadScene(head, SIZE, None, 1.0, False), lambda scene: scene.close())

    def draw(scene):
        for actor in scene.actors:
            actor.GetProperty().SetSpecular(0.0)
        rgba = scene.render(points_camera, camera, lighting) / 255.0
        stored = vtkFloatArray()
        scene.window.GetZbufferData(0, 0, SIZE[0] - 1, SIZE[1] - 1, stored)
        values = vtk_to_numpy(stored).reshape(SIZE[::-1])[::-1].astype(float)
        matrix = scene.camera.GetExplicitProjectionTransformMatrix()
        slope, offset = matrix.GetElement(2, 2), matrix.GetElement(2, 3)
        depth = np.where(values < 1.0, offset / (2.0 * values - 1.0 + slope), np.inf)
        return rgba[..., :3], rgba[..., 3] > 0.5, depth

    try:
        return thread.submit(draw).result(60)
    finally:
        thread.stop()


@needs_gl
def test_vtk_draws_the_same_head(head, model, parameters, camera):
    """Another program, another rasteriser: same silhouette, depth and colours, flat and shaded.

    VTK's light is the exact cosine; ours reproduces it within 0.1 at worst.
    """
    points = np.asarray(face_vertices(model, parameters), float)
    side = (-0.5, -0.6, -1.0)
    view = camera_from_fov(SIZE, 30.0)
    flat_color, there, depth = vtk_view(head, points, view, Lighting((), ambient=1.0))
    shaded_color = vtk_view(head, points, view, Lighting((Light(side, 0.7),), ambient=0.35))[0]
    ours = head_picture(model, parameters, camera, model.colors, AMBIENT, BLACK, antialias=False)
    here = np.asarray(ours.triangle) >= 0
    both = here & there
    assert both.sum() / (here | there).sum() > 0.998
    off = np.abs(np.asarray(ours.depth)[both] - depth[both])
    assert np.percentile(off, 95) < 0.01
    for light, expected, median, most in ((AMBIENT, flat_color, 0.003, 0.006), (LIGHT, shaded_color, 0.03, 0.06)):
        shown = np.asarray(head_picture(model, parameters, camera, model.colors, light, BLACK, antialias=False).color)
        difference = np.abs(shown[both] - expected[both]).max(axis=1)
        assert np.median(difference) < median
        assert np.percentile(difference, 95) < most
    # The normals alone, lit by the exact cosine as VTK does it.
    cosine = np.clip(np.asarray(ours.normals, float) @ side / np.linalg.norm(side), 0.0, None)
    lit = np.asarray(ours.color, float) * (0.35 + 0.7 * cosine[..., None])
    assert np.percentile(np.abs(lit - shaded_color)[both].max(axis=1), 95) < 0.006


# --- what it refuses ---


def test_meshes_that_cannot_be_drawn_are_refused():
    with pytest.raises(InputError, match="triangle"):
        mesh_topology(np.array([[0, 1, 5]]), 4)
    with pytest.raises(InputError, match="sides"):
        mesh_topology(np.array([[0, 1, 2]]), 3, np.array([4]))
    with pytest.raises(InputError, match="positive"):
        orthographic_camera((10, 10), 0.0)


def test_arrays_that_do_not_belong_together_are_refused():
    vertices = np.concatenate([quad((-4, -4), (4, 4), 10.0), ASIDE])
    with pytest.raises(InputError, match="8 vertices"):
        render(vertices[:5], mesh_topology(QUADS, 8), FLAT, RED_GREEN, AMBIENT, BLACK, size=(16, 12))
    with pytest.raises(InputError, match="Albedo"):
        flat(vertices, albedo=RED_GREEN[:3])
    with pytest.raises(InputError, match="texture"):
        flat(vertices, albedo=Texture(np.ones((2, 2, 3)), np.zeros((4, 2)), QUADS[:1]))
    with pytest.raises(InputError, match="background"):
        flat(vertices, background=np.zeros((16, 12, 3)))
    with pytest.raises(InputError, match="pixel"):
        flat(vertices, samples=0)


def test_the_lips_have_two_sides(head):
    sides = lip_sides(head)
    heights = head.neutral[head.triangles].mean(axis=1)[:, 1]
    assert (sides == 1).sum() > 100
    assert (sides == 2).sum() > 100
    # +y is down: the lower lip lies lower.
    assert heights[sides == 2].mean() > heights[sides == 1].mean() + 2.0
