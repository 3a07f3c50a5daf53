"""The differentiable renderer: what is seen, how it is lit, smooth contours, and derivatives of all of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from workbench.errors import InputError
from workbench.face import FaceParameters
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_fov, project
from workbench.pictures import HeadRenderer, Lighting, gl_available
from workbench.pictures.mesh import corner_sum
from workbench.pictures.mesh import vertex_normals as picture_normals
from workbench.rendering import (
    Texture,
    ambient_light,
    directional_light,
    face_vertices,
    mesh_topology,
    orthographic_camera,
    render,
    render_face,
    render_model,
    shading,
    spherical_harmonics,
)
from workbench.rendering.head import lip_sides

SIZE = (96, 80)
WHITE, BLACK = np.ones(3), np.zeros(3)
AMBIENT = ambient_light()
LIGHT = ambient_light(0.35) + directional_light((-0.5, -0.6, -1.0), 0.7)
FLAT = orthographic_camera((16, 12), 1.0)
"""One pixel per millimetre; the camera frame's origin between the middle pixels of a 16 × 12 picture."""


def square(low, high, depth, first=0):
    """Vertices and triangles of an axis-parallel rectangle that faces the camera; x to y in millimetres."""
    (x0, y0), (x1, y1) = low, high
    vertices = np.array([[x0, y0, depth], [x0, y1, depth], [x1, y1, depth], [x1, y0, depth]], float)
    return vertices, np.array([[0, 1, 2], [0, 2, 3]]) + first


def flat_picture(vertices, triangles, albedo, background=BLACK, **options):
    """Render in the flat camera under light from everywhere."""
    topology = mesh_topology(triangles, len(vertices))
    return render(vertices, topology, FLAT, albedo, AMBIENT, background, size=(16, 12), **options)


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
    return render_face(model, parameters, camera, model.colors, LIGHT, BLACK, size=SIZE)


# --- what is seen ---


def test_a_pixel_shows_what_is_at_its_centre():
    """x = -3.4..0.6 mm is 4.1..8.1 px, y = -2.4..2.6 mm is 3.1..8.1 px: the centres 5 to 8 and 4 to 8."""
    vertices, triangles = square((-3.4, -2.4), (0.6, 2.6), 10.0)
    seen = np.asarray(flat_picture(vertices, triangles, np.ones((4, 3)), antialias=False).triangle) >= 0
    assert np.flatnonzero(seen.any(axis=0)).tolist() == [5, 6, 7, 8]
    assert np.flatnonzero(seen.any(axis=1)).tolist() == [4, 5, 6, 7, 8]


