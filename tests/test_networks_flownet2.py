"""FlowNet2: what its parts compute, what it must do whatever its weights are, and its files. PyTorch is not needed."""

import tarfile
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from typer.testing import CliRunner

from tests.networks import randomised
from tests.old_checkpoints import write_old_checkpoint
from workbench.cli import app
from workbench.errors import InputError, ModelError
from workbench.flow import flow_estimator, read_flow
from workbench.flow.network_flow import seen_size
from workbench.networks import convert_checkpoint, named_arrays, read_checkpoint, read_flownet2, write_weights
from workbench.networks.flownet2 import (
    FlowNet2,
    correlation,
    empty_flownet2,
    flownet2_from,
    lengths,
    warped,
)
from workbench.networks.layers import TransposedConv
from workbench.networks.weights import Weights, read_weights

WIDTH = 4


@pytest.fixture(scope="module")
def network() -> FlowNet2:
    """A narrow FlowNet2 with random weights."""
    return randomised(empty_flownet2(WIDTH))


@pytest.fixture(scope="module")
def arrays(network) -> dict[str, np.ndarray]:
    return {name: np.asarray(array) for name, array in named_arrays(network).items()}


@pytest.fixture(scope="module")
def checkpoint(arrays, tmp_path_factory):
    """A file as NVIDIA published it, but narrow and with random numbers."""
    return write_old_checkpoint(tmp_path_factory.mktemp("flownet2") / "FlowNet2_checkpoint.pth.tar", arrays)


@pytest.fixture(scope="module")
def pair():
    """Two pictures of 128 × 64 pixels, channels first."""
    return np.random.default_rng(0).random((2, 3, 64, 128)).astype(np.float32)


@pytest.fixture(scope="module")
def tangent(network):
    """The flow and its derivative along a change of both pictures, compiled."""
    compiled = eqx.filter_jit(lambda network, pair, way: jax.jvp(lambda pair: network(*pair), (pair,), (way,)))
    return lambda pair, way: [np.asarray(part) for part in compiled(network, pair, way)]


@pytest.fixture(scope="module")
def answer(tangent):
    """The flow alone, by the same program."""
    return lambda pair: tangent(pair, np.zeros_like(pair))[0]


class TestParts:
    def test_a_transposed_convolution_adds_its_kernel_at_every_second_pixel(self):
        rng = np.random.default_rng(1)
        x = rng.normal(size=(3, 5, 2)).astype(np.float32)
        weight, bias = rng.normal(size=(2, 3, 4, 4)).astype(np.float32), rng.normal(size=3).astype(np.float32)
        spread = np.zeros((8, 12, 3))
        for row, column in np.ndindex(3, 5):
            kernel = np.einsum("i,iokl->klo", x[row, column], weight)
            spread[2 * row : 2 * row + 4, 2 * column : 2 * column + 4] += kernel
        expected = spread[1:-1, 1:-1] + bias
        layer = TransposedConv(jnp.asarray(weight), jnp.asarray(bias))
        assert np.allclose(layer(jnp.asarray(x)), expected, atol=1e-5)

    def test_correlation_is_the_mean_product_at_21_by_21_places_two_pixels_apart(self):
        first, second = np.random.default_rng(2).normal(size=(2, 8, 16, 3)).astype(np.float32)
        padded = np.pad(second, ((20, 20), (20, 20), (0, 0)))
        answer = np.asarray(correlation(jnp.asarray(first), jnp.asarray(second))).reshape(8, 16, 21, 21)
        for down, right in np.ndindex(21, 21):
            there = padded[2 * down : 2 * down + 8, 2 * right : 2 * right + 16]
            assert np.allclose(answer[:, :, down, right], (first * there).mean(axis=-1), atol=1e-6)

    def test_warping_reads_where_the_flow_points_to_and_holds_the_border(self):
        rng = np.random.default_rng(3)
        picture, flow = rng.random((6, 9, 3)), rng.normal(0, 4, (6, 9, 2))
        rows, columns = np.indices((6, 9))
        places = [rows + flow[..., 1], columns + flow[..., 0]]
        expected = [map_coordinates(picture[..., channel], places, order=1, mode="nearest") for channel in range(3)]
        assert np.allclose(warped(jnp.asarray(picture), jnp.asarray(flow)), np.stack(expected, axis=-1))

    def test_lengths_have_a_derivative_also_where_they_are_zero(self):
        vectors = jnp.array([[[3.0, 4.0], [0.0, 0.0]]])
        value, change = jax.jvp(lengths, (vectors,), (jnp.ones_like(vectors),))
        assert np.allclose(value[..., 0], [[5.0, 0.0]])
        assert np.allclose(change[..., 0], [[1.4, 0.0]])


