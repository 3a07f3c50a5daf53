"""The chooser of material: samples, paths, errors in one sentence, one panel at a time."""

import shutil
import threading
from datetime import UTC, datetime
from types import SimpleNamespace

import cv2
import ipywidgets as widgets
import numpy as np
import pytest

from workbench.config import preset
from workbench.errors import InputError
from workbench.landmarks.files import LandmarkRecord, read_landmark_file, write_landmark_file
from workbench.samples import sample
from workbench.session import TuningSession, open_session
from workbench.tracking import FrameObservation
from workbench.widgets import detection_preview as preview_module
from workbench.widgets import opener as opener_module
from workbench.widgets import upload as upload_module
from workbench.widgets.opener import SessionOpener
from workbench.widgets.upload import Upload, stored


class Panel(widgets.VBox):
    """Stands in for the tuning panel, which takes seconds to warm up."""

    def __init__(self, session: TuningSession) -> None:
        super().__init__()
        self.session = session
        self.closed, self.may_close = threading.Event(), threading.Event()
        self.may_close.set()

    def close(self) -> None:
        self.may_close.wait(10)
        super().close()
        self.closed.set()


@pytest.fixture
def opener():
    made = SessionOpener(Panel)
    yield made
    made.close()


@pytest.fixture(scope="module")
def landmark_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("opener") / "three frames.csv"
    landmarks = next(read_landmark_file(sample("astronaut-landmarks"))).landmarks
    write_landmark_file(path, [LandmarkRecord(k, f"{k}", landmarks, (512, 512)) for k in range(3)])
    return path


def test_a_sample_opens_with_one_click_and_the_panel_stands_under_the_chooser(opener):
    opener.samples["sample portrait"].click()
    assert opener.wait_idle()
    assert opener.place.children == (opener.panel,)
    assert opener.panel.session is opener.session
    assert opener.session.material.landmark_file == sample("astronaut-landmarks")
    assert opener.progress.layout.display == "none"


def test_every_sample_opens(opener):
    for text, frames in {"sample portrait": 1, "sample clip": 150, "sample glasses": 150, "sample speech": 55}.items():
        opener.open_sample(text)
        assert opener.wait_idle()
        assert len(opener.session) == frames
    assert opener_module.sample_choices()["sample clip"].config.camera.fov_deg == 33.0


def test_another_choice_closes_the_panel_before(opener, landmark_file):
    opener.open_sample("sample portrait")
    opener.wait_idle()
    first = opener.panel
    opener.open_path(landmark_file)
    opener.wait_idle()
    assert first.closed.wait(10)
    assert opener.panel is not first
    assert len(opener.session) == 3


def test_a_panel_that_takes_its_time_to_close_holds_nothing_up(opener, landmark_file):
    opener.open_sample("sample portrait")
    opener.wait_idle()
    slow = opener.panel
    slow.may_close.clear()
    opener.open_path(landmark_file)
    assert opener.wait_idle(10.0)
    assert "3 frames" in opener.message.value
    assert not slow.closed.is_set()
    slow.may_close.set()
    assert slow.closed.wait(10)


# --- what opening would lose ---


def change_a_setting(opener):
    opener.session.set(weights={"tau": 7.0})


def keep_a_snapshot(opener):
    opener.session.take_snapshot("mine")


def begin_to_write(opener):
    opener.panel.export_dialog = SimpleNamespace(writing=True)


def begin_to_sweep(opener):
    opener.panel.sweep = SimpleNamespace(running=True)


def loaded(opener):
    """The sample portrait open in an opener."""
    opener.open_sample("sample portrait")
    opener.wait_idle()
    return opener.panel


@pytest.mark.parametrize(
    ("work", "lost"),
    [
        (change_a_setting, "1 unsaved change"),
        (keep_a_snapshot, "1 snapshot"),
        (begin_to_write, "the file that is being written"),
        (begin_to_sweep, "the sweep that is running"),
    ],
)
def test_what_would_be_lost_is_said_and_stays_until_it_is_opened_anyway(opener, work, lost):
    panel = loaded(opener)
    work(opener)
    opener.samples["sample speech"].click()
    opener.wait_idle()
    assert f"would close astronaut and lose {lost}." in opener.message.value
    assert opener.place.children == (panel,)
    assert opener.anyway.layout.display is None
    opener.anyway.click()
    opener.wait_idle()
    assert panel.closed.wait(10)
    assert len(opener.session) == 55
    assert opener.anyway.layout.display == "none"


def test_what_is_not_there_is_no_reason_to_ask(opener, tmp_path):
    loaded(opener)
    change_a_setting(opener)
    opener.open_path(tmp_path / "nowhere.mp4")
    opener.wait_idle()
    assert "nowhere.mp4 does not exist" in opener.message.value
    assert opener.anyway.layout.display == "none"


