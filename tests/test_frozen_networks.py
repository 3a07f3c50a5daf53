"""Detectors' networks run without JAX: the answers are those of the network itself."""

import threading

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from workbench.landmarks.network_detector import bundled_landmark_network
from workbench.networks import soft_argmax
from workbench.networks.frozen import FrozenNetwork
from workbench.networks.landmark_network import empty_landmark_network


def random_network(seed: int, **sizes):
    """A small network whose every weight is drawn, biases too, so that no layer can be left out unseen."""
    empty = empty_landmark_network((4, 6, 8, 10), 2, **sizes)
    leaves, structure = jax.tree.flatten(empty)
    rng = np.random.default_rng(seed)
    return jax.tree.unflatten(structure, [jnp.asarray(rng.normal(0, 0.3, leaf.shape), jnp.float32) for leaf in leaves])


@pytest.mark.parametrize(("height", "width"), [(64, 64), (32, 96), (256, 256)])
def test_a_frozen_network_gives_the_heat_maps_of_the_network(height, width):
    network = random_network(height + width, outputs=5)
    picture = np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)
    expected = network(jnp.moveaxis(jnp.asarray(picture), -1, 0).astype(jnp.float32) / 255)
    found = FrozenNetwork(network)(picture)
    assert found.shape == (5, height // 4, width // 4)
    np.testing.assert_allclose(found, expected, atol=1e-5 * float(np.abs(expected).max()))


def test_maps_of_pupils_follow_those_of_the_landmarks_which_stay_what_the_network_says():
    network = random_network(5, outputs=5, pupils=True)
    picture = np.random.default_rng(6).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    expected = network(jnp.moveaxis(jnp.asarray(picture), -1, 0).astype(jnp.float32) / 255)
    found = FrozenNetwork(network)(picture)
    assert expected.shape == (5, 16, 16)
    assert found.shape == (7, 16, 16)
    np.testing.assert_allclose(found[:5], expected, atol=1e-5 * float(np.abs(expected).max()))
    without = eqx.tree_at(lambda tree: tree.head, network, network.pupils)
    np.testing.assert_allclose(found[5:], FrozenNetwork(without)(picture)[:2], atol=1e-5 * float(np.abs(found).max()))


def test_the_bundled_network_frozen_puts_landmarks_where_the_network_does():
    network = bundled_landmark_network()
    crop = np.random.default_rng(2).integers(0, 256, (256, 256, 3), dtype=np.uint8)
    expected = soft_argmax(eqx.filter_jit(network)(jnp.moveaxis(jnp.asarray(crop), -1, 0).astype(jnp.float32) / 255))
    np.testing.assert_allclose(soft_argmax(FrozenNetwork(network)(crop)[:68]), expected, atol=1e-3)


def test_a_frozen_network_answers_several_threads_at_once():
    frozen = FrozenNetwork(random_network(3))
    pictures = np.random.default_rng(4).integers(0, 256, (4, 64, 64, 3), dtype=np.uint8)
    alone, together = [frozen(picture) for picture in pictures], [None] * 4

    def look(k):
        together[k] = frozen(pictures[k])

    threads = [threading.Thread(target=look, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))
