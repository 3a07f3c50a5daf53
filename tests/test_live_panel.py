"""The live panel without a browser: its camera, what it sends, its buttons, and what is left when it ends."""

import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from tests.live_pictures import HandCamera, sample_frames
from workbench.config import preset
from workbench.errors import InputError
from workbench.face import posed_vertices
from workbench.geometry import rotation_matrix
from workbench.samples import sample
from workbench.session.live_frame import FrameSource, LiveFrame
from workbench.widgets import LivePanel
from workbench.widgets.live_view import (
    MARK_COLUMNS,
    NUMBERS_BEFORE_WEIGHTS,
    TROUBLES,
    BrowserCamera,
    LiveView,
    mesh_message,
    pack_fit,
    person_message,
)
from workbench.widgets.record_bar import free_folder


@pytest.fixture(scope="module")
def frames():
    return sample_frames(40)


@pytest.fixture
def camera():
    return HandCamera()


@pytest.fixture
def panel(head, camera):
    made = LivePanel(camera, head)
    sent = made.sent = []
    made.view.send = lambda content, buffers=(): sent.append((content, list(buffers)))
    yield made
    made.close()


def play(panel, camera, frames):
    for frame in frames:
        camera.deliver(frame)
        assert panel.wait_idle(120)


def fits_sent(panel):
    return [(content, buffers) for content, buffers in panel.sent if content["kind"] == "fit"]


def tell(view, content, *buffers):
    view._handle_custom_msg(content, list(buffers))


# --- from the camera to the screen ---


def test_each_frame_becomes_one_message_with_pose_weights_and_landmarks(panel, camera, frames, head):
    panel.start()
    play(panel, camera, frames[:1])
    tell(panel.view, {"kind": "shown", "page": "one", "number": 0, "ms": 40.0})
    play(panel, camera, frames[1:2])
    content, buffers = fits_sent(panel)[-1]
    assert (content["number"], content["found"], content["size"]) == (1, True, [640, 480])
    numbers, shapes = np.frombuffer(buffers[0], "<f4"), len(head.expression_names)
    fit = panel.fit
    np.testing.assert_allclose(numbers[:9].reshape(3, 3), rotation_matrix(np.asarray(fit.rotation)), atol=1e-6)
    np.testing.assert_allclose(numbers[9:12], fit.translation, rtol=1e-5)
    np.testing.assert_allclose(numbers[NUMBERS_BEFORE_WEIGHTS:][:shapes], fit.expression, atol=1e-6)
    marks = numbers[NUMBERS_BEFORE_WEIGHTS + shapes :].reshape(68, MARK_COLUMNS)
    np.testing.assert_allclose(marks[:, :2], fit.observed, rtol=1e-5)
    np.testing.assert_allclose(marks[:, 4], fit.residuals_px, rtol=1e-4, atol=1e-4)
    assert bytes(buffers[1]) == frames[1].jpeg
    assert content["error"] == pytest.approx(fit.errors[0], abs=1e-3)


def test_the_browser_can_build_the_very_head_of_a_fit(head):
    rng = np.random.default_rng(3)
    identity, weights = rng.normal(0.0, 1.0, len(head.identity_deltas)), rng.uniform(0.0, 1.0, 44)
    mesh, person = mesh_message(head), person_message(head, identity)
    deltas = np.frombuffer(mesh["deltas"], "<i2").reshape(44, -1, 3)
    scale = weights * mesh["steps"] * person["factors"]
    built = np.frombuffer(person["neutral"], "<f4").reshape(-1, 3) + np.einsum("k,kvd->vd", scale, deltas)
    personal = head.personal(identity)
    np.testing.assert_allclose(built, posed_vertices(personal, weights, np.zeros(6), 1.0), atol=0.05)
    order = np.frombuffer(mesh["order"], "<u4")
    drawn = np.frombuffer(mesh["drawn"], "<u4").reshape(-1, 3)
    assert sorted(map(sorted, order[drawn].tolist())) == sorted(map(sorted, head.triangles.tolist()))


