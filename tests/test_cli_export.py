"""`workbench export`: what is typed, what is written, what is told."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.pages import code_blocks, snippet
from tests.performances import FRAMES, performance
from tests.stereo_scenes import make_rig
from workbench.cli.exporting import model_of_track
from workbench.config import preset
from workbench.errors import InputError
from workbench.export import FORMATS, export_track, format_of, read_mapping
from workbench.export.sources import pictures_of
from workbench.face import load_default_head
from workbench.face.default_head import EARLIER_EDITIONS
from workbench.frames import VideoWriter, open_frames, write_picture
from workbench.geometry import write_rig
from workbench.landmarks.schemes import DENSE
from workbench.pipeline.temporal_run import views_of
from workbench.samples import sample
from workbench.session import open_session
from workbench.tracking import Track
from workbench.tracking.track_layout import file_record


@pytest.fixture
def stored(head, tmp_path):
    """A run's folder, with its input as a video."""
    with VideoWriter(tmp_path / "clip.mp4") as writer:
        for k in range(FRAMES):
            writer.write(np.full((480, 640, 3), 60 + 10 * k, np.uint8))
    track = performance(head)
    track.meta["inputs"] = [file_record(tmp_path / "clip.mp4")]
    track.save(tmp_path / "talk" / "track.npz")
    return tmp_path / "talk"


def character_folder(head, folder, names):
    """An OBJ folder as a modeller exports it."""
    folder.mkdir()
    small = head.with_expressions(tuple(names))
    shapes = {"neutral": head.neutral, **dict(zip(names.values(), small.expression_deltas + head.neutral, strict=True))}
    for name, vertices in shapes.items():
        trimesh.Trimesh(vertices, head.triangles, process=False).export(folder / f"{name}.obj")
    points = ", ".join(str(v) for v in head.landmarks.vertices[:, 0])
    (folder / "landmarks.toml").write_text(f"vertices = [{points}]\n")


@pytest.mark.parametrize("kind", sorted(FORMATS))
def test_every_format_is_written_by_its_suffix(kind, run, stored, tmp_path):
    code, out, err = run("export", "talk", "--to", f"made/x{kind}")
    assert (code, err) == (0, "")
    (made,) = (tmp_path / "made").iterdir()
    assert made.name == ("x" if kind in (".obj", ".ply") else f"x{kind}")
    assert str(made.relative_to(tmp_path)) in out
    assert FORMATS[kind] in out
    assert "note:" not in out


def test_the_plain_head_is_no_character(run, stored, tmp_path):
    assert run("export", "talk", "--to", "a.csv", "--character", "plain")[0] == 0
    assert (tmp_path / "a.csv").is_file()


def test_several_files_in_one_go(run, stored, tmp_path):
    assert run("export", "talk/track.npz", "--to", "a.csv", "--to", "b.arkit.csv", "--to", "c.usdc")[0] == 0
    assert {path.name for path in tmp_path.iterdir()} >= {"a.csv", "b.arkit.csv", "c.usdc"}


def test_the_film_has_a_picture_a_frame_and_the_head_beside(run, stored, tmp_path):
    run("export", "talk", "--to", "film.mp4")
    film = open_frames(tmp_path / "film.mp4")
    assert len(list(film.iterate())) == FRAMES
    assert film.image_size[0] > 640
    assert film.rate == 25.0


def test_moved_pictures_are_named(run, stored, tmp_path):
    (tmp_path / "clip.mp4").rename(tmp_path / "moved.mp4")
    code, _, err = run("export", "talk", "--to", "film.mp4")
    assert code == 2
    assert "no longer at" in err
    assert "--pictures" in err
    assert run("export", "talk", "--to", "film.mp4", "--pictures", "moved.mp4")[0] == 0
    code, out, _ = run("export", "talk", "--to", "report.html")
    assert code == 0
    assert "note: the report has no pictures of the input" in out


def folder_of_pictures(folder):
    """The pictures of a performance as files."""
    folder.mkdir()
    for k in range(FRAMES):
        write_picture(folder / f"{k:02d}.png", np.full((480, 640, 3), 60 + 10 * k, np.uint8))


