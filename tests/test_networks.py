"""N of Deep Energies by its pieces: crop and resize, soft-argmax, the way back, and the derivative of all together."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from workbench.errors import InputError
from workbench.networks import (
    CropBox,
    crop_and_resize,
    crop_box,
    fan_box,
    fan_box_from_landmarks,
    landmarks_of,
    patch_mass,
    place_and_mass,
    reduction_for,
    soft_argmax,
    to_crop,
    to_picture,
    within_picture,
)

RNG = np.random.default_rng(7)


def bump(x: float, y: float, side: int = 64, height: float = 1.0, width: float = 1.5) -> np.ndarray:
    """A heat map with a Gaussian at (x, y)."""
    rows, columns = np.mgrid[:side, :side]
    return height * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * width**2))


def eq_3(heat_map: np.ndarray, beta: float) -> np.ndarray:
    """Deep Energies Eq. 3, read aloud."""
    row, column = np.unravel_index(np.argmax(heat_map), heat_map.shape)
    above, below = np.zeros(2), 0.0
    for y, x in itertools.product((row - 1, row, row + 1), (column - 1, column, column + 1)):
        if 0 <= y < heat_map.shape[0] and 0 <= x < heat_map.shape[1]:
            weight = np.exp(beta * (heat_map[y, x] - heat_map.max()))
            above, below = above + weight * np.array([x, y]), below + weight
    return above / below


def central_difference(function, at, along, step=1e-6):
    return (function(at + step * along) - function(at - step * along)) / (2 * step)


# --- soft-argmax --------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), beta=st.floats(0.1, 200), height=st.integers(2, 9), width=st.integers(2, 9))
def test_soft_argmax_is_eq_3_on_any_map(seed, beta, height, width):
    maps = np.random.default_rng(seed).uniform(size=(3, height, width))
    expected = [eq_3(one, beta) for one in maps]
    np.testing.assert_allclose(soft_argmax(jnp.asarray(maps), beta), expected, atol=1e-9)


@pytest.mark.parametrize(("row", "column"), [(0, 0), (0, 9), (9, 0), (9, 9), (0, 4), (9, 4), (4, 0), (4, 9)])
def test_at_the_border_the_patch_is_what_lies_inside_the_map(row, column):
    heat_map = 0.01 * RNG.uniform(size=(10, 10))
    heat_map[row, column] = 0.05
    np.testing.assert_allclose(soft_argmax(heat_map[None])[0], eq_3(heat_map, 50.0), atol=1e-12)


@given(x=st.floats(1.0, 61.99), y=st.floats(1.0, 61.99))
def test_a_log_probability_map_gives_its_mean_place_between_pixels(x, y):
    """β·H = log p, with p shared bilinearly among the four pixels around a place: m̂ is that place."""
    rows, columns = np.mgrid[:64, :64]
    probability = np.clip(1 - abs(columns - x), 0, 1) * np.clip(1 - abs(rows - y), 0, 1)
    np.testing.assert_allclose(soft_argmax(np.log(probability + 1e-30)[None] / 50)[0], [x, y], atol=1e-9)


@pytest.mark.parametrize(("deviation", "largest"), [(0.35, 0.14), (0.5, 0.03), (0.8, 0.145), (1.0, 0.235)])
def test_how_well_places_between_pixels_are_told_depends_on_the_width(deviation, largest):
    places = 30 + np.linspace(0, 0.49, 15)
    rows, columns = np.mgrid[:64, :64]
    log_density = np.stack([-((columns - x) ** 2 + (rows - 30) ** 2) / (2 * deviation**2) for x in places])
    error = np.abs(np.asarray(soft_argmax(log_density / 50))[:, 0] - places).max()
    assert 0.8 * largest < error <= largest


def test_of_bumps_of_height_1_a_beta_near_4_deviations_squared_tells_the_most():
    places = 30 + np.linspace(-0.49, 0.49, 15)
    maps = np.stack([bump(x, 30, width=1.75) for x in places])
    betas = (3.0, 4 * 1.75**2, 50.0)
    worst = {beta: np.abs(np.asarray(soft_argmax(maps, beta))[:, 0] - places).max() for beta in betas}
    assert min(worst, key=worst.get) == 4 * 1.75**2
    assert worst[4 * 1.75**2] < 0.06
    assert worst[50.0] > 0.2  # the paper's, on a map like this


def test_of_equal_maxima_the_first_in_reading_order_counts():
    heat_map = np.zeros((8, 8))
    heat_map[2, 6] = heat_map[5, 1] = 1.0
    np.testing.assert_allclose(soft_argmax(heat_map[None])[0], [6, 2], atol=1e-12)


def test_huge_heat_values_neither_overflow_nor_lose_the_place():
    maps = np.stack([bump(20.3, 40.8, height=1e4), bump(20.3, 40.8) - 1e4]).astype(np.float32)
    points = soft_argmax(maps)
    assert points.dtype == jnp.float32
    np.testing.assert_allclose(points[0], [20, 41], atol=1e-4)
    assert np.isfinite(points).all()


@pytest.mark.parametrize("place", [(20.3, 40.8), (0.2, 0.1), (63.0, 31.0)], ids=["inside", "corner", "border"])
def test_soft_argmax_agrees_with_differences_in_both_modes(place):
    maps = np.stack([bump(*place, height=0.1) + 0.001 * RNG.uniform(size=(64, 64)) for _ in range(2)])
    along, back = RNG.normal(size=maps.shape), RNG.normal(size=(2, 2))
    expected = central_difference(soft_argmax, maps, along)
    forward = jax.jvp(soft_argmax, (maps,), (along,))[1]
    np.testing.assert_allclose(forward, expected, rtol=1e-6, atol=1e-7)
    reverse = jax.vjp(soft_argmax, jnp.asarray(maps))[1](jnp.asarray(back))[0]
    np.testing.assert_allclose((reverse * along).sum(), (back * expected).sum(), rtol=1e-6)


def test_only_the_patch_has_a_derivative():
    slope = jax.grad(lambda maps: soft_argmax(maps).sum())(jnp.asarray(bump(20.0, 40.0, height=0.1))[None])[0]
    touched = np.argwhere(np.asarray(slope) != 0)
    assert touched.min(axis=0).tolist() == [39, 19]
    assert touched.max(axis=0).tolist() == [41, 21]


def test_beta_is_traced_and_has_a_derivative_even_at_the_border():
    traces = []

    @jax.jit
    def points(maps, beta):
        traces.append(1)
        return soft_argmax(maps, beta)

    maps = jnp.asarray(bump(0.2, 30.4, height=0.1))[None]
    assert not np.allclose(points(maps, 10.0), points(maps, 50.0))
    assert len(traces) == 1
    expected = central_difference(lambda beta: soft_argmax(maps, beta), 50.0, 1.0, 1e-4)
    np.testing.assert_allclose(jax.jacfwd(lambda beta: soft_argmax(maps, beta))(50.0), expected, atol=1e-8)


def test_soft_argmax_and_mass_work_under_vmap():
    maps = jnp.asarray(RNG.uniform(size=(4, 3, 8, 8)))
    for read in (soft_argmax, patch_mass):
        # XLA adds the terms of a batch in another order: the last bit may differ.
        np.testing.assert_allclose(jax.vmap(read)(maps), np.stack([read(one) for one in maps]), rtol=1e-15, atol=1e-15)


def test_numpy_and_jax_read_maps_alike():
    maps = RNG.uniform(-0.2, 0.2, (68, 64, 64)).astype(np.float32)
    maps[::2] += np.stack([bump(*RNG.uniform(-1, 64, 2)) for _ in range(34)])  # at the border too
    for by_numpy, by_jax in zip(place_and_mass(maps), place_and_mass(jnp.asarray(maps)), strict=True):
        assert isinstance(by_numpy, np.ndarray)
        assert isinstance(by_jax, jax.Array)
        np.testing.assert_allclose(by_numpy, by_jax, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("kind", [np.asarray, jnp.asarray])
def test_place_and_mass_are_what_each_is_alone(kind):
    maps = kind(RNG.uniform(size=(5, 9, 12)))
    for together, alone in zip(place_and_mass(maps), (soft_argmax(maps), patch_mass(maps)), strict=True):
        np.testing.assert_array_equal(together, alone)


def test_patch_mass_is_the_softmax_probability_of_the_patch():
    maps = 0.1 * RNG.uniform(size=(5, 12, 12))
    for heat_map, mass in zip(maps, patch_mass(maps), strict=True):
        probability = np.exp(50 * heat_map) / np.exp(50 * heat_map).sum()
        row, column = np.unravel_index(np.argmax(heat_map), heat_map.shape)
        patch = probability[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        np.testing.assert_allclose(mass, patch.sum(), rtol=1e-9)


def test_patch_mass_tells_a_sharp_map_from_a_flat_one():
    flat, sharp = patch_mass(np.stack([np.zeros((64, 64)), bump(20, 30)]))
    assert flat == pytest.approx(4 / 64**2)  # the first of equal maxima is the corner pixel
    assert sharp > 0.999


# --- crop and resize ----------------------------------------------------------------------------------------------


def ramp(height: int, width: int) -> np.ndarray:
    """A picture whose channels tell x, y and a constant: bilinear interpolation is exact on it."""
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    return np.stack([columns, rows, np.full((height, width), 0.5)], axis=-1)


boxes = st.builds(
    lambda x, y, side, roll: CropBox(jnp.array([x, y]), jnp.asarray(side), jnp.asarray(roll)),
    *(st.floats(40, 80), st.floats(30, 60), st.floats(8, 30), st.floats(-1.5, 1.5)),
)


@given(box=boxes)
def test_a_crop_shows_the_picture_where_to_picture_says(box):
    crop = np.asarray(crop_and_resize(ramp(90, 120), box, 16))
    for x, y in [(0, 0), (15, 0), (0, 15), (7, 9)]:
        expected = to_picture(np.array([[float(x), float(y)]]), box, 16)[0]
        np.testing.assert_allclose(crop[:2, y, x], expected, atol=1e-9)


@given(box=boxes, side=st.sampled_from([16, 64, 256]))
def test_to_crop_undoes_to_picture(box, side):
    points = np.random.default_rng(0).uniform(-10, side + 10, (5, 2))
    np.testing.assert_allclose(to_crop(to_picture(points, box, side), box, side), points, atol=1e-9)


def test_a_box_on_pixel_edges_at_equal_size_copies_the_pixels():
    picture = RNG.uniform(size=(20, 30, 3))
    crop = crop_and_resize(picture, crop_box((4.5, 2.5, 12.5, 10.5)), 8)
    np.testing.assert_allclose(crop, picture[3:11, 5:13].transpose(2, 0, 1), atol=1e-12)


def test_pixels_between_are_bilinear_as_in_scipy():
    picture = RNG.uniform(size=(40, 50, 3))
    box = crop_box((8.2, 6.7, 30.9, 29.4), roll=0.3)
    rows, columns = np.mgrid[:32, :32]
    places = np.asarray(to_picture(np.stack([columns.ravel(), rows.ravel()], axis=1).astype(float), box, 32))
    expected = [map_coordinates(picture[..., c], places.T[::-1], order=1).reshape(32, 32) for c in range(3)]
    np.testing.assert_allclose(crop_and_resize(picture, box, 32), expected, atol=1e-9)


def test_a_roll_turns_the_crops_upright_clockwise():
    box = crop_box((10.0, 10.0, 30.0, 30.0), roll=np.pi / 2)
    top_of_the_crop = to_picture(np.array([[31.5, -0.5]]), box, 64)[0]
    np.testing.assert_allclose(top_of_the_crop, [30, 20], atol=1e-9)  # the picture's right


def test_beyond_the_picture_the_crop_is_black():
    crop = np.asarray(crop_and_resize(np.ones((10, 10, 3)), crop_box((-10.5, -10.5, 9.5, 9.5)), 20))
    np.testing.assert_array_equal(crop[:, :10, :], 0)
    np.testing.assert_array_equal(crop[:, :, :10], 0)
    np.testing.assert_allclose(crop[:, 10:, 10:], 1, atol=1e-12)


@given(centre=st.tuples(st.floats(-10, 40), st.floats(-10, 30)), side=st.floats(4, 60), roll=st.floats(-np.pi, np.pi))
def test_how_much_of_a_crop_lies_in_the_picture_is_the_crop_of_a_white_one(centre, side, roll):
    box = CropBox(np.array(centre), np.float64(side), np.float64(roll))
    expected = crop_and_resize(np.ones((20, 30, 1)), box, 16)[0]
    np.testing.assert_allclose(within_picture(box, np.array([30.0, 20.0]), 16), expected, atol=1e-9)


def test_a_box_far_outside_is_all_black_and_harmless():
    crop = crop_and_resize(np.ones((10, 10, 3)), crop_box((1e7, -3e7, 1.1e7, -2.9e7)), 16)
    assert float(abs(crop).max()) == 0


@pytest.mark.parametrize("reduction", [1, 3])
def test_the_crops_derivative_agrees_with_differences_in_both_modes(reduction):
    picture, along = RNG.uniform(size=(31, 44, 3)), RNG.normal(size=(31, 44, 3))
    box = crop_box((-4.3, 3.1, 26.0, 33.4), roll=-0.2)

    def crop(picture):
        return crop_and_resize(picture, box, 12, reduction)

    value, forward = jax.jvp(crop, (picture,), (along,))
    np.testing.assert_allclose(forward, crop(along), atol=1e-12)  # linear in the picture
    back = RNG.normal(size=value.shape)
    reverse = jax.vjp(crop, jnp.asarray(picture))[1](jnp.asarray(back))[0]
    np.testing.assert_allclose((reverse * along).sum(), (back * forward).sum(), rtol=1e-9)


def area_means(picture: np.ndarray, box: CropBox, side: int) -> np.ndarray:
    """What an ideal reduction shows: the mean over each crop pixel's area."""
    fine = np.asarray(crop_and_resize(picture, box, 16 * side))
    return fine.reshape(3, side, 16, side, 16).mean(axis=(2, 4))


