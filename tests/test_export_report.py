"""The report: one page, whole in itself, that tells where to look."""

import html
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests import browser
from tests.performances import FRAMES, GAP, performance
from workbench.cli.tracking import print_result
from workbench.config import preset
from workbench.diagnosis import flag_frames
from workbench.export.report import worst_frames, write_report
from workbench.export.report_charts import line_chart, nice_ticks, residual_picture
from workbench.export.summary import summary_of
from workbench.frames import VideoWriter, open_frames
from workbench.pipeline import RunResult
from workbench.tracking.records import SOURCES


@pytest.fixture(scope="module")
def track(head):
    """A clip with one frame far off, and its configuration."""
    made = performance(head, frames=FRAMES)
    made.projected[9] += np.array([30.0, 0.0])
    config = preset("joint").changed(weights={"tau": 0.25})
    meta = {"config": config.model_dump(mode="json"), "versions": {"workbench": "x & y"}}
    return replace(made, meta={**made.meta, **meta, "inputs": [{"path": "a <b>.mp4", "sha256": "0" * 64}]})


@pytest.fixture(scope="module")
def page(track, head, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    with VideoWriter(folder / "clip.mp4") as writer:
        for k in range(FRAMES):
            writer.write(np.full((480, 640, 3), 60 + 10 * k, np.uint8))
    write_report(track, head, folder / "report.html", open_frames(folder / "clip.mp4"))
    return folder / "report.html"


def test_the_page_refers_to_nothing_outside_itself(page):
    text = page.read_text(encoding="utf-8")
    addresses = re.findall(r"""(?:src|href)=["']([^"']*)["']|url\(([^)]*)\)""", text)
    assert addresses
    assert all((plain or styled).startswith("data:image/") for plain, styled in addresses)
    assert "<script" not in text
    assert "@import" not in text


def test_the_page_tells_counts_settings_and_origin_with_names_escaped(page):
    text = page.read_text(encoding="utf-8")
    assert f"<b>{FRAMES - 1} of {FRAMES}</b>" in text
    assert "<td>weights.tau</td>" in text
    assert "<td>0.25</td>" in text
    assert html.escape("a <b>.mp4") in text
    assert "x &amp; y" in text
    assert "a <b>" not in text


def test_the_frame_that_is_far_off_heads_the_worst_with_its_reason(page, track):
    flags = flag_frames(track)
    assert worst_frames(track, flags)[0] == 9
    section = page.read_text(encoding="utf-8").split("<h2>Worst frames</h2>")[1]
    first = section.split("<tr>")[2]
    assert '<td class="number">9</td>' in first
    assert html.escape(flags.text[9]) in first
    assert "largest at" in first


def test_neighbours_of_a_worst_frame_are_not_listed_again(head):
    track = performance(head, frames=30, gap=None)
    worst = worst_frames(track, flag_frames(track))
    assert len(worst) == len(set(worst)) >= 3
    assert np.diff(sorted(worst)).min() >= 8


@pytest.fixture(scope="module")
def filled(track):
    """The track with its gap filled, as infill leaves a frame: the model's own landmarks, none observed."""
    source = track.source.copy()
    source[GAP] = SOURCES.index("filled")
    columns = {name: getattr(track, name).copy() for name in ("rotation", "translation", "expression", "projected")}
    for column in columns.values():
        column[GAP] = column[GAP - 1]
    identity, observed, confidence = track.identity.copy(), track.observed.copy(), track.confidence.copy()
    identity[GAP], observed[GAP], confidence[GAP] = identity[GAP - 1], columns["projected"][GAP], 0.0
    found = np.ones(FRAMES, bool)
    given = {"identity": identity, "observed": observed, "confidence": confidence, "found": found, "source": source}
    return replace(track, **columns, **given)


def test_a_filled_frame_has_no_error_of_its_own_in_the_report(filled, head, tmp_path):
    write_report(filled, head, tmp_path / "report.html", None)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert ">nan<" not in text
    assert GAP not in worst_frames(filled, flag_frames(filled))
    assert "grey: no face, or filled from its neighbours" in text
    assert "1 of them filled" in text


def test_a_filled_frame_that_stands_out_is_listed_with_what_it_is(filled, head, tmp_path):
    translation = filled.translation.copy()
    translation[GAP, 0] += 200.0
    jumping = replace(filled, translation=translation)
    write_report(jumping, head, tmp_path / "report.html", None)
    row = listed((tmp_path / "report.html").read_text(encoding="utf-8"), GAP)
    assert "the pose jumps" in row
    assert "filled from its neighbours" in row
    assert "largest at" not in row
    assert row.count('<td class="number">–</td>') == 2  # neither error


def test_a_model_without_blendshapes_has_a_report(track, head, tmp_path):
    meta = {**track.meta, "expression_names": []}
    stiff = replace(track, expression=track.expression[:, :0], meta=meta)
    write_report(stiff, head.with_expressions(()), tmp_path / "report.html", None)
    assert "The model has no blendshapes." in (tmp_path / "report.html").read_text(encoding="utf-8")


def listed(text, frame):
    """The row of a frame in the table of the worst."""
    rows = text.split("<h2>Worst frames</h2>")[1].split("</table>")[0].split("<tr>")
    return next(row for row in rows if f'<td class="number">{frame}</td>' in row)


def test_moved_points_are_counted_in_the_report(track, head, tmp_path):
    points = {str(k): (100.123456789 + k, 50.25) for k in range(68)}
    config = preset("joint").changed(landmarks={"moved": {"9": points}})
    meta = {**track.meta, "config": config.model_dump(mode="json")}
    write_report(replace(track, meta=meta), head, tmp_path / "report.html", None)
    shown = (tmp_path / "report.html").read_text(encoding="utf-8").split("<summary>As a file for --config")[0]
    assert "frame 9: 68 points moved" in shown
    assert "100.123" not in shown


def test_the_mark_of_a_flagged_frame_says_why(page, track):
    why = html.escape(flag_frames(track).text[9])
    assert why
    assert f"<title>frame 9: {why}</title>" in page.read_text(encoding="utf-8")


def test_a_track_whose_character_is_elsewhere_is_reported_all_the_same(track, head, tmp_path):
    config = {**track.meta["config"], "head": {"character": "me"}}
    write_report(replace(track, meta={**track.meta, "config": config}), head, tmp_path / "report.html", None)
    assert "Worst frames" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["orthographic", "deep-parallel"])