class TestFlowNet2:
    def test_it_has_the_published_numbers_of_parameters(self):
        network = eqx.filter_eval_shape(empty_flownet2)
        counts = {
            name: sum(leaf.size for leaf in jax.tree.leaves(getattr(network, name)))
            for name in ("flownetc", "flownets_1", "flownets_2", "flownets_d", "flownetfusion")
        }
        assert (counts["flownetc"], counts["flownets_d"], counts["flownetfusion"]) == (39_175_298, 45_371_666, 581_226)
        assert sum(counts.values()) == 162_518_834
        picture = jax.ShapeDtypeStruct((3, 64, 192), np.float32)
        assert eqx.filter_eval_shape(network, picture, picture).shape == (2, 64, 192)

    @pytest.mark.long
    def test_the_flow_has_the_pictures_size(self, answer, pair):
        flow = answer(pair)
        assert flow.shape == (2, 64, 128)
        assert np.isfinite(flow).all()
        assert flow.std(axis=(1, 2)).min() > 0.05

    def test_a_colour_added_to_both_pictures_does_not_matter(self, answer, pair):
        colour = np.array([0.1, -0.2, 0.3], np.float32)[:, None, None]
        assert np.allclose(answer(pair), answer(pair + colour), atol=1e-3)

    @pytest.mark.parametrize("shape", [(3, 64, 96), (3, 32, 64), (3, 0, 64)])
    def test_sizes_that_it_cannot_see_are_refused(self, network, shape):
        with pytest.raises(InputError, match="sides are multiples of 64"):
            network(np.zeros(shape, np.float32), np.zeros(shape, np.float32))

    @pytest.mark.parametrize("which", [0, 1], ids=["first", "second"])
    def test_the_derivative_by_either_picture_agrees_with_finite_differences(self, tangent, answer, pair, which):
        way = np.zeros_like(pair)
        way[which] = np.random.default_rng(4).normal(size=pair.shape[1:])
        _, slope = tangent(pair, way)
        step = 1e-4
        numeric = (answer(pair + step * way) - answer(pair - step * way)) / (2 * step)
        assert np.median(np.abs(numeric)) > 0.5
        assert np.median(np.abs(slope - numeric)) < 0.03 * np.median(np.abs(numeric))


class TestFiles:
    def test_the_published_file_is_read(self, checkpoint, arrays):
        read = named_arrays(read_flownet2(checkpoint))
        assert set(read) == set(arrays)
        assert all(np.array_equal(read[name], arrays[name]) for name in arrays)

    def test_the_command_recognises_it_and_its_file_is_read_back(self, checkpoint, arrays, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        done = CliRunner().invoke(app, ["weights", "convert", str(checkpoint)])
        assert done.exit_code == 0
        weights = read_weights(tmp_path / "flownet2.safetensors")
        assert weights.architecture == "flownet2"
        assert weights.metadata["source"] == "FlowNet2_checkpoint.pth.tar"
        again = named_arrays(read_flownet2(tmp_path / "flownet2.safetensors"))
        assert all(np.array_equal(again[name], arrays[name]) for name in arrays)

    def test_a_file_of_hundreds_of_megabytes_is_read_once_to_convert_it(self, checkpoint, tmp_path, monkeypatch):
        read, read_bytes = [], Path.read_bytes
        monkeypatch.setattr(Path, "read_bytes", lambda path: (read.append(path), read_bytes(path))[1])
        convert_checkpoint(checkpoint, tmp_path / "flownet2.safetensors")
        assert read == [checkpoint]

    def test_estimators_take_the_file_as_published(self, checkpoint, arrays):
        estimator = flow_estimator(str(checkpoint), side=128)
        assert isinstance(estimator.network, FlowNet2)
        assert seen_size(estimator.network, 100, 130, estimator.side) == (128, 128)
        assert np.array_equal(
            named_arrays(estimator.network)["flownetc.conv1.0.weight"], arrays["flownetc.conv1.0.weight"]
        )

    def test_parts_that_were_published_alone_are_refused(self, arrays, tmp_path):
        stacked = {name: array for name, array in arrays.items() if name.startswith(("flownetc.", "flownets_1."))}
        alone = {name.removeprefix("flownetc."): array for name, array in stacked.items() if "flownetc." in name}
        for name, part in {"FlowNet2-CS": stacked, "FlowNet2-C": alone}.items():
            path = write_old_checkpoint(tmp_path / f"{name}_checkpoint.pth.tar", part)
            for read in (read_flownet2, read_flow):
                with pytest.raises(ModelError, match=r"supply NVIDIA's FlowNet2_checkpoint\.pth\.tar"):
                    read(path)
            done = CliRunner().invoke(app, ["weights", "convert", str(path), "--out", str(tmp_path / "no.safetensors")])
            assert done.exit_code != 0
            assert not (tmp_path / "no.safetensors").exists()

    def test_weights_of_other_networks_are_refused(self, arrays, tmp_path):
        with pytest.raises(ModelError, match="names fan"):
            flownet2_from(Weights(arrays, {"architecture": "fan"}, "fan.safetensors"))
        with pytest.raises(ModelError, match=r"lacks flownetc\.conv1\.0\.weight"):
            flownet2_from(Weights({name: arrays[name] for name in list(arrays)[1:]}, {}, "file"))
        write_weights(tmp_path / "other.safetensors", {"a": np.ones(3, np.float32)}, {"architecture": "pwc"})
        with pytest.raises(ModelError, match="should hold a flow network, got pwc: supply the workbench's own"):
            read_flow(tmp_path / "other.safetensors")

    def test_an_archive_that_was_not_unpacked_is_told(self, checkpoint, tmp_path):
        path = tmp_path / "FlowNet2.tar"
        with tarfile.open(path, "w") as archive:
            archive.add(checkpoint, "FlowNet2_checkpoint.pth.tar")
        with pytest.raises(InputError, match="it is a tar archive: unpack it first"):
            read_checkpoint(path)

    def test_a_file_that_was_cut_off_is_told(self, checkpoint, tmp_path):
        path = tmp_path / "FlowNet2_checkpoint.pth.tar"
        path.write_bytes(checkpoint.read_bytes()[:-1000])
        with pytest.raises(InputError, match="it is cut off"):
            read_flownet2(path)
