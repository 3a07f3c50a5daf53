"""Pictures: the head off screen, the plain fallback, overlays, overlay videos, and the sample clip's truth."""

import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.optional_parts import needs_gl
from tests.scenes import make_scene
from workbench.errors import InputError, MissingDependencyError, WorkbenchError
from workbench.face import load_character
from workbench.face.model import Embedding
from workbench.frames import VideoWriter, open_frames, read_picture
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_fov, project
from workbench.landmarks.files import read_landmark_file
from workbench.pictures import (
    HeadPanel,
    HeadRenderer,
    Lighting,
    OverlayParts,
    draw_overlay,
    draw_wireframe,
    gl_available,
    gl_probe,
    head_painter,
    picture_of_head,
    portrait_view,
    side_by_side,
    write_overlay_picture,
    write_overlay_video,
)
from workbench.pictures.extras import NOTHING, Extras
from workbench.pictures.lighting import STUDIO
from workbench.pictures.mesh import scaled_camera, split_seams, to_camera, to_pixels
from workbench.pictures.render_thread import RenderThread
from workbench.samples import sample
from workbench.tracking.records import ARRAYS, FrameFit, Track, stack_fits

SIZE = (200, 160)
FLAT = Lighting(lights=(), ambient=1.0)
LENS = Camera(
    np.array([230.0, 215.0]), np.array([96.0, 84.5]), np.array([-0.25, 0.1, 0.003, -0.002, 0.0, 0.0, 0.0, 0.0])
)
PINHOLE = Camera(np.array([230.0, 215.0]), np.array([96.0, 84.5]), np.zeros(8))


@pytest.fixture(scope="module")
def renderer(head):
    if not gl_available():
        pytest.skip("VTK has no usable GL here")
    with HeadRenderer(head, SIZE) as made:
        yield made


@pytest.fixture(scope="module")
def view(head):
    return portrait_view(head, SIZE)


@pytest.fixture(params=["VTK", "plain"])
def any_painter(request, head, monkeypatch):
    if request.param == "VTK" and not gl_available():
        pytest.skip("VTK has no usable GL here")
    if request.param == "plain":
        monkeypatch.setenv(gl_probe.NO_GL_VARIABLE, "1")
    with head_painter(head, SIZE) as painter:
        yield painter


def blobs_model(head, centres_head, radius_mm=4.0):
    """A model of small octahedra at these points of the head frame, with nothing else."""
    corners = radius_mm * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    vertices = np.concatenate([centre + corners for centre in centres_head])
    triangles = np.concatenate([faces + 6 * k for k in range(len(centres_head))]).astype(np.int32)
    count = len(vertices)
    return replace(
        head, name="blobs", neutral=vertices, triangles=triangles, triangles_uv=triangles, uv=np.zeros((0, 2)),
        expression_names=(), expression_deltas=np.zeros((0, count, 3)), identity_deltas=np.zeros((0, count, 3)),
        landmarks=Embedding(np.zeros((68, 3), np.int32), np.tile([1.0, 0.0, 0.0], (68, 1))),
        colors=np.full((count, 3), 255, np.uint8), regions={}, joints={}, jaw_weights=np.zeros(count),
        mirror=np.arange(count), identity_joint_deltas={}, blink_scale_identity=np.zeros((0, 2)),
    )  # fmt: skip


def fit_of(head, index=0, found=True, noise_px=0.0, angles=(0.0, 0.0, 0.0), **weights):
    """A fit of a synthetic scene, 640 × 480, with landmarks observed this badly."""
    scene = make_scene(head, angles, weights)
    shift = np.random.default_rng(index).normal(0.0, 1.0, (68, 2)) * noise_px
    unknown = 1.0 if found else np.nan
    return FrameFit(
        index=index, found=found, shot=0, source="detected" if found else "none", image_size=(640, 480),
        camera=scene.camera,
        rotation=np.asarray(scene.parameters.rotation) * unknown,
        translation=np.asarray(scene.parameters.translation) * unknown,
        expression=np.asarray(scene.parameters.expression) * unknown,
        identity=np.asarray(scene.parameters.identity) * unknown,
        observed=(scene.points + shift) * unknown,
        confidence=np.ones(68) * unknown,
        projected=scene.points * unknown,
        energies=np.zeros((1, 7)), status=np.zeros(1, int), iterations=np.zeros(1, int), milliseconds=np.zeros(3),
    )  # fmt: skip


