"""Quantise the head and write it as a byte-for-byte reproducible npz."""

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

EPOCH = (1980, 1, 1, 0, 0, 0)


def quantised(values: np.ndarray, step: float) -> np.ndarray:
    """Nearest multiples of `step` as int16; rounding is odd-symmetric, so mirror images stay mirror images."""
    steps = np.rint(values / step)
    if np.abs(steps).max() > np.iinfo(np.int16).max:
        raise OverflowError(f"values up to {np.abs(values).max():.1f} do not fit int16 in steps of {step}")
    return steps.astype(np.int16)


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Like np.savez_compressed, with sorted members and a fixed time stamp, written whole or not at all."""
    temporary = path.with_name(f".{path.name}.part")
    try:
        with zipfile.ZipFile(temporary, "w") as archive:
            for name in sorted(arrays):
                member = io.BytesIO()
                np.lib.format.write_array(member, np.asarray(arrays[name], order="C"), allow_pickle=False)
                info = zipfile.ZipInfo(f"{name}.npy", date_time=EPOCH)
                info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                archive.writestr(info, member.getvalue(), compresslevel=9)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
