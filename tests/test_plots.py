"""Figures of the notebooks: what they show, and that pictures keep their pixels."""

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg

from workbench import plots
from workbench.config import PRESETS
from workbench.energies import EnergyConstants
from workbench.frames import read_picture
from workbench.geometry import project, rotation_matrix
from workbench.landmarks.files import read_landmark_file
from workbench.samples import sample
from workbench.tracking import FaceTracker, FrameObservation


@pytest.fixture(scope="module")
def portrait(head):
    landmarks = next(read_landmark_file(sample("astronaut-landmarks"))).landmarks
    fit = FaceTracker(head, PRESETS["calibrated"], stills=True).push(FrameObservation(0, landmarks, (512, 512)))[0]
    return read_picture(sample("astronaut")), fit


def drawn(figure) -> np.ndarray:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def test_a_close_up_shows_the_face_larger_and_keeps_fit_and_picture_together(portrait):
    picture, fit = portrait
    cut, moved = plots.close_up(picture, fit, 400)
    assert cut.shape == (400, 400, 3)
    assert moved.observed.min() > 0
    assert moved.observed.max() < 399
    assert np.ptp(moved.observed[:, 0]) > 2.5 * np.ptp(fit.observed[:, 0])
    eye = np.rint(fit.observed[36]).astype(int)
    there = np.rint(moved.observed[36]).astype(int)
    assert np.abs(picture[eye[1], eye[0]].astype(int) - cut[there[1], there[0]]).max() < 40


def test_the_camera_of_a_close_up_projects_the_head_to_the_moved_points(head, portrait):
    picture, fit = portrait
    _, moved = plots.close_up(picture, fit, 400)
    origin = rotation_matrix(fit.rotation) @ np.zeros(3) + fit.translation
    before, after = (np.asarray(project(each.camera, origin[None]))[0] for each in (fit, moved))
    scale = np.ptp(moved.projected[:, 0]) / np.ptp(fit.projected[:, 0])
    np.testing.assert_allclose(after - moved.projected[30], scale * (before - fit.projected[30]), atol=1e-6)


def test_pictures_in_a_row_keep_their_pixels():
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 256, (60, 80, 3), np.uint8) for _ in range(3)]
    shown = drawn(plots.pictures_in_a_row(pictures, ["one", "two", "three"]))
    for k, picture in enumerate(pictures):
        left = k * 84
        np.testing.assert_allclose(shown[-60:, left : left + 80].astype(int), picture, atol=2)


def test_rows_of_pictures_fit_the_page():
    pictures = [np.full((300, 300, 3), 80, np.uint8)] * 5
    figure = plots.pictures_in_a_row(pictures, ["title"] * 5)
    assert figure.get_figwidth() <= plots.PAGE_WIDTH + 1e-9
    assert len(plots.pictures_in_a_row(pictures, columns=2).axes) == 5


def test_strongest_weights_are_sorted_by_size_and_named():
    figure = plots.strongest_weights(["a", "b", "c"], np.array([0.1, -0.9, 0.4]), count=2)
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels == ["c", "b"]
    widths = sorted(bar.get_width() for bar in figure.axes[0].patches if bar.get_height() < 1)
    assert widths[0] == pytest.approx(-0.9)


def test_several_vectors_of_weights_have_a_legend():
    figure = plots.strongest_weights(["a", "b"], {"fit": np.array([0.1, 0.2]), "truth": np.array([0.3, 0.0])})
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == ["fit", "truth"]


def test_the_beta_figure_shows_the_step_and_the_needle():
    left, right = plots.beta_figure(EnergyConstants()).axes
    assert left.lines[0].get_ydata().max() == pytest.approx(2.5, abs=0.01)
    assert right.lines[0].get_ydata().max() > 30_000


def test_with_points_draws_on_a_copy():
    picture = np.zeros((20, 30, 3), np.uint8)
    marked = plots.with_points(picture, np.array([[10.0, 5.0]]), "#ff0000")
    assert marked[5, 10].tolist() == [255, 0, 0]
    assert picture.max() == 0


def test_a_table_is_markdown():
    assert plots.markdown_table(("a", "b"), [("x", 0.12345)]) == "| a | b |\n| --- | --- |\n| x | 0.123 |"


def test_figures_do_not_pile_up_in_pyplot():
    plots.energy_over_iterations({"E": np.array([3.0, 2.0, 1.0])})
    plots.curves(np.arange(3.0), {"truth": np.arange(3.0), "found": np.arange(3.0)}, "frame", "yaw")
    plots.matrix_figure(["a", "b"], np.eye(2), "cosine")
    plots.profiles({"head": np.zeros((4, 3))}, np.array([0, 1]))
    assert pyplot.get_fignums() == []