def track_of(head, fits):
    return Track(meta={"expression_names": list(head.expression_names)}, **stack_fits(fits))


@pytest.fixture
def clip(tmp_path):
    """Six frames of 640 × 480, each of its own grey."""
    with VideoWriter(tmp_path / "clip.mp4") as writer:
        for k in range(6):
            writer.write(np.full((480, 640, 3), 60 + 20 * k, np.uint8))
    return open_frames(tmp_path / "clip.mp4")


# --- the camera convention ---


@needs_gl
@pytest.mark.parametrize("camera", [PINHOLE, LENS], ids=["pinhole", "lens"])
def test_rendered_points_lie_where_the_camera_projects_them(head, camera):
    centres = np.array([[x, y, z] for x, z in ((-60.0, 0.0), (0.0, 30.0), (55.0, -20.0)) for y in (-45.0, 0.0, 40.0)])
    rotation = axis_angle_from_yaw_pitch_roll(np.array([18.0, -7.0, 5.0]))
    translation = np.array([6.0, -4.0, 260.0])
    model = blobs_model(head, centres)
    with HeadRenderer(model, SIZE, supersampling=4.0) as renderer:
        mask = renderer.render_with_mask(model.neutral, camera, rotation, translation, lighting=FLAT)[1]
    expected = np.asarray(project(camera, to_camera(centres, rotation, translation)))
    rows, columns = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    for x, y in expected:
        near = (np.hypot(columns - x, rows - y) < 9) * mask.astype(float)
        found = np.array([(columns * near).sum(), (rows * near).sum()]) / near.sum()
        assert np.hypot(*(found - (x, y))) < 0.3


def test_opencv_and_jax_project_alike():
    points = np.random.default_rng(0).uniform([-80, -80, 200], [80, 80, 500], (50, 3))
    assert np.allclose(to_pixels(LENS, points), project(LENS, points), atol=1e-9)


def test_a_scaled_camera_sees_the_resized_picture():
    points = np.random.default_rng(0).uniform([-80, -80, 200], [80, 80, 500], (20, 3))
    resized = (to_pixels(LENS, points) + 0.5) * 0.25 - 0.5
    assert np.allclose(to_pixels(scaled_camera(LENS, 0.25), points), resized)


def test_plain_and_vtk_heads_cover_the_same_pixels(head, renderer, view):
    camera, translation = view
    rotation = axis_angle_from_yaw_pitch_roll(np.array([25.0, 5.0, -10.0]))
    mask = renderer.render_with_mask(head.neutral, camera, rotation, translation)[1] > 127
    plain = draw_wireframe(head, SIZE, head.neutral, camera, rotation, translation)[1] > 127
    assert (mask != plain).mean() < 0.01


# --- heads ---


def test_the_head_is_a_picture_on_its_background(any_painter, head, view):
    camera, translation = view
    picture, mask = any_painter.submit(head.neutral, camera, np.zeros(3), translation, (10, 200, 30)).result()
    assert picture.shape == (160, 200, 3)
    assert (picture[mask == 0] == (10, 200, 30)).all()
    assert 0.1 < (mask > 0).mean() < 0.8
    assert picture[mask == 255].std() > 20


def test_a_picture_as_background_shows_around_the_head(any_painter, head, view):
    camera, translation = view
    room = np.random.default_rng(0).integers(0, 255, (160, 200, 3)).astype(np.uint8)
    kept = room.copy()
    picture, mask = any_painter.submit(head.neutral, camera, np.zeros(3), translation, room).result()
    assert np.array_equal(picture[mask == 0], room[mask == 0])
    assert np.array_equal(room, kept)


def test_the_mask_moves_with_the_head(any_painter, head, view):
    camera, translation = view
    moved = translation + np.array([20.0, 0.0, 0.0])
    columns = [
        np.flatnonzero(any_painter.submit(head.neutral, camera, np.zeros(3), t).result()[1].any(0)).min()
        for t in (translation, moved)
    ]
    shift_px = 20.0 * camera.focal_px[0] / translation[2]
    assert columns[1] - columns[0] == pytest.approx(shift_px, abs=1.5)


