"""Overlay, timeline and chart without a browser: what they send, and what they do with what a browser says."""

import threading

import cv2
import numpy as np
import pytest
import traitlets
from hypothesis import given
from hypothesis import strategies as st

from workbench.errors import InputError
from workbench.landmarks.scheme import GROUPS, POINT_COUNT
from workbench.landmarks.uncertainty import ellipses
from workbench.widgets.chart_view import COLORS, ChartView, pack_series, series_colors
from workbench.widgets.encoded_pictures import LARGEST_SIDE
from workbench.widgets.overlay_view import (
    SMALLEST_SCALE,
    OverlayEvent,
    OverlayView,
    automatic_scale,
    color_table,
    fit_table,
    float_bytes,
    point_groups,
    read_event,
)
from workbench.widgets.timeline_view import (
    FLAGGED,
    FOUND,
    NEW_SHOT,
    NOTHING,
    STALE,
    TimelineView,
    color_indices,
    frame_marks,
    worst_landmarks,
)

NOISE = np.random.default_rng(3)
OBSERVED = NOISE.uniform(50, 400, (POINT_COUNT, 2))
PROJECTED = OBSERVED + NOISE.normal(0, 2, (POINT_COUNT, 2))
PICTURE = NOISE.integers(0, 255, (60, 80, 3), np.uint8)


class Sent:
    """The messages of a view: the names of the traits in each, and the custom ones."""

    def __init__(self, view, monkeypatch):
        self.updates, self.custom = [], []
        monkeypatch.setattr(view, "send_state", lambda key=None: self.updates.append(self._names(key)))
        monkeypatch.setattr(view, "send", lambda content, buffers=None: self.custom.append((content, buffers)))

    @staticmethod
    def _names(key) -> set[str]:
        return {key} if isinstance(key, str) else set(key)


def say(view, **content) -> None:
    """As a message of the browser arrives."""
    view._handle_custom_msg(content, [])


def floats(data: bytes) -> np.ndarray:
    return np.frombuffer(data, "<f4")


@pytest.fixture
def overlay():
    view = OverlayView()
    yield view
    view.close()


@pytest.fixture
def timeline():
    view = TimelineView()
    yield view
    view.close()


@pytest.fixture
def chart():
    view = ChartView(title="Energy")
    yield view
    view.close()


class TestColourScale:
    @given(st.lists(st.floats(0, 1e6), min_size=1, max_size=80))
    def test_it_covers_the_95th_percentile_but_not_much_more(self, values):
        values = np.array(values)
        top = max(np.percentile(values, 95), SMALLEST_SCALE)
        assert top * (1 - 1e-6) <= automatic_scale(values) <= top * 1.51

    def test_it_has_a_floor_and_ignores_what_is_not_finite(self):
        assert automatic_scale(np.zeros(68)) == SMALLEST_SCALE
        assert automatic_scale(np.full(68, np.nan)) == SMALLEST_SCALE
        assert automatic_scale(np.array([3.0, np.nan, np.inf])) == 3.0

    def test_the_colours_rise_in_lightness(self):
        lightness = color_table() @ np.array([0.2126, 0.7152, 0.0722])
        assert np.all(np.diff(lightness) > -1)
        assert lightness[-1] - lightness[0] > 100


