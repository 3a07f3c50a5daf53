"""Fitting a running camera without a screen: identity, settings, undo, recording; and the kernel's own camera."""

import threading
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.live_pictures import RATE, sample_frames
from workbench.config import preset
from workbench.errors import InputError
from workbench.export import export_track
from workbench.frames import open_frames
from workbench.samples import sample
from workbench.session.gesture import Gesture
from workbench.session.kernel_camera import KernelCamera
from workbench.session.knobs import changed_by
from workbench.session.live import FIRST_FRAMES, NEUTRAL_FRAMES, LiveSession
from workbench.session.live_frame import FrameSource, LiveFrame, reduced
from workbench.session.recording import Recorder, even_frames
from workbench.tracking import Track

BLANK = np.full((480, 640, 3), 90, np.uint8)


@pytest.fixture(scope="module")
def frames():
    return sample_frames(70)


@pytest.fixture(scope="module")
def seen(head, frames):
    """A session that has seen the first frames and calibrated itself, and its fits."""
    session = LiveSession(head)
    fits = [session.step(frame).fit for frame in frames[: FIRST_FRAMES + 1]]
    return session, fits


@pytest.fixture
def session(head, seen):
    """A session of its own, its detector already loaded."""
    return LiveSession(head, detector=seen[0]._landmarks.detector)


# --- frames ---


def test_a_frame_is_a_picture_and_a_jpeg_whichever_it_came_as(frames):
    again = LiveFrame(0, 0.0, jpeg=frames[0].jpeg)
    assert again.picture.shape == (480, 640, 3)
    assert np.abs(again.picture.astype(int) - frames[0].picture).mean() < 3.0
    assert again.jpeg == frames[0].jpeg


def test_a_frame_without_a_picture_is_refused():
    with pytest.raises(InputError, match="Frame 3 of the camera is empty"):
        LiveFrame(3, 0.0)
    with pytest.raises(InputError, match="not a readable JPEG"):
        _ = LiveFrame(4, 0.0, jpeg=b"not a picture").picture


@pytest.mark.parametrize(
    ("size", "made"), [((640, 480), (640, 480)), ((320, 200), (320, 200)), ((1920, 1080), (640, 360)),
                       ((600, 960), (300, 480))]
)  # fmt: skip
def test_large_pictures_are_reduced_in_their_proportions(size, made):
    assert reduced(np.zeros((size[1], size[0], 3), np.uint8)).shape == (made[1], made[0], 3)


# --- fitting ---


def test_every_frame_is_fitted_at_once_and_the_face_shape_follows_after_a_second(seen):
    session, fits = seen
    assert all(fit.found for fit in fits)
    assert [fit.index for fit in fits] == list(range(FIRST_FRAMES + 1))
    assert not fits[0].identity.any()
    assert np.abs(fits[-1].identity).max() > 0.1
    assert fits[-1].errors[2] < fits[FIRST_FRAMES - 2].errors[2]
    assert session.calibrated == "first second"


@pytest.mark.long
def test_a_stage_may_compare_the_cameras_pictures(session, frames):
    stages = [stage.model_dump() | {"terms": ("flow",)} for stage in session.config.stages]
    session.use(session.config.changed(stages=stages, flow={"side": 192, "points": 300}))
    column = session.config.terms.index("flow")
    energies = [session.step(frame).fit.energies[-1, column] for frame in frames[:4]]
    assert energies[0] == 0.0
    assert min(energies[1:]) > 0.0


def test_a_neutral_face_becomes_identity_and_undo_takes_it_back(seen, frames):
    session, _ = seen
    before = session.identity
    session.calibrate_neutral()
    assert session.gathering == (0, NEUTRAL_FRAMES)
    still = frames[0]
    for number in range(NEUTRAL_FRAMES + 2):
        fit = session.step(LiveFrame(number, number / RATE, still.picture)).fit
    assert session.gathering is None
    assert session.calibrated == "neutral face"
    assert not np.array_equal(session.identity, before)
    # The same picture has less expression once it counts as neutral.
    neutral = np.abs(fit.expression).sum()
    assert session.undo()
    for _ in range(2):
        fit = session.step(still).fit
    assert session.calibrated == "first second"
    np.testing.assert_allclose(session.identity, before, atol=1e-6)
    assert neutral < np.abs(fit.expression).sum()