def test_everything_that_would_be_lost_is_named(opener):
    loaded(opener)
    for work in (change_a_setting, keep_a_snapshot, begin_to_write, begin_to_sweep):
        work(opener)
    opener.open_sample("sample speech")
    opener.wait_idle()
    lost = "1 unsaved change, 1 snapshot, the file that is being written and the sweep that is running"
    assert f"lose {lost}." in opener.message.value


def test_who_stays_is_no_longer_asked(opener):
    panel = loaded(opener)
    change_a_setting(opener)
    opener.open_sample("sample speech")
    opener.wait_idle()
    opener.stay.click()
    assert opener.message.value == "<span>astronaut: 1 frame.</span>"
    assert (opener.anyway.layout.display, opener.stay.layout.display) == ("none", "none")
    assert opener.place.children == (panel,)


@pytest.mark.parametrize("end", ["export", "undo"])
def test_nothing_is_lost_once_it_is_saved_or_taken_back(opener, tmp_path, monkeypatch, end):
    monkeypatch.setattr("workbench.session.session_work.SessionWork.export", lambda *_: True)
    loaded(opener)
    change_a_setting(opener)
    opener.session.export(tmp_path / "tuned.toml") if end == "export" else opener.session.undo()
    opener.open_sample("sample speech")
    opener.wait_idle()
    assert len(opener.session) == 55


def test_work_done_while_a_clip_is_opened_is_not_lost_either_nor_is_the_clip_opened_twice(
    opener, landmark_file, monkeypatch
):
    panel, opened = loaded(opener), []

    def slow(path, config, landmarks, progress, seen):
        change_a_setting(opener)
        opened.append(path)
        return open_session(path, config, landmarks=landmarks)

    monkeypatch.setattr(opener_module, "open_session", slow)
    opener.open_path(landmark_file)
    opener.wait_idle()
    assert opener.place.children == (panel,)
    opener.anyway.click()
    opener.wait_idle()
    assert len(opener.session) == 3
    assert opened == [landmark_file]


# --- paths ---


def test_a_path_may_be_pasted_with_quotes_and_blanks(opener, landmark_file):
    opener.path.value = f' "{landmark_file}" '
    opener.open_button.click()
    opener.wait_idle()
    assert opener.session.material.inputs == (landmark_file,)


def test_a_path_may_end_in_an_apostrophe(opener, tmp_path):
    folder = tmp_path / "the kids'"
    folder.mkdir()
    shutil.copy(sample("astronaut"), folder)
    opener.open_path(folder, sample("astronaut-landmarks"))
    opener.wait_idle()
    assert opener.session.material.name == "the kids'"


def test_a_picture_opens_with_its_landmark_file(opener):
    opener.path.value, opener.landmarks.value = str(sample("astronaut")), str(sample("astronaut-landmarks"))
    opener.open_button.click()
    opener.wait_idle()
    assert opener.session.material.pictures.real


@pytest.mark.parametrize("name", ["track.npz", ""], ids=["file", "folder"])
def test_a_stored_track_opens_with_its_configuration(opener, landmark_file, tmp_path, name):
    tuned = preset("calibrated").changed(weights={"tau": 7.0})
    session = open_session(landmark_file, tuned)
    session.fit_clip().save(tmp_path / "track.npz")
    opener.open_path(tmp_path / name)
    opener.wait_idle()
    assert opener.session.config.weights.tau == 7.0
    np.testing.assert_array_equal(
        opener.session.material.observations[2].landmarks.points, session.material.observations[2].landmarks.points
    )


@pytest.mark.parametrize("name", ["missing.mp4", "missing.csv", "missing.npz"])
def test_an_error_is_one_red_sentence_and_leaves_what_is_open(opener, tmp_path, name):
    opener.open_sample("sample portrait")
    opener.wait_idle()
    panel = opener.panel
    opener.open_path(tmp_path / name)
    opener.wait_idle()
    assert name in opener.message.value
    assert "role='alert'" in opener.message.value
    assert "Traceback" not in opener.message.value
    assert opener.place.children == (panel,)
    assert not panel.closed.is_set()


def test_the_hint_of_the_path_is_short_and_its_tooltip_names_the_suffixes(opener):
    assert [".pts" in words for words in (opener.path.placeholder, opener.path.tooltip)] == [False, True]


def test_an_empty_path_says_what_to_do(opener):
    opener.open_button.click()
    assert "Type the path" in opener.message.value


def test_markup_in_a_name_is_shown_as_text(opener):
    opener.open_path("<b>no.csv")
    opener.wait_idle()
    assert "&lt;b&gt;no.csv" in opener.message.value


def test_landmarks_are_counted_while_they_are_found(opener, landmark_file):
    seen = []
    opener.message.observe(lambda change: seen.append(change["new"]), "value")
    opener.open_path(landmark_file)
    opener.wait_idle()
    assert any("Finding landmarks: frame 2" in text for text in seen)
    assert "3 frames" in seen[-1]