def test_an_expression_changes_the_picture_where_it_acts(any_painter, head, view):
    camera, translation = view
    weights = np.zeros(len(head.expression_names))
    weights[head.expression_names.index("jawOpen")] = 1.0
    neutral, opened = (
        any_painter.render(head.vertices(w), camera, np.zeros(3), translation).astype(int)
        for w in (0 * weights, weights)
    )
    changed = np.abs(opened - neutral).max(2) > 20
    mouth_row = to_pixels(camera, head.landmarks.of(head.neutral)[[66]] + translation)[0, 1]
    assert changed.any()
    assert np.flatnonzero(changed.any(1)).mean() == pytest.approx(mouth_row, abs=20)
    assert not changed[: round(mouth_row) - 50].any()


def test_another_light_changes_the_picture_and_not_the_mask(renderer, head, view):
    camera, translation = view
    lit, mask = renderer.render_with_mask(head.neutral, camera, np.zeros(3), translation)
    dim, dim_mask = renderer.render_with_mask(
        head.neutral, camera, np.zeros(3), translation, lighting=Lighting((), 0.1)
    )
    assert np.array_equal(mask, dim_mask)
    assert dim[mask == 255].mean() < 0.4 * lit[mask == 255].mean()


def test_another_thread_gets_the_same_picture(renderer, head, view):
    camera, translation = view
    mine = renderer.render(head.neutral, camera, np.zeros(3), translation)
    theirs = []
    thread = threading.Thread(
        target=lambda: theirs.append(renderer.render(head.neutral, camera, np.zeros(3), translation))
    )
    thread.start()
    thread.join()
    assert np.abs(theirs[0].astype(int) - mine).mean() < 2
    turned = renderer.render(head.neutral, camera, np.array([0.0, 0.6, 0.0]), translation)
    assert np.abs(turned.astype(int) - mine).mean() > 5


def test_a_head_behind_the_camera_is_not_drawn(any_painter, head, view):
    mask = any_painter.submit(head.neutral, view[0], np.zeros(3), np.array([0.0, 0.0, -900.0])).result()[1]
    assert not mask.any()


def test_seams_split_vertices_and_keep_triangles():
    triangles, triangles_uv = np.array([[0, 1, 2], [2, 1, 3]]), np.array([[0, 1, 2], [4, 1, 3]])
    vertex_of_point, uv_of_point, split = split_seams(triangles, triangles_uv)
    assert len(vertex_of_point) == 5
    assert np.array_equal(vertex_of_point[split], triangles)
    assert np.array_equal(uv_of_point[split], triangles_uv)


def test_wrong_scenes_are_refused_with_a_reason(any_painter, head, view):
    camera, translation = view
    with pytest.raises(InputError, match="vertices"):
        any_painter.render(head.neutral[:-1], camera, np.zeros(3), translation)
    with pytest.raises(InputError, match="finite"):
        any_painter.render(head.neutral, camera, np.full(3, np.nan), translation)
    with pytest.raises(InputError, match="resize"):
        any_painter.render(head.neutral, camera, np.zeros(3), translation, np.zeros((16, 20, 3), np.uint8))


def test_sizes_out_of_range_are_refused(head):
    with pytest.raises(InputError, match="8192"):
        head_painter(head, (0, 100))


@needs_gl
def test_a_faded_neck_ends_softly_and_leaves_the_face(head, renderer, view):
    camera, translation = view
    whole = renderer.render_with_mask(head.neutral, camera, np.zeros(3), translation)[1].astype(int)
    with HeadRenderer(head, SIZE, fade_neck=True) as fading:
        faded = fading.render_with_mask(head.neutral, camera, np.zeros(3), translation)[1].astype(int)
    mouth_row, chin_row = np.round(
        to_pixels(camera, head.landmarks.of(head.neutral)[[57, 8]] + translation)[:, 1]
    ).astype(int)
    assert np.array_equal(whole[:mouth_row], faded[:mouth_row])
    assert faded[chin_row:][whole[chin_row:] == 255].min() < 200