def test_undo_of_a_setting_leaves_the_shape_of_the_first_second(session, frames):
    """Whether the setting was changed before that second was over or after it."""
    session.use(session.config.changed(weights={"tau": 3.0}))
    for frame in frames[:5]:
        session.step(frame)
    assert session.undo()
    for frame in frames[5 : FIRST_FRAMES + 1]:
        session.step(frame)
    assert session.calibrated == "first second"
    shape = session.identity
    session.use(session.config.changed(weights={"tau": 4.0}))
    session.step(frames[FIRST_FRAMES + 1])
    assert session.undo()
    session.step(frames[FIRST_FRAMES + 2])
    assert session.calibrated == "first second"
    assert np.array_equal(session.identity, shape)


def test_undo_does_not_bring_the_person_before_back(session, frames):
    for frame in frames[: FIRST_FRAMES + 1]:
        session.step(frame)
    session.use(session.config.changed(weights={"tau": 3.0}))
    session.start_anew()
    session.step(frames[0])
    assert session.undo()
    session.step(frames[1])
    assert session.calibrated == "mean face"


def hold(session, frame):
    """Hold a face still for a neutral calibration."""
    session.calibrate_neutral()
    for number in range(NEUTRAL_FRAMES + 2):
        session.step(LiveFrame(number, number / RATE, frame.picture))
    assert session.calibrated == "neutral face"


def first_second(session, frames):
    for frame in frames[: FIRST_FRAMES + 1]:
        session.step(frame)


def test_the_first_second_begins_when_the_settings_want_a_shape(head, seen, frames):
    session = LiveSession(head, preset("face-it"), detector=seen[0]._landmarks.detector)
    session.step(frames[0])
    assert session.calibrated == "mean face"
    session.use(preset("joint"))
    first_second(session, frames)
    assert session.calibrated == "first second"
    assert session.identity.any()


def test_without_calibration_the_shape_is_called_the_mean_face(session, frames):
    first_second(session, frames)
    session.use(preset("face-it"))
    session.step(frames[0])
    assert session.calibrated == "mean face"
    assert not session.identity.any()
    assert session.undo()
    session.step(frames[0])
    assert session.calibrated == "first second"


def test_a_neutral_shape_taken_back_after_a_new_start_gives_way_to_the_first_second(session, frames):
    session.step(frames[0])
    hold(session, frames[0])
    session.start_anew()
    session.step(frames[0])
    assert session.calibrated == "neutral face"
    assert session.undo()
    first_second(session, frames)
    assert session.calibrated == "first second"


def test_undo_of_a_neutral_face_in_progress_is_undo_of_nothing_else(session, frames):
    """Within the first second, which then begins anew, and with a setting changed before."""
    changed = session.config.changed(weights={"tau": 3.0})
    session.calibrate_neutral()
    assert session.undo()
    assert session.gathering is None
    assert not session.undo()
    session.use(changed)
    session.calibrate_neutral()
    session.step(frames[0])
    assert session.undo()
    assert session.config == changed
    first_second(session, frames)
    assert session.calibrated == "first second"


def test_a_neutral_face_is_refused_where_the_settings_keep_the_average_one(session):
    session.use(session.config.changed(identity={"calibrate": False}))
    with pytest.raises(InputError, match=r"switch identity\.calibrate on"):
        session.calibrate_neutral()
    assert session.gathering is None


def test_frames_in_which_the_face_moves_are_no_neutral_ones(session, frames):
    session.step(frames[0])
    session.calibrate_neutral()
    session.step(frames[0])
    shifted = np.roll(frames[0].picture, 12, axis=1)
    session.step(LiveFrame(2, 0.1, shifted))
    assert session.gathering[0] == 1