@pytest.mark.parametrize("pixels_per_sample", [3.0, 4.4, 6.0])
def test_reducing_first_keeps_a_strong_minification_from_aliasing(pixels_per_sample):
    picture = RNG.uniform(size=(200, 200, 3))
    box = crop_box((3.2, 4.9, 3.2 + 32 * pixels_per_sample, 4.9 + 32 * pixels_per_sample))
    ideal, reduction = area_means(picture, box, 32), reduction_for(box, 32)

    def distance(reduction):
        return float(np.sqrt(((np.asarray(crop_and_resize(picture, box, 32, reduction)) - ideal) ** 2).mean()))

    assert distance(reduction) < 0.5 * distance(1)


def test_with_the_right_reduction_no_pixel_of_the_box_is_skipped():
    box = crop_box((9.5, 9.5, 89.5, 89.5))

    def unseen(reduction):
        slope = jax.grad(lambda picture: crop_and_resize(picture, box, 16, reduction).sum())(jnp.ones((100, 100, 3)))
        return int((slope[12:88, 12:88] == 0).sum())

    assert reduction_for(box, 16) == 3
    assert unseen(reduction_for(box, 16)) == 0
    assert unseen(1) > 0


def test_reduction_keeps_the_crop_in_place():
    picture = ramp(90, 120)  # a ramp stays a ramp under block means
    box = crop_box((20.0, 15.0, 80.0, 75.0))
    np.testing.assert_allclose(crop_and_resize(picture, box, 16, 2), crop_and_resize(picture, box, 16), atol=1e-9)


