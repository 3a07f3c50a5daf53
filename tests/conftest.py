"""Shared set-up: one compilation cache for the whole run, shared models."""

import os
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "agg")

import jax
import pytest
from hypothesis import settings

import workbench  # noqa: F401  (sets JAX up before any test does)

CACHE = Path(__file__).resolve().parent.parent / ".cache" / "jax"
jax.config.update("jax_compilation_cache_dir", str(CACHE))

# Hypothesis draws the same examples on every machine; compiled functions make the first call slow.
settings.register_profile("workbench", derandomize=True, deadline=None, max_examples=40)
settings.load_profile("workbench")


@pytest.fixture(scope="session")
def head():
    """The default head with FACE IT!'s 44 blendshapes."""
    from workbench.face import load_default_head

    return load_default_head()
