"""A stored track is read frame by frame, as it is read at once."""

import json

import numpy as np
import pytest

from tests.performances import performance
from workbench.errors import InputError
from workbench.tracking import Track
from workbench.tracking import track_reader as track_reader_module
from workbench.tracking.records import ARRAYS, stack_fits
from workbench.tracking.track_reader import TrackReader


@pytest.fixture
def stored(head, tmp_path):
    performance(head).save(tmp_path / "track.npz")
    return tmp_path / "track.npz"


@pytest.mark.parametrize("block", [1, 4, 256])
def test_frames_are_those_of_the_whole_track(stored, monkeypatch, block):
    monkeypatch.setattr(track_reader_module, "BLOCK_FRAMES", block)
    whole, reader = Track.load(stored), TrackReader(stored)
    assert len(reader) == len(whole)
    assert reader.meta == whole.meta
    for _ in range(2):
        read = stack_fits(list(reader))
        for name in ARRAYS:
            assert np.array_equal(read[name], getattr(whole, name), equal_nan=read[name].dtype.kind == "f"), name


def test_tracks_of_older_versions_are_read(stored, tmp_path):
    with np.load(stored, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files if name not in ("jaw", "scale", "failure")}
    meta = json.loads(arrays["meta"].item()) | {"format_version": 1}
    arrays["meta"] = np.array(json.dumps(meta))
    np.savez_compressed(tmp_path / "old.npz", **arrays)
    old = [*TrackReader(tmp_path / "old.npz")]
    assert all(fit.scale == 1.0 and not fit.jaw.any() and fit.failure == "" for fit in old)


def test_what_is_no_track_is_refused(stored, tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        TrackReader(tmp_path / "none.npz")
    (tmp_path / "broken.npz").write_bytes(stored.read_bytes()[:2000])
    with pytest.raises(InputError, match="damaged or no workbench track"):
        TrackReader(tmp_path / "broken.npz")
    np.savez(tmp_path / "other.npz", meta=np.array('{"format": "other"}'), index=np.arange(3))
    with pytest.raises(InputError, match="no workbench track"):
        TrackReader(tmp_path / "other.npz")
    newer = json.dumps({"format": "face-energy-workbench-track", "format_version": 99})
    np.savez(tmp_path / "newer.npz", meta=np.array(newer), index=np.arange(3))
    with pytest.raises(InputError, match="newer workbench"):
        TrackReader(tmp_path / "newer.npz")
