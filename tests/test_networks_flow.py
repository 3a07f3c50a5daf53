"""Flow networks: the workbench's own against its PyTorch twin, and what it must do whatever its weights are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from tests.flownet2_twin import FlowNet2Twin
from tests.raft_twin import RaftTwin
from workbench.cli import app
from workbench.errors import InputError, ModelError
from workbench.networks import flow_network
from workbench.networks.flow_network import (
    FlowNetwork,
    empty_flow_network,
    enlarged,
    read_flow_network,
    save_flow_network,
    similarities,
    warped,
)
from workbench.networks.flownet2 import flownet2_from
from workbench.networks.raft import instance_norm, raft_from, read_raft
from workbench.networks.torch_checkpoints import read_checkpoint
from workbench.networks.weights import Weights, fill, read_weights
from workbench.training import flow_torch
from workbench.training.loop import kept

WIDTHS, BLOCKS = (8, 8, 12, 12), 2
CORNERS = np.ix_([0, -1], [0, -1])


def random_twin(seed=0) -> flow_torch.TorchFlowNetwork:
    """A network whose every number, statistics included, is random."""
    torch.manual_seed(seed)
    network = flow_torch.TorchFlowNetwork(WIDTHS, BLOCKS)
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.2)
            module.running_var.uniform_(0.5, 2.0)
            module.weight.data.uniform_(0.5, 1.5)
            module.bias.data.normal_(0, 0.2)
    for decoder in (*network.g, network.r):
        decoder.out.weight.data.normal_(0, 0.05)
    return network.eval()


@pytest.fixture(scope="module")
def twins() -> tuple[flow_torch.TorchFlowNetwork, FlowNetwork]:
    twin = random_twin()
    arrays = kept(flow_torch.folded_flow_arrays(twin))
    return twin, fill(lambda: empty_flow_network(WIDTHS, BLOCKS), Weights(arrays, {}, "twin"))


@pytest.fixture(scope="module")
def pair():
    """Two pictures of 96 × 64 pixels, channels first."""
    return np.random.default_rng(0).random((2, 3, 64, 96)).astype(np.float32)


@pytest.fixture(scope="module")
def answer(twins):
    """The network compiled: its flow, and those of its levels."""
    _, network = twins
    return jax.jit(lambda first, second: (network(first, second), network.levels(first, second)))


def channels_last(x: torch.Tensor) -> np.ndarray:
    return x.detach()[0].permute(1, 2, 0).numpy()


class TestParity:
    def test_every_level_says_what_pytorch_says(self, twins, pair, answer):
        twin, _ = twins
        with torch.no_grad():
            expected = twin(torch.from_numpy(np.concatenate(pair))[None])
        _, flows = answer(*pair)
        assert [flow.shape for flow in flows] == [(2, 3, 2), (4, 6, 2), (8, 12, 2), (16, 24, 2), (16, 24, 2)]
        for flow, other in zip(flows, expected, strict=True):
            assert np.abs(channels_last(other)).max() > 0.05
            assert np.allclose(flow, channels_last(other), atol=2e-4)

    def test_similarities_warping_and_enlarging_are_pytorchs(self):
        rng = np.random.default_rng(1)
        first, second = rng.normal(size=(2, 1, 5, 7, 9)).astype(np.float32)
        flow = rng.normal(0, 3, (1, 2, 7, 9)).astype(np.float32)
        one, two, way = (torch.from_numpy(part) for part in (first, second, flow))
        mine = [jnp.asarray(np.moveaxis(part[0], 0, -1)) for part in (first, second, flow)]
        assert np.allclose(
            similarities(mine[0], mine[1], 2), channels_last(flow_torch.similarities(one, two, 2)), atol=1e-5
        )
        assert np.allclose(warped(mine[1], mine[2]), channels_last(flow_torch.warp(two, way)), atol=1e-5)
        for factor in (2, 4):
            expected = channels_last(flow_torch.enlarge(way, factor))
            assert np.allclose(enlarged(mine[2], factor), expected, atol=1e-5)


class TestFlowNetwork:
    def test_the_answer_is_the_finest_level_at_the_size_of_the_pictures(self, pair, answer):
        flow, levels = answer(*pair)
        assert flow.shape == (2, 64, 96)
        blocks = np.asarray(flow).reshape(2, 16, 4, 24, 4).mean(axis=(2, 4))
        finest = 4 * np.moveaxis(levels[-1], -1, 0)
        assert np.abs(blocks - finest)[:, 1:-1, 1:-1].max() < 0.5 * np.abs(finest - finest.mean()).max()
        assert np.allclose(blocks.mean(axis=(1, 2)), finest.mean(axis=(1, 2)), atol=0.02)

    def test_the_derivative_by_the_second_picture_agrees_with_finite_differences(self, twins, pair, answer):
        _, network = twins
        first, second = pair
        way = np.random.default_rng(3).normal(0, 1, second.shape).astype(np.float32)
        tangent = jax.jit(lambda picture: jax.jvp(lambda x: network(first, x), (picture,), (way,))[1])(second)
        step = 2e-4
        numeric = (answer(first, second + step * way)[0] - answer(first, second - step * way)[0]) / (2 * step)
        difference = np.abs(np.asarray(tangent - numeric))
        assert np.abs(numeric).max() > 0.1
        assert np.median(difference) < 0.02 * np.abs(numeric).max()

    def test_sizes_that_it_cannot_see_are_refused(self, twins):
        _, network = twins
        with pytest.raises(InputError, match="multiples of 32"):
            network(np.zeros((3, 64, 100), np.float32), np.zeros((3, 64, 100), np.float32))
        with pytest.raises(InputError, match="at least"):
            network(np.zeros((3, 32, 64), np.float32), np.zeros((3, 32, 64), np.float32))

    def test_a_saved_network_is_read_back(self, twins, tmp_path):
        _, network = twins
        path = tmp_path / "flow.safetensors"
        save_flow_network(path, network, {"licence": "none"})
        again = read_flow_network(path)
        assert all(
            np.array_equal(a, b) for a, b in zip(*(jax.tree.leaves(part) for part in (network, again)), strict=True)
        )

    def test_weights_of_another_network_are_refused(self, tmp_path):
        with pytest.raises(ModelError, match=flow_network.NAME):
            flow_network.flow_network_from(Weights({}, {"architecture": "fan"}, "fan.safetensors"))


@pytest.fixture(scope="module")
def raft_twin():
    torch.manual_seed(1)
    return RaftTwin().eval()


@pytest.fixture(scope="module")
def raft_file(raft_twin, tmp_path_factory):
    """A checkpoint as torchvision publishes it, with random numbers."""
    path = tmp_path_factory.mktemp("raft") / "raft_small_C_T_V2-01064c6d.pth"
    torch.save(raft_twin.state_dict(), path)
    return path


@pytest.fixture(scope="module")
def raft(raft_file):
    return raft_from(read_checkpoint(raft_file), updates=3)


class TestRaft:
    def test_the_flow_after_every_update_is_pytorchs(self, raft, raft_twin):
        rng = np.random.default_rng(0)
        pair = rng.random((2, 3, 128, 136)).astype(np.float32)
        with torch.no_grad():
            expected = raft_twin(*(torch.from_numpy(2 * part - 1)[None] for part in pair), 3)
        flows, answer = jax.jit(lambda *pair: (raft.flows(*pair), raft(*pair)))(*pair)
        for flow, other in zip(flows, expected, strict=True):
            assert np.allclose(np.asarray(flow)[CORNERS], channels_last(other / 8)[CORNERS], atol=1e-4)
        assert np.abs(channels_last(expected[-1])).max() > 1
        assert np.allclose(np.moveaxis(answer, 0, -1), channels_last(expected[-1]), atol=1e-3)

    def test_each_part_is_pytorchs(self, raft, raft_twin):
        rng = np.random.default_rng(2)
        picture = rng.normal(size=(1, 3, 32, 40)).astype(np.float32)
        with torch.no_grad():
            features = channels_last(raft_twin.feature_encoder(torch.from_numpy(picture)))
            context = channels_last(raft_twin.context_encoder(torch.from_numpy(picture)))
        mine = jnp.asarray(np.moveaxis(picture[0], 0, -1))
        encode = jax.jit(lambda x: (raft.feature_encoder(x, instance_norm), raft.context_encoder(x, lambda y: y)))
        for answer, expected in zip(encode(mine), (features, context), strict=True):
            assert np.allclose(answer, expected, atol=1e-4)

    def test_it_is_differentiable_in_the_second_picture(self, raft):
        first, second, way = np.random.default_rng(3).random((3, 3, 128, 128)).astype(np.float32)
        tangent = jax.jit(lambda: jax.jvp(lambda picture: raft(first, picture), (second,), (way,))[1])()
        assert np.isfinite(tangent).all()
        assert np.abs(tangent).max() > 0

    def test_small_and_odd_pictures_are_refused(self, raft):
        for shape in ((3, 64, 128), (3, 130, 128)):
            with pytest.raises(InputError, match="multiples of 8 and at least 128"):
                raft(np.zeros(shape, np.float32), np.zeros(shape, np.float32))

    def test_the_command_recognises_the_checkpoint(self, raft_file, raft_twin, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        done = CliRunner().invoke(app, ["weights", "convert", str(raft_file)])
        assert done.exit_code == 0
        assert "raft-small" in done.output
        weights = read_weights(tmp_path / "raft-small.safetensors")
        assert weights.metadata["source"] == raft_file.name
        name = "update_block.flow_head.conv2.weight"
        assert np.array_equal(weights.arrays[name], raft_twin.state_dict()[name].numpy())
        assert read_raft(tmp_path / "raft-small.safetensors").updates == 12

    def test_the_large_form_and_other_networks_are_refused(self, raft_file):
        large = dict(read_checkpoint(raft_file).arrays) | {"mask_predictor.conv.weight": np.zeros(1, np.float32)}
        for arrays in (large, {"m0.weight": np.zeros(1, np.float32)}):
            with pytest.raises(ModelError, match="raft_small"):
                raft_from(Weights(arrays, {}, "file"))


@pytest.fixture(scope="module")
def flownet2_twin():
    """A narrow FlowNet2 with random numbers of a size that keeps the flow at a few pixels."""
    torch.manual_seed(2)
    twin = FlowNet2Twin(width=8)
    for name, values in twin.named_parameters():
        gain = 0.1 if "predict_flow" in name else 1.0
        inputs = values[0].numel() if values.ndim > 1 else 10
        values.data.normal_(0, gain * (2 / inputs) ** 0.5)
    return twin.eval()


class TestFlowNet2:
    def test_every_part_of_the_published_kind_of_file_says_what_pytorch_says(self, flownet2_twin, tmp_path):
        saved = {"epoch": 0, "state_dict": flownet2_twin.state_dict(), "best_EPE": 1e10}
        torch.save(saved, tmp_path / "FlowNet2_checkpoint.pth.tar", _use_new_zipfile_serialization=False)
        network = flownet2_from(read_checkpoint(tmp_path / "FlowNet2_checkpoint.pth.tar"))
        pair = np.random.default_rng(0).random((2, 3, 64, 128)).astype(np.float32)
        with torch.no_grad():
            expected = flownet2_twin(*(torch.from_numpy(255 * picture)[None] for picture in pair))
        flows = jax.jit(lambda pair: network.flows(*pair))(pair)
        assert set(flows) == set(expected)
        for name, flow in flows.items():
            other = channels_last(expected[name])
            largest = np.abs(other).max()
            assert other.std(axis=(0, 1)).min() > 0.01 * largest
            assert np.allclose(flow, other, atol=1e-4 * largest)