@needs_gl
def test_a_closed_renderer_says_so(head, view):
    renderer = HeadRenderer(head, (32, 32))
    renderer.close()
    renderer.close()
    with pytest.raises(WorkbenchError, match="closed"):
        renderer.render(head.neutral, view[0], np.zeros(3), view[1])


# --- without GL ---


def test_without_gl_a_plain_picture_and_a_note_come(head, view, monkeypatch):
    monkeypatch.setenv(gl_probe.NO_GL_VARIABLE, "1")
    picture, note = picture_of_head(head, SIZE, head.neutral, view[0], np.zeros(3), view[1])
    assert picture.std() > 15
    assert "libegl1" in note


def test_without_gl_the_note_says_that_a_character_is_not_shown(head, monkeypatch):
    monkeypatch.setenv(gl_probe.NO_GL_VARIABLE, "1")
    with head_painter(head, SIZE, dressed=load_character("mei")) as painter:
        assert "mei needs GL" in painter.note


@needs_gl
def test_colours_stand_alone_after_the_texture_has_changed(head, view):
    # Where there is no GL it cannot even be imported.
    from workbench.pictures.head_scene import HeadScene

    white, dark = (np.full((8, 8, 3), shade, np.uint8) for shade in (255, 20))
    extras, points = Extras(colors=head.colors), to_camera(head.neutral, np.zeros(3), view[1])

    def drawn(scene):
        def shown(extras):
            return scene.render(points, view[0], STUDIO, extras).astype(int)

        first = shown(extras)
        scene.set_texture(dark)
        return first, shown(extras), shown(NOTHING)

    thread = RenderThread(lambda: HeadScene(head, SIZE, white, 1.0, False), lambda scene: scene.close())
    try:
        first, second, textured = thread.submit(drawn).result(60)
    finally:
        thread.stop()
    assert np.abs(first - second).max() <= 1
    assert textured[..., :3].max() < first[..., :3].max() - 50


@needs_gl
def test_with_gl_there_is_no_note(head, view):
    assert picture_of_head(head, (64, 64), head.neutral, view[0], np.zeros(3), view[1])[1] is None


def test_without_gl_the_renderer_names_the_remedy(head, monkeypatch):
    monkeypatch.setenv(gl_probe.NO_GL_VARIABLE, "1")
    with pytest.raises(MissingDependencyError, match="libegl1"):
        HeadRenderer(head, SIZE)


@pytest.mark.parametrize("content", ['{"window": 3}', '{"window": "other"}', "[]", '{"a":' * 50_000, "", "{"])
def test_a_damaged_answer_of_an_earlier_process_is_asked_for_again(tmp_path, content):
    path = tmp_path / "gl.json"
    gl_probe._write_answer(path, gl_probe._candidates()[0])
    assert gl_probe._read_answer(path) == gl_probe._candidates()[0]
    path.write_text(content)
    assert gl_probe._read_answer(path) is None


def test_the_probe_survives_a_crash_and_remembers_only_success(tmp_path, monkeypatch):
    monkeypatch.delenv(gl_probe.NO_GL_VARIABLE, raising=False)
    monkeypatch.setenv("WORKBENCH_CACHE", str(tmp_path))
    monkeypatch.setenv(gl_probe.WINDOW_VARIABLE, "vtkEGLRenderWindow")
    answers = []
    try:
        for program in ("import os; os.abort()", "raise SystemExit(0)", "import os; os.abort()"):
            gl_probe._working_window.cache_clear()
            monkeypatch.setattr(gl_probe, "PROBE", program)
            answers.append(gl_available())
    finally:
        gl_probe._working_window.cache_clear()
    assert answers == [False, True, True]


# --- overlays ---


