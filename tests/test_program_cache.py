"""Compiled programs on a full disk, damaged or in the way: one line names the folder, and the next start is well."""

import os
import subprocess
import sys

import pytest

COMPILING = """
import workbench, jax, jax.numpy as jnp
from concurrent.futures import ThreadPoolExecutor
with ThreadPoolExecutor(4) as threads:
    list(threads.map(lambda factor: jax.jit(lambda x: jnp.sin(x) * factor)(jnp.ones(3)), range(6)))
"""
"""Several programs of one name and some of others, at once."""


@pytest.fixture
def start(tmp_path, monkeypatch):
    """Compile in a fresh Python, in the folder of that test: what it says on standard error, line by line."""
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("WORKBENCH_CACHE", str(tmp_path))

    def compile_all(code: str = COMPILING, most_bytes: int | None = None) -> list[str]:
        limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({most_bytes}, {most_bytes}))\n"
        command = [sys.executable, "-c", code if most_bytes is None else limit + code]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stderr.splitlines()

    return compile_all


@pytest.fixture
def programs(tmp_path):
    """Where the workbench keeps them."""
    return tmp_path / "face-energy-workbench" / "jax"


def cut_off(folder):
    """Cut every entry off; their names."""
    entries = sorted(folder.iterdir())
    for number, entry in enumerate(entries):
        os.truncate(entry, 100 * (number % 2))
    return [entry.name for entry in entries]


def test_a_full_disk_is_told_in_a_line_and_forgotten_once_there_is_room(start, programs):
    (told,) = start(most_bytes=1000)
    assert f"{programs}, cannot be used (File too large)" in told
    assert told.endswith("see that it can be written to and has room, or name another by WORKBENCH_CACHE.")
    assert all(entry.stat().st_size for entry in programs.iterdir())
    assert start() == []


def test_damaged_programs_are_made_again_at_one_start(start, programs):
    assert start() == []
    names = cut_off(programs)
    assert len(names) > 6
    (told,) = start()
    assert told.startswith(f"Some compiled programs in {programs} are damaged (")
    assert told.endswith(") and are compiled again.")
    assert sorted(entry.name for entry in programs.iterdir()) == names
    assert start() == []


def test_programs_of_other_names_stay(start, programs):
    start()
    other = programs / f"jit_other-{'0' * 64}-cache"
    other.write_bytes(b"kept")
    cut_off(programs)
    other.write_bytes(b"kept")
    start()
    assert other.read_bytes() == b"kept"


def test_a_folder_that_the_user_has_set_is_left_as_it_is(start, tmp_path, monkeypatch):
    folder = tmp_path / "mine"
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(folder))
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    start()
    cut_off(folder)
    before = {entry.name: entry.read_bytes() for entry in folder.iterdir()}
    (told,) = start()
    assert str(folder) in told
    assert told.endswith("; empty that folder.")
    assert {entry.name: entry.read_bytes() for entry in folder.iterdir()} == before


def test_a_file_in_the_place_of_the_folder_is_told_in_a_line(start, programs):
    programs.parent.mkdir()
    programs.write_text("mine")
    (told,) = start()
    assert f"{programs}, cannot be used (File exists)" in told
    assert programs.read_text() == "mine"


def test_other_warnings_are_shown_as_ever(start):
    said = start("import workbench, jax, warnings; warnings.warn('Look here')")
    assert said[0].endswith("UserWarning: Look here")