def test_reduction_counts_what_the_picture_lacks_to_whole_blocks_as_black():
    crop = np.asarray(crop_and_resize(np.ones((9, 9, 1)), crop_box((-0.5, -0.5, 9.5, 9.5)), 5, 2))
    np.testing.assert_allclose(crop[0, :4, :4], 1, atol=1e-12)
    np.testing.assert_allclose(crop[0, 4, 4], 0.25, atol=1e-12)


@pytest.mark.parametrize(("side", "reduction"), [(100, 1), (500, 1), (512, 2), (1000, 2), (1024, 3), (2048, 5)])
def test_the_reduction_follows_from_the_pixels_per_sample(side, reduction):
    assert reduction_for(crop_box((0.0, 0.0, side, side))) == reduction


def test_another_box_compiles_nothing():
    traces = []

    @jax.jit
    def crop(picture, box):
        traces.append(1)
        return crop_and_resize(picture, box, 8)

    picture = jnp.asarray(RNG.uniform(size=(20, 20, 3)))
    crop(picture, crop_box((1, 2, 9, 10)))
    crop(picture, crop_box((1.5, 2.5, 11.0, 10.0), roll=0.4))
    crop(picture, fan_box((1, 2, 9, 10)))
    assert len(traces) == 1


# --- boxes --------------------------------------------------------------------------------------------------------