def test_a_parallel_projection_has_no_lens(name, track, head, tmp_path, capsys):
    parallel = replace(track, meta={**track.meta, "config": preset(name).model_dump(mode="json")})
    summary = summary_of([parallel])
    assert summary["camera"]["projection"] == "orthographic"
    assert summary["camera"]["focal_px"] is summary["camera"]["horizontal_fov_deg"] is None
    assert not summary["camera"]["guessed"]
    write_report(parallel, head, tmp_path / "report.html", None)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<b>parallel</b><span>projection, no lens</span>" in text
    assert "field of view<" not in text
    print_result(RunResult(tmp_path, summary, ()))
    printed = capsys.readouterr().out
    assert "parallel projection, no lens" in printed
    assert "--fov" not in printed


def test_a_perspective_camera_has_its_field_of_view_in_the_report(page, track):
    assert summary_of([track])["camera"]["projection"] == "perspective"
    assert "field of view, guessed" in page.read_text(encoding="utf-8")


def test_a_track_without_pictures_gets_grey_ones(track, head, tmp_path):
    write_report(track, head, tmp_path / "report.html", None)
    assert (tmp_path / "report.html").read_text(encoding="utf-8").count("data:image/jpeg") >= 6


def test_a_track_without_any_face_says_so(track, head, tmp_path):
    nothing = replace(
        track,
        found=np.zeros(FRAMES, bool),
        **{name: getattr(track, name) * np.nan for name in ("rotation", "translation", "expression", "projected")},
    )
    write_report(nothing, head, tmp_path / "report.html", None)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"<b>0 of {FRAMES}</b>" in text
    assert "No frame has a face" in text


