"""Every notebook runs from top to bottom in a fresh kernel, shows its pictures, and leaves the repository alone."""

import base64
import io

import nbformat
import numpy as np
import pytest
from PIL import Image

from tests import browser
from tests.notebook_runs import NOTEBOOKS, ROOT, ruler, run_notebook
from workbench.config import preset
from workbench.samples import sample
from workbench.session import open_session

LEAST_PICTURES = {
    "00_quickstart": 4,
    "01_face_it_step_by_step": 20,
    "02_the_workbench": 5,
    "03_the_beta_trap": 5,
    "04_rho_and_epsilon": 6,
    "05_tau_and_jitter": 5,
    "06_why_a_frame_fails": 8,
    "07_rendering_and_light": 13,
    "08_what_the_network_sees": 13,
    "09_deep_energies_on_one_frame": 11,
    "10_workbench_app": 0,  # the panel alone
    "11_other_programs_other_faces": 4,
    "12_two_cameras": 6,
    "13_optical_flow_and_infill": 9,
    "14_temporal_refinement": 10,
    "15_live": 2,
    "16_face_it_remade": 8,
    "17_deep_energies_remade": 8,
    "18_deep_energies_through_time": 11,
    "19_let_the_data_choose": 4,
    "20_what_68_points_cannot_see": 5,
}
APP = "10_workbench_app"
"""No part of the path: `workbench app` shows it as a page."""
EXERCISES = (
    "03_the_beta_trap",
    "04_rho_and_epsilon",
    "05_tau_and_jitter",
    "06_why_a_frame_fails",
    "09_deep_energies_on_one_frame",
    "13_optical_flow_and_infill",
)
MOST_SCREENS = {"01_face_it_step_by_step": 35}
"""Of a window of 1366 × 768 pixels: the first paper from end to end, and `OTHER_SCREENS` for any other notebook."""
OTHER_SCREENS = 15


def bounds_hold_and_the_step_does_not(rows):
    """Notebook 03: where the fit starts outside, E_β leaves weights there, bounds none."""
    assert int(rows["bounds"][0]) == 0
    assert int(rows["ω_β = 1"][0]) > 5


def a_second_camera_locates_the_head(rows):
    """Notebook 12: the position error falls to less than half."""
    one, two = (float(cell) for cell in rows["position, mm"][:2])
    assert two < 0.5 * one


def more_points_help_if_their_errors_are_independent(rows):
    """Notebook 20: with independent errors all three improve; with the network's, rotation and shape, not weights."""
    ratios = {
        errors: np.array(rows[f"377, {errors}"], float) / np.array(rows[f"68, {errors}"], float)
        for errors in ("the network's", "independent noise")
    }
    assert (ratios["independent noise"] < 0.7).all()
    weights, rotation, shape = ratios["the network's"]
    assert weights > 0.95
    assert max(rotation, shape) < 0.85


def a_prior_shares_out_what_is_seen(rows):
    """Notebook 20: the usual prior moves cheeks that few shapes leave at rest, less so with the network's points, with
    which it errs more; symmetry halves how lopsided faces are at no cost."""
    found = {name: np.array(cells, float) for name, cells in rows.items() if name != "truth"}
    weights, lopsided, cheeks = 0, 1, 2
    for points in ("exact", "the network's"):
        few, even, usual = (found[f"{points}, {prior}"] for prior in ("few", "few, both sides alike", "usual"))
        assert few[cheeks] < 0.02 < usual[cheeks]
        assert even[lopsided] < 0.7 * few[lopsided]
        assert even[weights] < 1.05 * few[weights]
    assert found["the network's, usual"][cheeks] < 0.75 * found["exact, usual"][cheeks]
    assert found["exact, usual"][cheeks] > 0.1
    assert found["exact, usual"][weights] < 1.05 * found["exact, few"][weights]
    assert found["the network's, usual"][weights] > 1.05 * found["the network's, few"][weights]


CONCLUSIONS = {
    "03_the_beta_trap": {"from outside": bounds_hold_and_the_step_does_not},
    "12_two_cameras": {"mean error of four frames": a_second_camera_locates_the_head},
    "20_what_68_points_cannot_see": {
        "points and errors": more_points_help_if_their_errors_are_independent,
        "points and prior": a_prior_shares_out_what_is_seen,
    },
}
"""What the text around a table concludes: the head of its first column, and the check of its rows."""