def test_the_overlay_marks_model_points_in_their_pixels_and_leaves_the_frame_alone(head):
    fit = fit_of(head, angles=(10.0, 0.0, 0.0))
    picture = np.full((480, 640, 3), 90, np.uint8)
    drawn = draw_overlay(picture, fit, parts=OverlayParts(lines=False, axes=False, text=False, legend=False))
    changed = (drawn != picture).any(2)
    for x, y in fit.projected:
        assert changed[round(y), round(x)]
    rows, columns = np.nonzero(changed)
    distances = np.hypot(columns[:, None] - fit.projected[:, 0], rows[:, None] - fit.projected[:, 1])
    assert distances.min(1).max() < 8
    assert (picture == 90).all()


def test_a_large_residual_is_brighter_than_a_small_one(head):
    parts = OverlayParts(observed=False, lines=False, axes=False, text=False, legend=False)
    fit = fit_of(head)
    off = fit.observed.copy()
    off[30] += (0.0, 40.0)
    drawn = draw_overlay(np.zeros((480, 640, 3), np.uint8), replace(fit, observed=off), parts=parts).astype(int)
    x, y = np.round(fit.projected[30] + (0, 20)).astype(int)
    bad, good = drawn[y, x], drawn[tuple(np.round(fit.projected[8, ::-1]).astype(int))]
    assert bad[:2].min() > 150
    assert good[2] > good[0]


def test_a_frame_without_a_face_gets_text_only(head):
    picture = np.full((480, 640, 3), 90, np.uint8)
    drawn = draw_overlay(picture, fit_of(head, found=False))
    assert (drawn[:40] != 90).any()
    assert (drawn[60:] == 90).all()


@pytest.mark.parametrize(
    ("size", "expected"), [((100, 80), (320, 256)), ((640, 480), (640, 480)), ((8000, 6000), (1920, 1440))]
)
def test_overlays_have_a_size_for_people(head, size, expected):
    scale = size[0] / 640
    fit = fit_of(head)
    fit = replace(
        fit, camera=scaled_camera(fit.camera, scale), image_size=size,
        observed=(fit.observed + 0.5) * scale - 0.5, projected=(fit.projected + 0.5) * scale - 0.5,
    )  # fmt: skip
    picture = np.zeros((size[1], size[0], 3), np.uint8)
    parts = OverlayParts(text=False, legend=False)
    drawn = draw_overlay(picture, fit, parts=parts)
    assert drawn.shape == (expected[1], expected[0], 3)
    x, y = np.round((fit.projected[8] + 0.5) * expected[0] / size[0] - 0.5).astype(int)
    assert drawn[y - 1 : y + 2, x - 1 : x + 2].max() > 60


def test_the_mesh_is_drawn_on_the_head(head):
    fit = fit_of(head)
    parts = OverlayParts(False, False, False, False, mesh=True, axes=False, text=False, legend=False)
    changed = draw_overlay(np.zeros((480, 640, 3), np.uint8), fit, head, parts).any(2)
    mask = draw_wireframe(head, (640, 480), head.neutral, fit.camera, fit.rotation, fit.translation)[1] > 0
    assert changed[~cv2.dilate(mask.astype(np.uint8), np.ones((5, 5))).astype(bool)].sum() == 0
    assert changed[mask].mean() > 0.2


def test_points_far_outside_the_picture_do_no_harm(head):
    fit = fit_of(head)
    far = replace(fit, projected=fit.projected + 1e7, translation=np.array([0.0, 0.0, 1e-6]))
    assert draw_overlay(np.zeros((480, 640, 3), np.uint8), far, head, OverlayParts(mesh=True)).shape == (480, 640, 3)


def test_side_by_side_gives_the_right_picture_the_height_of_the_left():
    joined = side_by_side(np.zeros((120, 160, 3), np.uint8), np.full((60, 50, 3), 200, np.uint8))
    assert joined.shape == (120, 260, 3)
    assert (joined[:, 160:] == 200).all()


# --- files ---


