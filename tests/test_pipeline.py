"""The whole job on real files: what it writes, how it resumes, and what bad input does to it."""

import csv
import json
from contextlib import nullcontext

import av
import cv2
import numpy as np
import pytest

from tests.scenes import make_scene
from tests.short_clips import write_timed_clip
from workbench.config import preset, read_config
from workbench.errors import ConfigError, InputError, OutputError
from workbench.frames import VideoWriter, open_frames
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord, read_landmark_file, write_landmark_file
from workbench.landmarks.formats.own_json import json_text
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.tracking import LandmarkTracker
from workbench.pipeline import OUTPUTS, retrack, track
from workbench.pipeline.sources import open_source
from workbench.samples import sample
from workbench.tracker import FaceTracker
from workbench.tracking import Track
from workbench.tracking.track_writer import TrackWriter


@pytest.fixture(scope="module")
def quick():
    """A configuration that calibrates on a short window."""
    return preset("calibrated").changed(identity={"window": 6, "frames": 4})


@pytest.fixture(scope="module")
def clip(head, tmp_path_factory):
    """A landmark file of 20 frames; frame 7 has no face, frame 12 starts another shot far away."""
    path = tmp_path_factory.mktemp("clip") / "clip.csv"
    with LandmarkCsvWriter(path, confidence=False) as writer:
        for index in range(20):
            yaw = 2.0 * index if index < 12 else -30.0
            place = (0.0, 0.0, 600.0) if index < 12 else (120.0, 30.0, 450.0)
            scene = make_scene(head, (yaw, 0, 0), {"jawOpen": 0.02 * index}, translation=place)
            landmarks = None if index == 7 else Landmarks2D(scene.points, np.ones(68), (640, 480))
            writer.write(LandmarkRecord(index, f"{index}", landmarks, (640, 480)))
    return path