@pytest.fixture
def kernel_environment(monkeypatch):
    """The kernel finds this checkout from any folder, and draws figures as a notebook does."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.delenv("MPLBACKEND", raising=False)


def is_blank(output) -> bool:
    """Whether a picture is of one colour."""
    picture = Image.open(io.BytesIO(base64.b64decode(output["data"]["image/png"])))
    return len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0)) < 2


def table(outputs, title: str) -> dict[str, list[str]]:
    """The other cells of each row by its first one, of the table whose first column is called so."""
    texts = [output["data"]["text/markdown"] for output in outputs if "text/markdown" in output.get("data", {})]
    lines = next(text for text in texts if text.split("|")[1].strip() == title).splitlines()
    rows = [[cell.strip() for cell in line.strip("| ").split("|")] for line in lines[2:] if line.strip()]
    return {row[0]: row[1:] for row in rows}


def test_the_learning_path_has_its_notebooks():
    assert set(LEAST_PICTURES) == {path.stem for path in NOTEBOOKS}


def test_the_failing_frame_of_the_sixth_notebook_is_mended_by_its_first_reason():
    config = preset("face-it").changed(
        weights={"beta": 0.0, "sigma": 0.01},
        solver={"bounded": True},
        landmarks={"confidence": True},
        camera={"fov_deg": 33.0},
    )
    session = open_session(sample("glasses"), config, landmarks=sample("glasses-landmarks"))
    before = session.fit_clip()
    frame = int((before.expression > 0.999).sum(axis=1).argmax())
    reasons = session.diagnose(frame).reasons
    assert reasons[0].code == "wrong_identity"
    session.apply(reasons[0].change, frame)
    after = session.fit_clip()
    assert after[frame].errors[2] < 0.7 * before[frame].errors[2]
    assert (after.expression > 0.5).sum() < 0.8 * (before.expression > 0.5).sum()
    # No landmark sees the tongue, so no remedy sticks it out.
    tongue = session.model.expression_names.index("tongueOut")
    assert not before.expression[:, tongue].any()
    assert not after.expression[:, tongue].any()
    for change in (reason.change for reason in reasons[1:] if reason.change is not None):
        session.undo()
        session.apply(change, frame)
        assert session.fit_frame(frame).expression[tongue] == 0.0, change.label


# The later ones take longest: begun last, one would leave the other processes idle.
@pytest.mark.notebook
@pytest.mark.parametrize("path", NOTEBOOKS[::-1], ids=lambda path: path.stem)
def test_a_notebook_runs_without_errors_and_shows_pictures(path, tmp_path, kernel_environment):
    stored = path.read_bytes()
    run = run_notebook(path, tmp_path)
    outputs = run.outputs
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) >= LEAST_PICTURES[path.stem]
    assert [number for number, picture in enumerate(pictures) if is_blank(picture)] == []
    for title, holds in CONCLUSIONS.get(path.stem, {}).items():
        holds(table(outputs, title))
    assert [output.text for output in outputs if output.get("name") == "stderr"] == []
    assert path.read_bytes() == stored
    if not browser.missing():
        with ruler() as measure:
            assert measure.screens(run.notebook) <= MOST_SCREENS.get(path.stem, OTHER_SCREENS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_opens_with_what_you_need_and_what_you_get(path):
    first = nbformat.read(path, as_version=4).cells[0]
    assert first.cell_type == "markdown"
    assert first.source.startswith("# ")
    assert "**You need**" in first.source
    assert "**You get**" in first.source


def cells_of(path):
    return nbformat.read(path, as_version=4).cells


def tagged(cells, tag):
    return [cell for cell in cells if tag in cell.metadata.get("tags", ())]


def titled(path):
    """A notebook's number and title, as links call it."""
    return f"{path.stem[:2]} · {cells_of(path)[0].source.splitlines()[0].removeprefix('# ')}"


def test_the_index_lists_every_notebook_and_the_quickstart_ends_with_it():
    index = (ROOT / "notebooks" / "README.md").read_text(encoding="utf-8")
    for path in NOTEBOOKS:
        assert f"| [{titled(path)}]({path.name}) |" in index
    assert index.count(".ipynb)") == len(NOTEBOOKS)
    last = cells_of(NOTEBOOKS[0])[-2].source
    assert last.partition("\n\n")[0] == "## All notebooks"
    assert last.partition("\n\n")[2] in index


def test_each_notebook_leads_to_the_one_before_and_the_one_after():
    path = [each for each in NOTEBOOKS if each.stem != APP]
    for before, here, after in zip([None, *path], path, [*path[1:], None], strict=False):
        cells = cells_of(here)
        way_in, way_on = tagged(cells, "navigation")
        assert (way_in, way_on) == (cells[1], cells[-1])
        assert way_in.source == way_on.source
        for other in (before, after):
            assert other is None or f"[{titled(other)}]({other.name})" in way_in.source
        assert "[all notebooks](" in way_in.source


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_no_notebook_shows_a_wall_of_imports(path):
    for cell in cells_of(path):
        lines = cell.source.splitlines()
        imports = sum(line.startswith(("import ", "from ")) for line in lines)
        folded = cell.metadata.get("jupyter", {}).get("source_hidden", False)
        assert cell.cell_type != "code" or folded or imports <= 4


@pytest.mark.parametrize("name", EXERCISES)
def test_an_exercise_has_a_solution_that_is_folded_away(name):
    cells = cells_of(ROOT / "notebooks" / f"{name}.ipynb")
    exercise, solution, answer = (tagged(cells, tag) for tag in ("exercise", "solution", "answer"))
    assert len(exercise) == len(solution) == len(answer) == 1
    place = cells.index(exercise[0])
    assert cells[place : place + 3] == [exercise[0], solution[0], answer[0]]
    assert solution[0].metadata["jupyter"] == {"source_hidden": True, "outputs_hidden": True}
    assert solution[0].cell_type == "code"  # which the test that runs notebooks runs too
    assert answer[0].source.startswith("<details>")