def test_a_film_of_moved_pictures_keeps_the_rate_of_the_track(run, stored, tmp_path):
    track = Track.load(stored / "track.npz")
    replace(track, meta=track.meta | {"rate": 50.0}).save(stored / "track.npz")
    folder_of_pictures(tmp_path / "moved")
    code, out, _ = run("export", "talk", "--to", "film.mp4", "--pictures", "moved")
    assert code == 0
    assert "note:" not in out
    assert open_frames(tmp_path / "film.mp4").rate == 50.0


def test_a_film_of_pictures_without_a_rate_says_so(run, stored, tmp_path):
    folder_of_pictures(tmp_path / "photos")
    track = Track.load(stored / "track.npz")
    meta = track.meta | {"rate": None, "inputs": [file_record(tmp_path / "photos")]}
    replace(track, meta=meta).save(stored / "track.npz")
    code, out, _ = run("export", "talk", "--to", "film.mp4")
    assert code == 0
    assert "note: the input has no frame rate" in out


def test_another_clip_under_the_same_name_is_not_drawn(run, stored, tmp_path):
    with VideoWriter(tmp_path / "clip.mp4") as writer:
        for _ in range(FRAMES):
            writer.write(np.zeros((480, 640, 3), np.uint8))
    code, _, err = run("export", "talk", "--to", "film.mp4")
    assert code == 2
    assert "clip.mp4, where another file is now; name them with --pictures" in " ".join(err.split())
    assert run("export", "talk", "--to", "film.mp4", "--pictures", "clip.mp4")[0] == 0


def test_a_folder_that_was_moved_with_clip_and_run_in_it_is_still_worked_in(run, stored, tmp_path, monkeypatch):
    (tmp_path / "moved").mkdir()
    for name in ("clip.mp4", "talk"):
        (tmp_path / name).rename(tmp_path / "moved" / name)
    monkeypatch.chdir(tmp_path / "moved")
    assert run("export", "talk", "--to", "film.mp4")[0] == 0
    code, _, err = run("export", "talk", "--to", "clip.mp4")
    assert code == 2
    assert "clip.mp4 is an input" in err
    (tmp_path / "moved" / "clip.mp4").write_bytes((tmp_path / "moved" / "film.mp4").read_bytes())
    code, _, err = run("export", "talk", "--to", "again.mp4")
    assert code == 2
    assert f"no longer at {tmp_path / 'clip.mp4'}; name them" in "".join(err.split("\n"))


def test_in_a_copied_folder_the_copied_clip_is_kept_and_drawn(run, stored, tmp_path, monkeypatch):
    original, copy = tmp_path / "clip.mp4", tmp_path / "copy" / "clip.mp4"
    shutil.copytree(stored, tmp_path / "copy" / "talk")
    shutil.copy(original, copy)
    monkeypatch.chdir(copy.parent)
    before = copy.read_bytes()
    code, _, err = run("export", "talk", "--to", "clip.mp4")
    assert code == 2
    assert "clip.mp4 is an input" in err
    assert copy.read_bytes() == before
    original.write_bytes(b"another clip")
    assert run("export", "talk", "--to", "film.mp4")[0] == 0


def test_another_folder_under_the_same_name_is_not_taken_for_the_moved_one(stored, tmp_path, monkeypatch):
    photos = tmp_path / "photos"
    folder_of_pictures(photos)
    track = Track.load(stored / "track.npz")
    track.meta["inputs"] = [file_record(photos)]
    write_picture(photos / "later.png", np.zeros((480, 640, 3), np.uint8))
    assert pictures_of(track).name == "photos"
    (photos / "later.png").unlink()
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    photos.rename(tmp_path / "work" / "photos")
    assert pictures_of(track).name == "photos"
    write_picture(tmp_path / "work" / "photos" / "0.png", np.ones((480, 640, 3), np.uint8))
    with pytest.raises(InputError, match=f"no longer at {photos}"):
        pictures_of(track)


def test_a_rate_of_ones_own(run, stored, tmp_path):
    assert run("export", "talk", "--to", "a.arkit.csv", "--fps", "60")[0] == 0
    assert (tmp_path / "a.arkit.csv").read_text().splitlines()[-1].startswith("00:00:00:11.000,61,")