@pytest.fixture(scope="module")
def run(head, clip, quick, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return track(clip, folder, head, quick)


def rows(path):
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_a_run_leaves_every_file_it_promises_and_nothing_else(run):
    assert sorted(path.name for path in run.folder.iterdir()) == sorted(OUTPUTS)
    assert all(path.is_file() for path in run.files)


def test_the_parameter_table_has_a_row_a_frame_and_a_column_a_weight(run, head):
    table = rows(run.folder / "parameters.csv")
    assert len(table) == 20
    assert ",".join(list(table[0])[:11]) == "frame,found,rx,ry,rz,tx,ty,tz,yaw_deg,pitch_deg,roll_deg"
    assert tuple(list(table[0])[11:-3]) == head.expression_names
    assert list(table[0])[-3:] == ["error_px", "error_inner_pct", "error_all_pct"]
    assert table[7]["found"] == "0"
    assert table[7]["rx"] == table[7]["jawOpen"] == table[7]["error_px"] == ""
    assert float(table[3]["yaw_deg"]) == pytest.approx(6.0, abs=3.0)


def test_the_landmark_table_reads_back_as_the_input(run, clip):
    assert rows(run.folder / "landmarks.csv") == rows(clip)


def test_the_summary_agrees_with_the_track(run):
    summary = json.loads((run.folder / "summary.json").read_text())
    fits = [run.track[k] for k in range(20) if run.track.found[k]]
    assert summary == run.summary
    assert summary["frames"] == 20
    assert summary["frames_with_face"] == 19
    percent = np.array([fit.errors for fit in fits])
    error = summary["reprojection_error"]
    assert error["inner_51_percent_of_eye_distance"]["mean"] == pytest.approx(percent[:, 1].mean(), abs=1e-3)
    assert error["all_68_percent_of_eye_distance"]["p95"] == pytest.approx(np.percentile(percent[:, 2], 95), abs=1e-3)
    assert error["all_68_px"]["median"] == pytest.approx(np.median(percent[:, 0]), abs=1e-3)
    assert set(summary["milliseconds_per_frame"]) == {"detect", "landmarks", "solve"}
    assert summary["camera"]["guessed"] is True


def test_the_stored_configuration_gives_the_same_numbers_again(run, clip, head, tmp_path):
    again = track(clip, tmp_path, head, read_config(run.folder / "config.toml"), pictures=False)
    np.testing.assert_array_equal(again.track.expression, run.track.expression)
    np.testing.assert_array_equal(again.track.rotation, run.track.rotation)


def test_the_overlay_has_a_picture_a_frame(run):
    with av.open(str(run.folder / "overlay.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == 20


def test_a_track_saves_and_loads_back_equal(run, tmp_path):
    run.track.save(tmp_path / "copy.npz")
    copy = Track.load(tmp_path / "copy.npz")
    for name, value in vars(run.track).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(copy, name), value)
    assert copy.meta == run.track.meta
    assert copy.meta["inputs"][0]["sha256"]
    assert copy.expression_names == run.track.expression_names


@pytest.mark.parametrize("damage", ["truncated", "foreign", "text", "missing"])
def test_a_track_file_that_is_none_is_refused(damage, run, tmp_path):
    path = tmp_path / "bad.npz"
    if damage == "truncated":
        path.write_bytes((run.folder / "track.npz").read_bytes()[:3000])
    elif damage == "foreign":
        np.savez(path, meta=np.array("{}"))
    elif damage == "text":
        path.write_text("no archive")
    with pytest.raises(InputError, match=r"bad.npz"):
        Track.load(path)


def test_an_interrupted_run_resumes_with_the_same_numbers(head, clip, quick, run, tmp_path, monkeypatch):
    monkeypatch.setattr("workbench.tracking.track_writer.PART_FRAMES", 4)
    stop_at = 14

    def interrupt(step, done, total):
        if done == stop_at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track(clip, tmp_path, head, quick, progress=interrupt, pictures=False)
    assert not (tmp_path / "track.npz").exists()
    seen = []
    track(clip, tmp_path, head, quick, progress=lambda *a: seen.append(a[1]), pictures=False, resume=True)
    assert seen[0] > 4
    resumed = Track.load(tmp_path / "track.npz")
    for name in ("rotation", "expression", "identity", "projected", "shot"):
        np.testing.assert_array_equal(getattr(resumed, name), getattr(run.track, name))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(set(OUTPUTS) - {"overlay.mp4"})


def test_parts_of_another_configuration_are_not_resumed(head, clip, quick, tmp_path):
    """Nor thrown away: `overwrite` does that."""
    writer = TrackWriter(tmp_path / "track.npz", {}, "another fingerprint")
    with pytest.raises(OutputError, match="an interrupted run of another input or configuration"):
        track(clip, tmp_path, head, quick, pictures=False, resume=True)
    assert writer.parts_folder.is_dir()
    seen = []
    options = {"pictures": False, "resume": True, "overwrite": True}
    track(clip, tmp_path, head, quick, progress=lambda *a: seen.append(a[1]), **options)
    assert seen[0] == 1


@pytest.mark.parametrize("begun", ["landmarks", "fit"])
def test_a_run_interrupted_in_the_middle_of_a_frame_resumes_with_the_same_numbers(begun, head, tmp_path, monkeypatch):
    """Ctrl-C hardly ever comes between two frames: what a frame has begun is not taken for what is done."""
    config = preset("joint").changed(landmarks={"detector": "network"}, identity={"calibrate": False})
    options = {"frames": (20, 31), "pictures": False}
    whole = track(sample("laugh"), tmp_path / "whole", head, config, **options).track
    owner, name = {"landmarks": (LandmarkTracker, "step"), "fit": (FaceTracker, "push")}[begun]
    work, calls = getattr(owner, name), []

    def interrupted(self, *given):
        calls.append(given)
        # The landmarks of the eighth frame are found; the run does not get to see them.
        done = work(self, *given) if begun == "landmarks" or len(calls) < 8 else None
        if len(calls) == 8:
            raise KeyboardInterrupt
        return done

    with monkeypatch.context() as patch:
        patch.setattr(owner, name, interrupted)
        with pytest.raises(KeyboardInterrupt):
            track(sample("laugh"), tmp_path / "cut", head, config, **options)
    seen = []
    resumed = track(
        sample("laugh"), tmp_path / "cut", head, config, progress=lambda *a: seen.append(a[1]), resume=True, **options
    ).track
    assert seen[0] == 8  # the seven whole frames are kept
    for name in ("observed", "confidence", "rotation", "expression", "projected", "shot", "source"):
        np.testing.assert_array_equal(getattr(resumed, name), getattr(whole, name))


@pytest.mark.parametrize("suffix", [".csv", ".json"])
def test_frames_that_a_landmark_file_leaves_out_have_no_face_and_the_others_keep_their_pictures(suffix, clip, tmp_path):
    records = [record for record in read_landmark_file(clip) if record.frame not in (0, 3, 4)]
    write_landmark_file(tmp_path / f"some{suffix}", records)
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for index in range(20):
        cv2.imwrite(str(pictures / f"{index:02d}.png"), np.full((480, 640, 3), index, np.uint8))

    def read(frames=None):
        source = open_source([pictures], preset("joint"), tmp_path / f"some{suffix}", frames, keep_pictures=True)
        return list(source.observations(0, {}, False))

    given = {record.frame: record.landmarks for record in records}
    for seen, first in ((read(), 0), (read((2, 6)), 2)):
        assert len(seen) == (20 if first == 0 else 5)
        for observation in seen:
            frame = observation.index + first
            assert int(observation.picture[0, 0, 0]) == frame
            if given.get(frame) is None:
                assert observation.landmarks is None
            else:
                np.testing.assert_array_equal(observation.landmarks.points, given[frame].points)


@pytest.fixture(params=[".mp4", ".mkv", "/"])
def pictures(request, tmp_path):
    """Six pictures: a video whose header counts them, one whose header does not, a folder."""
    path = tmp_path / f"six{request.param}"
    if request.param == "/":
        path.mkdir()
        for index in range(6):
            cv2.imwrite(str(path / f"{index}.png"), np.full((48, 64, 3), 120, np.uint8))
        return path
    with VideoWriter(path, rate=25) as writer:
        for _ in range(6):
            writer.write(np.full((48, 64, 3), 120, np.uint8))
    return path


def points_of(path, count, size=(64, 48)):
    """A landmark file of this many frames."""
    places = np.random.default_rng(0).uniform(10.0, 40.0, (68, 2))
    records = [LandmarkRecord(index, "", Landmarks2D(places, np.ones(68), size), size) for index in range(count)]
    write_landmark_file(path, records)
    return path


@pytest.mark.parametrize("kept", [False, True], ids=["counted", "kept"])
@pytest.mark.parametrize("start", [0, 5])
def test_frames_after_the_last_row_of_a_file_have_no_face(kept, start, pictures, tmp_path):
    source = open_source([pictures], preset("joint"), points_of(tmp_path / "few.csv", 4), keep_pictures=kept)
    seen = list(source.observations(start, {}, False))
    assert [observation.index for observation in seen] == list(range(start, 6))
    assert [observation.landmarks is not None for observation in seen] == [index < 4 for index in range(start, 6)]
    assert {observation.image_size for observation in seen} == {(64, 48)}
    assert source.notes() == []


@pytest.mark.parametrize("kept", [False, True], ids=["counted", "kept"])
def test_a_file_that_goes_on_after_the_last_picture_is_told(kept, pictures, tmp_path):
    source = open_source([pictures], preset("joint"), points_of(tmp_path / "many.csv", 8), keep_pictures=kept)
    assert len(list(source.observations(0, {}, False))) == 6
    assert source.notes() == ["many.csv has rows beyond the last frame of six; they are left out."]


def test_a_part_of_a_clip_whose_header_does_not_count_ends_with_it(tmp_path):
    with VideoWriter(tmp_path / "six.mkv", rate=25) as writer:
        for _ in range(6):
            writer.write(np.full((48, 64, 3), 120, np.uint8))
    source = open_source([tmp_path / "six.mkv"], preset("joint"), points_of(tmp_path / "few.csv", 4), (2, 90))
    faces = [observation.landmarks is not None for observation in source.observations(0, {}, False)]
    assert faces == [True, True, False, False]


@pytest.mark.parametrize("kept", [False, True], ids=["counted", "kept"])
def test_landmarks_of_pictures_of_another_size_are_refused(kept, pictures, tmp_path):
    given = points_of(tmp_path / "points.csv", 6, size=(128, 96))
    source = open_source([pictures], preset("joint"), given, keep_pictures=kept)
    with pytest.raises(InputError, match="of a picture of 128 × 96 pixels, frame 0 of six has 64 × 48; give the"):
        list(source.observations(0, {}, False))


def test_landmarks_of_several_frames_are_refused_for_one_picture(tmp_path):
    cv2.imwrite(str(tmp_path / "b.png"), np.full((48, 64, 3), 120, np.uint8))
    with pytest.raises(InputError, match=r"found\.csv holds the landmarks of several frames, and b is one picture"):
        open_source([tmp_path / "b.png"], preset("joint"), points_of(tmp_path / "found.csv", 2))


def test_what_is_odd_in_a_clip_is_told_where_the_film_reads_it_first(head, tmp_path):
    pictures = [np.full((48, 64, 3), 120, np.uint8)] * 40
    write_timed_clip(tmp_path / "phone.mp4", pictures, np.cumsum([0, *[33] * 20, *[100] * 19]))
    with LandmarkCsvWriter(tmp_path / "points.csv", confidence=False) as writer:
        for index in range(40):
            writer.write(LandmarkRecord(index, "", None, (64, 48)))
    given = {"landmarks": tmp_path / "points.csv"}
    result = track(tmp_path / "phone.mp4", tmp_path / "out", head, preset("joint"), **given)
    assert [note for note in result.notes if "uneven times" in note]
    again = retrack(tmp_path / "out" / "track.npz", tmp_path / "again", head, preset("joint"), ["reestimate"])
    assert [note for note in again.notes if "uneven times" in note]


def test_landmarks_in_disorder_are_refused(clip, tmp_path):
    entries = json_text(read_landmark_file(clip))
    (tmp_path / "a.json").write_text(entries.replace('"frame": 3,', '"frame": 8,'))
    with pytest.raises(InputError, match=r"a\.json: frame indices must ascend, got 4 after 8: sort the frames"):
        list(open_source([tmp_path / "a.json"], preset("joint"), None).observations(0, {}, False))


def test_a_run_on_other_landmarks_is_not_resumed(head, clip, quick, tmp_path, monkeypatch):
    monkeypatch.setattr("workbench.tracking.track_writer.PART_FRAMES", 4)
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for index in range(20):
        cv2.imwrite(str(pictures / f"{index:02d}.png"), np.full((480, 640, 3), 90, np.uint8))

    def interrupt(step, done, total):
        if done == 12:
            raise KeyboardInterrupt

    options = {"pictures": False, "progress": interrupt}
    with pytest.raises(KeyboardInterrupt):
        track(pictures, tmp_path / "out", head, quick, landmarks=clip, **options)
    other, seen = tmp_path / "other.csv", []
    other.write_text(clip.read_text().replace("640,480", "640,481"))
    options = {"pictures": False, "progress": lambda *a: seen.append(a[1]), "resume": True}
    with pytest.raises(OutputError, match="an interrupted run of another input or configuration"):
        track(pictures, tmp_path / "out", head, quick, landmarks=other, **options)
    assert seen == []
    track(pictures, tmp_path / "out", head, quick, landmarks=clip, **options)
    assert seen[0] > 4


def test_a_crash_leaves_no_file_under_a_final_name(head, clip, quick, tmp_path):
    def fail(step, done, total):
        if done == 9:
            raise RuntimeError("as if the power went")

    with pytest.raises(RuntimeError):
        track(clip, tmp_path, head, quick, progress=fail)
    assert not any((tmp_path / name).exists() for name in OUTPUTS)


def test_stored_landmarks_stand_in_for_a_detector(head, tmp_path):
    result = track(sample("astronaut"), tmp_path, head, preset("calibrated"), landmarks=sample("astronaut-landmarks"))
    assert result.summary["frames_with_face"] == 1
    assert result.track[0].source == "given"
    picture = cv2.imread(str(tmp_path / "overlay.png"))
    assert picture.std() > 10


@pytest.fixture
def two_photos(head, tmp_path):
    """Arguments of a run of two photos with their landmarks."""
    folder = tmp_path / "photos"
    folder.mkdir()
    scenes = [make_scene(head, (yaw, 0, 0)) for yaw in (-10, 20)]
    with LandmarkCsvWriter(tmp_path / "points.csv", confidence=False) as writer:
        for index, scene in enumerate(scenes):
            cv2.imwrite(str(folder / f"photo{index}.png"), np.full((480, 640, 3), 90, np.uint8))
            writer.write(LandmarkRecord(index, "", Landmarks2D(scene.points, np.ones(68), (640, 480)), None))
    given = {"landmarks": tmp_path / "points.csv", "stills": True}
    return {"inputs": folder, "folder": tmp_path / "out", "model": head, "config": preset("calibrated"), **given}


def drawn(folder):
    return sorted(path.name for path in (folder / "overlay").iterdir())


def test_stills_get_a_picture_each_and_their_names(two_photos):
    result = track(**two_photos)
    assert drawn(result.folder) == ["0000-photo0.jpg", "0001-photo1.jpg"]
    assert result.track.meta["names"] == ["photo0.png", "photo1.png"]
    assert list(result.track.shot) == [0, 1]


def test_pictures_of_finished_stills_stay_where_a_repetition_ends_early(two_photos):
    finished, points = track(**two_photos), two_photos["landmarks"]
    other = points.read_text() + "\n"
    with pytest.raises(InputError, match="was changed while this run read it"):
        track(**two_photos, overwrite=True, progress=lambda *_: points.write_text(other))
    assert drawn(finished.folder) == ["0000-photo0.jpg", "0001-photo1.jpg"]


class NoFaces:
    """A detector that finds nothing (the real ones have tests of their own)."""

    name = "network"

    def detect_faces(self, picture, effort="full"):
        return []

    def align(self, picture, box):
        raise AssertionError("no face was found, so none is aligned")

    def refine(self, picture, points):
        raise AssertionError("no face was found, so none is followed")


@pytest.fixture
def no_faces(monkeypatch):
    monkeypatch.setattr("workbench.pipeline.picture_source.make_detector", lambda *_: NoFaces())


@pytest.mark.usefixtures("no_faces")
def test_a_video_without_a_face_is_a_track_that_says_so(head, tmp_path):
    with VideoWriter(tmp_path / "grey.mp4", rate=25) as writer:
        for _ in range(5):
            writer.write(np.full((64, 96, 3), 120, np.uint8))
    result = track(tmp_path / "grey.mp4", tmp_path / "out", head, preset("calibrated"))
    assert result.summary["frames_with_face"] == 0
    assert result.summary["reprojection_error"]["all_68_px"]["mean"] is None
    assert np.isnan(result.track.rotation).all()
    assert open_frames(tmp_path / "out" / "overlay.mp4").announced_count == 5


@pytest.mark.usefixtures("no_faces")
def test_summary_and_track_name_the_detector_that_ran_and_not_the_one_that_was_asked_for(head, tmp_path):
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((64, 96, 3), 120, np.uint8))
    result = track(tmp_path / "grey.png", tmp_path / "out", head, preset("joint"), pictures=False)
    assert result.track.meta["config"]["landmarks"]["detector"] == "auto"
    assert result.track.meta["detector"] == "network"
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["detector"] == "network"
    assert read_config(tmp_path / "out" / "config.toml").landmarks.detector == "auto"


def test_where_the_landmarks_were_given_no_detector_is_named(run):
    assert run.summary["detector"] is None
    assert run.track.meta["detector"] is None


@pytest.mark.usefixtures("no_faces")
@pytest.mark.parametrize(("again", "goes_on"), [("network", True), ("dlib", False)])
def test_a_run_resumes_with_the_detector_that_ran_before_under_whatever_name(
    again, goes_on, head, tmp_path, monkeypatch
):
    with VideoWriter(tmp_path / "grey.mp4", rate=25) as writer:
        for _ in range(8):
            writer.write(np.full((64, 96, 3), 120, np.uint8))

    def interrupt(step, done, total):
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track(tmp_path / "grey.mp4", tmp_path / "out", head, preset("joint"), pictures=False, progress=interrupt)
    monkeypatch.setattr(NoFaces, "name", again)
    seen, config = [], preset("joint").changed(landmarks={"detector": again})
    options = {"pictures": False, "resume": True, "progress": lambda *a: seen.append(a[1])}
    told = (
        "an interrupted run that was started with the detector network; continue with --detector network, name another"
    )
    with nullcontext() if goes_on else pytest.raises(OutputError, match=told):
        track(tmp_path / "grey.mp4", tmp_path / "out", head, config, **options)
    assert seen[:1] == ([6] if goes_on else [])


@pytest.mark.usefixtures("no_faces")
@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("missing.mp4", None, "missing.mp4"),
        ("empty.mp4", b"", "empty.mp4"),
        ("empty.png", b"", "empty.png"),
        ("text.mp4", b"this is a shopping list\n" * 40, "text.mp4"),
        ("text.jpg", b"this is a shopping list\n" * 40, "text.jpg"),
        ("header_only.csv", b"frame,width,height\n", "header_only.csv"),
    ],
)
def test_files_that_are_no_pictures_are_refused_and_leave_nothing(name, content, message, head, tmp_path):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        track(path, tmp_path / "out", head, preset("calibrated"))
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("no_faces")
@pytest.mark.parametrize(
    "picture",
    [
        np.full((40, 50), 128, np.uint8),
        np.full((40, 50, 4), 128, np.uint8),
        np.full((40, 50, 3), 40000, np.uint16),
        np.full((1, 1, 3), 7, np.uint8),
        np.full((6000, 8000, 3), 128, np.uint8),
    ],
    ids=["grey", "rgba", "16-bit", "1x1", "8000x6000"],
)
def test_unusual_pictures_are_tracked_like_others(picture, head, tmp_path):
    cv2.imwrite(str(tmp_path / "picture.png"), picture)
    result = track(tmp_path / "picture.png", tmp_path / "out", head, preset("calibrated"))
    assert result.summary["frames"] == 1
    assert result.track.image_size[0].tolist() == [picture.shape[1], picture.shape[0]]
    assert (tmp_path / "out" / "overlay.png").is_file()


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (["0", "640", "480", *["1.0"] * 134], "68"),
        (["0", "640", "480", *["nan"] * 136], "finite|nan|number"),
        (["0", "640", "480", "x", *["1.0"] * 135], "number|x0"),
    ],
    ids=["67 points", "NaN", "text"],
)
def test_bad_landmarks_are_refused_with_their_line(row, message, head, tmp_path):
    path = tmp_path / "bad.csv"
    header = ["frame", "width", "height", *(f"{axis}{i}" for i in range(68) for axis in "xy")]
    path.write_text("\n".join([",".join(header), ",".join(row)]) + "\n")
    with pytest.raises(InputError, match=message):
        track(path, tmp_path / "out", head, preset("calibrated"))
    assert not (tmp_path / "out" / "track.npz").exists()


def test_pictures_and_landmark_files_do_not_mix(head, clip, tmp_path):
    with pytest.raises(InputError, match="--landmarks"):
        track([clip, sample("astronaut")], tmp_path, head, preset("calibrated"))
    with pytest.raises(InputError, match="nothing to track"):
        track([], tmp_path, head, preset("calibrated"))


def test_settings_of_the_flow_that_cannot_be_used_are_refused_before_a_frame_is_fitted(head, clip, quick, tmp_path):
    config = quick.changed(flow={"renders": "network"}, infill={"method": "linear"})
    fitted = []
    with pytest.raises(ConfigError, match="takes the derivative of the flow network"):
        track(clip, tmp_path, head, config, progress=lambda *told: fitted.append(told))
    assert not [told for told in fitted if told[0] == "track"]
    assert not (tmp_path / "track.npz").exists()