def test_the_nearer_surface_is_seen_whatever_the_order():
    (near, first), (far, second) = square((-4, -4), (4, 4), 10.0), square((-6, -3), (6, 3), 20.0, first=4)
    vertices, triangles = np.concatenate([near, far]), np.concatenate([first, second])
    albedo = np.repeat([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 4, axis=0)
    for order in (triangles, triangles[::-1]):
        color = np.asarray(flat_picture(vertices, order, albedo).color)
        assert color[6, 8] == pytest.approx([1, 0, 0], abs=1e-5)
        assert color[6, 2] == pytest.approx([0, 1, 0], abs=1e-5)
        assert color[0, 0] == pytest.approx([0, 0, 0], abs=1e-5)


def test_a_triangle_larger_than_the_picture_fills_it():
    vertices = np.array([[-4000.0, -4000.0, 10.0], [0.0, 8000.0, 10.0], [4000.0, -4000.0, 10.0]])
    rendering = flat_picture(vertices, np.array([[0, 1, 2]]), np.ones((3, 3)))
    assert (np.asarray(rendering.triangle) == 0).all()
    assert np.asarray(rendering.coverage) == pytest.approx(np.ones((12, 16)))


def test_shared_edges_leave_no_gap_and_no_seam(model, parameters):
    """A close-up of the cheek, triangles many pixels wide: every pixel is covered."""
    camera = Camera(np.full(2, 3000.0), np.array([100.0, 100.0]), np.zeros(8))
    rendering = render_face(model, parameters, camera, model.colors, AMBIENT, WHITE, size=(200, 200))
    assert (np.asarray(rendering.triangle) >= 0).all()
    assert np.asarray(rendering.coverage) == pytest.approx(np.ones((200, 200)), abs=1e-5)


def test_backs_are_not_seen_unless_asked_for():
    vertices, triangles = square((-4, -4), (4, 4), 10.0)
    turned = triangles[:, ::-1]
    assert (np.asarray(flat_picture(vertices, turned, np.ones((4, 3))).triangle) == -1).all()
    assert (np.asarray(flat_picture(vertices, turned, np.ones((4, 3)), cull_backfaces=False).triangle) >= 0).any()


def test_what_lies_behind_the_camera_or_is_not_a_number_is_left_out(model, parameters, camera):
    behind = parameters._replace(translation=np.float32([0.0, 0.0, -500.0]))
    for place in (behind, parameters._replace(translation=np.float32([np.nan, 0.0, 500.0]))):
        rendering = render_face(model, place, camera, model.colors, LIGHT, np.float32([0.2, 0.3, 0.4]), size=SIZE)
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


def test_lens_distortion_moves_the_head_as_opencv_does(model, parameters, camera):
    lens = camera._replace(distortion=np.float32([-0.3, 0.1, 0.01, -0.02, 0, 0, 0, 0]))
    rendering = render_face(model, parameters, lens, model.colors, LIGHT, BLACK, size=SIZE, antialias=False)
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
    vertices, triangles = square((-3.2, -2.7), (2.6, 1.9), 10.0)
    coverage = np.asarray(flat_picture(vertices, triangles, np.ones((4, 3))).coverage)
    assert coverage.sum() == pytest.approx(5.8 * 4.6, abs=0.5)
    assert coverage[5, [4, 10]] == pytest.approx([0.2, 0.6], abs=1e-3)
    assert coverage[[3, 7], 7] == pytest.approx([0.7, 0.9], abs=1e-3)


def test_smooth_pictures_come_close_to_supersampled_ones(model, parameters, camera):
    def at(offset):
        shifted = camera._replace(principal_point_px=camera.principal_point_px - np.float32(offset))
        args = (model, parameters, shifted, model.colors, LIGHT, WHITE)
        return np.asarray(render_face(*args, size=SIZE, antialias=False).color)

    grid = (np.arange(6) + 0.5) / 6 - 0.5
    truth = np.mean([at((x, y)) for x in grid for y in grid], axis=0)
    args = (model, parameters, camera, model.colors, LIGHT, WHITE)
    rough, smooth, smoother = (
        np.abs(np.asarray(render_face(*args, size=SIZE, **options).color) - truth).mean()
        for options in ({"antialias": False}, {}, {"samples": 2})
    )
    assert smooth < 0.5 * rough
    assert smoother < 0.75 * smooth


def test_a_moving_border_changes_coverage_by_its_length():
    """Widening a 6 mm high rectangle to the right uncovers 6 pixels per pixel of motion, wherever the border lies."""
    vertices, triangles = square((-4, -3), (2.3, 3), 10.0)
    way = np.zeros((4, 3))
    way[2:, 0] = 1.0
    topology = mesh_topology(triangles, 4)

    def covered(shift):
        points = vertices + shift * way
        return render(points, topology, FLAT, np.ones((4, 3)), AMBIENT, BLACK, size=(16, 12)).coverage.sum()

    for shift in (0.0, 0.41, 1.3):
        assert jax.jvp(covered, (shift,), (1.0,))[1] == pytest.approx(6.0, abs=1e-3)
        assert jax.grad(covered)(shift) == pytest.approx(6.0, abs=1e-3)


def test_a_slanted_border_moves_by_the_exact_share():
    """Coverage of every pixel along a slanted border against central differences of a fine grid of points."""
    vertices = np.array([[-5.0, -4.0, 10.0], [-3.0, 5.0, 10.0], [6.0, 1.0, 10.0]])
    topology = mesh_topology(np.array([[0, 1, 2]]), 3)

    def at(shift, offset=(0.0, 0.0), **options):
        moved = vertices + shift * jnp.array([0.8, 0.6, 0.0])
        camera = FLAT._replace(principal_point_px=jnp.asarray(FLAT.principal_point_px) - jnp.asarray(offset))
        return render(moved, topology, camera, np.ones((3, 3)), AMBIENT, BLACK, size=(16, 12), **options).coverage

    grid = (np.arange(24) + 0.5) / 24 - 0.5
    step = 0.05
    fine = jax.jit(lambda shift: jnp.mean(
        jax.lax.map(lambda o: at(shift, o, antialias=False), jnp.array([(x, y) for x in grid for y in grid])), axis=0
    ))  # fmt: skip
    reference = (np.asarray(fine(step)) - np.asarray(fine(-step))) / (2 * step)
    derivative = np.asarray(jax.jit(lambda s: jax.jvp(at, (s,), (1.0,))[1])(0.0))
    assert (derivative * reference).sum() > 0.995 * np.linalg.norm(derivative) * np.linalg.norm(reference)
    assert np.linalg.norm(derivative - reference) < 0.08 * np.linalg.norm(reference)


def test_an_inner_border_blends_what_is_in_front_and_behind():
    (near, first), (far, second) = square((-4, -4), (0.3, 4), 10.0), square((-7, -5), (7, 5), 20.0, 4)
    vertices, triangles = np.concatenate([near, far]), np.concatenate([first, second])
    albedo = np.repeat([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 4, axis=0)
    color = np.asarray(flat_picture(vertices, triangles, albedo, WHITE).color)
    assert color[6, 8] == pytest.approx([0.3, 0.7, 0.0], abs=1e-3)


def test_a_hidden_border_changes_nothing():
    (near, first), (far, second) = square((-6, -5), (6, 5), 10.0), square((-2, -2), (1.3, 2), 20.0, 4)
    topology = mesh_topology(np.concatenate([first, second]), 8)
    way = np.zeros((8, 3))
    way[4:, 0] = 1.0

    def picture(shift):
        points = np.concatenate([near, far]) + shift * way
        return render(points, topology, FLAT, np.ones((8, 3)), AMBIENT, BLACK, size=(16, 12)).color

    assert jax.jvp(picture, (0.0,), (1.0,))[1] == pytest.approx(np.zeros((12, 16, 3)))


def test_parts_that_pass_through_each_other_have_a_moving_border():
    """A red plane that tilts through a green one meets it at x = 0.3; lifted by 1 mm at slope 1 the line moves 1 px."""
    flat, first = square((-6, -5), (6, 5), 20.0)
    tilted, second = square((-6, -4), (6, 4), 20.0, 4)
    tilted[:, 2] += tilted[:, 0] - 0.3
    topology = mesh_topology(np.concatenate([first, second]), 8)
    albedo = np.repeat([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], 4, axis=0)
    way = np.zeros((8, 3))
    way[4:, 2] = 1.0

    def picture(shift):
        points = np.concatenate([flat, tilted]) + shift * way
        return render(points, topology, FLAT, albedo, AMBIENT, BLACK, size=(16, 12)).color

    color, derivative = jax.jvp(picture, (0.0,), (1.0,))
    assert color[6, 8] == pytest.approx([0.3, 0.7, 0.0], abs=0.02)
    assert derivative[6, 8] == pytest.approx([-1.0, 1.0, 0.0], abs=0.05)


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
    assert np.abs(shown - np.clip(-directions[:, 2], 0.0, None)).max() < 0.07


def test_a_light_needs_a_direction():
    with pytest.raises(InputError, match="direction"):
        directional_light((0.0, 0.0, 0.0))


def test_a_picture_is_linear_in_light_albedo_and_background(model, parameters, camera):
    def color(albedo, light, background):
        return np.asarray(render_face(model, parameters, camera, albedo, light, background, size=SIZE).color)

    albedo, half = model.colors, 0.5 * model.colors
    full = color(albedo, LIGHT, BLACK)
    assert color(half, LIGHT, BLACK) == pytest.approx(0.5 * full, abs=1e-5)
    assert color(albedo, 0.5 * LIGHT, BLACK) == pytest.approx(0.5 * full, abs=1e-5)
    behind = np.random.default_rng(0).uniform(size=(*SIZE[::-1], 3)).astype(np.float32)
    backdrop = color(albedo, LIGHT, behind) - full
    seen = np.asarray(render_face(model, parameters, camera, albedo, LIGHT, BLACK, size=SIZE).coverage)
    assert backdrop == pytest.approx((1.0 - seen[..., None]) * behind, abs=1e-4)


def test_a_texture_is_seen_the_right_way_up():
    """v points up in the OBJ convention: the picture's first row belongs to v = 1."""
    vertices, triangles = square((-4, -4), (4, 4), 10.0)
    texels = np.zeros((2, 2, 3))
    texels[0, :, 0], texels[1, :, 1] = 1.0, 1.0
    uv = np.stack([(vertices[:, 0] + 4) / 8, 1.0 - (vertices[:, 1] + 4) / 8], axis=1)
    color = np.asarray(flat_picture(vertices, triangles, Texture(texels, uv, triangles)).color)
    assert color[2, 8] == pytest.approx([1, 0, 0], abs=0.1)
    assert color[9, 8] == pytest.approx([0, 1, 0], abs=0.1)


# --- derivatives ---


def test_forward_and_reverse_agree(model, parameters, camera):
    random = np.random.default_rng(0)
    weights = jnp.asarray(random.normal(size=(*SIZE[::-1], 3)), jnp.float32)

    def score(parts):
        face, view, albedo, light = parts
        return (render_face(model, face, view, albedo, light, BLACK, size=SIZE).color * weights).sum()

    parts = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), (parameters, camera, model.colors, LIGHT))
    gradient = jax.jit(jax.grad(score))(parts)
    way = jax.tree.map(lambda x: jnp.asarray(random.normal(size=x.shape), jnp.float32), parts)
    forward = jax.jit(lambda parts, way: jax.jvp(score, (parts,), (way,))[1])
    for k in range(4):
        only = tuple(jax.tree.map(lambda x, keep=(j == k): x * keep, part) for j, part in enumerate(way))
        along = sum(float((a * b).sum()) for a, b in zip(jax.tree.leaves(gradient), jax.tree.leaves(only), strict=True))
        assert float(forward(parts, only)) == pytest.approx(along, rel=2e-3, abs=1e-2)
        assert abs(along) > 0.0