def test_while_it_runs_busy_cells_leave_other_threads_their_turn_each_millisecond(panel, head):
    usual = sys.getswitchinterval()
    other = LivePanel(HandCamera(), head)
    panel.start()
    other.start()
    panel.stop()
    assert sys.getswitchinterval() == pytest.approx(0.001)
    other.close()
    assert sys.getswitchinterval() == pytest.approx(usual)


def test_a_frame_without_a_face_is_told_as_that(panel, camera):
    panel.start()
    play(panel, camera, [LiveFrame(0, 0.0, np.full((480, 640, 3), 90, np.uint8))])
    content, buffers = fits_sent(panel)[-1]
    assert content["found"] is False
    assert np.isnan(np.frombuffer(buffers[0], "<f4")[:12]).all()
    assert np.isfinite(pack_fit(panel.fit)[12:16]).all()


def test_pictures_wait_until_the_browser_has_drawn_the_one_before(panel, camera, frames):
    panel.start()
    play(panel, camera, frames[:3])
    assert [content["number"] for content, _ in fits_sent(panel)] == [0]
    tell(panel.view, {"kind": "shown", "page": "p", "number": 0, "ms": 40.0})
    play(panel, camera, frames[3:4])
    assert [content["number"] for content, _ in fits_sent(panel)] == [0, 3]
    assert panel.view.times[-1].milliseconds == 40.0


def test_of_frames_that_come_during_a_fit_only_the_newest_counts(panel, camera, frames, monkeypatch):
    panel.start()
    play(panel, camera, frames[:1])
    entered, go, fitted, step = threading.Event(), threading.Event(), [], panel.session.step

    def slow(frame):
        fitted.append(frame.number)
        entered.set()
        assert go.wait(30)
        return step(frame)

    monkeypatch.setattr(panel.session, "step", slow)
    camera.deliver(frames[1])
    assert entered.wait(30)
    began = time.monotonic()
    for frame in frames[2:30]:
        camera.deliver(frame)
    assert time.monotonic() - began < 1.0
    go.set()
    assert panel.wait_idle()
    assert fitted == [1, 29]


def test_a_frame_that_fails_is_told_and_the_next_one_is_fitted(panel, camera, frames):
    panel.start()
    play(panel, camera, frames[:1])
    camera.deliver(LiveFrame(7, 0.3, jpeg=b"broken"))
    assert panel.wait_idle()
    assert (panel.view.message, panel.view.alert) == (
        "Frame 7 of the camera is not a readable JPEG; it was skipped.",
        True,
    )
    assert camera.skips == [7]
    play(panel, camera, frames[1:2])
    assert panel.fit.index == 1


def test_the_avatar_gets_the_calibrated_face_shape(panel, camera, frames):
    panel.start()
    before = panel.view._person["neutral"]
    play(panel, camera, frames[:26])
    assert panel.session.calibrated == "first second"
    panel.status._written = 0.0
    panel.status.tell(panel.session)
    assert "face shape: from the first second" in panel.status.value
    assert panel.view._person["neutral"] != before


# --- the browser's camera ---


@pytest.fixture
def browser_panel(head):
    made = LivePanel(model=head)
    sent = made.sent = []
    made.view.send = lambda content, buffers=(): sent.append((content, list(buffers)))
    yield made
    made.close()


def kinds(panel):
    return [content["kind"] for content, _ in panel.sent]


def test_the_first_page_that_answers_gets_the_camera(browser_panel):
    view = browser_panel.view
    browser_panel.start()
    assert kinds(browser_panel) == ["call"]
    tell(view, {"kind": "here", "page": "one"})
    tell(view, {"kind": "here", "page": "two"})
    opened = [content for content, _ in browser_panel.sent if content["kind"] == "open"]
    assert [content["page"] for content in opened] == ["one"]
    assert opened[0]["size"] == [640, 480]
    assert view.pages == 2