def test_the_overlay_video_has_a_picture_for_every_tracked_frame(head, clip, tmp_path):
    fits = [fit_of(head, index, found=index != 3, jawOpen=0.1 * index) for index in range(1, 6)]
    done = []
    note = write_overlay_video(clip, track_of(head, fits), head, tmp_path / "overlay.mp4", lambda *n: done.append(n))
    assert (note is None) == gl_available()
    assert done == [(k, 5) for k in range(1, 6)]
    written = open_frames(tmp_path / "overlay.mp4")
    assert written.image_size == (640 + 480, 480)
    pictures = [frame.picture for frame in written.iterate()]
    assert len(pictures) == 5
    # Row 470 lies under all text: the grey tells which frame it was.
    assert [int(picture[470, 600].mean()) for picture in pictures] == pytest.approx([80, 100, 120, 140, 160], abs=3)
    heads = [picture[:, 640:].std() for picture in pictures]
    assert heads[2] < 0.5 * min(heads[:2] + heads[3:])


def test_the_overlay_video_works_without_gl(head, clip, tmp_path, monkeypatch):
    monkeypatch.setenv(gl_probe.NO_GL_VARIABLE, "1")
    note = write_overlay_video(clip, track_of(head, [fit_of(head)]), head, tmp_path / "plain.mp4", view="front")
    assert "libegl1" in note
    assert next(open_frames(tmp_path / "plain.mp4").iterate()).picture[:, 640:].std() > 15


def test_a_failed_overlay_video_leaves_nothing(head, clip, tmp_path):
    def fail(done, total):
        if done == 3:
            raise KeyboardInterrupt

    before = sorted(tmp_path.iterdir())
    track = track_of(head, [fit_of(head, index) for index in range(6)])
    with pytest.raises(KeyboardInterrupt):
        write_overlay_video(clip, track, head, tmp_path / "overlay.mp4", fail)
    assert sorted(tmp_path.iterdir()) == before


def test_tracks_that_do_not_fit_the_input_are_refused(head, clip, tmp_path):
    elsewhere = track_of(head, [fit_of(head, index=99)])
    with pytest.raises(InputError, match="that was tracked"):
        write_overlay_video(clip, elsewhere, head, tmp_path / "overlay.mp4")
    empty = replace(elsewhere, **{name: getattr(elsewhere, name)[:0] for name in ARRAYS})
    with pytest.raises(InputError, match="no frames"):
        write_overlay_video(clip, empty, head, tmp_path / "overlay.mp4")
    with pytest.raises(InputError, match="front"):
        HeadPanel(head, (64, 64), view="side")


@pytest.mark.parametrize(("shape", "top", "left"), [((240, 1280, 3), 180, 0), ((960, 320, 3), 0, 240)])
def test_a_film_shows_pictures_of_another_size_whole_and_in_the_middle(head, tmp_path, shape, top, left):
    cv2.imwrite(str(tmp_path / "1.png"), np.full((480, 640, 3), 120, np.uint8))
    cv2.imwrite(str(tmp_path / "2.png"), np.full(shape, 200, np.uint8))
    fits = [fit_of(head, 0), fit_of(head, 1, found=False)]
    frames = open_frames([tmp_path / "1.png", tmp_path / "2.png"])
    write_overlay_video(frames, track_of(head, fits), head, tmp_path / "overlay.mp4")
    _, second = (frame.picture[:480, :640] for frame in open_frames(tmp_path / "overlay.mp4").iterate())
    bright = second.mean(axis=2) > 160
    inside = np.zeros((480, 640), bool)
    inside[top : 480 - top, left : 640 - left] = True
    assert (bright != inside).mean() < 0.1


def test_a_fit_is_drawn_where_it_is_in_a_picture_that_is_scaled_to_fit(head):
    picture, fit = np.full((480, 640, 3), 90, np.uint8), fit_of(head, noise_px=2.0)
    dots = OverlayParts(observed=False, residuals=False, lines=False, axes=False, text=False, legend=False)
    small = draw_overlay(picture, fit, head, dots, within=(320, 400))
    assert small.shape == (240, 320, 3)
    drawn = np.argwhere(small.std(axis=2) > 5)[:, ::-1]
    assert np.linalg.norm((fit.projected[:, None] + 0.5) / 2 - 0.5 - drawn, axis=2).min(axis=1).max() < 1.5


def test_the_overlay_still_shows_frame_and_head(head, tmp_path):
    picture = np.full((480, 640, 3), 90, np.uint8)
    write_overlay_picture(tmp_path / "still.png", picture, fit_of(head, noise_px=2.0), head)
    still = read_picture(tmp_path / "still.png")
    assert still.shape == (480, 640 + 480, 3)
    assert (still[470, 600] == 90).all()
    assert still[:, 640:].std() > 15