def test_a_knob_takes_effect_at_the_next_frame(session, frames):
    free = [session.step(frame).fit for frame in frames[:3]][-1]
    session.use(session.config.changed(weights={"sigma_smooth": 900.0}))
    tied = session.step(frames[2]).fit
    assert np.abs(tied.expression).sum() < 0.3 * np.abs(free.expression).sum()
    session.use(session.config.changed(**changed_by(session.config, "epsilon", 0)))
    assert session.step(frames[2]).fit.iterations.max() == 0


def test_undo_goes_back_one_gesture_at_a_time(session):
    start = session.config
    for value in (1.0, 2.0, 3.0):
        session.use(session.config.changed(weights={"tau": value}), gesture="weights.tau")
    session.use(session.config.changed(weights={"beta": 5.0}), gesture="weights.beta")
    assert session.undo()
    assert (session.config.weights.tau, session.config.weights.beta) == (3.0, start.weights.beta)
    assert session.undo()
    assert session.config == start
    assert not session.undo()


def test_a_slow_drag_is_one_step_of_undo(session, monkeypatch):
    monkeypatch.setattr("workbench.session.gesture.GESTURE_S", 0.0)
    start = session.config
    for value in (1.0, 2.0, 3.0):
        session.use(session.config.changed(weights={"tau": value}), Gesture("weights.tau", drag=1))
    session.use(session.config.changed(weights={"tau": 4.0}), Gesture("weights.tau", drag=2))
    assert session.undo()
    assert session.config.weights.tau == 3.0
    assert session.undo()
    assert session.config == start


@pytest.mark.parametrize("change", [{"camera": {"fov_deg": 33.0}}, {"landmarks": {"confidence": False}}], ids=str)
def test_what_the_shape_depends_on_is_calibrated_again_on_the_same_frames(head, seen, frames, change):
    session = LiveSession(head, detector=seen[0]._landmarks.detector)
    for frame in frames[: FIRST_FRAMES + 1]:
        session.step(frame)
    before = session.identity
    session.use(session.config.changed(**change))
    session.step(frames[FIRST_FRAMES])
    changed = session.identity
    session.undo()
    session.step(frames[FIRST_FRAMES])
    assert np.abs(changed - before).max() > 0.01
    np.testing.assert_allclose(session.identity, before, atol=1e-6)


def test_a_picture_without_a_face_gives_an_empty_fit_and_the_next_one_goes_on(session, frames):
    session.step(frames[0])
    for number in range(12):
        lost = session.step(LiveFrame(number, 0.0, BLANK)).fit
    assert not lost.found
    assert session.step(frames[1]).fit.found


def test_deep_energies_is_refused(head, session):
    with pytest.raises(InputError, match="takes seconds per frame"):
        LiveSession(head, preset("deep"))
    with pytest.raises(InputError, match="use one of"):
        session.use(preset("deep-points"))


@pytest.mark.parametrize("name", ["gaze", "dense"])
def test_a_detector_of_other_points_is_refused(name, head):
    session = LiveSession(head)
    with pytest.raises(InputError, match="finds different points from those this session fits, ibug68; open another"):
        session.use(preset(name))
    assert session.config == session.base


# --- recording ---


@given(st.integers(2, 60), st.floats(5.0, 60.0), st.floats(0.0, 100.0))
def test_a_steady_stream_keeps_every_frame(count, rate, start):
    chosen, found = even_frames([start + k / rate for k in range(count)])
    assert chosen.tolist() == list(range(count))
    assert found == pytest.approx(rate, rel=1e-6)


@given(st.lists(st.floats(0.01, 0.3), min_size=3, max_size=60))
def test_every_instant_of_the_grid_has_its_nearest_frame(gaps):
    times = np.cumsum(gaps)
    chosen, rate = even_frames(times.tolist())
    instants = times[0] + np.arange(len(chosen)) / rate
    nearest = np.abs(times[None] - instants[:, None]).min(axis=1)
    np.testing.assert_allclose(np.abs(times[chosen] - instants), nearest, atol=1e-9)
    assert len(chosen) / rate == pytest.approx(times[-1] - times[0], abs=1.51 / rate)