def test_a_page_that_shows_the_panel_later_is_asked_then(browser_panel):
    browser_panel.start()
    tell(browser_panel.view, {"kind": "here", "page": "late"})
    assert kinds(browser_panel)[-1] == "open"


def test_a_page_that_was_loaded_anew_gets_the_camera_of_the_one_before(browser_panel, monkeypatch):
    monkeypatch.setattr("workbench.widgets.live_view.LOST_S", 0.05)
    browser_panel.start()
    tell(browser_panel.view, {"kind": "here", "page": "before"})
    time.sleep(0.1)
    tell(browser_panel.view, {"kind": "here", "page": "after"})
    assert [content["page"] for content, _ in browser_panel.sent if content["kind"] == "open"] == ["before", "after"]


def test_a_page_whose_camera_closed_unasked_opens_it_again_with_its_next_sign_of_life(browser_panel):
    """As when the connection to the kernel broke, and came back without anybody telling."""
    browser_panel.start()
    tell(browser_panel.view, {"kind": "here", "page": "one"})
    tell(browser_panel.view, {"kind": "beat", "page": "one", "closed": False})
    tell(browser_panel.view, {"kind": "beat", "page": "another", "closed": True})
    assert kinds(browser_panel) == ["call", "open"]
    tell(browser_panel.view, {"kind": "beat", "page": "one", "closed": True})
    assert kinds(browser_panel) == ["call", "open", "open"]
    browser_panel.stop()
    tell(browser_panel.view, {"kind": "beat", "page": "one", "closed": True})
    assert kinds(browser_panel) == ["call", "open", "open", "close"]


def test_a_page_that_the_kernel_took_for_gone_gets_the_camera_with_its_next_sign_of_life(browser_panel):
    browser_panel.start()
    for page in ("one", "two"):
        tell(browser_panel.view, {"kind": "here", "page": page})
    tell(browser_panel.view, {"kind": "left", "page": "one"})
    tell(browser_panel.view, {"kind": "beat", "page": "two", "closed": True})
    assert [content["page"] for content, _ in browser_panel.sent if content["kind"] == "open"] == ["one", "two"]


def test_a_frame_of_the_browser_is_fitted_and_its_picture_stays_there(browser_panel, frames):
    browser_panel.start()
    tell(browser_panel.view, {"kind": "here", "page": "one"})
    message = {"kind": "frame", "page": "one", "number": 5, "time": 1234.5, "shown": None}
    tell(browser_panel.view, message, memoryview(frames[0].jpeg))
    assert browser_panel.wait_idle(120)
    content, buffers = fits_sent(browser_panel)[-1]
    assert (content["number"], len(buffers)) == (5, 1)
    message = {**message, "number": 6, "shown": {"number": 5, "ms": 88.0}}
    tell(browser_panel.view, message, memoryview(frames[1].jpeg))
    assert browser_panel.view.times[-1].milliseconds == 88.0


@pytest.mark.parametrize(
    "content",
    [
        "text",
        {"kind": "frame"},
        {"kind": "frame", "page": "other", "number": 0, "time": 0.0},
        {"kind": "frame", "page": "one", "number": "0", "time": 0.0},
        {"kind": "frame", "page": "one", "number": 0, "time": None},
        {"kind": "frame", "page": "one", "number": 0, "time": 0.0},
        {"kind": "shown", "page": "one", "number": None, "ms": 3.0},
        {"kind": "unknown", "page": "one"},
    ],
)
def test_messages_that_make_no_sense_are_left_out(browser_panel, content):
    browser_panel.start()
    tell(browser_panel.view, {"kind": "here", "page": "one"})
    tell(browser_panel.view, content)
    assert browser_panel.wait_idle()
    assert browser_panel.fit is None
    assert not browser_panel.view.times