@pytest.mark.parametrize("first", [(480, 640), (300, 200)])
def test_pictures_of_any_size_are_drawn_by_one_renderer_as_each_would_be_alone(head, tmp_path, monkeypatch, first):
    from workbench.pictures import overlay_files

    made, panel = [], overlay_files.HeadPanel

    def counted(*arguments, **named):
        made.append(arguments)
        return panel(*arguments, **named)

    monkeypatch.setattr(overlay_files, "HeadPanel", counted)
    sizes = [first, (480, 640), (640, 360)]
    fits = [fit_of(head, noise_px=2.0), fit_of(head, found=False), fit_of(head, noise_px=1.0)]
    pictures = [np.full((*size, 3), 90, np.uint8) for size in sizes]
    with overlay_files.OverlayPictures(head) as together:
        for k in range(3):
            together.add(tmp_path / f"{k}.png", pictures[k], fits[k])
        assert (tmp_path / "1.png").exists()
        together.flush()
    assert len(made) == 1
    for k in range(3):
        write_overlay_picture(tmp_path / "alone.png", pictures[k], fits[k], head)
        assert np.array_equal(read_picture(tmp_path / f"{k}.png"), read_picture(tmp_path / "alone.png"))


# --- the sample clip ---


@pytest.fixture(scope="module")
def truth():
    with np.load(sample("performance-truth"), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def test_the_truth_of_the_clip_projects_to_its_landmarks(head, truth):
    assert tuple(truth["expression_names"].tolist()) == head.expression_names
    person = head.personal(truth["identity"])
    camera = Camera(truth["focal_px"], truth["principal_point_px"], truth["distortion"])
    for k in range(0, len(truth["rotation"]), 40):
        matrix = Rotation.from_rotvec(truth["rotation"][k]).as_matrix()
        points_head = person.landmarks.of(person.vertices(truth["expression"][k]))[17:]
        pixels = project(camera, points_head @ matrix.T + truth["translation"][k])
        assert np.abs(np.asarray(pixels) - truth["landmarks"][k][17:]).max() < 0.01


def test_the_clip_has_a_frame_and_tracked_landmarks_for_every_truth(truth):
    frames = open_frames(sample("performance"))
    width, height = frames.image_size
    assert [width, height] == truth["image_size"].tolist()
    assert frames.announced_count == len(truth["landmarks"])
    records = list(read_landmark_file(sample("performance-landmarks")))
    assert [record.frame for record in records] == list(range(len(truth["landmarks"])))
    tracked = np.stack([record.landmarks.points for record in records])
    eyes = np.linalg.norm(truth["landmarks"][:, 45] - truth["landmarks"][:, 36], axis=1)
    error = np.linalg.norm(tracked - truth["landmarks"], axis=2)[:, 17:].mean(1) / eyes
    assert np.median(error) < 0.03
    assert error.max() < 0.12


def test_the_clip_shows_the_head_where_the_truth_says(head, truth):
    """Skin is redder than the room: around the nose tip of the truth the picture is skin."""
    for frame in open_frames(sample("performance")).iterate():
        if frame.index % 60:
            continue
        x, y = np.round(truth["landmarks"][frame.index, 30]).astype(int)
        patch = frame.picture[y - 8 : y + 9, x - 8 : x + 9].reshape(-1, 3).mean(0)
        assert patch[0] > 1.2 * patch[2]


def test_the_portrait_has_landmarks():
    (record,) = read_landmark_file(sample("astronaut-landmarks"))
    width, height = record.image_size
    assert ((record.landmarks.points > 0) & (record.landmarks.points < (width, height))).all()


def test_portraits_show_the_whole_face(head):
    camera, translation = portrait_view(head, (100, 140))
    pixels = to_pixels(camera, head.landmarks.of(head.neutral) + translation)
    assert ((pixels > 0) & (pixels < (99, 139))).all()
    assert camera_from_fov((100, 140), 20.0).principal_point_px == pytest.approx(camera.principal_point_px)