def test_a_moving_head_changes_the_picture_as_differences_do(model, parameters, camera):
    """One small case of benchmarks/rendering_gradient.py, which has twenty scenes of 256 px."""
    grid = (np.arange(6) + 0.5) / 6 - 0.5
    offsets = jnp.asarray([(x, y) for x in grid for y in grid], jnp.float32)

    def picture(face, view, **options):
        return render_face(model, face, view, model.colors, LIGHT, WHITE, size=SIZE, **options).color

    @jax.jit
    def supersampled(face):
        def at(offset):
            return picture(
                face, camera._replace(principal_point_px=camera.principal_point_px - offset), antialias=False
            )

        return jax.lax.map(at, offsets).mean(axis=0)

    along = jax.jit(lambda face, way: jax.jvp(lambda f: picture(f, camera, samples=2), (face,), (way,))[1])
    ways = {"translation": np.float32([1.0, 0.5, 0.0]), "rotation": np.float32([0.006, 0.01, 0.0])}
    for name, direction in ways.items():
        way = jax.tree.map(np.zeros_like, parameters)._replace(**{name: direction})
        moved = [jax.tree.map(lambda value, d, s=s: value + np.float32(s) * d, parameters, way) for s in
                 (-1.0, 1.0, *((np.arange(12) + 0.5) / 6 - 1.0))]  # fmt: skip
        reference = 0.5 * (np.asarray(supersampled(moved[1])) - np.asarray(supersampled(moved[0])))
        derivative = np.mean([np.asarray(along(face, way)) for face in moved[2:]], axis=0)
        cosine = (derivative * reference).sum() / (np.linalg.norm(derivative) * np.linalg.norm(reference))
        assert cosine > 0.97
        assert np.linalg.norm(derivative - reference) < 0.25 * np.linalg.norm(reference)