def test_a_failed_report_leaves_no_file(track, head, tmp_path):
    def fail(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_report(track, head, tmp_path / "report.html", None, progress=fail)
    assert not list(tmp_path.iterdir())


# --- charts ---


def test_a_curve_is_broken_where_it_has_no_number():
    values = np.array([0.0, 1.0, np.nan, 2.0, 3.0])
    path = re.search(r'class="curve c0" d="([^"]*)"', line_chart(np.arange(5.0), {"x": values}, "mm")).group(1)
    assert path.count("M") == 2
    assert "nan" not in path


def test_a_number_between_gaps_is_a_dot():
    values = np.array([np.nan, 1.0, np.nan, 2.0, 3.0])
    path = re.search(r'class="curve c0" d="([^"]*)"', line_chart(np.arange(5.0), {"x": values}, "mm")).group(1)
    assert re.findall("[MLh]", path) == ["M", "h", "M", "L"]


def test_frames_are_counted_in_whole_numbers():
    chart = line_chart(np.arange(4.0), {"x": np.arange(4.0)}, "mm")
    assert re.findall(r'text-anchor="middle">([^<]*)<', chart) == ["0", "1", "2", "3"]


def test_a_single_photo_has_numbers_and_no_charts(head, tmp_path):
    photo = performance(head, frames=1, gap=None)
    write_report(photo, head, tmp_path / "report.html", None)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<svg" not in text
    assert f"{photo.translation[0, 2]:.2f}" in text
    assert "All 44 weights" in text


def test_long_curves_are_thinned():
    chart = line_chart(np.arange(100_000.0), {"x": np.zeros(100_000)}, "mm")
    assert chart.count("L") < 1600


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (0.0, 1.0, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
        (-31.0, 44.0, [-40.0, -20.0, 0.0, 20.0, 40.0, 60.0]),
        (2.0, 2.0, [2.0]),
    ],
)
def test_ticks_are_round_numbers(low, high, ticks):
    assert nice_ticks(low, high) == pytest.approx(ticks, abs=1e-6)


def test_the_strip_is_grey_where_a_frame_was_filled(filled):
    picture = residual_picture(filled)
    assert (picture[:, GAP] == 128).all()
    assert (picture[:, GAP + 1] != 128).any()


def test_the_strip_has_a_row_a_landmark_and_is_grey_without_a_face(track):
    picture = residual_picture(track)
    assert picture.shape == (68, FRAMES, 3)
    assert (picture[:, GAP] == 128).all()
    assert picture[:, 9].astype(int).sum() > picture[:, 8].astype(int).sum()  # brighter where the error is large


# --- in a browser ---


@pytest.mark.skipif(browser.missing() is not None, reason=browser.missing() or "")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_browser_shows_it_readably_and_asks_for_nothing(scheme, page, screenshots):
    from playwright.sync_api import sync_playwright

    asked, complaints = [], []
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser.CHROMIUM, args=browser.FLAGS)
        tab = chromium.new_page(viewport={"width": 1366, "height": 768}, color_scheme=scheme)
        tab.on("request", lambda request: asked.append(request.url))
        tab.on("console", lambda message: complaints.append(message.text))
        tab.goto(page.as_uri())
        images = tab.eval_on_selector_all("img", "all => all.map(one => one.naturalWidth)")
        colors = tab.evaluate(
            "(() => { const s = getComputedStyle(document.body); return [s.color, s.backgroundColor]; })()"
        )
        wide = tab.evaluate("document.documentElement.scrollWidth")
        tab.screenshot(path=screenshots / f"report-{scheme}.png", full_page=True)
        chromium.close()
    assert [url for url in asked if not url.startswith("data:")] == [page.as_uri()]
    assert complaints == []
    assert images
    assert all(width > 0 for width in images)
    assert wide <= 1366
    ink, paper = (np.mean([int(part) for part in re.findall(r"\d+", color)[:3]]) for color in colors)
    assert (ink < 60 and paper > 240) if scheme == "light" else (ink > 220 and paper < 40)
    assert cv2.imread(str(screenshots / f"report-{scheme}.png")) is not None
