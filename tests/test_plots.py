"""Figures of the notebooks: what they show, and that pictures keep their pixels."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb

from workbench import plots
from workbench.config import PRESETS
from workbench.energies import EnergyConstants
from workbench.energies.terms import TABLE
from workbench.errors import InputError
from workbench.frames import read_picture
from workbench.geometry import project, rotation_matrix
from workbench.landmarks.files import read_landmark_file
from workbench.plots.style import THEMES
from workbench.samples import sample
from workbench.tracker import FaceTracker
from workbench.tracking import FrameObservation, Track
from workbench.tracking.records import stack_fits


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


def test_factors_of_points_name_the_least_believed_and_frame_the_marked():
    factors = np.exp(np.linspace(0.0, 1.0, 68))
    factors[[7, 40]] = 0.1
    figure = plots.point_factors({"one": factors, "other": np.ones(68)}, marked={"one": [7]})
    one, _, bar = figure.axes
    assert {"7", "40"} <= {text.get_text() for text in one.texts}
    frames = one.collections[1].get_offsets()
    np.testing.assert_allclose(frames, one.collections[0].get_offsets()[[7]])
    assert bar.get_ylim() == pytest.approx((0.1, 10.0))
    assert figure.get_figwidth() <= plots.PAGE_WIDTH


def test_the_beta_figure_shows_the_step_and_the_needle():
    left, right = plots.beta_figure(EnergyConstants()).axes
    assert left.lines[0].get_ydata().max() == pytest.approx(2.5, abs=0.01)
    assert right.lines[0].get_ydata().max() > 30_000


def test_the_steps_of_beta_fail_where_those_of_a_quadratic_term_do_not():
    slope, steps = plots.beta_step_figure(EnergyConstants(), stiffness=100.0, weight=100.0).axes
    lines = {line.get_label(): line for line in steps.lines}
    distance = lines["E_β"].get_xdata()
    far = np.argmin(np.abs(distance - 0.1))
    assert lines["range term"].get_ydata()[far] == pytest.approx(0.05, rel=0.1)
    assert lines["E_β"].get_ydata()[far] < 0.01
    assert slope.lines[0].get_ydata()[far] < 0.01


def test_lines_of_one_figure_differ_in_more_than_colour():
    x = np.array([1.0, 10.0, 100.0])
    axis = plots.curves(x, {"one": x, "two": 2 * x, "truth": 3 * x}, "x", "y", log="xy").axes[0]
    assert {line.get_linestyle() for line in axis.lines[:2]} == {"-", "--"}
    assert axis.lines[2].get_linewidth() > axis.lines[0].get_linewidth()
    assert (axis.get_xscale(), axis.get_yscale()) == ("log", "log")


def test_no_line_is_left_out_however_many_there_are():
    x = np.array([1.0, 10.0, 100.0])
    names = [f"series {k}" for k in range(8)]
    assert len(plots.curves(x, dict.fromkeys(names, x), "x", "y").axes[0].lines) == 8
    assert len(plots.energy_over_iterations(dict.fromkeys(names, x)).axes[0].lines) == 8
    assert len(plots.errors_per_stage(["one", "two"], {"error": dict.fromkeys(names, x[:2])}).axes[0].lines) == 8
    assert len(plots.error_boxes({"error": dict.fromkeys(names, x)}).axes[0].get_xticklabels()) == 8
    swept = plots.sweep_figure(x, {"error": dict.fromkeys(names, x)}, "x").axes[0]
    assert len(swept.get_legend_handles_labels()[0]) == 8
    bars = plots.strongest_weights(["jawOpen", "mouthFunnel"], dict.fromkeys(names, np.array([0.2, 0.7]))).axes[0]
    assert len(bars.containers) == 8


def test_curves_over_frames_have_no_ticks_between_frames():
    axis = plots.curves(np.arange(222, 240), {"one": np.arange(18.0)}, "frame", "y").axes[0]
    assert all(tick == int(tick) for tick in axis.get_xticks())


def test_a_sweep_rings_the_least_value_and_shows_zero_on_a_logarithmic_axis():
    x = np.array([0.0, 1.0, 10.0, 100.0])
    error = {"quiet": np.array([3.0, 2.0, 1.0, 4.0]), "noisy": np.array([9.0, 8.0, 7.0, 6.0])}
    figure = plots.sweep_figure(x, {"error": error, "lag": {"quiet": x}}, "ω", {"error": 0.5})
    first, second = figure.axes
    assert first.get_title() == "error"
    rings = [line for line in first.lines if line.get_fillstyle() == "none"]
    assert [float(ring.get_xdata()[0]) for ring in rings] == [10.0, 100.0]
    assert first.lines[-1].get_ydata()[0] == 0.5
    assert [text.get_text() for text in first.get_legend().get_texts()] == ["quiet", "noisy"]
    assert second.get_legend() is None
    assert first.get_xticklabels()[0].get_text() == "0"
    assert first.lines[0].get_xdata()[0] == pytest.approx(0.1)


def test_energies_over_stages_break_between_stages_and_leave_out_what_never_changes():
    stages = {
        "translation": np.array([[900.0, 40.0, 0.0, 7.0], [300.0, 30.0, 0.0, 7.0], [100.0, 20.0, 0.0, 7.0]]),
        "jaw and mouth": np.array([[90.0, 0.0, 0.0, 7.0], [10.0, 0.0, 5.0, 7.0]]),
    }
    figure = plots.energies_over_stages(stages, ("landmarks", "edges", "lambda", "identity"))
    axis = figure.axes[0]
    assert [text.get_text() for text in axis.get_legend().get_texts()] == ["sum", "landmarks", "edges", "lambda"]
    assert [text.get_text() for text in axis.get_xticklabels()] == ["translation", "jaw and\nmouth"]
    first = next(line for line in axis.lines if line.get_label() == "sum")
    np.testing.assert_allclose(first.get_ydata(), [940.0, 330.0, 120.0])
    borders = [line for line in axis.lines if len(set(line.get_xdata())) == 1]
    assert [line.get_xdata()[0] for line in borders] == [3.0]


def test_errors_per_stage_have_a_plot_a_quantity_and_a_line_a_way():
    errors = {
        "rotation, °": {"deep": np.array([20.0, 5.0, 1.0]), "points": np.array([20.0, 6.0, 3.0])},
        "depth, mm": {"deep": np.array([10.0, 8.0, 7.0]), "points": np.array([10.0, 9.0, 9.0])},
    }
    figure = plots.errors_per_stage(["start", "translation", "rigid"], errors)
    left, right = figure.axes
    assert [axis.get_title() for axis in figure.axes] == list(errors)
    assert [axis.get_yscale() for axis in figure.axes] == ["log", "linear"]
    np.testing.assert_allclose(left.lines[1].get_ydata(), [20.0, 6.0, 3.0])
    assert [text.get_text() for text in left.get_legend().get_texts()] == ["deep", "points"]
    assert right.get_legend() is None


def test_boxes_of_errors_show_every_frame():
    one, two = np.array([4.0, 6.0, 9.0, 20.0]), np.array([1.0, 2.0, 2.5, 3.0])
    figure = plots.error_boxes({"depth, mm": {"one camera": one, "two cameras": two}})
    axis = figure.axes[0]
    dots = [line for line in axis.lines if line.get_marker() == "."]
    np.testing.assert_allclose(dots[0].get_ydata(), one)
    medians = [line.get_ydata()[0] for line in axis.lines if len(set(line.get_ydata())) == 1]
    assert {7.5, 2.25} <= set(medians)
    assert [text.get_text() for text in axis.get_xticklabels()] == ["one\ncamera", "two\ncameras"]
    assert axis.get_ylim()[0] == 0.0


@pytest.mark.parametrize(("quantities", "series"), [(4, 4), (6, 3), (4, 3)])
def test_names_of_boxes_do_not_lie_on_one_another(quantities, series):
    names = ("deep-energies", "preselected-points", "deep", "deep-points")[:series]
    errors = {f"error {k}": {name: np.arange(5.0) for name in names} for k in range(quantities)}
    figure = plots.error_boxes(errors)
    figure.draw_without_rendering()
    for axis in figure.axes:
        places = [label.get_window_extent() for label in axis.get_xticklabels()]
        assert all(one.x1 < other.x0 for one, other in pairwise(places))


def test_a_heat_map_has_a_readable_number_in_every_cell():
    figure = plots.heat_map(np.array([[1.0, 2.0], [3.0, 400.0]]), ["a", "b"], [5, 6], "rows", "columns", "error", True)
    texts = figure.axes[0].texts
    assert [text.get_text() for text in texts] == ["1", "2", "3", "400"]
    assert texts[0].get_color() == "white"
    assert texts[3].get_color() == "0.05"


def test_the_residual_strip_has_a_row_a_landmark_and_marks_flags(portrait):
    _, fit = portrait
    missing = replace(fit, found=False)
    axis = plots.residual_strip([fit, missing, fit], [False, False, True], frame=0).axes[0]
    values = np.ma.filled(axis.images[0].get_array(), np.nan)
    assert values.shape == (68, 3)
    assert np.isnan(values[:, 1]).all()
    eyes = np.linalg.norm(fit.observed[45] - fit.observed[36])
    np.testing.assert_allclose(values[:17, 0], 100 * fit.residuals_px[:17] / eyes)
    filled = replace(fit, source="filled", observed=fit.projected, confidence=np.zeros(68))
    shown = plots.residual_strip([fit, filled]).axes[0].images[0].get_array()
    assert np.isnan(np.ma.filled(shown, np.nan)).all(axis=0).tolist() == [False, True]
    flags = next(line for line in axis.lines if line.get_marker() == "v")
    assert flags.get_xdata().tolist() == [2]


def test_compared_fits_stand_side_by_side_over_their_heads(head, portrait):
    picture, fit = portrait
    neutral = replace(fit, expression=np.zeros(44))
    figure = plots.compared_fits(head, picture, {"before": neutral, "after": fit}, side=120)
    assert [axis.get_title() for axis in figure.axes] == ["before", "after", "", ""]
    pictures = [axis.images[0].get_array() for axis in figure.axes]
    assert {shown.shape for shown in pictures} == {(120, 120, 3)}
    assert np.abs(pictures[2].astype(int) - pictures[3]).max() > 30


def test_compared_fits_of_another_model_are_told(head, portrait):
    picture, fit = portrait
    dense = replace(fit, expression=np.zeros(52))
    with pytest.raises(InputError, match="'dense' has 52 blendshape weights, and the face model has 44: give"):
        plots.compared_fits(head, picture, {"joint": fit, "dense": dense})


def test_one_fit_alone_has_its_head_beside_it_and_heads_need_no_picture(head, portrait):
    picture, fit = portrait
    alone = plots.compared_fits(head, picture, {"fit": fit}, side=100, view="front")
    assert alone.get_figwidth() > alone.get_figheight()
    heads = plots.compared_fits(head, None, {"a": fit, "b": fit, "c": fit}, side=100, columns=2)
    assert [axis.get_title() for axis in heads.axes] == ["a", "b", "c"]


def test_with_points_draws_on_a_copy():
    picture = np.zeros((20, 30, 3), np.uint8)
    marked = plots.with_points(picture, np.array([[10.0, 5.0]]), "#ff0000")
    assert marked[5, 10].tolist() == [255, 0, 0]
    assert picture.max() == 0


def test_a_table_is_markdown():
    assert plots.markdown_table(("a", "b"), [("x", 0.12345)]) == "| a | b |\n| --- | --- |\n| x | 0.123 |"


def test_a_bar_in_a_cell_does_not_end_it():
    assert plots.markdown_table(("a",), [("Σ|w|",)]).splitlines()[-1] == r"| Σ\|w\| |"


def test_figures_do_not_pile_up_in_pyplot():
    plots.energy_over_iterations({"E": np.array([3.0, 2.0, 1.0])})
    plots.curves(np.arange(3.0), {"truth": np.arange(3.0), "found": np.arange(3.0)}, "frame", "yaw")
    plots.matrix_figure(["a", "b"], np.eye(2), "cosine")
    plots.profiles({"head": np.zeros((4, 3))}, np.array([0, 1]))
    assert pyplot.get_fignums() == []


def test_colours_become_a_picture_and_are_clipped():
    values = np.array([[[0.0, 0.5, 1.0], [-0.2, 1.3, 0.2]]])
    np.testing.assert_array_equal(plots.as_picture(values), [[[0, 128, 255], [0, 255, 51]]])


def test_signed_numbers_are_white_at_zero_red_above_and_blue_below():
    below, zero, above = plots.signed_picture(np.array([[-2.0, 0.0, 2.0]]))[0].astype(int)
    assert zero.min() > 240
    assert above[0] > above[2] + 50
    assert below[2] > below[0] + 50


def test_signed_numbers_beyond_the_limit_look_like_the_limit():
    shown = plots.signed_picture(np.array([[1.0, 5.0, -5.0, -1.0]]), limit=1.0)[0]
    np.testing.assert_array_equal(shown[0], shown[1])
    np.testing.assert_array_equal(shown[2], shown[3])


def test_signed_numbers_that_are_all_zero_are_white():
    assert plots.signed_picture(np.zeros((2, 2))).min() > 240


def test_heat_covers_the_picture_where_it_is_high():
    picture = np.full((40, 60, 3), (200, 40, 40), np.uint8)
    heat = np.zeros((4, 6))
    heat[1, 2] = 1.0
    shown = plots.heat_over(picture, heat, "#0000ff")
    assert (shown[15, 25] == (0, 0, 255)).all()
    assert len(np.unique(shown[5, 5])) == 1
    hot = np.argwhere(shown[..., 0] == 0)
    np.testing.assert_array_equal([hot.min(axis=0), hot.max(axis=0)], [(10, 20), (19, 29)])


def test_arrows_run_from_their_points_along_their_vectors():
    picture = np.zeros((40, 60, 3), np.uint8)
    shown = plots.with_arrows(picture, np.array([[10.0, 20.0]]), np.array([[30.0, 0.0]]), "#ffffff")
    assert picture.max() == 0
    assert shown[20, 11:39].min() > 100
    assert shown[:, 45:].max() == 0
    assert shown[:10].max() == 0


def test_the_normals_of_a_ball_are_unit_vectors_towards_the_camera():
    normals = plots.ball_normals(41)
    inside = np.isfinite(normals).all(axis=-1)
    assert 0.75 < inside.mean() < 0.80
    np.testing.assert_allclose(np.linalg.norm(normals[inside], axis=-1), 1.0)
    np.testing.assert_allclose(normals[20, 20], [0, 0, -1], atol=1e-12)
    assert normals[20, 35, 0] > 0.6
    assert normals[35, 20, 1] > 0.6


@pytest.fixture
def short_track(head, portrait):
    """Four frames of one fit that turns and opens its mouth; frames 10 to 13, the third one without a face."""
    _, fit = portrait
    fits = []
    for k in range(4):
        expression = fit.expression.copy()
        expression[head.expression_names.index("jawOpen")] = 0.1 * k
        turned = fit.rotation + np.array([0.0, 0.1 * k, 0.0])
        fits.append(replace(fit, index=10 + k, rotation=turned, expression=expression, found=k != 2))
    return Track(meta={"expression_names": list(head.expression_names)}, **stack_fits(fits))


def test_curves_of_tracks_show_each_quantity_of_each_track_with_the_truth_behind(short_track):
    moved = replace(short_track, translation=short_track.translation + 5.0)
    figure = plots.track_curves(
        {"truth": short_track, "moved": moved}, ("yaw", "z", "jawOpen", "roll"), shaded=[(11, 12)]
    )
    yaw, depth, jaw, _ = figure.axes[:4]
    assert [axis.get_title() for axis in figure.axes[:4]] == ["yaw, °", "z, mm", "jawOpen", "roll, °"]
    behind, before = depth.get_lines()
    np.testing.assert_array_equal(before.get_ydata() - behind.get_ydata(), np.full(4, 5.0))
    assert behind.get_linewidth() > before.get_linewidth()
    assert behind.get_zorder() < before.get_zorder()
    np.testing.assert_allclose(jaw.get_lines()[0].get_ydata(), [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(yaw.get_lines()[0].get_xdata(), [10, 11, 12, 13])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["truth", "moved"]
    assert drawn(figure).min() < 100


@pytest.mark.parametrize("x", [[0.0, 1.0], [1.0, 2.0], [0.5]])
def test_a_sweep_of_few_values_is_drawn(x):
    axis = plots.sweep_figure(np.array(x), {"error": {"one": np.arange(1.0, 1.0 + len(x))}}, "ω").axes[0]
    drawn = axis.lines[0].get_xdata()
    assert (np.diff(drawn) > 0.0).all()
    assert drawn[0] > 0.0


def test_a_sweep_of_nothing_above_zero_is_refused():
    with pytest.raises(InputError, match="at least one value above zero"):
        plots.sweep_figure(np.zeros(1), {"error": {"one": np.ones(1)}}, "ω")


def test_curves_of_tracks_can_show_a_part(short_track):
    figure = plots.track_curves({"fits": short_track}, ("yaw",), frames=(11, 12))
    np.testing.assert_array_equal(figure.axes[0].get_lines()[0].get_xdata(), [11, 12])


def test_curves_of_tracks_can_be_their_distances_from_the_truth(short_track):
    moved = replace(short_track, translation=short_track.translation + np.array([0.0, 0.0, -5.0]))
    figure = plots.track_curves({"moved": moved, "right": short_track}, ("z", "yaw"), truth=short_track)
    far, right = figure.axes[0].get_lines()
    np.testing.assert_array_equal(far.get_ydata(), np.full(4, 5.0))
    np.testing.assert_array_equal(right.get_ydata(), np.zeros(4))


def test_a_truth_of_other_frames_is_refused(short_track):
    shorter = Track(meta=short_track.meta, **stack_fits([short_track[k] for k in range(3)]))
    with pytest.raises(InputError, match="The truth has 3 frames and the track 'fits' 4"):
        plots.track_curves({"fits": short_track}, truth=shorter)


def test_curves_of_tracks_name_the_quantities_there_are(short_track):
    with pytest.raises(InputError, match="yaw, pitch, roll, x, y, z or a blendshape of the track, got 'jaw'"):
        plots.track_curves({"fits": short_track}, ("jaw",))


def test_rows_of_pictures_have_their_labels_and_one_size():
    shades = {"dark": [10, 20, 30], "bright": [210, 220, 230]}
    rows = {name: [np.full((7, 7, 3), shade, np.uint8) for shade in each] for name, each in shades.items()}
    figure = plots.picture_rows(rows, ["a", "b", "c"])
    panels = [axis.images[0].get_array() for axis in figure.axes]
    assert [int(panel.mean()) for panel in panels] == [10, 20, 30, 210, 220, 230]
    assert len({panel.shape for panel in panels}) == 1
    assert [axis.get_title() for axis in figure.axes[:3]] == ["a", "b", "c"]
    assert [text.get_text() for text in figure.texts] == ["dark", "bright"]


def test_long_names_of_rows_stand_on_several_lines_beside_their_own_row():
    names = ("exact, photos by the network, 128 px", "estimated, the mesh's derivative, 256 px", "linear")
    figure = plots.picture_rows({name: [np.zeros((192, 192, 3), np.uint8)] * 2 for name in names}, ["a", "b"])
    figure.draw_without_rendering()
    rows = {text.get_text().replace("\n", " "): text.get_window_extent() for text in figure.texts}
    assert list(rows) == list(names)
    for place, axis in zip(rows.values(), figure.axes[::2], strict=True):
        beside = axis.get_window_extent()
        assert beside.y0 <= place.y0 < place.y1 <= beside.y1
        assert 0.0 <= place.x0 < place.x1 <= beside.x0


def test_a_film_strip_has_a_row_of_pictures_and_one_for_each_track(head, portrait, short_track):
    picture, _ = portrait
    right = [short_track[k] for k in (0, 1, 3)]
    far = [replace(fit, translation=fit.translation + np.array([60.0, 0.0, 0.0])) for fit in right]
    notes = {"far": ["", "much too far", ""]}
    figure = plots.film_strip(head, [picture] * 3, {"right": right, "far": far}, notes)
    panels = [axis.images[0].get_array().astype(int) for axis in figure.axes]
    assert len(panels) == 9
    assert len({panel.shape for panel in panels}) == 1
    assert [axis.get_title() for axis in figure.axes[:3]] == ["frame 10", "frame 11", "frame 13"]
    assert [text.get_text() for text in figure.texts] == ["picture", "right", "far"]
    assert "much too far" in [text.get_text() for axis in figure.axes for text in axis.texts]
    photo, fitted, moved = panels[0], panels[3], panels[6]
    assert np.abs(moved - fitted).mean() > 2.0
    assert np.abs(fitted - photo).mean() > 2.0
    # The corner beside the head: the same square of the picture in all rows.
    assert np.abs(moved[:10, :10] - photo[:10, :10]).mean() < 12.0


def test_a_film_strip_darkens_frames_without_a_face_and_needs_one_in_a_column(head, portrait, short_track):
    picture, _ = portrait
    lost = short_track[2]
    kept = plots.film_strip(head, [picture], {"before": [lost], "after": [short_track[1]]})
    photo, dark, _ = (axis.images[0].get_array().astype(float) for axis in kept.axes)
    assert dark.mean() < 0.4 * photo.mean()
    with pytest.raises(InputError, match="Frame 12 of the film strip has no face in any row"):
        plots.film_strip(head, [picture], {"before": [lost]})


def lettered(figure) -> np.ndarray:
    """The colour of the ticks' names, 0 to 1."""
    figure.draw_without_rendering()
    return np.array(to_rgb(figure.axes[0].get_xticklabels()[0].get_color()))


