"""PyTorch checkpoints read as data: the published formats, damaged files, and files that mean harm."""

import pickle
import warnings
import zipfile
from collections import OrderedDict
from contextlib import suppress
from copy import copy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.errors import InputError
from workbench.networks import read_checkpoint, write_weights

torch = pytest.importorskip("torch", reason="the checkpoints of these tests are written by PyTorch")


def small_network():
    """A network whose state dict has weights, statistics and a counter."""
    torch.manual_seed(0)
    return torch.nn.Sequential(torch.nn.Conv2d(3, 4, 3), torch.nn.BatchNorm2d(4), torch.nn.ReLU()).eval()


NETWORK = small_network()
STATE = {name: tensor.numpy() for name, tensor in NETWORK.state_dict().items()}


def save_script(path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PyTorch has announced the end of TorchScript
        torch.jit.save(torch.jit.trace(NETWORK, torch.zeros(1, 3, 8, 8)), path)


WRITERS = {
    "zip": lambda path: torch.save(NETWORK.state_dict(), path),
    "older stream": lambda path: torch.save(NETWORK.state_dict(), path, _use_new_zipfile_serialization=False),
    "torchscript": save_script,
}


@pytest.fixture
def marker(tmp_path) -> Path:
    return tmp_path / "harm-was-done"


class Harm:
    """Its pickle calls a function of the operating system."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        import os

        return os.mkdir, (str(self.marker),)


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_every_published_format_gives_the_state_dict(tmp_path, write):
    write(tmp_path / "c.pth")
    read = read_checkpoint(tmp_path / "c.pth")
    assert set(read.arrays) - {"1.num_batches_tracked"} == set(STATE) - {"1.num_batches_tracked"}
    for name, array in read.arrays.items():
        np.testing.assert_array_equal(array, STATE[name])
        assert array.dtype == STATE[name].dtype


@pytest.mark.parametrize("legacy", [False, True], ids=["zip", "older stream"])
def test_training_checkpoints_with_a_state_dict_inside_and_parallel_names(tmp_path, legacy):
    parallel = OrderedDict((f"module.{name}", tensor) for name, tensor in NETWORK.state_dict().items())
    saved = {"epoch": 40, "state_dict": parallel, "best": 0.04}
    torch.save(saved, tmp_path / "c.pth.tar", _use_new_zipfile_serialization=not legacy)
    assert set(read_checkpoint(tmp_path / "c.pth.tar").arrays) == set(STATE)


def test_parameters_views_and_other_number_types_are_read(tmp_path):
    numbers = torch.arange(24.0).reshape(4, 6)
    tensors = {
        "parameter": torch.nn.Parameter(numbers),
        "turned": numbers.T,
        "part": numbers[1:3, ::2],
        "half": numbers.half(),
        "whole": numbers.long(),
        "double": numbers.double(),
        "single": torch.tensor(3.5),
        "empty": torch.zeros(0, 5),
    }
    torch.save(tensors, tmp_path / "c.pth")
    read = read_checkpoint(tmp_path / "c.pth").arrays
    for name, tensor in tensors.items():
        np.testing.assert_array_equal(read[name], tensor.detach().numpy())
        assert read[name].dtype == tensor.detach().numpy().dtype
        assert read[name].shape == tuple(tensor.shape)


def test_the_source_and_its_sha_256_are_kept(tmp_path):
    import hashlib

    path = tmp_path / "3DFAN4.pth.tar"
    torch.save(NETWORK.state_dict(), path)
    sha = hashlib.sha256(path.read_bytes()).hexdigest()
    assert read_checkpoint(path).metadata == {"source": "3DFAN4.pth.tar", "source_sha256": sha}


def test_a_safetensors_file_comes_back_as_it_is(tmp_path):
    write_weights(tmp_path / "w.safetensors", {"a": np.ones(3, np.float32)}, {"source": "elsewhere"})
    read = read_checkpoint(tmp_path / "w.safetensors")
    assert (set(read.arrays), read.metadata) == ({"a"}, {"source": "elsewhere"})


# --- files that mean harm -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("legacy", [False, True], ids=["zip", "older stream"])
def test_code_in_a_checkpoint_is_not_run(tmp_path, marker, legacy):
    path = tmp_path / "c.pth"
    torch.save({"a": torch.ones(2), "harm": Harm(marker)}, path, _use_new_zipfile_serialization=not legacy)
    read = read_checkpoint(path)
    np.testing.assert_array_equal(read.arrays["a"], [1, 1])
    assert set(read.arrays) == {"a"}
    assert not marker.exists()
    torch.load(path, weights_only=False)  # the harm is real
    assert marker.is_dir()


def test_a_pickle_that_only_means_harm_is_refused_unrun(tmp_path, marker):
    (tmp_path / "c.pth").write_bytes(pickle.dumps(Harm(marker)))
    with pytest.raises(InputError, match="cannot be read as a PyTorch checkpoint"):
        read_checkpoint(tmp_path / "c.pth")
    assert not marker.exists()


def zip_of(path: Path, structure: bytes, storages: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("c/data.pkl", structure)
        for key, data in storages.items():
            archive.writestr(f"c/data/{key}", data)
    return path


def tensor_pickle(offset: int, shape: str, stride: str, count: int = 4, kind: str = "FloatStorage") -> bytes:
    """A state dict {"w": tensor} in pickle's text opcodes."""
    storage = f"(S'storage'\nctorch\n{kind}\nS'0'\nS'cpu'\nI{count}\ntQ"
    return f"}}S'w'\nctorch._utils\n_rebuild_tensor_v2\n({storage}I{offset}\n{shape}{stride}I00\nNtRs.".encode()


def pair(first: int, second: int) -> str:
    return f"(I{first}\nI{second}\nt"


FOUR = np.arange(4, dtype="<f4").tobytes()


def test_the_hand_written_pickle_of_these_tests_is_one(tmp_path):
    path = zip_of(tmp_path / "c.zip", tensor_pickle(0, pair(2, 2), pair(2, 1)), {"0": FOUR})
    np.testing.assert_array_equal(read_checkpoint(path).arrays["w"], [[0, 1], [2, 3]])


@pytest.mark.parametrize(
    ("structure", "told"),
    [
        (tensor_pickle(1, pair(2, 2), pair(2, 1)), "reaches beyond its storage of 4 numbers"),
        (tensor_pickle(0, pair(2, 2), pair(200000000, 1)), "reaches beyond its storage"),
        (tensor_pickle(0, pair(100000, 100000), pair(0, 0)), "reaches beyond its storage"),
        (tensor_pickle(0, pair(2, 2), pair(-2, 1)), "an invalid shape"),
        (tensor_pickle(-4, pair(2, 2), pair(2, 1)), "an invalid shape"),
        (tensor_pickle(0, pair(2, 2), "(I1\nt"), "an invalid shape"),
        (tensor_pickle(0, pair(2, 2), pair(2, 1), count=5), "storage 0 of 5 numbers has 16 bytes: it is cut off"),
        (tensor_pickle(0, pair(2, 2), pair(2, 1), count=-1), "storage 0 of -1 numbers has 16 bytes"),
        (tensor_pickle(0, pair(2, 2), pair(2, 1), kind="QUInt8Storage"), "numbers of the kind QUInt8Storage"),
        (tensor_pickle(0, pair(2, 2), pair(2, 1)).replace(b"S'0'", b"S'7'"), "storage 7 of 4 numbers is missing"),
        (b"S'nothing'\nQ.", "not the storage of a tensor"),
        (b"}.", "holds no tensors by name"),
        (b"]q\x00h\x00a.", "holds no tensors by name"),
        (b"}q\x00S'again'\nh\x00s.", "nested without end"),
        (b"}" + b"S'a'\n}S'b'\n" * 50 + b"s" * 50 + b".", "holds no tensors|broken|nested"),
        (b"\x80\x04]\x94(h\x00e", "cannot be read"),
        (b"tR.", "cannot be read"),
        (b"(ios\nsystem\n.", "opcode INST"),
    ],
)
def test_structures_that_no_state_dict_has_are_refused(tmp_path, structure, told):
    path = zip_of(tmp_path / "c.zip", structure, {"0": FOUR})
    with pytest.raises(InputError, match=told):
        read_checkpoint(path)


def test_a_structure_that_doubles_at_every_level_is_refused_soon(tmp_path):
    """2⁶⁰ paths in a few hundred bytes."""
    doubled = b"}q\x00" + b"".join(b"}q%c(S'a'\nh%cS'b'\nh%cu" % (n, n - 1, n - 1) for n in range(1, 36)) + b"."
    path = zip_of(tmp_path / "c.zip", doubled, {})
    with pytest.raises(InputError, match="nested without end"):
        read_checkpoint(path)


def test_keys_that_would_take_for_ever_to_hash_are_left_out(tmp_path):
    doubled = b"((K\x01K\x02tq\x00" + b"".join(b"h%ch%c\x86q%c" % (n - 1, n - 1, n) for n in range(1, 60)) + b"l"
    path = zip_of(tmp_path / "c.zip", doubled + b"}h\x3bNs.", {})
    with pytest.raises(InputError, match="holds no tensors by name"):
        read_checkpoint(path)


# --- damaged and other files --------------------------------------------------------------------------------------


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
@pytest.mark.parametrize("kept", [0.02, 0.3, 0.7, 0.999])
def test_a_checkpoint_that_was_cut_off_is_told(tmp_path, write, kept):
    path = tmp_path / "c.pth"
    write(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    with pytest.raises(InputError, match=r"c\.pth cannot be read as a PyTorch checkpoint .* supply a state dict"):
        read_checkpoint(path)


@pytest.mark.parametrize("name", WRITERS)
@settings(max_examples=60)
@given(data=st.data())
def test_no_damage_leads_to_anything_but_arrays_or_an_input_error(tmp_path_factory, name, data):
    folder = tmp_path_factory.getbasetemp() / f"damage-{name.replace(' ', '-')}"
    folder.mkdir(exist_ok=True)
    whole, path = folder / "whole.pth", folder / "damaged.pth"
    if not whole.exists():
        WRITERS[name](whole)
    content = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    with suppress(InputError):
        assert all(isinstance(array, np.ndarray) for array in read_checkpoint(path).arrays.values())


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "it begins with b''"),
        (b"<!DOCTYPE html><html>", "it begins with b'<!DOCTYPE ht'"),
        (b"\x89PNG\r\n\x1a\n" + b"\0" * 50, "it begins with"),
        (pickle.dumps({"a": 1}), "it begins with"),
        (b"PK\x03\x04 and no zip file", "not a zip file"),
    ],
    ids=["empty", "web page", "picture", "other pickle", "no zip file"],
)
def test_another_kind_of_file_is_told(tmp_path, content, told):
    (tmp_path / "c.pth").write_bytes(content)
    with pytest.raises(InputError, match=told):
        read_checkpoint(tmp_path / "c.pth")