@pytest.mark.parametrize("why", sorted(TROUBLES))
def test_every_trouble_of_a_browser_is_one_sentence_and_ends_it(browser_panel, why):
    browser_panel.start()
    tell(browser_panel.view, {"kind": "here", "page": "one"})
    tell(browser_panel.view, {"kind": "trouble", "page": "one", "why": why, "detail": "OddError"})
    assert not browser_panel.running
    assert (browser_panel.view.running, browser_panel.run_button.value) == (False, False)
    said = browser_panel.view.message
    assert said == TROUBLES[why].format(detail="OddError")
    assert browser_panel.view.alert
    assert said.endswith(".")
    assert said.count(". ") == 0


def test_the_camera_goes_off_when_no_page_shows_the_panel(browser_panel):
    browser_panel.start()
    for page in ("one", "two"):
        tell(browser_panel.view, {"kind": "here", "page": page})
    tell(browser_panel.view, {"kind": "left", "page": "one"})
    assert browser_panel.running
    tell(browser_panel.view, {"kind": "left", "page": "two"})
    assert not browser_panel.running
    assert kinds(browser_panel)[-1] == "close"


def test_the_kernels_camera_goes_off_when_no_page_was_heard_of_for_long(panel, camera, frames, monkeypatch):
    panel.start()
    tell(panel.view, {"kind": "here", "page": "one"})
    play(panel, camera, frames[:1])
    assert panel.running
    monkeypatch.setattr("workbench.widgets.live_panel.FORSAKEN_S", 0.0)
    play(panel, camera, frames[1:2])
    assert not panel.running


def test_both_cameras_keep_one_protocol(head):
    assert isinstance(BrowserCamera(LiveView(head)), FrameSource)
    assert isinstance(HandCamera(), FrameSource)


@pytest.mark.parametrize(
    ("camera", "offered", "said"),
    [
        (None, "browser's camera", "from the browser to the kernel and nowhere else."),
        (0, "kernel's camera", "of camera 0 of the kernel go from the kernel to this page"),
        (sample("performance"), "performance.mp4", "of performance.mp4 go from the kernel to this page"),
    ],
)
def test_the_first_message_says_where_the_pictures_of_the_chosen_source_go(head, camera, offered, said):
    made = LivePanel(camera, head)
    assert made.camera.value == offered
    assert made.view.message.startswith("Press start. ")
    assert said in made.view.message
    made.camera.value = "sample clip"
    assert "of laugh.mp4 go from the kernel to this page" in made.view.message
    made.camera.value = "browser's camera"
    assert "from the browser to the kernel" in made.view.message
    made.close()


# --- buttons ---


def test_the_button_starts_and_stops(panel, camera, frames):
    panel.run_button.value = True
    assert panel.running
    assert panel.run_button.description == "■ stop"
    play(panel, camera, frames[:1])
    assert panel.view.message == ""
    panel.run_button.value = False
    assert not panel.running
    assert camera.deliver is None
    assert panel.view.message == "Stopped; the camera is off."


def test_the_browser_may_stop_by_itself(panel):
    panel.start()
    panel.view.running = False
    assert not panel.running


def test_recording_ends_with_the_camera_and_is_saved(panel, camera, frames, tmp_path):
    panel.start()
    play(panel, camera, frames[:1])
    panel.record()
    play(panel, camera, frames[1:7])
    panel.stop()
    assert not panel.record_button.value
    assert len(panel.track) == 6
    assert "recorded 6 frames" in panel.saved.value
    panel.folder.value = str(tmp_path / "take")
    panel.save_button.click()
    assert panel.wait_idle()
    assert sorted(path.name for path in (tmp_path / "take").iterdir()) == ["clip.mp4", "track.npz"]
    assert "(track.npz, clip.mp4)" in panel.saved.value
    assert panel.folder.value == str(tmp_path / "take-2")
    panel.folder.value = str(tmp_path / "take")
    panel.save_button.click()
    assert panel.wait_idle()
    assert "already holds a recording or a run; name another folder" in panel.view.message


