"""Weights files, and the workbench's own landmark network read from one."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.networks import random_landmark_network
from workbench.errors import InputError, ModelError
from workbench.networks import (
    Calibration,
    Weights,
    crop_box,
    landmarks_of,
    named_arrays,
    patch_mass,
    read_landmark_network,
    read_weights,
    save_landmark_network,
    write_weights,
)
from workbench.networks.landmark_network import NAME, empty_landmark_network
from workbench.networks.weights import fill

RNG = np.random.default_rng(11)


def torch_heat_maps(arrays: dict[str, np.ndarray], blocks: int, picture: np.ndarray) -> np.ndarray:
    """The network's definition, once more in PyTorch."""
    torch = pytest.importorskip("torch")
    functional = torch.nn.functional
    tensors = {name: torch.from_numpy(np.array(array)) for name, array in arrays.items()}

    def conv(x, name, stride=1):
        weight = tensors[f"{name}.weight"]
        return functional.conv2d(x, weight, tensors[f"{name}.bias"], stride=stride, padding=weight.shape[-1] // 2)

    def step(x, name, stride=1):
        return functional.relu(conv(x, name, stride))

    def residual(x, *names):
        for name in names:
            x = x + functional.relu(conv(x, name))
        return x

    def up(x):
        return functional.interpolate(x, scale_factor=2, mode="nearest")

    x = (torch.from_numpy(picture)[None] - 0.5) / 0.25
    x0 = residual(step(x, "stem", 4), "e0")
    x1 = residual(step(x0, "d1", 2), "e1.0", "e1.1")
    x2 = residual(step(x1, "d2", 2), "e2.0", "e2.1")
    x3 = residual(step(x2, "d3", 2), *(f"e3.{block}" for block in range(blocks)))
    x2 = residual(x2 + up(step(x3, "u2")), "f2")
    x1 = residual(x1 + up(step(x2, "u1")), "f1")
    x0 = residual(x0 + up(step(x1, "u0")), "f0")
    return conv(x0, "head")[0].numpy()


def changed(weights: Weights, drop: tuple[str, ...] = (), **arrays: np.ndarray) -> Weights:
    """The weights without some arrays, and with others."""
    kept = {name: array for name, array in weights.arrays.items() if name not in drop}
    return Weights(kept | {name.replace("__", "."): array for name, array in arrays.items()}, weights.metadata, "w")


@pytest.fixture
def weights(tmp_path) -> Weights:
    save_landmark_network(tmp_path / "small.safetensors", random_landmark_network())
    return read_weights(tmp_path / "small.safetensors")


@pytest.fixture
def save(tmp_path):
    """Write weights to a file."""

    def to_file(weights: Weights, **metadata: str):
        path = tmp_path / "changed.safetensors"
        write_weights(path, weights.arrays, {**weights.metadata, **metadata})
        return path

    return to_file


# --- files --------------------------------------------------------------------------------------------------------


def test_a_weights_file_keeps_arrays_and_metadata(tmp_path):
    arrays = {"a.weight": RNG.normal(size=(2, 3)).astype(np.float32), "b": np.arange(4, dtype=np.float16)[::-2]}
    write_weights(tmp_path / "w.safetensors", arrays, {"licence": "Apache-2.0", "trained on": "Köpfe"})
    read = read_weights(tmp_path / "w.safetensors")
    assert dict(read.metadata) == {"licence": "Apache-2.0", "trained on": "Köpfe"}
    assert read.architecture is None
    assert read.arrays.keys() == arrays.keys()
    for name, array in arrays.items():
        assert read.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(read.arrays[name], array)


def test_a_failed_write_leaves_what_was_there(tmp_path):
    path = tmp_path / "w.safetensors"
    write_weights(path, {"a": np.zeros(3, np.float32)}, {})
    before = path.read_bytes()
    with pytest.raises(Exception, match="object"):
        write_weights(path, {"a": np.array([object()])}, {})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_an_absent_weights_file_is_told(tmp_path):
    with pytest.raises(InputError, match=r"there is no weights file .*nowhere\.safetensors"):
        read_weights(tmp_path / "nowhere.safetensors")


@pytest.mark.parametrize("kept", [0, 5, 40, 0.5, 0.99])
def test_a_weights_file_that_was_cut_off_is_told(tmp_path, kept):
    path = tmp_path / "w.safetensors"
    write_weights(path, {"a": np.zeros(300, np.float32)}, {})
    whole = path.read_bytes()
    path.write_bytes(whole[: kept if isinstance(kept, int) else int(kept * len(whole))])
    with pytest.raises(InputError, match=r"cut off or of another kind; get it again, or .*weights convert"):
        read_weights(path)


def test_another_kind_of_file_is_told(tmp_path):
    (tmp_path / "page.safetensors").write_text("<html>404 not found</html>")
    with pytest.raises(InputError, match="cannot be read as a safetensors file"):
        read_weights(tmp_path / "page.safetensors")


# --- names --------------------------------------------------------------------------------------------------------


def test_names_are_those_of_a_torch_state_dict():
    names = list(named_arrays(random_landmark_network(blocks=3)))
    levels = ["stem", "e0", "d1", "e1.0", "e1.1", "d2", "e2.0", "e2.1", "d3", "e3.0", "e3.1", "e3.2"]
    convs = [*levels, "u2", "f2", "u1", "f1", "u0", "f0", "head"]
    assert names == [f"{conv}.{part}" for conv in convs for part in ("weight", "bias")]


def test_a_network_survives_its_file(tmp_path):
    network = random_landmark_network()
    save_landmark_network(tmp_path / "n.safetensors", network, {"licence": "Apache-2.0"})
    again = read_landmark_network(tmp_path / "n.safetensors")
    assert jax.tree.structure(again) == jax.tree.structure(network)
    for name, array in named_arrays(network).items():
        np.testing.assert_array_equal(named_arrays(again)[name], array)
    metadata = read_weights(tmp_path / "n.safetensors").metadata
    assert metadata == {"architecture": NAME, "widths": "[4, 6, 8, 10]", "blocks": "2", "licence": "Apache-2.0"}


def test_half_precision_weights_run_in_single_precision(save, weights):
    halved = {name: array.astype(np.float16) for name, array in weights.arrays.items()}
    network = read_landmark_network(save(Weights(halved, weights.metadata, "w")))
    assert {array.dtype.name for array in named_arrays(network).values()} == {"float32"}


def test_missing_arrays_are_named(save, weights):
    with pytest.raises(ModelError, match=r"lacks stem.bias of the 36 arrays .* not the weights of this network"):
        read_landmark_network(save(changed(weights, drop=("stem.bias",))))
    some = tuple(name for name in weights.arrays if name.startswith("e"))
    with pytest.raises(ModelError, match=r"lacks e0.weight, e0.bias, e1.0.weight and 11 more"):
        read_landmark_network(save(changed(weights, drop=some)))


def test_unknown_arrays_are_named(save, weights):
    with pytest.raises(ModelError, match=r"holds extra.weight, which the network does not have"):
        read_landmark_network(save(changed(weights, extra__weight=np.zeros(3, np.float32))))


def test_an_array_of_another_shape_is_named(save, weights):
    with pytest.raises(ModelError, match=r"head.weight in .* should have shape \(68, 4, 1, 1\), got \(68, 5, 1, 1\)"):
        read_landmark_network(save(changed(weights, head__weight=np.zeros((68, 5, 1, 1), np.float32))))


def test_numbers_that_are_no_floats_or_not_finite_are_refused(save, weights):
    with pytest.raises(ModelError, match=r"stem.bias in .* holds int32 numbers: weights are float16 or float32"):
        read_landmark_network(save(changed(weights, stem__bias=np.zeros(4, np.int32))))
    with pytest.raises(ModelError, match=r"stem.bias in .* not finite"):
        read_landmark_network(save(changed(weights, stem__bias=np.full(4, np.nan, np.float32))))


# --- our network --------------------------------------------------------------------------------------------------


@pytest.mark.train
@pytest.mark.parametrize(("widths", "blocks"), [((4, 6, 8, 10), 2), ((5, 3, 4, 4), 3), ((2, 2, 2, 2), 1)])
def test_heat_maps_equal_those_of_the_same_network_in_pytorch(widths, blocks):
    network = random_landmark_network(widths, blocks)
    picture = RNG.uniform(size=(3, 256, 256)).astype(np.float32)
    expected = torch_heat_maps(named_arrays(network), blocks, picture)
    heat_maps = network(picture)
    assert heat_maps.shape == (68, 64, 64)
    assert heat_maps.dtype == jnp.float32
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(heat_maps, expected, atol=2e-5 * np.abs(expected).max())


def test_widths_are_read_from_the_weights(weights, save):
    assert read_landmark_network(save(weights)).widths == (4, 6, 8, 10)


@pytest.mark.parametrize(
    "metadata",
    [
        {"widths": "[4, 6, 8]"},
        {"widths": "wide"},
        {"widths": '[4, 6, 8, "10"]'},
        {"blocks": "0"},
        {"blocks": "[2]"},
        {"blocks": "1000000000"},
        {"widths": "[4, 6, 8, 1000000000]"},
        {"widths": "[" * 50_000},
    ],
    ids=lambda metadata: str(*metadata.values()),
)
def test_metadata_without_the_networks_size_is_told(save, weights, metadata):
    with pytest.raises(ModelError, match=r"metadata .* should hold widths \(four numbers.* and blocks .*, got "):
        read_landmark_network(save(weights, **metadata))


def test_weights_of_another_network_are_told(save, weights):
    with pytest.raises(ModelError, match=f"should hold the weights of {NAME}, but its metadata names 3dfan"):
        read_landmark_network(save(weights, architecture="3dfan"))


def test_metadata_that_do_not_fit_the_arrays_are_told(save, weights):
    with pytest.raises(ModelError, match=r"stem.weight in .* should have shape \(5, 3, 7, 7\), got \(4, 3, 7, 7\)"):
        read_landmark_network(save(weights, widths=json.dumps([5, 6, 8, 10])))


def test_the_real_size_chains_derivative_agrees_with_differences():
    network = random_landmark_network((32, 64, 128, 192), 2, dtype=np.float64)
    picture, along = RNG.uniform(size=(120, 160, 3)), RNG.normal(size=(120, 160, 3))
    box = crop_box((20.3, 5.0, 130.3, 115.0), roll=0.1)
    # A step so short that (almost) no unit crosses its bend at zero.
    points = jax.jit(lambda picture: landmarks_of(network, picture, box, beta=1.0).points)
    slope = jax.jit(lambda picture, along: jax.jvp(points, (picture,), (along,))[1])(picture, along)
    step = 1e-8
    expected = (points(picture + step * along) - points(picture - step * along)) / (2 * step)
    assert float(jnp.abs(slope).max()) > 0.01
    np.testing.assert_allclose(slope, expected, atol=1e-3 * float(jnp.abs(expected).max()))


def test_uncalibrated_confidence_is_the_patch_mass():
    heat_maps = 0.1 * RNG.uniform(size=(68, 64, 64))
    np.testing.assert_array_equal(random_landmark_network().confidence_of(heat_maps), patch_mass(heat_maps))


def test_calibrated_confidence_is_linear_between_the_files_knots(save, weights):
    knots = {"calibration__mass": np.array([0.2, 0.5, 0.9]), "calibration__confidence": np.array([0.0, 0.3, 1.0])}
    network = read_landmark_network(save(changed(weights, **{k: v.astype(np.float32) for k, v in knots.items()})))
    assert isinstance(network.calibration, Calibration)
    found = network.calibration(jnp.array([0.0, 0.2, 0.35, 0.7, 0.95]))
    np.testing.assert_allclose(found, [0, 0, 0.15, 0.65, 1], atol=1e-6)
    heat_maps = (0.1 * RNG.uniform(size=(68, 64, 64))).astype(np.float32)
    np.testing.assert_allclose(network.confidence_of(heat_maps), network.calibration(patch_mass(heat_maps)))


@pytest.mark.parametrize(
    ("mass", "confidence"),
    [([0.5, 0.2], [0.0, 1.0]), ([0.2, 0.5], [1.0, 0.0]), ([0.2, 1.5], [0.0, 1.0]), ([0.2, 0.5], [-0.1, 1.0])],
    ids=["mass falls", "confidence falls", "mass beyond 1", "confidence below 0"],
)
def test_a_calibration_that_is_no_ascending_map_is_refused(save, weights, mass, confidence):
    knots = {
        "calibration__mass": np.array(mass, np.float32),
        "calibration__confidence": np.array(confidence, np.float32),
    }
    with pytest.raises(ModelError, match="should map ascending masses"):
        read_landmark_network(save(changed(weights, **knots)))


@pytest.mark.parametrize("largest", [np.ones(3), np.zeros(30), -np.ones(30)], ids=["too few", "zero", "negative"])
def test_largest_numbers_that_are_no_sizes_of_the_layers_are_refused(save, weights, largest):
    with pytest.raises(ModelError, match="a number above zero for each of the network's 30 layers, got"):
        read_landmark_network(save(changed(weights, largest=largest.astype(np.float32))))


def test_networks_are_arguments_of_a_compiled_function_so_other_weights_compile_nothing():
    traces = []

    @jax.jit
    def heat_maps(network, picture):
        traces.append(1)
        return network(picture)

    picture = jnp.asarray(RNG.uniform(size=(3, 64, 64)), jnp.float32)
    first, second = (heat_maps(random_landmark_network(seed=seed), picture) for seed in (0, 1))
    assert len(traces) == 1
    assert not np.allclose(first, second)


def test_fill_reads_into_what_the_caller_describes(weights):
    network = fill(lambda: empty_landmark_network((4, 6, 8, 10), 2), weights)
    np.testing.assert_array_equal(network.e1[1].weight, weights.arrays["e1.1.weight"])
