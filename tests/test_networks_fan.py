"""The Face Alignment Network against the PyTorch model of the package face-alignment, with random weights."""

import importlib.util
import sys
import warnings
from pathlib import Path
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from workbench.errors import InputError, ModelError
from workbench.networks import (
    Fan,
    Weights,
    convert_checkpoint,
    crop_box,
    named_arrays,
    read_checkpoint,
    read_fan,
    read_weights,
    soft_argmax,
    to_picture,
    write_weights,
)
from workbench.networks.fan import empty_fan, fan_from

torch = pytest.importorskip("torch", reason="the network that ours is compared with is PyTorch's")
RNG = np.random.default_rng(3)


def published_module() -> ModuleType:
    """`face_alignment.models.fan` alone: the package itself imports detectors, scikit-image and a compiler."""
    package = importlib.util.find_spec("face_alignment")
    if package is None or not package.submodule_search_locations:
        pytest.skip("the published network is missing: pip install --no-deps face-alignment==1.5.0")
    path = Path(package.submodule_search_locations[0]) / "models" / "fan.py"
    spec = importlib.util.spec_from_file_location("published_fan", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["published_fan"] = module
    spec.loader.exec_module(module)
    return module


def published_fan(count: int):
    """The published network with random weights and random statistics of its batch norms."""
    torch.manual_seed(count)
    network = published_module().FAN(count).eval()
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.weight.data.uniform_(0.3, 1.2)
            module.bias.data.normal_(0, 0.3)
            module.running_mean.normal_(0, 0.3)
            module.running_var.uniform_(0.3, 2)
    return network


@pytest.fixture(scope="module")
def one_stack():
    return published_fan(1)


@pytest.fixture(scope="module")
def one_stack_file(one_stack, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("fan") / "3DFAN1.pth.tar"
    torch.save(one_stack.state_dict(), path)
    return path


@pytest.fixture(scope="module")
def fan(one_stack_file):
    """Ours, of the same file."""
    return read_fan(one_stack_file)


def part(network, name: str):
    """Our module of PyTorch's name."""
    for step in name.split("."):
        if step.isdigit():
            network = network[int(step)]
            continue
        inside = {**getattr(network, "stacks", {}), **getattr(network, "blocks", {})}
        network = inside.get(step) if step in inside else getattr(network, step)
    return network


# --- the same network ---------------------------------------------------------------------------------------------


def test_every_layer_and_block_equals_the_published_one(one_stack, fan):
    """Each of our modules on what PyTorch's module of that name saw; 64×64 pixels so that the lowest map is one."""
    seen = {}

    def remember(name):
        def hook(module, inputs, output):
            seen[name] = (inputs[0].numpy().copy(), output.numpy().copy())

        return hook

    kinds = (torch.nn.Conv2d, torch.nn.BatchNorm2d, type(one_stack.conv2), type(one_stack.m0))
    named = {name: module for name, module in one_stack.named_modules() if isinstance(module, kinds)}
    hooks = [module.register_forward_hook(remember(name)) for name, module in named.items()]
    with torch.no_grad():
        one_stack(torch.rand(1, 3, 64, 64))
    for hook in hooks:
        hook.remove()
    blocks = [name for name in named if isinstance(named[name], kinds[2:])]
    layers = [name for name in named if name.split(".")[0] in ("conv1", "bn1", "conv2", "conv_last0", "bn_end0", "l0")]
    assert (len(named), len(blocks)) == (129, 18)
    run_part = jax.jit(lambda part, x: part(x))
    for name in sorted({*blocks, *layers}):
        given, expected = seen[name]
        got = run_part(part(fan, name), given[0].transpose(1, 2, 0))
        scale = np.abs(expected).max()
        np.testing.assert_allclose(np.moveaxis(got, -1, 0), expected[0], atol=1e-5 * scale, err_msg=name)


def test_the_four_stacks_heat_maps_and_landmarks_equal_the_published_ones(tmp_path):
    published = published_fan(4)
    torch.save(published.state_dict(), tmp_path / "3DFAN4.pth.tar", _use_new_zipfile_serialization=False)
    network = read_fan(tmp_path / "3DFAN4.pth.tar")
    picture = RNG.uniform(size=(3, 256, 256)).astype(np.float32)
    with torch.no_grad():
        expected = [maps[0].numpy() for maps in published(torch.from_numpy(picture)[None])]
    found, answer = jax.jit(lambda network, picture: (network.all_heat_maps(picture), network(picture)))(
        network, picture
    )
    np.testing.assert_array_equal(answer, found[-1])
    box = crop_box((100.0, 80.0, 356.0, 336.0))
    assert network.count == len(found) == 4
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.shape == (68, 64, 64)
        assert np.abs(theirs).max() > 0.5  # as tall as real heat maps: the tolerances mean something
        assert np.abs(np.asarray(ours) - theirs).max() < 1e-4
        landmarks = [to_picture(soft_argmax(jnp.asarray(maps)), box, 64) for maps in (ours, theirs)]
        assert np.linalg.norm(landmarks[0] - landmarks[1], axis=1).max() < 0.01


def test_names_and_shapes_are_those_of_the_published_state_dict(one_stack, fan):
    theirs = {k: tuple(v.shape) for k, v in one_stack.state_dict().items() if not k.endswith("num_batches_tracked")}
    assert {name: array.shape for name, array in named_arrays(fan).items()} == theirs


def test_a_blocks_derivative_agrees_with_differences(fan):
    block = jax.tree.map(lambda array: array.astype(jnp.float64), fan.conv2)
    x, along = jnp.asarray(RNG.normal(size=(2, 6, 6, 64)))
    slope, step = jax.jvp(block, (x,), (along,))[1], 1e-7
    expected = (block(x + step * along) - block(x - step * along)) / (2 * step)
    np.testing.assert_allclose(slope, expected, atol=1e-4 * float(jnp.abs(expected).max()))


def test_the_call_gives_the_last_stacks_heat_maps(monkeypatch):
    answers = [jnp.full((68, 1, 1), stack) for stack in (0.0, 1.0, 2.0)]
    monkeypatch.setattr(Fan, "all_heat_maps", lambda self, picture: answers)
    np.testing.assert_array_equal(empty_fan(1)(jnp.zeros((3, 4, 4))), answers[-1])


def test_confidence_is_the_height_of_the_peak():
    heat_maps = np.zeros((3, 8, 8), np.float32)
    heat_maps[:, 2, 3] = [0.7, 1.3, 0.0]
    heat_maps[2] -= 0.2
    assert empty_fan(1).confidence_of(heat_maps).tolist() == pytest.approx([0.7, 1.0, 0.0])


# --- its files ----------------------------------------------------------------------------------------------------


def test_a_torchscript_archive_has_the_same_names_for_modules_that_were_added_by_name(tmp_path):
    torch.manual_seed(0)
    hour_glass = published_module().HourGlass(1, 2, 8).eval()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PyTorch has announced the end of TorchScript
        torch.jit.save(torch.jit.trace(hour_glass, torch.zeros(1, 8, 4, 4)), tmp_path / "m0.zip")
    found, expected = read_checkpoint(tmp_path / "m0.zip").arrays, hour_glass.state_dict()
    names = {name for name in expected if not name.endswith("num_batches_tracked")}
    assert names == {name for name in found if not name.endswith("num_batches_tracked")}
    assert "b2_plus_1.conv3.weight" in names
    for name in names:
        np.testing.assert_array_equal(found[name], expected[name].numpy())


def test_convert_writes_once_what_is_read_without_pytorch(one_stack_file, fan, tmp_path, run, monkeypatch):
    code, out, err = run("weights", "convert", str(one_stack_file), "--out", "models/fan.safetensors")
    assert (code, err) == (0, "")
    written = tmp_path / "models" / "fan.safetensors"
    metadata = read_weights(written).metadata
    assert metadata["architecture"] == "fan"
    assert metadata["stacks"] == "1"
    assert metadata["source"] == "3DFAN1.pth.tar"
    assert metadata["source_sha256"] in out
    monkeypatch.setitem(sys.modules, "torch", None)  # importing it fails from here on
    again = named_arrays(read_fan(written))
    for name, array in named_arrays(fan).items():
        np.testing.assert_array_equal(again[name], array)


def test_convert_of_a_converted_file_keeps_its_source(one_stack_file, tmp_path):
    first = convert_checkpoint(one_stack_file, tmp_path / "fan.safetensors")
    convert_checkpoint(tmp_path / "fan.safetensors", tmp_path / "again.safetensors")
    assert read_weights(tmp_path / "again.safetensors").metadata == first.metadata


def test_weights_that_are_there_are_replaced_only_where_that_is_asked_for(one_stack_file, tmp_path, run):
    (tmp_path / "fan.safetensors").write_text("mine")
    code, _, err = run("weights", "convert", str(one_stack_file))
    assert code == 2
    assert "fan.safetensors exists already; name another (--out), or add --overwrite." in err
    assert (tmp_path / "fan.safetensors").read_text() == "mine"
    assert run("weights", "convert", str(one_stack_file), "--overwrite")[0] == 0
    assert read_weights(tmp_path / "fan.safetensors").metadata["architecture"] == "fan"


def test_show_tells_what_a_file_holds(one_stack_file, tmp_path, run):
    code, out, _ = run("weights", "show", str(one_stack_file))
    assert code == 0
    assert "3DFAN1.pth.tar" in out
    assert "source_sha256" in out
    assert "fan" in architecture_in(out)
    torch.save({"a": torch.zeros(3)}, tmp_path / "other.pth")
    assert "none that the workbench knows" in architecture_in(run("weights", "show", "other.pth")[1])


def architecture_in(out: str) -> str:
    return next(line for line in out.splitlines() if "architecture" in line)


def test_converting_another_file_writes_nothing_and_says_what_was_expected(tmp_path, run):
    torch.save({"conv1_1.weight": torch.zeros(64, 3, 3, 3)}, tmp_path / "s3fd.pth")
    code, _, err = run("weights", "convert", "s3fd.pth")
    assert code == 2
    assert "should hold a FAN with arrays such as m0.b1_4.conv1.weight, got conv1_1.weight: supply" in err
    assert "not that of a face detector" in err
    (tmp_path / "page.pth").write_text("<html>")
    assert run("weights", "convert", "page.pth")[0] == 2
    assert run("weights", "convert", "nowhere.pth")[0] == 2
    assert not (tmp_path / "fan.safetensors").exists()


def test_missing_unknown_and_misshapen_arrays_are_named(one_stack_file, tmp_path):
    whole = read_weights_of(one_stack_file)
    name = "m0.b2_3.bn2.running_var"
    with pytest.raises(ModelError, match=rf"lacks {name} of the 279 arrays"):
        read_fan(saved(tmp_path, {key: array for key, array in whole.items() if key != name}))
    with pytest.raises(ModelError, match=r"holds depth.weight, which the network does not have"):
        read_fan(saved(tmp_path, {**whole, "depth.weight": np.zeros(3, np.float32)}))
    with pytest.raises(ModelError, match=r"l0.weight in .* \(68, 256, 1, 1\), got \(98, 256, 1, 1\)"):
        read_fan(saved(tmp_path, {**whole, "l0.weight": np.zeros((98, 256, 1, 1), np.float32)}))


def test_weights_of_another_network_are_told(tmp_path):
    write_weights(
        tmp_path / "n.safetensors", {"a": np.zeros(3, np.float32)}, {"architecture": "face-energy-landmarks-1"}
    )
    with pytest.raises(ModelError, match="should hold a FAN, but its metadata names face-energy-landmarks-1"):
        read_fan(tmp_path / "n.safetensors")


def test_an_absent_file_is_told(tmp_path):
    with pytest.raises(InputError, match="there is no weights file"):
        read_fan(tmp_path / "nowhere.pth")


def test_half_of_a_stack_is_not_taken_for_a_network(one_stack_file):
    whole = read_weights_of(one_stack_file)
    two = {**whole, **{f"m1{name[2:]}": array for name, array in whole.items() if name.startswith("m0.")}}
    with pytest.raises(ModelError, match=r"w lacks .* and \d+ more of the 501 arrays"):
        fan_from(Weights(two, {}, "w"))


def read_weights_of(path: Path) -> dict[str, np.ndarray]:
    return {k: v for k, v in read_checkpoint(path).arrays.items() if not k.endswith("num_batches_tracked")}


def saved(folder: Path, arrays: dict[str, np.ndarray]) -> Path:
    write_weights(folder / "changed.safetensors", arrays, {})
    return folder / "changed.safetensors"