def test_nothing_recorded_is_said(panel, tmp_path):
    with pytest.raises(InputError, match="Nothing has been recorded"):
        _ = panel.track
    with pytest.raises(InputError, match="Nothing has been recorded"):
        panel.save(tmp_path)
    panel.record()
    assert (panel.view.message, panel.record_button.value) == ("Start the camera first.", False)
    panel.calibrate()
    assert panel.view.message == "Start the camera first."


def test_a_recording_that_ended_by_itself_is_kept(panel, camera, frames, monkeypatch):
    panel.start()
    play(panel, camera, frames[:1])
    panel.record()
    play(panel, camera, frames[1:3])
    monkeypatch.setattr("workbench.session.recording.MOST_S", 0.0)
    play(panel, camera, frames[3:4])
    assert len(panel.recording) == 2
    assert "maximum length" in panel.view.message
    assert not panel.record_button.value


def test_knobs_presets_undo_and_defaults(panel):
    start = panel.session.config
    panel.turn("weights.sigma_smooth", 4.0)
    panel.turn("rho", 3)
    assert panel.session.config.weights.sigma_smooth == 4.0
    panel.preset.value = "face-it"
    assert panel.session.config == preset("face-it")
    panel.undo.click()
    assert (panel.preset.value, panel.controls.by_path["rho"].value) == ("joint", 3)
    panel.defaults.click()
    assert panel.session.config == start
    panel.undo.click()
    assert panel.session.config.weights.sigma_smooth == 4.0
    for _ in range(3):
        panel.undo.click()
    assert panel.session.config == start
    assert "nothing to undo" in panel.status.value


def test_a_refused_number_leaves_the_slider_at_the_old_value(panel):
    knob = panel.controls.by_path["weights.tau"]
    old, shown = knob.value, knob.readout.value
    knob.readout.value = "-3"
    assert "tau" in panel.view.message
    assert (panel.session.config.weights.tau, knob.value, knob.readout.value) == (old, old, shown)


def test_another_preset_while_recording_is_refused_and_the_menu_goes_back(panel, camera, frames):
    panel.start()
    play(panel, camera, frames[:1])
    panel.record()
    panel.preset.value = "face-it"
    assert "stop the recording first" in panel.view.message
    assert panel.preset.value == "joint"


def test_an_error_goes_after_some_seconds_of_pictures(panel, camera, frames, monkeypatch):
    panel.start()
    play(panel, camera, frames[:1])
    panel.controls.by_path["weights.tau"].readout.value = "-3"
    play(panel, camera, frames[1:2])
    assert panel.view.alert
    monkeypatch.setattr("workbench.widgets.live_messages.ALERT_S", 0.0)
    play(panel, camera, frames[2:3])
    assert (panel.view.alert, panel.view.message) == (False, "")


def test_a_preset_keeps_the_detector_and_its_points(panel, camera, frames):
    panel.preset.value = "dense"
    assert panel.session.config.stages == preset("dense").stages
    assert panel.session.config.landmarks.detector == panel.session.base.landmarks.detector
    panel.start()
    play(panel, camera, frames[:1])
    assert len(panel.fit.observed) == 68


def test_the_avatar_has_the_shapes_of_the_points_that_are_fitted(head):
    made = LivePanel(HandCamera(), head, preset("gaze"))
    assert made.view._mesh["shapes"] == len(made.session.model.expression_names) > len(head.expression_names)
    made.close()


def test_a_configuration_with_a_name_of_its_own_is_in_the_menu(head):
    config = preset("joint").changed(preset="mine", weights={"tau": 3.0})
    made = LivePanel(HandCamera(), head, config)
    assert made.preset.value == "mine"
    made.preset.value = "face-it"
    made.preset.value = "mine"
    assert made.session.config == config
    made.close()