def test_a_gap_is_held_so_that_what_follows_keeps_its_time():
    times = [0.0, 0.1, 0.2, 0.3, 1.0, 1.1, 1.2]
    chosen, rate = even_frames(times)
    assert rate == pytest.approx(10.0)
    assert chosen.tolist() == [0, 1, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 6]


def test_one_frame_alone_is_a_recording():
    assert even_frames([3.0])[0].tolist() == [0]


def test_a_recording_is_a_track_that_everything_reads(session, frames, tmp_path, monkeypatch):
    session.start_recording()
    fits = [session.step(frame).fit for frame in frames[:8]]
    assert session.recording[0] == 8
    recording = session.stop_recording("a test")
    assert session.recording is None
    monkeypatch.chdir(tmp_path)
    stored = recording.save("take")
    track = Track.load(stored)
    np.testing.assert_array_equal(track.expression, np.stack([fit.expression for fit in fits]))
    assert track.index.tolist() == list(range(8))
    assert track.meta["rate"] == pytest.approx(RATE)
    assert track.meta["live"]["camera"] == "a test"
    assert track.meta["inputs"][0]["path"] == str(tmp_path / "take" / "clip.mp4")
    clip = open_frames(track.meta["inputs"][0]["path"])
    assert (clip.announced_count, clip.image_size, clip.rate) == (8, (640, 480), pytest.approx(RATE))
    written = export_track(track, session.model, tmp_path / "take.glb").path
    assert written.stat().st_size > 100_000


def test_a_recording_without_pictures_holds_none(session, frames, tmp_path):
    session.start_recording(keep_pictures=False)
    session.step(frames[0])
    recording = session.stop_recording()
    recording.save(tmp_path / "take")
    assert recording.jpegs == ()
    (tmp_path / "take" / "clip.mp4").write_bytes(b"of an earlier recording")
    recording.save(tmp_path / "take", overwrite=True)
    assert [path.name for path in (tmp_path / "take").iterdir()] == ["track.npz"]


def test_a_recording_without_a_face_or_without_a_start_is_refused(session):
    with pytest.raises(InputError, match="press record first"):
        session.stop_recording()
    session.start_recording()
    session.step(LiveFrame(0, 0.0, BLANK))
    with pytest.raises(InputError, match="No face was found"):
        session.stop_recording()


def test_while_recording_the_stages_stay(session, frames):
    session.start_recording()
    session.step(frames[0])
    session.use(session.config.changed(weights={"tau": 1.0}))
    # `gaze` has the stages of `joint`, and more terms.
    for name in ("face-it", "gaze"):
        with pytest.raises(InputError, match="stop the recording first"):
            session.use(preset(name))
    assert session.config.preset == "joint"


def test_while_recording_undo_brings_no_other_stages_or_terms_back(session, frames):
    session.use(preset("gaze"))
    session.start_recording()
    for frame in frames[:3]:
        session.step(frame)
    with pytest.raises(InputError, match="stop the recording first"):
        session.undo()
    assert session.config.preset == "gaze"
    assert len(session.stop_recording()) == 3
    assert session.undo()
    assert session.config.preset == "joint"


def test_a_recording_ends_by_itself_when_it_is_long_or_the_pictures_change_size(seen, frames, monkeypatch):
    _, fits = seen
    recorder = Recorder(keep_pictures=True)
    recorder.add(fits[0], frames[0])
    monkeypatch.setattr("workbench.session.recording.MOST_BYTES", 1000)
    recorder.add(fits[1], frames[1])
    assert "maximum length" in recorder.ended
    assert len(recorder) == 1
    other = Recorder(keep_pictures=False)
    other.add(fits[0], frames[0])
    other.add(replace(fits[1], image_size=(320, 240)), frames[1])
    assert "picture size changed" in other.ended