def test_new_values_compile_nothing(model, parameters, camera):
    def run(face, view, light, background):
        return render_face(model, face, view, model.colors, light, background, size=SIZE).color

    compiled = jax.jit(run)
    for k in range(3):
        face = parameters._replace(translation=np.float32([3.0 * k, 0.0, 500.0 + 60.0 * k]))
        view = camera._replace(focal_px=np.float32([170.0 + k, 170.0]), distortion=np.full(8, 0.01 * k, np.float32))
        compiled(face, view, np.float32(LIGHT * (1.0 + k)), np.float32([0.1 * k] * 3))
    assert compiled._cache_size() == 1


def test_a_batch_is_its_pictures_one_by_one(model, parameters, camera):
    moves = np.float32([[0.0, 0.0, 540.0], [10.0, 0.0, 500.0]])

    def color(translation):
        face = parameters._replace(translation=translation)
        return render_face(model, face, camera, model.colors, LIGHT, BLACK, size=(48, 40)).color

    batch = jax.jit(jax.vmap(color))(moves)
    for k in range(2):
        assert np.asarray(batch[k]) == pytest.approx(np.asarray(color(moves[k])), abs=1e-5)


def test_single_precision_goes_in_and_out(rendering):
    assert {str(array.dtype) for array in rendering} == {"float32", "int32"}
    assert int(rendering.lost_contours) == 0


