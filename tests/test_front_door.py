"""`import workbench` is light, its names load when they are used, and JAX counts in double precision all the same."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import workbench

PACKAGE = Path(workbench.__file__).parent
LAZY = sorted(path.parent for path in PACKAGE.rglob("__init__.pyi"))
HEAVY = (
    "jax", "numpy", "scipy", "cv2", "av", "PIL", "trimesh", "networkx", "h5py", "matplotlib", "vtkmodules", "pyvista",
    "optimistix", "pydantic", "IPython", "ipywidgets", "pygltflib", "pxr", "torch",
)  # fmt: skip


def module_name(folder: Path) -> str:
    return ".".join(folder.relative_to(PACKAGE.parent).parts)


def promised(folder: Path) -> set[str]:
    """The names that a package's stub imports."""
    body = ast.parse((folder / "__init__.pyi").read_text(encoding="utf-8")).body
    return {alias.asname for node in body if isinstance(node, ast.ImportFrom) for alias in node.names}


def output_of(code: str, *options: str) -> str:
    """What a fresh Python prints."""
    done = subprocess.run([sys.executable, *options, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_import_loads_nothing_heavy():
    loaded = output_of("import sys, workbench; print(*sys.modules)").split()
    assert "workbench" in loaded
    assert not set(HEAVY) & set(loaded)


def test_a_configuration_is_read_without_jax_and_without_pictures():
    loaded = output_of("import sys, workbench; workbench.preset('joint'); print(*sys.modules)").split()
    assert not {"jax", "cv2", "matplotlib", "trimesh", "vtkmodules"} & set(loaded)


def test_reading_a_track_needs_no_solver_and_no_drawing():
    loaded = output_of("import sys; from workbench import Track; print(*sys.modules)").split()
    assert not {"optimistix", "matplotlib", "trimesh", "vtkmodules", "IPython"} & set(loaded)


FIRST_FRAME = """
import asyncio, sys
from workbench import sample
from workbench.session import open_session
from workbench.widgets import TuningPanel

async def cell():
    panel = TuningPanel(open_session(sample("laugh"), landmarks=sample("laugh-landmarks")))
    print(*sys.modules)
    print(len(panel.children))
    print(panel.frame, panel.transport.speed.value, len(panel.children) > 2)

asyncio.run(cell())
"""
"""A cell with a panel, in a loop as in a kernel: what is loaded for its first frame, then what a part that is asked for
brings."""


def test_the_first_frame_of_a_clip_needs_none_of_what_computes():
    loaded, shown, asked = output_of(FIRST_FRAME).splitlines()
    assert not {"jax", "scipy", "matplotlib", "onnxruntime", "vtkmodules", "workbench.session.session_work"} & set(
        loaded.split()
    )
    assert int(shown) == 2  # the style and the picture
    assert asked == "0 1.0 True"


@pytest.mark.parametrize(
    "code",
    [
        "import workbench; import jax.numpy as jnp",
        "import jax.numpy as jnp; import workbench",
        "import workbench.energies; import jax.numpy as jnp",
        "import workbench, importlib.util; importlib.util.find_spec('jax'); import jax.numpy as jnp",
        "from workbench.config import Config; from jax import numpy as jnp",
    ],
)
def test_jax_counts_in_double_precision_whatever_is_imported_first(code):
    assert output_of(f"{code}; print(jnp.arange(3.0).dtype)") == "float64"


@pytest.mark.parametrize(
    ("first", "user", "threads"),
    [("import workbench", None, "1"), ("import workbench", "3", "3"), ("import numpy, workbench", None, "None")],
)
def test_blas_uses_one_thread_unless_numpy_is_there_or_the_user_has_chosen(monkeypatch, first, user, threads):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if user is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", user)
    assert output_of(f"{first}; import os; print(os.environ.get('OPENBLAS_NUM_THREADS'))") == threads


def test_what_the_user_set_of_the_compilation_cache_stays():
    code = "import workbench, jax; print(jax.config.jax_compilation_cache_dir)"
    setting = "import os; os.environ['JAX_COMPILATION_CACHE_DIR'] = '/somewhere'; "
    assert output_of(setting + code) == "/somewhere"


@pytest.mark.parametrize("folder", LAZY, ids=module_name)
def test_every_promised_name_is_listed_and_resolves_to_what_its_module_holds(folder):
    package = importlib.import_module(module_name(folder))
    assert promised(folder) == set(package.__all__) <= set(dir(package))
    for node in ast.parse((folder / "__init__.pyi").read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.ImportFrom):
            continue
        for alias in node.names:
            whole = ".".join(filter(None, [package.__name__, node.module]))
            kept = getattr(importlib.import_module(whole), alias.name)
            assert getattr(package, alias.asname) is kept


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = workbench.no_such_thing


def test_functions_named_like_their_module_stay_functions():
    code = "import workbench.face.landmark_model; from workbench.face import landmark_model; print(landmark_model)"
    assert output_of(code).startswith("<function landmark_model")


def test_types_and_completion_are_told_of_the_stubs():
    assert (PACKAGE / "py.typed").is_file()
    assert "__version__: str" in (PACKAGE / "__init__.pyi").read_text(encoding="utf-8")


@pytest.mark.parametrize("command", ["--help", "config show"])
def test_the_command_line_tells_of_itself_without_jax_and_without_pictures(command):
    run = f"import sys; from workbench.cli import app; app({command.split()}, standalone_mode=False)"
    loaded = output_of(f"{run}; print('LOADED', *sys.modules)").rpartition("LOADED")[2].split()
    assert "workbench.cli" in loaded
    assert not {"jax", "scipy", "cv2", "matplotlib", "trimesh", "vtkmodules"} & set(loaded)