# --- the kernel's camera ---


class Taken:
    """What a camera delivered."""

    def __init__(self):
        self.frames, self.troubles, self.changed = [], [], threading.Event()

    def deliver(self, frame):
        self.frames.append(frame)
        self.changed.set()

    def trouble(self, sentence):
        self.troubles.append(sentence)
        self.changed.set()


def test_a_video_stands_in_for_a_camera_at_its_own_rate_over_and_over(tmp_path):
    writer = cv2.VideoWriter(str(tmp_path / "short.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 50.0, (1280, 720))
    for k in range(5):
        writer.write(np.full((720, 1280, 3), 40 * k, np.uint8))
    writer.release()
    taken, camera = Taken(), KernelCamera(tmp_path / "short.avi")
    assert isinstance(camera, FrameSource)
    camera.start(taken.deliver, taken.trouble)
    deadline = time.monotonic() + 20
    while len(taken.frames) < 12 and time.monotonic() < deadline:
        time.sleep(0.01)
    camera.stop()
    count = len(taken.frames)
    assert count >= 12
    assert not camera.running
    assert [frame.number for frame in taken.frames] == list(range(count))
    assert taken.frames[0].picture.shape == (360, 640, 3)
    levels = [int(frame.picture.mean()) for frame in taken.frames]
    assert abs(levels[0] - levels[5]) < 6  # from the beginning again
    seconds = taken.frames[11].time_s - taken.frames[0].time_s
    assert seconds >= 0.9 * 11 / 50
    time.sleep(0.1)
    assert len(taken.frames) == count
    assert taken.troubles == []


def test_a_camera_that_is_not_there_is_said_in_one_sentence(capfd):
    taken, camera = Taken(), KernelCamera(97)
    camera.start(taken.deliver, taken.trouble)
    assert taken.changed.wait(20)
    camera.stop()
    assert taken.troubles == [
        "The computer that runs Python has no camera 97, or another program uses it; use the browser's camera or name "
        "another number."
    ]
    assert "camera 97" in camera.name


def test_a_camera_that_falls_silent_is_said_in_one_sentence(monkeypatch):
    class Unplugged:
        """Gives three pictures, then none."""

        def __init__(self, _device):
            self.left = 3

        def isOpened(self):  # noqa: N802
            return True

        def get(self, _what):
            return 0.0

        def set(self, _what, _value):
            return True

        def read(self):
            self.left -= 1
            return (self.left >= 0, BLANK if self.left >= 0 else None)

        def release(self):
            pass

    monkeypatch.setattr("workbench.session.kernel_camera.cv2.VideoCapture", Unplugged)
    monkeypatch.setattr("workbench.session.kernel_camera.PATIENCE_S", 0.1)
    taken, camera = Taken(), KernelCamera(0)
    camera.start(taken.deliver, taken.trouble)
    deadline = time.monotonic() + 20
    while not taken.troubles and time.monotonic() < deadline:
        time.sleep(0.01)
    assert len(taken.frames) == 3
    assert taken.troubles == ["Camera 0 of the kernel no longer delivers pictures; plug it in again and press start."]
    camera.stop()


def test_files_that_are_no_videos_are_refused(tmp_path):
    with pytest.raises(InputError, match="There is no video"):
        KernelCamera(tmp_path / "missing.mp4")
    (tmp_path / "text.mp4").write_text("no video")
    taken, camera = Taken(), KernelCamera(tmp_path / "text.mp4")
    camera.start(taken.deliver, taken.trouble)
    assert taken.changed.wait(20)
    assert "cannot be read" in taken.troubles[0]


def test_a_camera_is_started_again_after_it_was_stopped():
    taken, camera = Taken(), KernelCamera(sample("performance"))
    for _ in range(2):
        taken.changed.clear()
        camera.start(taken.deliver, taken.trouble)
        assert taken.changed.wait(20)
        camera.stop()
    assert not camera.running