class TestOverlay:
    def test_a_fit_is_one_message(self, overlay, monkeypatch):
        sent = Sent(overlay, monkeypatch)
        overlay.set_fit(OBSERVED, PROJECTED)
        assert len(sent.updates) == 1
        assert {"_fit", "_scale"} <= sent.updates[0]
        assert "_picture" not in sent.updates[0]

    def test_the_same_picture_again_sends_nothing(self, overlay, monkeypatch):
        sent = Sent(overlay, monkeypatch)
        overlay.set_picture(PICTURE)
        overlay.set_picture(PICTURE)
        overlay.set_picture(PICTURE.copy())
        assert len([names for names in sent.updates if names]) == 1

    def test_the_picture_is_a_jpeg_of_it(self, overlay):
        smooth = cv2.resize(PICTURE[:6, :8], (320, 240), interpolation=cv2.INTER_CUBIC)
        overlay.set_picture(smooth)
        decoded = cv2.imdecode(np.frombuffer(overlay._picture, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        assert np.abs(decoded.astype(int) - smooth).mean() < 6
        assert overlay._size == [320, 240]

    def test_a_huge_picture_is_reduced_but_keeps_its_pixel_numbers(self, overlay):
        overlay.set_picture(np.zeros((500, 2 * LARGEST_SIDE, 3), np.uint8))
        assert cv2.imdecode(np.frombuffer(overlay._picture, np.uint8), cv2.IMREAD_COLOR).shape == (250, LARGEST_SIDE, 3)
        assert overlay._size == [2 * LARGEST_SIDE, 500]

    def test_the_table_of_a_fit(self):
        values, weights = np.arange(68.0), np.ones(68)
        table = fit_table(OBSERVED, PROJECTED, values, None, weights)
        np.testing.assert_array_equal(table[:, :2], OBSERVED)
        np.testing.assert_array_equal(table[:, 2:4], PROJECTED)
        np.testing.assert_array_equal(table[:, 4], values)
        np.testing.assert_allclose(table[:, 5], np.linalg.norm(PROJECTED - OBSERVED, axis=1))
        np.testing.assert_array_equal(table[:, 6:], 1.0)

    def test_a_detection_without_a_model_can_be_shown(self):
        table = fit_table(OBSERVED, None, None, None, None)
        assert np.isnan(table[:, 2:6]).all()

    def test_the_bytes_are_little_endian_float32(self, overlay):
        overlay.set_fit(OBSERVED, PROJECTED)
        np.testing.assert_allclose(floats(overlay._fit).reshape(68, 8)[:, :2], OBSERVED, rtol=1e-6)
        assert float_bytes(np.array([[1.0, 2.0]])) == b"\x00\x00\x80?\x00\x00\x00@"

    def test_muted_landmarks_are_those_without_weight_and_do_not_set_the_scale(self, overlay):
        values, weights = np.ones(68), np.ones(68)
        weights[[3, 40]], values[:8] = 0.0, 50.0
        overlay.set_fit(OBSERVED, PROJECTED, values, weights=weights)
        assert overlay.muted == (3, 40)
        assert overlay.scale == 50.0
        weights[:8] = 0.0
        overlay.set_fit(OBSERVED, PROJECTED, values, weights=weights)
        assert overlay.scale == 1.0

    def test_a_scale_that_was_set_stays(self, overlay):
        overlay.set_fit(OBSERVED, PROJECTED, np.full(68, 7.0))
        assert overlay.scale == 8.0
        overlay.scale_max = 25.0
        assert overlay.scale == 25.0
        overlay.set_fit(OBSERVED, PROJECTED, np.full(68, 70.0))
        assert overlay.scale == 25.0
        overlay.scale_max = 0.0
        assert overlay.scale == 80.0

    def test_no_face_takes_the_landmarks_away(self, overlay):
        overlay.set_fit(OBSERVED, PROJECTED)
        overlay.set_fit(None)
        assert overlay._fit == b""
        assert overlay._no_face
        assert overlay.muted == ()

    def test_the_layer_is_a_png_with_its_transparency(self, overlay):
        rgba = np.dstack([PICTURE, np.full((60, 80), 90, np.uint8)])
        overlay.set_layer(rgba)
        decoded = cv2.imdecode(np.frombuffer(overlay._layer, np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(cv2.cvtColor(decoded, cv2.COLOR_BGRA2RGBA), rgba)
        overlay.set_layer(None)
        assert overlay._layer == b""

    def test_heat_is_a_layer_of_its_own(self, overlay):
        rgba = np.dstack([PICTURE, np.full((60, 80), 90, np.uint8)])
        overlay.set_layer(rgba)
        overlay.set_heat(rgba[::2, ::2].copy())
        decoded = cv2.imdecode(np.frombuffer(overlay._heat, np.uint8), cv2.IMREAD_UNCHANGED)
        assert decoded.shape == (30, 40, 4)
        overlay.set_heat(None)
        assert overlay._heat == b""
        assert overlay._layer

    def test_wire_segments_that_are_not_finite_are_left_out(self, overlay):
        segments = np.arange(12.0).reshape(3, 2, 2)
        segments[1, 0, 0] = np.nan
        overlay.set_wire(segments)
        np.testing.assert_array_equal(floats(overlay._wire), segments[[0, 2]].ravel())
        overlay.set_wire(None)
        assert overlay._wire == b""

    def test_ellipses_are_closed_lines_around_the_landmarks(self, overlay):
        corners = ellipses(OBSERVED, np.tile(np.diag([4.0, 1.0]), (len(OBSERVED), 1, 1)))
        overlay.set_ellipses(corners)
        np.testing.assert_array_equal(floats(overlay._ellipses), corners.astype(np.float32).ravel())
        overlay.set_ellipses(None)
        assert overlay._ellipses == b""
        assert not overlay.layers["ellipses"]

    def test_every_landmark_has_its_smallest_group(self):
        groups = point_groups()
        assert (groups[8], groups[17], groups[36], groups[48], groups[60]) == (
            *("jaw", "right brow", "right eye"),
            *("outer lips", "inner lips"),
        )

    @pytest.mark.parametrize("count", [67, 69])
    def test_another_number_of_landmarks_is_refused(self, overlay, count):
        with pytest.raises(InputError, match="68"):
            overlay.set_fit(np.zeros((count, 2)))
        with pytest.raises(InputError, match="weights"):
            overlay.set_fit(OBSERVED, weights=np.ones(count))

    def test_pictures_of_another_kind_are_refused(self, overlay):
        for picture in (PICTURE / 255, PICTURE[..., 0]):
            with pytest.raises(InputError, match="uint8"):
                overlay.set_picture(picture)
        with pytest.raises(InputError, match=r"h, w, 4"):
            overlay.set_layer(PICTURE)
        with pytest.raises(InputError, match=r"h, w, 4"):
            overlay.set_heat(PICTURE)
        with pytest.raises(InputError, match=r"n, 2, 2"):
            overlay.set_wire(np.zeros((4, 2)))
        with pytest.raises(InputError, match=r"points, corners, 2"):
            overlay.set_ellipses(np.zeros((68, 2)))

    def test_traits_check_their_values(self, overlay):
        for name, value in [("tool", "hammer"), ("selection", [68]), ("layers", {"hat": True}), ("layer_opacity", 2.0)]:
            with pytest.raises(traitlets.TraitError):
                setattr(overlay, name, value)

    def test_setters_work_from_many_threads(self, overlay):
        fits = [OBSERVED + k for k in range(8)]
        threads = [threading.Thread(target=lambda fit=fit: overlay.set_fit(fit, fit)) for fit in fits]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(timeout=20)
        shown = floats(overlay._fit).reshape(68, 8)[:, :2]
        assert any(np.allclose(shown, fit, rtol=1e-6) for fit in fits)


class TestEvents:
    def test_they_reach_every_callback(self, overlay):
        heard, others = [], []
        overlay.on_event(heard.append)
        overlay.on_event(others.append)
        say(overlay, kind="drag", points=[30], x=12.5, y=40)
        overlay.on_event(others.append, remove=True)
        say(overlay, kind="mute", points=[3, 4], x=None, y=None)
        assert heard == [OverlayEvent("drag", (30,), 12.5, 40.0), OverlayEvent("mute", (3, 4), None, None)]
        assert others == heard[:1]

    @pytest.mark.parametrize("kind", ["select", "lasso"])
    def test_the_selection_is_set_before_the_callbacks(self, overlay, kind):
        seen = []
        overlay.on_event(lambda event: seen.append(list(overlay.selection)))
        say(overlay, kind=kind, points=[5, 6])
        assert seen == [[5, 6]]

    @pytest.mark.parametrize(
        "content",
        [
            "select",
            {},
            {"kind": "delete", "points": [1]},
            {"kind": "select", "points": [68]},
            {"kind": "select", "points": [-1]},
            {"kind": "select", "points": [True]},
            {"kind": "select", "points": "30"},
            {"kind": "drag", "points": [30], "x": 1.0},
            {"kind": "drag", "points": [30], "x": float("nan"), "y": 1.0},
            {"kind": "drag", "points": [30], "x": "1", "y": 1.0},
            {"kind": "drop", "points": [30, 31], "x": 1.0, "y": 1.0},
        ],
    )
    def test_what_is_not_an_event_is_ignored(self, content):
        assert read_event(content) is None

    def test_a_failing_callback_is_shown_and_the_others_still_run(self, overlay):
        heard = []

        def fail(event):
            if event.kind == "mute":
                raise InputError("nothing to mute")

        overlay.on_event(fail)
        overlay.on_event(heard.append)
        say(overlay, kind="mute", points=[3])
        assert overlay.message == "nothing to mute"
        assert len(heard) == 1
        say(overlay, kind="reset", points=[3])
        assert overlay.message == ""

    def test_an_unexpected_error_is_named(self, overlay):
        overlay.on_event(lambda event: 1 / 0)
        say(overlay, kind="reset", points=[3])
        assert overlay.message == "ZeroDivisionError: division by zero"


class TestTimeline:
    VALUES = np.abs(NOISE.normal(0, 2, (50, 68)))

    def test_colour_indices_reach_from_zero_to_the_scale(self):
        values = np.zeros((1, 68))
        values[0, :5] = [0.0, 2.0, 4.0, 90.0, np.nan]
        assert color_indices(values, 4.0)[0, :5].tolist() == [0, 127, 254, 254, NOTHING]

    def test_the_worst_landmark_of_every_frame(self):
        values = np.zeros((3, 68))
        values[0, 7], values[1, :], values[2, 60:] = 5.0, np.nan, np.nan
        values[2, 59] = 1.0
        largest, worst = worst_landmarks(values)
        np.testing.assert_array_equal(largest, [5.0, np.nan, 1.0])
        assert worst.tolist() == [7, 0, 59]
        assert [len(part) for part in worst_landmarks(np.zeros((0, 68)))] == [0, 0]

    def test_marks(self):
        yes_no = np.array([True, False, False, False])
        marks = frame_marks(yes_no, yes_no[::-1], ~yes_no, np.array([2, 2, 3, 3]))
        assert marks.tolist() == [FLAGGED, FOUND, FOUND | NEW_SHOT, FOUND | STALE]

    def test_a_track_is_one_message_with_everything(self, timeline, monkeypatch):
        sent = Sent(timeline, monkeypatch)
        timeline.set_track(self.VALUES, first_index=10)
        track = timeline.get_state("_track")["_track"]
        assert (track["first"], track["count"]) == (10, 50)
        assert [len(track[name]) for name in ("codes", "largest", "worst", "marks")] == [50 * 68, 200, 100, 50]
        assert "_track" in sent.updates[0]
        assert timeline.frame == 10

    def test_a_flagged_frame_carries_why_it_is_flagged(self, timeline):
        flagged = np.arange(50) == 7
        timeline.set_track(self.VALUES, flagged, why=["the pose jumps" if flag else "" for flag in flagged])
        assert timeline.get_state("_why")["_why"] == {"7": "the pose jumps"}
        timeline.set_track(self.VALUES, flagged)
        assert timeline.get_state("_why")["_why"] == {}
        with pytest.raises(InputError, match="one text for each of the 50 frames; got 1"):
            timeline.set_track(self.VALUES, flagged, why=["the pose jumps"])

    def test_frames_without_numbers_have_no_face(self, timeline):
        values = self.VALUES.copy()
        values[5:7] = np.nan
        timeline.set_track(values)
        marks = np.frombuffer(timeline.get_state("_track")["_track"]["marks"], np.uint8)
        assert np.flatnonzero(marks & FOUND == 0).tolist() == [5, 6]

    def test_a_part_is_sent_alone_but_a_new_browser_gets_it_too(self, timeline, monkeypatch):
        timeline.set_track(self.VALUES, first_index=100)
        sent = Sent(timeline, monkeypatch)
        flags = np.array([True, False])
        timeline.update_frames(120, self.VALUES[:2] / 9, flagged=flags, stale=flags)
        assert sent.updates == []
        (content, buffers) = sent.custom[0]
        assert content["start"] == 20
        assert content["names"] == ["codes", "largest", "worst", "marks"]
        assert len(buffers[0]) == 3 * 68  # and the frame after, which may begin a shot
        whole = timeline.get_state("_track")["_track"]
        assert whole["codes"][20 * 68 : 23 * 68] == buffers[0]
        assert timeline.flagged == (120,)

    def test_a_second_display_asks_for_the_parts_it_has_missed(self, timeline, monkeypatch):
        timeline.set_track(self.VALUES)
        sent = Sent(timeline, monkeypatch)
        say(timeline, kind="shown")
        assert sent.updates == []
        timeline.update_frames(3, self.VALUES[:1] / 9)
        say(timeline, kind="shown")
        assert sent.updates == [{"_track"}]

    def test_the_automatic_scale_grows_with_a_track_that_comes_in_parts(self, timeline):
        timeline.set_track(np.full((4, 68), np.nan))
        assert timeline.scale == SMALLEST_SCALE
        timeline.update_frames(0, np.full((2, 68), 3.0))
        assert timeline.scale == 3.0
        codes = np.frombuffer(timeline.get_state("_track")["_track"]["codes"], np.uint8).reshape(4, 68)
        assert codes[:, 0].tolist() == [254, 254, NOTHING, NOTHING]

    def test_a_scale_that_was_set_colours_the_strip(self, timeline):
        timeline.set_track(np.full((2, 68), 3.0))
        timeline.scale_max = 6.0
        assert set(timeline.get_state("_track")["_track"]["codes"]) == {127}

    def test_what_was_given_is_copied(self, timeline):
        values = self.VALUES.copy()
        timeline.set_track(values)
        before = timeline.get_state("_track")["_track"]["codes"]
        values[:] = 0.0
        assert timeline.get_state("_track")["_track"]["codes"] == before

    def test_the_frame_stays_inside_the_track(self, timeline):
        timeline.frame = 400
        timeline.set_track(self.VALUES, first_index=7)
        assert timeline.frame == 56

    def test_arrays_that_do_not_fit_are_refused(self, timeline):
        timeline.set_track(self.VALUES, first_index=5)
        with pytest.raises(InputError, match="5 to 54"):
            timeline.update_frames(4, self.VALUES[:1])
        with pytest.raises(InputError, match="5 to 54"):
            timeline.update_frames(50, self.VALUES[:6])
        with pytest.raises(InputError, match="stale"):
            timeline.update_frames(50, self.VALUES[:2], stale=np.zeros(3, bool))
        with pytest.raises(InputError, match="frames, 68"):
            timeline.set_track(self.VALUES[:, :60])


class TestChart:
    X = np.arange(5)

    def test_one_row_for_x_and_one_for_each_series(self):
        packed = pack_series(self.X, {"a": self.X * 2.0, "b": np.full(5, np.nan)})
        rows = floats(packed["data"]).reshape(3, 5)
        np.testing.assert_array_equal(rows, [self.X, self.X * 2, np.full(5, np.nan)])
        assert packed["names"] == ["a", "b"]

    def test_the_first_eight_colours_differ_and_then_come_again(self):
        assert len(set(series_colors(8))) == 8
        assert series_colors(10)[8:] == list(COLORS[:2])

    def test_own_colours(self):
        packed = pack_series(self.X, {"a": self.X, "b": self.X}, {"b": "#123456"})
        assert packed["colors"] == [COLORS[0], "#123456"]

    def test_values_beyond_float32_are_left_out(self):
        assert np.isinf(floats(pack_series(self.X, {"a": np.full(5, 1e300)})["data"])[5:]).all()

    def test_series_that_do_not_fit_are_refused(self):
        with pytest.raises(InputError, match="'a'"):
            pack_series(self.X, {"a": np.zeros(4)})
        with pytest.raises(InputError, match="ascending"):
            pack_series(self.X[::-1].copy(), {})

    def test_marks_labels_and_cursor(self, chart):
        chart.set_series(self.X, {"a": self.X}, marks=[(0, "pose"), (3, "expression")], cursor=2, shaded=[(1, 3)])
        assert chart._series["marks"] == [[0.0, "pose"], [3.0, "expression"]]
        assert chart._series["shaded"] == [[1.0, 3.0]]
        assert chart.cursor == 2.0
        chart.set_series(self.X, {"a": self.X})
        assert chart.cursor == 2.0

    def test_a_click_moves_the_cursor_and_calls_back(self, chart):
        heard = []
        chart.on_pick(heard.append)
        say(chart, pick=3.0)
        assert heard == [3.0]
        assert chart.cursor == 3.0
        chart.on_pick(heard.append, remove=True)
        say(chart, pick=4)
        assert heard == [3.0]

    @pytest.mark.parametrize("pick", [None, "3", True, float("nan")])
    def test_other_messages_are_ignored(self, chart, pick):
        chart.on_pick(lambda x: pytest.fail("called"))
        say(chart, pick=pick)
        assert chart.cursor is None

    def test_a_failing_callback_does_not_stop_the_others(self, chart, caplog):
        heard = []
        chart.on_pick(lambda x: 1 / 0)
        chart.on_pick(heard.append)
        say(chart, pick=1.0)
        assert heard == [1.0]
        assert "ChartView" in caplog.text


def test_the_views_say_what_they_show_without_their_arrays(overlay, timeline, chart):
    overlay.set_picture(PICTURE)
    overlay.set_fit(OBSERVED)
    timeline.set_track(TestTimeline.VALUES)
    chart.set_series(np.arange(3), {"a": np.zeros(3)})
    assert repr(overlay) == "OverlayView(80 × 60, face)"
    assert repr(timeline) == "TimelineView(50 frames from 0, at 0)"
    assert repr(chart) == "ChartView('Energy', 1 series of 3)"


@pytest.mark.parametrize("view", [OverlayView, TimelineView, ChartView])
def test_the_scripts_load_nothing(view):
    text = str(view._esm)
    assert text.endswith(" render };\n")
    for word in ("import ", "http:", "https:", "fetch(", "XMLHttpRequest", "innerHTML"):
        assert word not in text


def test_groups_cover_every_row(timeline):
    rows = timeline._scheme["rows"]
    assert sum(row["count"] for row in rows) == POINT_COUNT
    assert [row["first"] for row in rows] == [GROUPS[row["name"]][0] for row in rows]
