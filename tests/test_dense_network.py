"""The dense network as it runs: the frozen graph is the network, and five numbers mean a place and a covariance."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from workbench.errors import ModelError
from workbench.frames import read_picture
from workbench.landmarks.alignment import frame_from_points
from workbench.landmarks.dense_detector import bundled_dense_network
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.network_detector import crop_frame, sampled_crop
from workbench.networks.dense_network import NAME, SIDE, empty_dense_network, read_dense_network
from workbench.networks.encoder import BLOCKS, WIDTHS
from workbench.networks.frozen import FrozenDenseNetwork
from workbench.networks.frozen_floats import largest_passed
from workbench.networks.regression import LEAST_DEVIATION_PX, MOST_DEVIATION_PX, places_of
from workbench.networks.weights import ARCHITECTURE, save_module
from workbench.samples import sample

POINTS = 7


@pytest.fixture(scope="module")
def network():
    """Small, with every weight drawn, so that no layer can be left out unseen."""
    empty = empty_dense_network((4, 6, 8, 10), 2, 3, 5, POINTS, calibrated=True)
    leaves, structure = jax.tree.flatten(empty)
    rng = np.random.default_rng(1)
    drawn = [jnp.asarray(np.abs(rng.normal(0, 0.3, leaf.shape)), jnp.float32) for leaf in leaves]
    return jax.tree.unflatten(structure, drawn)


@pytest.fixture(scope="module")
def picture():
    return np.random.default_rng(2).integers(0, 256, (SIDE, SIDE, 3), dtype=np.uint8)


def test_the_frozen_network_says_what_the_network_says(network, picture):
    expected = network(jnp.moveaxis(jnp.asarray(picture), -1, 0).astype(jnp.float32) / 255)
    found = FrozenDenseNetwork(network)(picture)
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4 * float(np.abs(theirs).max()))


def in_bytes(network):
    pictures = [np.random.default_rng(seed).integers(0, 256, (SIDE, SIDE, 3), dtype=np.uint8) for seed in range(2, 5)]
    return replace(network, largest=jnp.asarray(largest_passed(network, pictures)))


def test_a_network_in_bytes_says_what_the_network_says_but_for_small_steps(network, picture):
    exact, found = FrozenDenseNetwork(network)(picture), FrozenDenseNetwork(in_bytes(network))(picture)
    for ours, theirs in zip(found, exact, strict=True):
        assert 0.0 < np.abs(ours - theirs).max() < 0.02 * np.abs(theirs).max()


def test_the_bundled_network_in_bytes_puts_a_faces_points_a_fraction_of_a_pixel_away():
    network, picture = bundled_dense_network(), read_picture(sample("astronaut"))
    points = next(read_landmark_file(sample("astronaut-landmarks"))).landmarks.points
    crop = sampled_crop(picture, crop_frame(frame_from_points(points)))
    exact, found = (FrozenDenseNetwork(net)(crop) for net in (replace(network, largest=None), network))
    away = np.linalg.norm(found.points - exact.points, axis=1)
    assert 0.0 < np.median(away) < 0.6
    assert away.max() < 2.0
    deviations = [np.linalg.det(places.whitening) ** -0.5 for places in (exact, found)]
    assert np.abs(np.log(deviations[1] / deviations[0])).mean() < 0.1


def test_places_have_a_derivative_in_the_picture(network, picture):
    crop = jnp.moveaxis(jnp.asarray(picture), -1, 0).astype(jnp.float32) / 255
    way = jnp.asarray(np.random.default_rng(3).normal(size=crop.shape), jnp.float32)
    _, slope = jax.jvp(lambda seen: network(seen).points, (crop,), (way,))
    step = 1e-3
    ends = [network(crop + sign * step * way).points for sign in (1.0, -1.0)]
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * step), atol=0.02 * float(jnp.abs(slope).max()))


def test_errors_that_are_drawn_by_the_covariance_are_whitened_to_unit_variance():
    numbers = np.array([0.1, -0.2, np.log(1 / 3.0), np.log(1 / 0.5), 0.4])
    places = places_of(numbers, SIDE)
    np.testing.assert_allclose(places.points, [[0.6 * SIDE - 0.5, 0.3 * SIDE - 0.5]])
    covariance = np.linalg.inv(places.whitening[0].T @ places.whitening[0])
    errors = np.random.default_rng(4).multivariate_normal([0, 0], covariance, 20000)
    np.testing.assert_allclose(np.cov(errors @ places.whitening[0].T, rowvar=False), np.eye(2), atol=0.03)


def test_no_point_is_claimed_to_be_surer_or_less_sure_than_the_limits():
    places = places_of(np.array([0, 0, 50.0, -50.0, 0]), SIDE)
    np.testing.assert_allclose(1 / np.diagonal(places.whitening[0]), [LEAST_DEVIATION_PX, MOST_DEVIATION_PX])


def test_the_measured_factor_widens_the_deviations():
    numbers = np.zeros(10)
    plain, wide = places_of(numbers, SIDE), places_of(numbers, SIDE, np.array([2.0, 1.0]))
    np.testing.assert_allclose(wide.whitening, plain.whitening / np.array([2.0, 1.0])[:, None, None])


def test_a_file_gives_the_network_back_and_another_network_is_refused(network, tmp_path):
    size = {WIDTHS: json.dumps([4, 6, 8, 10]), BLOCKS: "2"}
    save_module(tmp_path / "dense.safetensors", network, {**size, ARCHITECTURE: NAME})
    read = read_dense_network(tmp_path / "dense.safetensors")
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(read), jax.tree.leaves(network), strict=True))
    save_module(tmp_path / "other.safetensors", network, {**size, ARCHITECTURE: "another"})
    with pytest.raises(ModelError, match="should hold the weights of face-energy-dense-1, but its metadata names"):
        read_dense_network(tmp_path / "other.safetensors")


def test_a_file_gives_back_the_largest_numbers_of_its_layers_and_too_few_are_refused(network, tmp_path):
    size = {WIDTHS: json.dumps([4, 6, 8, 10]), BLOCKS: "2", ARCHITECTURE: NAME}
    known = in_bytes(network)
    save_module(tmp_path / "bytes.safetensors", known, size)
    np.testing.assert_array_equal(read_dense_network(tmp_path / "bytes.safetensors").largest, known.largest)
    save_module(tmp_path / "few.safetensors", replace(known, largest=known.largest[:-1]), size)
    with pytest.raises(ModelError, match=f"each of the network's {len(known.largest)} layers, got"):
        read_dense_network(tmp_path / "few.safetensors")
