"""Pictures of a Deep Energies solve: the film strip of its stages, and heat maps of photo and render side by side."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.stereo_scenes import make_rig, make_stereo_scene
from workbench.config import Config, preset
from workbench.errors import InputError
from workbench.frames import open_frames, read_picture
from workbench.geometry import write_rig
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.observations import Landmarks2D
from workbench.pictures import heat_map_pair, stage_strip, write_stage_strip
from workbench.pictures.deep_strip import (
    APART,
    CAPTION,
    FOOTER,
    GAP,
    HEAT_PANEL,
    PANEL,
    SEEN_IN_PHOTO,
    SEEN_IN_RENDER,
)
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_target import bundled_heat_maps, photo_landmarks
from workbench.tracking.fitting import FrameContext
from workbench.tracking.observation import FrameObservation

FRAME = 0


def short(energy: str, **changed) -> Config:
    """A solve from too far away, two stages only, with the model's own colours."""
    stages = [stage.model_copy(update={"limit": 6}) for stage in preset("deep").stages[:2]]
    deep = {"energy": energy, "appearance": "model", "distance_mm": 550.0, "network": "heat-maps"}
    return preset("deep").changed(
        deep=deep, stages=[stage.model_dump() for stage in stages], identity={"calibrate": False}, **changed
    )


@pytest.fixture(scope="module")
def photo() -> np.ndarray:
    return next(iter(open_frames(sample("performance")).iterate(FRAME))).picture


@pytest.fixture(scope="module")
def observation(photo) -> FrameObservation:
    detected = next(iter(read_landmark_file(sample("performance-landmarks")))).landmarks
    seen = photo_landmarks(bundled_heat_maps(), photo, detected)
    return FrameObservation(FRAME, seen, seen.image_size, picture=photo)


def solved(head, energy, observation, **changed):
    """Everything that a picture of the solve takes after the photo."""
    fitter = DeepFitter(head, plan_of(short(energy, **changed)))
    context = FrameContext(0, fitter.mean_identity(), None, None)
    return fitter, fitter.solve(fitter.problem(observation, context))


@pytest.fixture(scope="module")
def deep(head, observation):
    return solved(head, "deep", observation)


@pytest.fixture(scope="module")
def points(head, observation):
    return solved(head, "points", observation)


def panels(strip: np.ndarray, count: int) -> list[np.ndarray]:
    """The pictures of a strip of one row, without their captions."""
    lefts = [GAP + k * (PANEL + GAP) for k in range(count)]
    return [strip[GAP : GAP + PANEL, left : left + PANEL] for left in lefts]


def where(picture: np.ndarray, color: tuple[int, int, int], tolerance: int = 40) -> np.ndarray:
    return np.abs(picture.astype(int) - color).max(axis=2) <= tolerance


def test_a_strip_shows_photo_start_stages_and_result_in_one_row_that_fits_a_small_screen(photo, deep):
    strip = stage_strip(photo, *deep)
    assert strip.dtype == np.uint8
    assert strip.shape == (2 * GAP + PANEL + CAPTION + FOOTER, 5 * (PANEL + GAP) + GAP, 3)
    assert strip.shape[1] <= 1366


def test_a_stage_draws_the_render_over_the_photo_with_its_landmarks_and_brings_them_together(photo, deep):
    shown, start, _, last, result = panels(stage_strip(photo, *deep), 5)
    for marked in (start, last):
        assert where(marked, SEEN_IN_RENDER).sum() > 68
        assert where(marked, SEEN_IN_PHOTO).sum() > 68
    assert where(start, APART, 10).sum() > 2 * where(last, APART, 10).sum()
    assert not where(shown, SEEN_IN_RENDER).any()
    assert not where(result, SEEN_IN_RENDER).any()
    # Beside the faces all panels show the same square of the photo, and the face covers it.
    corner = (slice(20), slice(20))
    assert np.array_equal(start[corner], shown[corner])
    middle = (slice(110, 150), slice(110, 150))
    assert np.abs(result[middle].astype(int) - shown[middle]).mean() > 5.0