def test_a_crop_box_is_the_square_about_a_face_box():
    box = crop_box((10, 20, 30, 60))
    assert (*np.asarray(box.centre), float(box.side), float(box.roll)) == (20, 40, 30, 0)


def test_fan_box_is_the_crop_of_the_face_alignment_package():
    # center[1] -= 0.12 · height; scale = (width + height) / 195; the crop shows 200 · scale pixels.
    box = fan_box((100, 50, 200, 170))
    assert np.asarray(box.centre).tolist() == pytest.approx([150, 110 - 0.12 * 120])
    assert float(box.side) == pytest.approx(200 * (100 + 120) / 195)


def test_fan_box_rises_along_the_heads_roll():
    upright, rolled = fan_box((100, 50, 200, 170)), fan_box((100, 50, 200, 170), roll=np.pi / 2)
    rise = 110 - float(upright.centre[1])
    assert np.asarray(rolled.centre).tolist() == pytest.approx([150 + rise, 110])


def test_a_fan_box_from_landmarks_is_that_of_their_bounding_box():
    points = RNG.uniform(10, 200, (68, 2))
    box, expected = fan_box_from_landmarks(points), fan_box((*points.min(axis=0), *points.max(axis=0)))
    np.testing.assert_allclose(np.hstack(box), np.hstack(expected))


