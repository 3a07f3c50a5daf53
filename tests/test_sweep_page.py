"""The panel's page of sweeps without a browser: choosing settings in words, what grows, and taking a point."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import turning_clip
from workbench.config import preset
from workbench.errors import InputError
from workbench.session import TuningSession
from workbench.session.sweep_settings import found_setting, place_among, sweep_settings, value_at
from workbench.session.sweeping import in_groups
from workbench.sweeps import Point, config_at, points_of, read_axis
from workbench.widgets.sweep_page import SweepPage, progress_text
from workbench.widgets.sweep_view import packed

FRAMES = 6
CONFIG = preset("joint").changed(identity={"calibrate": False})


@pytest.fixture(scope="module")
def clip(head):
    return turning_clip(head, FRAMES, -6.0)


@pytest.fixture(scope="module")
def shared(head, clip):
    session = TuningSession(head, clip, CONFIG)
    page = SweepPage(session, lambda seconds: True, 170)
    page.first.choose(found_setting(sweep_settings(CONFIG), "steady head"))
    page.first.count.value, page.first.low.value, page.first.high.value = 5, "0.01", "100"
    page.run()
    assert page.wait_idle(300), page.said.value
    yield page
    page.close()


@pytest.fixture
def page(shared):
    """One page with the curve of ω_τ for all tests, its session brought back to the start."""
    yield shared
    shared._session.use(CONFIG)
    shared.show_config()


# --- settings in words ---


SETTINGS = sweep_settings(preset("joint"))


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda setting: setting.path)
def test_every_setting_that_is_offered_can_be_swept_and_read_back(setting):
    axis = read_axis(setting.axis(f"{setting.low:g}", f"{setting.high:g}", 3))
    point = points_of([axis])[-1]
    config = config_at(preset("joint"), point)
    assert value_at(config, setting.path) == pytest.approx(dict(point.values)[setting.path])


def test_the_present_value_of_a_group_is_that_of_its_slider():
    config = preset("joint").changed(landmarks={"weights": {"mouth": 2.0}})
    assert value_at(config, "landmarks.weights.outer_lips") == 2.0
    assert value_at(config, "landmarks.weights.jaw") == 1.0


def test_settings_are_found_by_plain_words_symbols_and_names():
    assert found_setting(SETTINGS, "STEADY head").path == "weights.tau"
    assert found_setting(SETTINGS, "weights.tau").path == "weights.tau"
    assert found_setting(SETTINGS, "few shapes").path == "weights.sigma_smooth"
    assert found_setting(SETTINGS, "lens").path == "camera.fov_deg"
    assert found_setting(SETTINGS, next(item.title for item in SETTINGS if item.symbol == "ω_τ")).path == "weights.tau"
    assert len({item.title for item in SETTINGS}) == len(SETTINGS)


def test_words_of_no_or_of_several_settings_are_told():
    with pytest.raises(InputError, match="matches the words 'moustache'"):
        found_setting(SETTINGS, "moustache")
    with pytest.raises(InputError, match="settings match the words 'brow': trust of right brow, trust of left brow"):
        found_setting(SETTINGS, "brow")


def test_settings_without_effect_are_not_offered():
    fixed = preset("joint").changed(camera={"matrix": [[900, 0, 320], [0, 900, 240], [0, 0, 1]]})
    assert "camera.fov_deg" not in {item.path for item in sweep_settings(fixed)}
    assert "weights.flow" not in {item.path for item in SETTINGS}


def test_the_present_value_lies_among_those_of_the_curve():
    assert place_among((1.0, 10.0, 100.0), 10.0, log=True) == 1.0
    assert place_among((1.0, 10.0, 100.0), 10.0**1.5, log=True) == pytest.approx(1.5)
    assert place_among((1, 11), 6, log=False) == 0.5
    assert place_among((1.0, 10.0), 0.0, log=True) is None


# --- what is drawn ---


def test_groups_of_points_fill_a_block_and_are_spread_over_the_curve():
    windows = [range(20), range(100, 120), range(200, 220)]
    groups = in_groups(15, windows, ("error",))
    assert [list(group) for group in groups] == [[0, 3, 6, 9, 12], [1, 4, 7, 10, 13], [2, 5, 8, 11, 14]]
    assert all(len(group) == 1 for group in in_groups(15, windows, ("left-out-points",)))
    assert all(len(group) == 4 for group in in_groups(16, [range(240)], ("error",)))


def test_a_curve_shows_means_quartiles_and_the_present_value(page):
    assert page.result.objectives == ("error", "jitter", "iterations")
    rows = np.frombuffer(page.view._sent["data"], np.float32).reshape(3, 5)
    np.testing.assert_allclose(rows[0], page.result.means("error"), rtol=1e-6)
    np.testing.assert_allclose(rows[1:].T, page.result.bands("error"), rtol=1e-6)
    assert page.view._sent["now"] == pytest.approx(1.0)  # ω_τ = 0.1 between 0.01 and 100
    assert "Lowest error" in page.said.value
    page.objective.value = "jitter"
    rows = np.frombuffer(page.view._sent["data"], np.float32).reshape(3, 5)
    np.testing.assert_allclose(rows[0], page.result.means("jitter"), rtol=1e-6)
    page.objective.value = "left-out-points"
    assert "Run it again" in page.said.value
    page.objective.value = "error"


def test_what_is_not_known_yet_is_left_out_and_two_settings_make_a_map(page):
    from dataclasses import replace

    half = replace(page.result, values={key: rows for key, rows in page.result.values.items() if key[0] < 2})
    sent = packed(half, "error", ("steady head",))
    assert np.isnan(np.frombuffer(sent["data"], np.float32).reshape(3, 5)[0]).tolist() == [False] * 2 + [True] * 3
    axes = tuple(map(read_axis, ("weights.tau=log(0.1,10,3)", "camera.fov_deg=lin(30,60,2)")))
    grid = replace(page.result, axes=axes, points=points_of(axes), values={})
    sent = packed(grid, "error", ("steady head", "lens"))
    assert (sent["kind"], sent["count"]) == ("map", 6)
    assert [axis["values"] for axis in sent["axes"]] == [["0.1", "1", "10"], ["30", "60"]]


def test_the_time_that_is_left_is_told():
    assert progress_text(300, 900, 2.0) == "300 of 900 fits, about 4 s left"
    assert progress_text(900, 900, 6.0) == "900 of 900 fits"


# --- taking a point ---


def test_a_click_takes_a_point_as_one_undo_step_and_keeps_the_other_settings(page):
    session = page._session
    session.set(camera={"fov_deg": 50.0})
    page.show_config()
    assert "Other settings have changed" in page.note.value
    page.view._handle_custom_msg({"pick": 4}, [])
    page.show_config()
    assert (session.config.weights.tau, session.config.camera.fov_deg) == (100.0, 50.0)
    assert session.undo_label == "sweep: steady head 100"
    assert page.view._sent["now"] == 4.0
    session.undo()
    assert (session.config.weights.tau, session.config.camera.fov_deg) == (CONFIG.weights.tau, 50.0)
    session.undo()
    page.show_config()
    assert page.note.value == ""


def test_a_curve_over_a_stage_stays_where_a_preset_lacks_the_stage(page):
    result, asked = page.result, page._asked
    point = Point(0, (("stages.expression.limit", 3),))
    axes = (read_axis("stages.expression.limit=1..3"),)
    page.result = replace(result, axes=axes, points=(point, *result.points[1:]))
    page._session.use(preset("deep"))
    page.show_config()
    assert page.view._sent["now"] is None
    assert "Other settings have changed" in page.note.value
    page.result, page._asked = result, asked


@pytest.mark.parametrize("content", [{"pick": 5}, {"pick": -1}, {"pick": True}, {"pick": "1"}, {}, "pick"])
def test_nonsense_from_a_page_takes_nothing(page, content):
    before = page._session.config
    page.view._handle_custom_msg(content, [])
    assert page._session.config == before


# --- what the user does ---


def test_the_slider_moved_last_is_offered_until_a_setting_is_chosen(head, clip):
    page = SweepPage(TuningSession(head, clip, CONFIG), lambda seconds: True, 170)
    page.moved("weights.tau")
    assert page.first.setting.path == "weights.tau"
    page.moved("group.jaw")
    assert page.first.setting.path == "landmarks.weights.jaw"
    assert (page.first.low.value, page.first.high.value) == ("0", "3")
    page.first.name.value = "lens"
    assert page.first.name.value == "lens · fov, ° · camera.fov_deg"
    page.moved("weights.tau")
    assert page.first.setting.path == "camera.fov_deg"
    page.close()


def test_refused_requests_are_said_in_a_sentence_and_leave_the_curve(page):
    before, name = page.result, page.first.name.value
    for text, said in (("", "Choose a setting first"), ("moustache", "No setting that can be swept")):
        page.first.name.value = text
        page.run()
        assert said in page.said.value
    page.first.name.value = name
    for low, said in (("many", "with numbers"), ("1e9", "the range is empty"), ("0.01", "")):
        page.first.low.value = low
        if said:
            page.run()
            assert page.wait_idle(60)
            assert said in page.said.value
    assert page.result is before


def test_looking_at_another_page_and_back_takes_nothing_from_a_sweep_that_is_asked_for(head, clip):
    """The page warms up once; a second time it would take the place of the sweep, which waits for the first."""
    session, running, begun = TuningSession(head, clip, CONFIG), [], threading.Event()
    page, sweep = SweepPage(session, lambda seconds: True, 170), session.sweep

    def seen(*asked, **options):
        running.append((page.running, page.stop.disabled))
        begun.set()
        return sweep(*asked, **options)

    session.sweep = seen
    page.turned(True)
    assert begun.wait(60)
    page.first.choose(found_setting(sweep_settings(CONFIG), "steady head"))
    page.first.count.value = 3
    page.run()
    page.turned(False)
    page.turned(True)
    assert page.wait_idle(300)
    assert page.result is not None
    assert len(page.result.values) == 3
    # Opening another clip asks of the second alone, and it alone is worth a stop.
    assert running == [(False, True), (True, False)]
    assert page.stop.disabled
    page.close()


def test_a_curve_keeps_its_names_while_the_next_sweep_has_no_point_yet(page):
    before, sent = page._asked, page.view._sent
    page._asked = replace(before, names=("another", "and one more"))
    page.objective.value = "jitter"
    page.objective.value = "error"
    assert page.view._sent == sent
    page._asked = before


def test_a_stopped_sweep_keeps_what_is_known(head, clip):
    session, reached, go_on = TuningSession(head, clip, CONFIG), threading.Event(), threading.Event()
    page = SweepPage(session, lambda seconds: go_on.wait(60) if reached.is_set() else None, 170)
    grown = page._grown

    def first_group(result):
        grown(result)
        reached.set()

    page._grown = first_group
    page.first.choose(found_setting(sweep_settings(CONFIG), "steady head"))
    page.first.count.value = 40
    assert not page.running
    assert page.stop.disabled
    page.run()
    assert not page.stop.disabled
    assert reached.wait(300)
    assert page.running
    assert not page.stop.disabled
    page.stop.click()
    go_on.set()
    assert page.wait_idle(60)
    assert not page.running
    assert page.stop.disabled
    assert "Stopped" in page.said.value
    assert 0 < len(page.result.values) < 40
    assert page.progress.layout.visibility == "hidden"
    page.close()


def test_a_configuration_that_cannot_be_swept_says_why(page):
    page._session.use(preset("deep"))
    page.run()
    assert page.wait_idle(60)
    assert "Deep Energies renders" in page.said.value
    assert page.stop.disabled