def test_rings_lie_where_the_photo_has_its_landmarks(photo, points):
    place = np.rint(points[1].problem.observation.landmarks.points[8]).astype(int)
    picture = np.zeros_like(photo)
    cv2.circle(picture, place.tolist(), 3, (255, 255, 255), -1)
    shown, start = panels(stage_strip(picture, *points), 5)[:2]
    bright = np.argwhere(shown.min(axis=2) > 128).mean(axis=0)
    chin = np.argwhere(where(start, SEEN_IN_PHOTO, 90)).astype(float)
    assert np.linalg.norm(chin - bright, axis=1).min() < 5.0
    assert abs(chin[:, 0].max() - bright[0]) < 6.0  # the lowest ring


def test_preselected_points_make_a_strip_but_no_heat_maps(photo, points):
    assert stage_strip(photo, *points).shape[1] <= 1366
    with pytest.raises(InputError, match=r"it has them only if the network found a face, deep\.energy is"):
        heat_map_pair(photo, points[1])


def test_heat_maps_of_photo_and_render_stand_above_each_other_and_are_hot_at_their_landmarks(photo, deep):
    page = heat_map_pair(photo, deep[1], points=(36, 30))
    step = HEAT_PANEL + CAPTION + GAP
    assert page.shape == (2 * step + GAP + FOOTER, 2 * (HEAT_PANEL + GAP) + GAP, 3)
    middle = HEAT_PANEL // 2
    for row in range(2):
        for column in range(2):
            top, left = GAP + row * step, GAP + column * (HEAT_PANEL + GAP)
            panel = page[top : top + HEAT_PANEL, left : left + HEAT_PANEL].astype(int)
            warm = panel[..., 0] - panel[..., 2]
            near = warm[middle - 25 : middle + 25, middle - 25 : middle + 25]
            assert near.max() > 60
            assert np.abs(warm[:30, :30]).max() < 10  # grey where the landmark is not


def test_strips_are_written_as_pictures_whole_or_not_at_all(photo, points, tmp_path):
    strip = stage_strip(photo, *points)
    write_stage_strip(tmp_path / "new" / "strip.png", photo, *points)
    assert np.array_equal(read_picture(tmp_path / "new" / "strip.png"), strip)
    write_stage_strip(tmp_path / "strip.jpg", photo, *points)
    assert np.abs(read_picture(tmp_path / "strip.jpg").astype(int) - strip).mean() < 3.0
    with pytest.raises(InputError, match="pictures are written as"):
        write_stage_strip(tmp_path / "strip.gif", photo, *points)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "strip.jpg"]


def test_each_view_of_a_rig_has_its_strip_also_one_that_saw_no_face(head, tmp_path):
    rig = make_rig()
    write_rig(rig, tmp_path / "rig.toml")
    scene = make_stereo_scene(head, rig)
    size = rig.views[0].image_size
    seen = Landmarks2D(scene.points[0, 0], np.ones(68), size)
    observation = FrameObservation(0, seen, size, others=(None,))
    config = short("points", camera={"rig": str(tmp_path / "rig.toml")})
    fitter = DeepFitter(head, plan_of(config))
    context = FrameContext(0, fitter.mean_identity(), None, None)
    given = fitter, fitter.solve(fitter.problem(observation, context))
    picture = np.full((size[1], size[0], 3), 90, np.uint8)
    first, second = (panels(stage_strip(picture, *given, view=view), 5)[3] for view in (0, 1))
    assert where(first, SEEN_IN_PHOTO).any()
    assert not where(second, SEEN_IN_PHOTO).any()
    assert where(second, SEEN_IN_RENDER).any()
    with pytest.raises(InputError, match="has 2 views, counted from 0; got view 2"):
        stage_strip(picture, *given, view=2)


def test_a_failed_solve_says_so(photo, head, observation):
    good = observation.landmarks
    wild = replace(good, points=good.points + np.where(np.arange(68) < 17, 60.0, 0.0)[:, None])
    given = solved(head, "points", replace(observation, landmarks=wild))
    assert given[0].record(given[1]).failure
    caption = stage_strip(photo, *given)[GAP + PANEL : GAP + PANEL + CAPTION]
    assert where(caption[:, -PANEL:], APART, 60).any()
    assert not where(caption[:, :PANEL], APART, 60).any()