def test_a_rate_of_ones_own_is_that_of_the_film_and_the_report_too(run, stored, tmp_path):
    assert run("export", "talk", "--to", "film.mp4", "--to", "report.html", "--fps", "5")[0] == 0
    assert open_frames(tmp_path / "film.mp4").rate == 5.0
    assert "12 frames, 2.4 s at 5 frames per second" in (tmp_path / "report.html").read_text(encoding="utf-8")


# --- characters ---


def test_a_character_plays_by_names_and_what_has_no_counterpart_is_told(run, stored, head, tmp_path):
    character_folder(head, tmp_path / "hero", {"jawOpen": "JawOpen", "mouthSmileLeft": "Mouth_Smile_L"})
    code, out, err = run("export", "talk", "--to", "hero.npz", "--character", "hero")
    assert (code, err) == (0, "")
    assert "move nothing on the character" in out
    with np.load(tmp_path / "hero.npz") as arrays:
        assert sorted(arrays["names"]) == ["JawOpen", "Mouth_Smile_L"] or len(arrays["names"]) == 2
        np.testing.assert_allclose(arrays["weights"][-1], [0.6, 1.0])


def test_a_character_plays_by_a_mapping_file(run, stored, head, tmp_path):
    character_folder(head, tmp_path / "hero", {"jawOpen": "wide", "mouthSmileLeft": "grin"})
    (tmp_path / "map.toml").write_text("[shapes]\ngrin = { mouthSmileLeft = 0.5, mouthSmileRight = 0.5 }\n")
    code, out, _ = run("export", "talk", "--to", "hero.csv", "--character", "hero", "--map", "map.toml")
    assert code == 0
    assert "the blendshapes wide of the character stay at rest" in out


def test_a_character_plays_by_its_surface(run, stored, head, tmp_path):
    character_folder(head, tmp_path / "hero", {"jawOpen": "one", "mouthSmileLeft": "two"})
    assert run("export", "talk", "--to", "hero.npz", "--character", "hero", "--surface")[0] == 0
    with np.load(tmp_path / "hero.npz") as arrays:
        weights = dict(zip(arrays["names"].tolist(), arrays["weights"][-1], strict=True))
    assert weights["one"] == pytest.approx(0.6, abs=0.1)
    assert weights["two"] == pytest.approx(1.0, abs=0.1)


def test_the_example_of_the_documentation_runs(stored, head, tmp_path, monkeypatch):
    mapping = next(text for _, text in code_blocks("toml") if "[shapes]" in text)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    stored.rename(tmp_path / "out" / "talk")
    export_track(performance(head), head, tmp_path / "hero.glb")
    names = {}
    exec(compile(snippet("AvatarPlayer"), "documentation", "exec"), names)
    assert (tmp_path / "hero.usd").is_file()
    np.testing.assert_allclose(names["played"].expression[-1].max(), 1.0)
    names["player"].close()
    (tmp_path / "map.toml").write_text(mapping)
    assert read_mapping("map.toml", head.expression_names, ("Mouth_Open", "Smile")).still == ()


def test_a_file_of_its_own_beside_the_track_is_written_and_written_again(run, stored, tmp_path):
    for _ in range(2):
        assert run("export", "talk", "--to", "talk/mine.csv")[0] == 0
    assert (tmp_path / "talk" / "mine.csv").is_file()