@pytest.fixture
def lab_theme(monkeypatch, tmp_path):
    """Lets a theme be the one that a JupyterLab keeps for its user."""
    monkeypatch.setenv("JPY_SESSION_NAME", "lesson.ipynb")
    monkeypatch.setenv("JUPYTERLAB_SETTINGS_DIR", str(tmp_path))

    def choose(name):
        file = tmp_path / THEMES
        file.parent.mkdir(parents=True, exist_ok=True)
        lines = ("{", "    // Theme", "    // Selected Theme", f'    "theme": "{name}",', "}")
        file.write_text("\n".join(lines), encoding="utf-8")

    return choose


def test_figures_are_dark_where_jupyterlab_is(lab_theme):
    draw = lambda: plots.curves(np.arange(3.0), {"one": np.arange(3.0)}, "x", "y")  # noqa: E731 - thrice the same
    assert drawn(draw()).mean() > 200
    lab_theme("JupyterLab Dark High Contrast")
    dark = draw()
    assert drawn(dark).mean() < 60
    assert lettered(dark).min() > 0.7
    lab_theme("JupyterLab Light")
    assert lettered(draw()).max() < 0.3


def test_files_are_light_whatever_the_theme_is(lab_theme):
    lab_theme("JupyterLab Dark")
    with plots.on_page(plots.LIGHT):
        assert drawn(plots.matrix_figure(["a", "b"], np.eye(2), "cosine")).mean() > 150
    assert drawn(plots.matrix_figure(["a", "b"], np.eye(2), "cosine")).mean() < 150


def test_the_theme_is_asked_for_only_in_a_notebook_and_can_be_told(monkeypatch, lab_theme):
    lab_theme("JupyterLab Dark")
    monkeypatch.delenv("JPY_SESSION_NAME")
    figure = plots.profiles({"head": np.zeros((4, 3))}, np.array([0, 1]))
    assert figure.get_facecolor()[:3] == (1.0, 1.0, 1.0)
    monkeypatch.setenv("WORKBENCH_FIGURES", "dark")
    assert max(plots.profiles({"head": np.zeros((4, 3))}, np.array([0, 1])).get_facecolor()[:3]) < 0.2


def test_every_term_has_its_own_line_in_all_figures():
    lines = [plots.term_line(name) for name in TABLE]
    assert len(set(lines)) == len(lines)
    stages = {"one": np.array([[3.0, 2.0], [1.0, 1.0]])}
    axis = plots.energies_over_stages(stages, ("tau", "edges")).axes[0]
    drawn_lines = {line.get_label(): (line.get_color(), line.get_linestyle()) for line in axis.lines}
    assert drawn_lines["tau"] == plots.term_line("tau")
    assert drawn_lines["edges"] == plots.term_line("edges")