def test_a_newer_choice_ends_an_older_one(opener, landmark_file, monkeypatch):
    started, go_on = threading.Event(), threading.Event()

    def slow(path, config, landmarks, progress, seen):
        if path == landmark_file:
            started.set()
            go_on.wait(10)
        progress("landmarks", 1, None)
        return open_session(path, config, landmarks=landmarks)

    monkeypatch.setattr(opener_module, "open_session", slow)
    opener.open_path(landmark_file)
    assert started.wait(10)
    opener.open_sample("sample portrait")
    go_on.set()
    opener.wait_idle()
    assert opener.session.material.inputs == (sample("astronaut"),)
    assert len(opener.place.children) == 1


def test_closing_closes_the_panel():
    opener = SessionOpener(Panel)
    opener.open_sample("sample portrait")
    opener.wait_idle()
    panel = opener.panel
    opener.close()
    assert panel.closed.is_set()
    assert "SessionOpener" in repr(opener)


def test_the_first_picture_is_there_before_the_detector_and_detections_follow(monkeypatch):
    monkeypatch.setattr(preview_module, "EVERY_S", 0.0)
    preview = preview_module.DetectionPreview()
    preview.begin(sample("astronaut"))
    assert preview.layout.display is None
    first = decoded(preview)
    assert first.shape == (512, 512, 3)
    landmarks = next(read_landmark_file(sample("astronaut-landmarks"))).landmarks
    preview.see(FrameObservation(0, landmarks, landmarks.image_size))
    assert np.abs(decoded(preview).astype(int) - first).max() > 60
    preview.end()
    assert (preview.layout.display, preview.value) == ("none", b"")


def test_between_two_pictures_the_detector_is_not_held_up():
    preview = preview_module.DetectionPreview()
    preview.begin(sample("astronaut"))
    first = preview.value
    landmarks = next(read_landmark_file(sample("astronaut-landmarks"))).landmarks
    preview.see(FrameObservation(0, landmarks, landmarks.image_size))
    assert preview.value == first


def test_landmarks_alone_have_no_picture_to_show(landmark_file):
    preview = preview_module.DetectionPreview()
    preview.begin(landmark_file)
    assert preview.layout.display == "none"


def decoded(preview):
    return cv2.imdecode(np.frombuffer(preview.value, np.uint8), cv2.IMREAD_COLOR)


# --- a file that the browser sends ---


def sent(name, content):
    """A file as the browser sends it."""
    told = {"name": name, "type": "", "size": len(content), "last_modified": datetime(2026, 1, 1, tzinfo=UTC)}
    return told | {"content": memoryview(content)}


def test_a_sent_file_opens_and_is_removed_with_the_chooser(opener, landmark_file):
    opener.upload.value = (sent("C:\\faces\\three.csv", landmark_file.read_bytes()),)
    assert opener.wait_idle()
    assert opener.session.material.name == "three"
    assert len(opener.session) == 3
    path = opener.session.material.inputs[0]
    assert path.read_bytes() == landmark_file.read_bytes()
    opener.upload.close()
    assert not path.exists()


def test_the_same_file_may_be_sent_again():
    opened = []
    made = Upload(opened.append, pytest.fail)
    for _ in range(2):
        made.set_state({"value": [sent("face.png", b"abc") | {"last_modified": 1_700_000_000_000}]})
    assert [path.name for path in opened] == ["face.png", "face.png"]
    made.close()


def test_a_file_sent_under_the_name_of_an_earlier_one_leaves_that_as_it_was():
    opened = []
    made = Upload(opened.append, pytest.fail)
    for content in (b"first", b"second"):
        made.value = (sent("face.png", content),)
    assert [(path.name, path.read_bytes()) for path in opened] == [("face.png", b"first"), ("face.png", b"second")]
    made.close()


def test_what_cannot_be_opened_or_is_too_large_is_refused(opener, tmp_path, monkeypatch):
    opener.upload.value = (sent("notes.docx", b"abc"),)
    assert "notes.docx is not a picture, a video or a landmark file" in opener.message.value
    monkeypatch.setattr(upload_module, "LARGEST_MB", 1e-6)
    with pytest.raises(InputError, match=r"face.png is .*; uploads are limited to"):
        stored(tmp_path, "face.png", b"abcdef")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("server", "shown"), [("voila/0.5.8", None), ("", "none")])
def test_files_are_sent_in_the_app_alone(server, shown, monkeypatch):
    monkeypatch.setenv("SERVER_SOFTWARE", server)
    made = Upload(lambda path: None, lambda error: None)
    assert made.layout.display == shown
    assert f"up to {upload_module.LARGEST_MB} MB" in made.tooltip
    made.close()