def test_calibration_tells_what_to_do_and_when_it_is_done(panel, camera, frames):
    panel.start()
    play(panel, camera, frames[:1])
    panel.neutral.click()
    assert "neutral face" in panel.view.message
    play(panel, camera, [LiveFrame(number, number / 25, frames[0].picture) for number in range(20)])
    assert panel.view.message == ""
    assert panel.session.calibrated == "neutral face"


def test_why_a_neutral_face_is_refused_stands_in_the_panel(panel):
    panel.session.use(panel.session.config.changed(identity={"calibrate": False}))
    panel.start()
    panel.neutral.click()
    assert "keep the average face" in panel.view.message


def test_a_recording_names_the_camera_that_it_was_begun_with(panel, camera, frames):
    panel.start()
    play(panel, camera, frames[:1])
    panel.record()
    play(panel, camera, frames[1:4])
    panel.camera.value = "sample clip"
    assert panel.track.meta["live"]["camera"] == camera.name


def test_a_recording_that_cannot_be_written_is_no_longer_being_saved(panel, monkeypatch):
    def denied(folder, overwrite=False):
        raise PermissionError(13, "Permission denied", str(folder))

    panel._recording.recording = SimpleNamespace(jpegs=(), save=denied)
    panel.save_button.click()
    assert panel.wait_idle()
    assert "Writing failed" in panel.view.message
    assert panel.saved.value == ""


def test_another_camera_in_the_menu_takes_over(panel, camera, frames):
    panel.start()
    play(panel, camera, frames[:1])
    panel.camera.value = "sample clip"
    assert camera.deliver is None
    deadline = time.monotonic() + 60
    while panel.fit.index == 0 and time.monotonic() < deadline:
        time.sleep(0.02)
    assert panel.running
    assert panel.fit.found


def test_after_closing_nothing_runs(head):
    before = {thread.name for thread in threading.enumerate()}
    panel = LivePanel(sample("performance"), head)
    panel.start()
    deadline = time.monotonic() + 120
    while panel.fit is None and time.monotonic() < deadline:
        time.sleep(0.02)
    assert panel.fit.found
    panel.close()
    panel.close()
    panel.start()  # too late
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline and {"live-fit", "kernel-camera"} & {t.name for t in threading.enumerate()}:
        time.sleep(0.02)
    assert {t.name for t in threading.enumerate()} - before <= {"live-save_0"}
    assert not panel.running


def test_the_kernel_answers_while_it_runs(panel, camera, frames):
    """What a cell would do in the main thread goes on while frames are fitted in theirs."""
    panel.start()
    play(panel, camera, frames[:1])
    for frame in frames[1:20]:
        camera.deliver(frame)
        began = time.perf_counter()
        sum(range(1000))
        assert time.perf_counter() - began < 0.5
    assert panel.wait_idle()


def test_free_folders_count_up(tmp_path):
    assert free_folder(tmp_path / "take") == tmp_path / "take"
    for name in ("take", "take-2"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "track.npz").touch()
    assert free_folder(tmp_path / "take") == tmp_path / "take-3"
    assert free_folder(tmp_path / "take-2") == tmp_path / "take-3"


def test_a_panel_that_cannot_be_made_says_why(head, tmp_path):
    with pytest.raises(InputError, match="There is no video"):
        LivePanel(tmp_path / "missing.mp4", head)
    with pytest.raises(InputError, match="takes seconds per frame"):
        LivePanel(model=head, config=preset("deep"))


def test_it_has_a_short_name(panel):
    assert repr(panel) == "LivePanel(LiveSession('default-head', 'joint', 0 frames), stopped)"


def test_the_avatar_is_drawn_as_the_character_of_the_configuration():
    panel = LivePanel(config=preset("joint").changed(head={"character": "ravi"}))
    try:
        assert [part["kind"] for part in panel.view._mesh["worn"]][-1] == "hair"
        before = panel.view._person["growth"]
        panel.view.set_person(np.linspace(-1.5, 1.5, 50))
        assert len(before) == 3
        assert panel.view._person["growth"] != before
    finally:
        panel.close()