# --- mistakes ---


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["talk", "--to", "x.fbx"], "is exported as .glb"),
        (["talk", "--to", ".csv"], "is exported as .glb"),
        (["talk", "--to", ".arkit.csv"], "got .arkit.csv: name the file."),
        (["talk", "--to", ""], "got no name: name the file."),
        (["nowhere", "--to", "x.glb"], "does not exist"),
        (["talk", "--to", "x.glb", "--shot", "4"], "the shots 0 to 0"),
        (["talk", "--to", "x.csv", "--fps", "0"], "a rate between 0 and 1000"),
        (["talk", "--to", "x.mp4", "--fps", "0.0003"], "a rate between 0.001 and 1000"),
        (["talk", "--to", "x.csv", "--map", "m.toml"], "name it with --character"),
        (["talk", "--to", "talk/track.npz"], "would be overwritten"),
        (["talk", "--to", "x.glb", "--character", "meii"], "meii is neither a ready character"),
        (["talk", "--to", "talk.ply"], "talk already exists; name another folder for the meshes."),
        (["talk", "--to", "m.obj", "--to", "m.ply"], "m.obj and m.ply would both be written to m;"),
        (["talk", "--to", "x.npz", "--to", "x.glb", "--character", "mei"], "x.npz cannot show the character mei"),
        (["talk", "--to", "x.glb", "--to", "x.npz", "--character", "mei"], "x.npz cannot show the character mei"),
        (
            ["talk", "--to", "x.glb", "--character", "mei", "--surface"],
            "another face model; mei is a character of the default head",
        ),
    ],
)
def test_mistakes_are_one_sentence_and_write_nothing(arguments, message, run, stored, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    code, out, err = run("export", *arguments)
    assert code == 2
    assert err.startswith("error: ")
    assert message in err
    assert "Traceback" not in out + err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_folder_of_meshes_that_is_there_stops_all_files_before_the_first(run, stored, tmp_path):
    (tmp_path / "meshes").mkdir()
    code, _, err = run("export", "talk", "--to", "x.csv", "--to", "meshes.obj")
    assert code == 2
    assert "meshes already exists; name another folder" in err
    assert not (tmp_path / "x.csv").exists()


def test_a_track_of_another_model_asks_for_it(run, stored, head):
    track = Track.load(stored / "track.npz")
    replace(track, meta={**track.meta, "model": {"name": "flame", "sha256": "1"}}).save(stored / "track.npz")
    code, _, err = run("export", "talk", "--to", "x.glb")
    assert code == 2
    assert "fitted with the model flame" in err
    assert "--model" in err


def test_a_model_gets_the_eyes_units_that_a_run_with_pupils_gave_it():
    full = load_default_head(gaze=True)
    track = performance(full)
    track.meta["scheme"] = DENSE.name
    model, notes = model_of_track(track, sample("head"))
    assert model.expression_names == track.expression_names
    assert not notes


def test_an_older_edition_of_the_default_head_is_told(run, stored):
    track = Track.load(stored / "track.npz")
    replace(track, meta={**track.meta, "model": {"name": "default-head", "sha256": "1"}}).save(stored / "track.npz")
    code, out, _ = run("export", "talk", "--to", "x.glb")
    assert code == 0
    assert "another edition of default-head" in out


def test_an_edition_that_fits_as_the_default_head_does_is_not_told(run, stored):
    track = Track.load(stored / "track.npz")
    earlier = next(sha256 for sha256, gaze in EARLIER_EDITIONS.items() if not gaze)
    replace(track, meta={**track.meta, "model": {"name": "default-head", "sha256": earlier}}).save(stored / "track.npz")
    code, out, _ = run("export", "talk", "--to", "x.glb")
    assert code == 0
    assert "another edition" not in out


def test_landmarks_alone_make_no_film(head, tmp_path):
    track = performance(head, frames=2, gap=None)
    track.meta["inputs"] = [{"path": "points.csv", "sha256": "0"}]
    with pytest.raises(InputError, match="landmarks without pictures"):
        export_track(track, head, tmp_path / "x.mp4")


@pytest.mark.parametrize(
    ("name", "kind"), [("a.GLB", ".glb"), ("b.usda", ".usd"), ("c.arkit.csv", ".arkit.csv"), ("d.x.csv", ".csv")]
)
def test_the_suffix_decides(name, kind):
    assert format_of(name) == kind


def test_a_track_of_a_part_of_a_clip_is_shown_with_the_pictures_of_that_part(stored):
    track = Track.load(stored / "track.npz")
    part = Track(**{**vars(track), "meta": {**track.meta, "frames": [2, 4]}})
    shades = [float(frame.picture.mean()) for frame in pictures_of(part).iterate()]
    assert shades == pytest.approx([80, 90, 100], abs=3)
    assert len(list(pictures_of(track).iterate())) == FRAMES


@pytest.mark.parametrize(
    "command", [("export", "--to", "x.mp4"), ("export", "--to", "x.html"), ("character", "--out", "x")]
)
def test_pictures_of_another_size_than_the_tracked_ones_are_refused(command, run, stored, tmp_path):
    with VideoWriter(tmp_path / "half.mp4") as writer:
        for _ in range(FRAMES):
            writer.write(np.full((240, 320, 3), 90, np.uint8))
    before = sorted(tmp_path.rglob("*"))
    name, *options = command
    code, _, err = run(name, "talk", *options, "--pictures", "half.mp4")
    assert code == 2
    assert "The pictures of half.mp4 are 320x240 (half#0), those that were tracked 640x480" in " ".join(err.split())
    assert sorted(tmp_path.rglob("*")) == before


def test_in_a_folder_each_picture_is_compared_with_the_one_that_was_tracked(stored, tmp_path):
    track = Track.load(stored / "track.npz")
    (tmp_path / "shoot.2024").mkdir()
    for k, width in enumerate((640, 640, 320)):
        write_picture(tmp_path / "shoot.2024" / f"{k}.png", np.zeros((480, width, 3), np.uint8))
    track.meta["inputs"] = [{"path": str(tmp_path / "shoot.2024"), "sha256": "0" * 64}]
    stream = pictures_of(track).iterate()
    assert [next(stream).index for _ in range(2)] == [0, 1]
    with pytest.raises(InputError, match=r"are 320x480 \(2.png\), those that were tracked 640x480"):
        next(stream)


def test_a_folder_with_a_dot_in_its_name_holds_pictures(stored, tmp_path):
    track = Track.load(stored / "track.npz")
    (tmp_path / "shoot.2024").mkdir()
    write_picture(tmp_path / "shoot.2024" / "0.png", np.zeros((480, 640, 3), np.uint8))
    track.meta["inputs"] = [{"path": str(tmp_path / "shoot.2024"), "sha256": "0" * 64}]
    assert pictures_of(track).name == "shoot.2024"
    assert [frames.name for frames in views_of(track.meta, preset("joint"))] == ["shoot.2024"]


@pytest.mark.parametrize("named", [True, False])
def test_a_track_of_several_cameras_is_shown_and_tuned_with_the_pictures_of_the_first(named, stored, tmp_path):
    """Older tracks do not name the clips of the other views: the rig tells how many of the inputs they are."""
    with VideoWriter(tmp_path / "right.mp4") as writer:
        writer.write(np.zeros((480, 640, 3), np.uint8))
    rig = make_rig((0.0, 30.0), 600.0, (640, 480), 40.0)
    write_rig(rig, tmp_path / "rig.toml")
    track, right = Track.load(stored / "track.npz"), str(tmp_path / "right.mp4")
    config = preset("deep-points").changed(camera={"rig": str(tmp_path / "rig.toml")})
    inputs = [*track.meta["inputs"], {"path": right, "sha256": ""}]
    meta = {**track.meta, "inputs": inputs, "config": config.model_dump(mode="json")}
    name = rig.names[1]
    meta |= {"views": {name: right}} if named else {}
    track = replace(track, meta=meta)
    shades = [float(frame.picture.mean()) for frame in pictures_of(track).iterate()]
    assert shades == pytest.approx([60 + 10 * k for k in range(FRAMES)], abs=3)
    session = open_session(track)
    assert session.picture(2).mean() == pytest.approx(80, abs=3)
    assert f"clip.mp4 --config a.toml --view {name}={right}" in session.command("a.toml")
    session.use(preset("joint"))
    assert "--view" not in session.command("a.toml")  # FACE IT! takes one


@pytest.mark.long
def test_a_ready_character_plays_in_gltf_and_in_the_film(run, stored, tmp_path):
    code, _, err = run("export", "talk", "--to", "mei.glb", "--to", "mei.mp4", "--character", "mei")
    assert (code, err) == (0, "")
    run("export", "talk", "--to", "plain.glb", "--to", "plain.mp4")
    assert (tmp_path / "mei.glb").stat().st_size > 1.2 * (tmp_path / "plain.glb").stat().st_size
    dressed, plain = (next(open_frames(tmp_path / f"{name}.mp4").iterate()).picture for name in ("mei", "plain"))
    assert np.abs(dressed.astype(int) - plain)[:, plain.shape[1] // 2 :].mean() > 1.0


def test_other_formats_cannot_show_a_character(run, stored):
    code, _, err = run("export", "talk", "--to", "mei.csv", "--character", "mei")
    assert code != 0
    assert "cannot show the character mei" in " ".join(err.split())
