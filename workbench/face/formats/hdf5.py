"""Arrays from HDF5 files, read in a process of its own: some damaged files crash the HDF5 library, or never end."""

import os
import subprocess
import sys
from collections.abc import Collection
from io import BytesIO
from pathlib import Path

import numpy as np

from workbench.extras import needs
from workbench.reading import MOST_UNPACKED_BYTES, checked_arrays

LEAST_S, BYTES_PER_S = 5.0, 5e6
"""How long reading may take: this long for a small file, and a slow disk's time for a large one."""
START_S = 60.0
"""How long the other process may take to start."""


def hdf5_arrays(path: Path, wanted: Collection[str]) -> dict[str, np.ndarray]:
    """The wanted data sets that the file has, of numbers or one text (its bytes). Raises ValueError for damage.

    Links, numbers in other files, and lengths beyond what the file holds or `MOST_UNPACKED_BYTES` are refused. Raises
    `MissingDependencyError` without h5py.
    """
    with needs("formats"):
        from workbench.face.formats import hdf5_process  # here: it imports h5py

    seconds = LEAST_S + path.stat().st_size / BYTES_PER_S
    program = Path(hdf5_process.__file__)
    ended = subprocess.run(
        [sys.executable, "-P", str(program), str(MOST_UNPACKED_BYTES), str(seconds), str(path.absolute()), *wanted],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        timeout=START_S + seconds,
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        check=False,
    )
    if ended.returncode == hdf5_process.REFUSED:
        raise ValueError(ended.stderr.decode(errors="replace").strip())
    if ended.returncode:
        raise ValueError("the HDF5 library crashed on it or did not finish")
    with checked_arrays(BytesIO(ended.stdout)) as stored:
        return {key: stored[key] for key in stored.files}
