"""The dense network as it runs: the frozen graph is the network, and five numbers mean a place and a covariance."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from workbench.errors import ModelError
from workbench.networks.dense_network import NAME, SIDE, empty_dense_network, read_dense_network
from workbench.networks.encoder import BLOCKS, WIDTHS
from workbench.networks.frozen import FrozenDenseNetwork
from workbench.networks.regression import LEAST_DEVIATION_PX, MOST_DEVIATION_PX, places_of
from workbench.networks.weights import ARCHITECTURE, save_module

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