@given(roll=st.floats(-1.5, 1.5))
def test_a_fan_box_from_landmarks_turns_with_the_face(roll):
    points = np.random.default_rng(1).uniform(-50, 50, (68, 2))
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    upright, turned = fan_box_from_landmarks(points), fan_box_from_landmarks(points @ turn.T, roll)
    np.testing.assert_allclose(turned.centre, turn @ np.asarray(upright.centre), atol=1e-9)
    np.testing.assert_allclose(turned.side, upright.side)


@pytest.mark.parametrize("edges", [(5, 5, 5, 9), (5, 9, 8, 6), (0, 0, float("nan"), 5), (0, 0, float("inf"), 5)])
@pytest.mark.parametrize("make", [crop_box, fan_box])
def test_an_empty_box_is_refused(make, edges):
    with pytest.raises(InputError, match="right > left and bottom > top"):
        make(edges)


def test_a_roll_that_is_no_angle_is_refused():
    with pytest.raises(InputError, match="angle in radians, got nan"):
        crop_box((0, 0, 5, 5), roll=float("nan"))


def test_landmarks_that_span_no_box_are_refused():
    with pytest.raises(InputError, match="right > left"):
        fan_box_from_landmarks(np.ones((68, 2)))


# --- the whole chain ----------------------------------------------------------------------------------------------


