"""Detectors' networks run without JAX: the answers are those of the network itself."""

import threading
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from workbench.frames import read_picture
from workbench.landmarks.alignment import frame_from_points
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.network_detector import bundled_landmark_network, crop_frame, sampled_crop
from workbench.networks import soft_argmax
from workbench.networks.frozen import FrozenNetwork
from workbench.networks.frozen_floats import largest_passed
from workbench.networks.landmark_network import empty_landmark_network
from workbench.samples import sample

CELL = 4
"""Pixels of the crop in one of a heat map's."""


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


def test_the_bundled_network_frozen_in_single_precision_puts_landmarks_where_the_network_does():
    network = replace(bundled_landmark_network(), largest=None)
    crop = np.random.default_rng(2).integers(0, 256, (256, 256, 3), dtype=np.uint8)
    expected = soft_argmax(eqx.filter_jit(network)(jnp.moveaxis(jnp.asarray(crop), -1, 0).astype(jnp.float32) / 255))
    np.testing.assert_allclose(soft_argmax(FrozenNetwork(network)(crop)[:68]), expected, atol=1e-3)


def noise(seed: int, height: int, width: int):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.mark.parametrize(("height", "width"), [(64, 64), (32, 96)])
def test_heat_maps_in_bytes_are_those_of_the_network_but_for_small_steps(height, width):
    network = random_network(height, outputs=5, pupils=True)
    known = replace(network, largest=jnp.asarray(largest_passed(network, [noise(k, height, width) for k in range(3)])))
    exact, found = FrozenNetwork(network)(noise(1, height, width)), FrozenNetwork(known)(noise(1, height, width))
    assert found.shape == exact.shape == (7, height // 4, width // 4)
    assert 0.0 < np.abs(found - exact).max() < 0.06 * np.ptp(exact)
    assert np.corrcoef(found.ravel(), exact.ravel())[0, 1] > 0.999


def test_an_output_in_bytes_that_is_its_bias_alone_is_that_bias():
    drawn = random_network(9, outputs=5)
    where = (lambda tree: tree.stem.weight), (lambda tree: tree.stem.bias)
    for part, value in zip(where, (0.0, 0.7), strict=True):
        drawn = eqx.tree_at(part, drawn, part(drawn).at[0].set(value))
    network = replace(drawn, largest=jnp.asarray(largest_passed(drawn, [noise(1, 64, 64)])))
    exact, found = FrozenNetwork(drawn)(noise(1, 64, 64)), FrozenNetwork(network)(noise(1, 64, 64))
    assert np.abs(found - exact).max() < 0.06 * np.ptp(exact)


def test_the_largest_that_layers_pass_on_is_that_of_three_of_four_pictures():
    """The brightest of five pictures has no say in it."""
    network, pictures = random_network(7), [noise(1, 64, 64), *(noise(k, 64, 64) // (3 + k) for k in range(2, 6))]
    each = [largest_passed(network, [picture]) for picture in pictures]
    np.testing.assert_allclose(largest_passed(network, pictures), np.sort(each, axis=0)[3], rtol=1e-6)
    lowest = network.features(jnp.moveaxis(jnp.asarray(pictures[0]), -1, 0).astype(jnp.float32) / 255)[-1]
    encoder = 4 + 2 * (1 + 2 + 2 + 2)
    assert each[0][encoder - 1] == pytest.approx(float(lowest.max()), rel=1e-4)
    assert len(each[0]) == network.passed_on


def test_the_bundled_network_in_bytes_puts_a_faces_landmarks_a_fraction_of_a_pixel_away():
    network, picture = bundled_landmark_network(), read_picture(sample("astronaut"))
    points = next(read_landmark_file(sample("astronaut-landmarks"))).landmarks.points
    crop = sampled_crop(picture, crop_frame(frame_from_points(points)))
    exact, found = (soft_argmax(FrozenNetwork(net)(crop)[:68]) for net in (replace(network, largest=None), network))
    away = CELL * np.linalg.norm(found - exact, axis=1)
    assert 0.0 < np.median(away) < 0.2
    assert away[17:].max() < 1.0  # the upper ends of the jaw lie under hair, where more than one place is likely


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