def test_a_zip_file_without_a_checkpoint_is_told(tmp_path):
    with zipfile.ZipFile(tmp_path / "c.zip", "w") as archive:
        archive.writestr("readme.txt", "hello")
    with pytest.raises(InputError, match=r"a zip file without the data\.pkl of PyTorch"):
        read_checkpoint(tmp_path / "c.zip")


def test_entries_on_top_of_each_other_are_told(tmp_path):
    path = zip_of(tmp_path / "c.zip", tensor_pickle(0, pair(2, 2), pair(2, 1)), {"0": b"\0" * 10_000})
    with zipfile.ZipFile(path) as archive:
        listed = archive.infolist()
    with zipfile.ZipFile(path, "a") as archive:
        # Many names for one storage: a small file may stand for more than there is memory.
        archive.filelist += [copy(listed[-1]) for _ in range(100)]
        archive._didModify = True
    with pytest.raises(InputError, match="entries overlap"):
        read_checkpoint(path)


def test_a_big_endian_checkpoint_is_told(tmp_path):
    path = zip_of(tmp_path / "c.zip", tensor_pickle(0, pair(2, 2), pair(2, 1)), {"0": b"\0" * 16})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("c/byteorder", "big")
    with pytest.raises(InputError, match="big-endian"):
        read_checkpoint(path)


def test_numbers_that_belong_to_no_tensor_are_told(tmp_path):
    path = tmp_path / "c.pth"
    torch.save([torch.ones(2), {"a": torch.ones(3)}], path, _use_new_zipfile_serialization=False)
    with pytest.raises(InputError, match="holds no tensors by name"):
        read_checkpoint(path)
    torch.save({"a": torch.ones(3), "b": [torch.ones(2)]}, path, _use_new_zipfile_serialization=False)
    with pytest.raises(InputError, match="belong to no tensor"):
        read_checkpoint(path)


def test_an_absent_file_is_told(tmp_path):
    with pytest.raises(InputError, match="there is no weights file"):
        read_checkpoint(tmp_path / "nowhere.pth")