def blob_network(crop):
    """A network without weights: heat maps of how alike each 4×4 block's colour is to three given ones."""
    blocks = crop.reshape(3, crop.shape[1] // 4, 4, crop.shape[2] // 4, 4).mean(axis=(2, 4))
    return -((blocks[None] - jnp.eye(3)[:, :, None, None]) ** 2).sum(axis=1)


def picture_with_dots(centres: np.ndarray, size: tuple[int, int] = (150, 200)) -> np.ndarray:
    """A red, a green and a blue dot on black, at these places."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    return np.stack([np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 4.0**2)) for x, y in centres], axis=-1)


CENTRES = np.array([[80.3, 60.2], [112.9, 71.6], [97.1, 100.4]])


@pytest.mark.parametrize("roll", [0.0, 0.5])
@pytest.mark.parametrize("half", [60.0, 75.5])
def test_the_chain_finds_dots_in_the_pictures_pixels_whatever_the_box(half, roll):
    box = crop_box((100 - half, 80 - half, 100 + half, 80 + half), roll)
    found = landmarks_of(blob_network, picture_with_dots(CENTRES), box)
    assert found.heat_maps.shape == (3, 64, 64)
    np.testing.assert_allclose(found.points, CENTRES, atol=0.25)  # a heat-map pixel is about two pixels here


def test_half_a_pixel_is_not_lost_between_heat_map_and_picture():
    """One dot on every heat-map pixel's middle comes back to exactly that place: edges map to edges."""

    def network(crop):
        return jnp.zeros((1, 64, 64)).at[0, 10, 20].set(1.0)

    box = crop_box((-0.5, -0.5, 255.5, 255.5))
    found = landmarks_of(network, np.zeros((256, 256, 3)), box)
    np.testing.assert_allclose(found.points[0], [4 * 20.5 - 0.5, 4 * 10.5 - 0.5], atol=1e-9)


def test_the_chains_derivative_agrees_with_differences_in_both_modes():
    picture = picture_with_dots(CENTRES)
    along, back = RNG.normal(size=picture.shape), RNG.normal(size=(3, 2))
    box = crop_box((30.0, 12.0, 165.0, 147.0), roll=0.1)

    def points(picture):
        return landmarks_of(blob_network, picture, box).points

    forward = jax.jvp(points, (picture,), (along,))[1]
    np.testing.assert_allclose(forward, central_difference(points, picture, along), rtol=1e-5, atol=1e-6)
    reverse = jax.vjp(points, jnp.asarray(picture))[1](jnp.asarray(back))[0]
    np.testing.assert_allclose((reverse * along).sum(), (back * forward).sum(), rtol=1e-9)


def test_a_moved_dot_moves_its_landmark_as_the_derivative_says():
    """∂N/∂p for a picture that depends on p, as a render does: Eq. 2's Jacobian by the chain rule."""
    box = crop_box((30.0, 12.0, 165.0, 147.0))
    rows, columns = np.mgrid[:150, :200]

    def points(shift):
        dots = [jnp.exp(-((columns - x - shift[0]) ** 2 + (rows - y - shift[1]) ** 2) / 32.0) for x, y in CENTRES]
        return landmarks_of(blob_network, jnp.stack(dots, axis=-1), box).points

    slope = np.asarray(jax.jacfwd(points)(jnp.zeros(2)))  # (3, 2, 2)
    steps = [central_difference(points, jnp.zeros(2), jnp.eye(2)[axis], 1e-5) for axis in (0, 1)]
    np.testing.assert_allclose(slope, np.stack(steps, axis=-1), rtol=1e-5, atol=1e-7)
    assert (slope.diagonal(axis1=1, axis2=2) > 0.2).all()  # each landmark follows its dot


def test_the_box_has_no_part_in_the_chains_program():
    traces = []

    @jax.jit
    def points(picture, box, beta):
        traces.append(1)
        return landmarks_of(blob_network, picture, box, beta).points

    picture = jnp.asarray(picture_with_dots(CENTRES), jnp.float32)
    points(picture, crop_box((30.0, 12.0, 165.0, 147.0)), 50.0)
    points(picture, crop_box((20.0, 12.0, 165.0, 157.0), roll=0.2), 20.0)
    assert len(traces) == 1