# --- against VTK ---


@pytest.mark.skipif(not gl_available(), reason="VTK has no usable GL here")
def test_vtk_draws_the_same_head(head, model, parameters, camera):
    """Another program, another rasteriser: same silhouette, and the same flat colours away from edges."""
    size = (200, 160)
    view = camera_from_fov(size, 30.0)
    matrix = np.asarray(parameters.rotation, float), np.asarray(parameters.translation, float)
    vertices = head.vertices(np.asarray(parameters.expression, float))
    with HeadRenderer(head, size, texture=False, supersampling=1.0) as vtk:
        picture, mask = vtk.render_with_mask(
            vertices, view, *matrix, background=(0, 0, 0), lighting=Lighting(lights=(), ambient=1.0)
        )
    ours = render_face(
        model, parameters, view, model.colors, AMBIENT, BLACK, size=size, antialias=False
    )  # fmt: skip
    here, there = np.asarray(ours.triangle) >= 0, mask > 127
    assert (here & there).sum() / (here | there).sum() > 0.99
    difference = np.abs(np.asarray(ours.color)[here & there] - picture[here & there] / 255.0).max(axis=1)
    assert np.median(difference) < 0.01
    assert np.percentile(difference, 95) < 0.05


# --- what it refuses ---


def test_meshes_that_cannot_be_drawn_are_refused():
    with pytest.raises(InputError, match="triangle"):
        mesh_topology(np.array([[0, 1, 5]]), 4)
    with pytest.raises(InputError, match="sides"):
        mesh_topology(np.array([[0, 1, 2]]), 3, np.array([4]))
    with pytest.raises(InputError, match="positive"):
        orthographic_camera((10, 10), 0.0)


def test_the_lips_have_two_sides(head):
    sides = lip_sides(head)
    heights = head.neutral[head.triangles].mean(axis=1)[:, 1]
    assert (sides == 1).sum() > 100
    assert (sides == 2).sum() > 100
    # +y is down: the lower lip lies lower.
    assert heights[sides == 2].mean() > heights[sides == 1].mean() + 5.0
