"""Every notebook runs from top to bottom in a fresh kernel, shows its pictures, and leaves the repository alone."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LEAST_PICTURES = {
    "00_quickstart": 4,
    "01_face_it_step_by_step": 20,
    "02_the_workbench": 5,
    "03_the_beta_trap": 5,
    "04_rho_and_epsilon": 6,
    "05_tau_and_jitter": 5,
    "06_why_a_frame_fails": 8,
}
TIMEOUT_S = 300


@pytest.fixture
def kernel_environment(monkeypatch):
    """The kernel finds this checkout from any folder, and draws figures as a notebook does."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.delenv("MPLBACKEND", raising=False)


def test_the_learning_path_has_its_notebooks():
    assert set(LEAST_PICTURES) <= {path.stem for path in NOTEBOOKS}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_without_errors_and_shows_pictures(path, tmp_path, kernel_environment):
    stored = path.read_bytes()
    notebook = nbformat.reads(stored.decode(), as_version=4)
    client = NotebookClient(
        notebook, timeout=TIMEOUT_S, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) >= LEAST_PICTURES.get(path.stem, 1)
    assert [output.text for output in outputs if output.get("name") == "stderr"] == []
    assert path.read_bytes() == stored


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_opens_with_what_it_uses_and_what_comes_out(path):
    first = nbformat.read(path, as_version=4).cells[0]
    assert first.cell_type == "markdown"
    assert first.source.startswith("# ")
    assert "**Uses**" in first.source
    assert "**Comes out**" in first.source
