"""What is behind the renders of Deep Energies: the photo around the face, without the face."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.deep_scenes import DEEP, IMAGE_SIZE, make_deep_scene, make_parameters
from tests.stereo_scenes import make_rig
from workbench.energies.deep import view_vertices
from workbench.errors import InputError
from workbench.geometry import write_rig
from workbench.landmarks.network_detector import MEAN_SHAPE, landmark_crop
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.surroundings import GREY, SIDE, photo_surroundings, plain_surroundings, seen_around
from workbench.networks import CropBox, crop_and_resize, seen_in_crop, to_crop
from workbench.planning import plan_of
from workbench.rendering import render
from workbench.tracking import FrameContext, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_programs import look
from workbench.tracking.deep_target import bundled_heat_maps, photo_landmarks

SKIN, WALL_LEFT, WALL_RIGHT = (220, 150, 120), (20, 90, 160), (40, 140, 30)
FACE_PX, MIDDLE = 120.0, (320.0, 240.0)


def make_photo(points: np.ndarray) -> np.ndarray:
    """A wall of two colours, and a round face of a third before it."""
    photo = np.empty((480, 640, 3), np.uint8)
    photo[:, :320], photo[:, 320:] = WALL_LEFT, WALL_RIGHT
    rows, columns = np.mgrid[:480, :640]
    middle = points.mean(axis=0)
    inside = np.hypot(columns - middle[0], rows - middle[1]) < 0.45 * np.ptp(points[:, 1])
    photo[inside] = SKIN
    return photo


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    """A frontal face of the detector's mean shape."""
    return FACE_PX * (MEAN_SHAPE - MEAN_SHAPE.mean(axis=0)) + np.array(MIDDLE)


def _landmarks(points):
    return Landmarks2D(points, np.ones(68), (640, 480))


def near(picture, colour, within: float = 25.0) -> np.ndarray:
    return np.abs(picture.astype(float) - colour).max(axis=-1) < within


# A part of a picture in a crop.


def part_of(box: CropBox, side: int) -> tuple[np.ndarray, np.ndarray]:
    """From a picture's pixels to those of a square of it, as `Surroundings` has it."""
    corners = np.asarray(to_crop(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), box, side))
    return (corners[1:] - corners[0]).T, corners[0]


def test_a_square_of_a_picture_in_its_own_crop_is_that_square():
    seen = np.random.default_rng(0).random((12, 12, 3))
    box = CropBox(np.array([40.0, 30.0]), np.float64(24.0), np.float64(0.3))
    np.testing.assert_allclose(seen_in_crop(seen, *part_of(box, 12), box, 12), seen, atol=1e-12)


def test_a_crop_through_a_square_is_the_crop_of_the_picture():
    """Two routes, exact where the picture is linear: through a wide square, or straight from the picture."""
    rows, columns = np.mgrid[:100, :120].astype(float)
    picture = np.stack([rows, columns, rows - 2.0 * columns], axis=-1)
    wide = CropBox(np.array([60.0, 50.0]), np.float64(60.0), np.float64(0.2))
    narrow = CropBox(np.array([57.0, 54.0]), np.float64(20.0), np.float64(-0.5))
    square = np.moveaxis(np.asarray(crop_and_resize(picture, wide, 30)), 0, -1)
    through = seen_in_crop(square, *part_of(wide, 30), narrow, 16)
    np.testing.assert_allclose(np.moveaxis(through, -1, 0), crop_and_resize(picture, narrow, 16), atol=1e-9)


def test_beyond_a_square_its_border_goes_on():
    seen = np.zeros((8, 8, 3))
    seen[:, -1] = [1.0, 0.5, 0.25]
    right = CropBox(np.array([40.0, 4.0]), np.float64(8.0), np.float64(0.0))
    shown = seen_in_crop(seen, np.eye(2), np.zeros(2), right, 4)
    np.testing.assert_allclose(shown, np.full((4, 4, 3), [1.0, 0.5, 0.25]))


# What a photo shows around a face.


def test_the_face_is_not_in_its_surroundings_and_what_is_around_it_is(points):
    around = photo_surroundings(make_photo(points), points)
    assert not near(around.picture, SKIN).any()
    columns = np.arange(SIDE)
    left, right = columns < SIDE // 2 - 16, columns > SIDE // 2 + 16
    assert near(around.picture, WALL_LEFT)[:, left].all()
    assert near(around.picture, WALL_RIGHT)[:, right].all()


def test_surroundings_are_twice_the_networks_crop_and_turn_with_it(points):
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    rolled = (points - MIDDLE) @ turn.T + MIDDLE
    around, crop = photo_surroundings(make_photo(rolled), rolled), landmark_crop(rolled)
    square = CropBox(crop.centre, 2.0 * crop.side, crop.roll)
    np.testing.assert_allclose(rolled @ around.matrix.T + around.origin, to_crop(rolled, square, SIDE), atol=1e-9)
    # Seen upright again, the wall's border runs straight down through the picture.
    upright = CropBox(np.array(MIDDLE), crop.side, np.float64(0.0))
    seen = np.asarray(seen_in_crop(around.picture.astype(float), around.matrix, around.origin, upright, 32))
    assert near(seen, WALL_LEFT)[:, :4].all()
    assert near(seen, WALL_RIGHT)[:, -4:].all()


def test_beyond_the_photo_its_border_goes_on(points):
    around = photo_surroundings(make_photo(points)[:, 200:440], points - [200.0, 0.0])
    assert near(around.picture, WALL_LEFT)[:, 0].all()
    assert near(around.picture, WALL_RIGHT)[:, -1].all()


def test_a_face_that_is_larger_than_the_photo_leaves_something_to_show(points):
    """Nothing but skin: what is around it is of that colour, too."""
    photo = np.full((60, 60, 3), SKIN, np.uint8)
    assert near(photo_surroundings(photo, points - np.array(MIDDLE) + 30.0).picture, SKIN).all()


def test_without_a_photo_or_a_face_surroundings_are_plain(points):
    """No face, too, is where landmarks coincide."""
    photo = make_photo(points)
    for picture, landmarks in ((None, _landmarks(points)), (photo, None), (photo, _landmarks(0.0 * points))):
        assert np.unique(seen_around(picture, landmarks).picture).tolist() == [GREY]


# Behind a render.


@pytest.fixture(scope="module")
def deep(head):
    return DeepFitter(head, plan_of(DEEP))


def test_a_render_shows_the_surroundings_beside_the_face_and_not_in_it(deep, head):
    truth = make_parameters(head, (5.0, 0.0, 0.0), (0.0, 0.0, 600.0))
    observation = make_deep_scene(deep, truth).observation()
    context = FrameContext(0, np.asarray(truth.identity), None, None)
    photo = np.empty((*IMAGE_SIZE[::-1], 3), np.uint8)
    photo[:] = WALL_LEFT
    plain = look(deep.scene(None), deep.views(observation, context)[0], truth)
    walled = look(deep.scene(None), deep.views(replace(observation, picture=photo), context)[0], truth)
    beside = cv2.erode(near(255.0 * np.asarray(plain.picture), GREY, 0.01).astype(np.uint8), np.ones((3, 3))) > 0
    assert 0.1 < beside.mean() < 0.9
    assert near(255.0 * np.asarray(walled.picture), WALL_LEFT, 3.0)[beside].all()  # painting over rounds its colours
    face = np.abs(np.asarray(plain.picture) - np.asarray(walled.picture)).max(axis=-1) == 0.0
    assert face.mean() > 0.3


def test_given_surroundings_are_taken_for_those_of_the_picture(deep, points):
    photo, landmarks = make_photo(points), _landmarks(points)
    around = seen_around(photo, landmarks)
    observation = FrameObservation(0, landmarks, (640, 480), picture=photo)
    context = FrameContext(0, deep.mean_identity(), None, None)
    made = deep.views(observation, context)[0].surroundings.picture
    np.testing.assert_array_equal(made, around.picture)
    given = replace(observation, surroundings=(plain_surroundings(),))
    assert np.unique(deep.views(given, context)[0].surroundings.picture).tolist() == [GREY]


def test_each_view_of_a_rig_has_its_own_and_their_number_is_checked(head, tmp_path, points):
    write_rig(make_rig(), tmp_path / "rig.toml")
    fitter = DeepFitter(head, plan_of(DEEP.changed(camera={"rig": str(tmp_path / "rig.toml")})))
    landmarks = _landmarks(points)
    plain = plain_surroundings()
    wall = plain._replace(picture=np.full_like(plain.picture, 7))
    observation = FrameObservation(0, landmarks, (640, 480), others=(landmarks,), surroundings=(plain, wall))
    context = FrameContext(0, fitter.mean_identity(), None, None)
    shown = [np.unique(view.surroundings.picture).tolist() for view in fitter.views(observation, context)]
    assert shown == [[GREY], [7]]
    with pytest.raises(InputError, match="surroundings of 1"):
        fitter.views(replace(observation, surroundings=(wall,)), context)


@pytest.mark.long
def test_before_its_surroundings_the_jaw_is_read_as_in_the_photo(deep, head):
    """A photo with a wall of two colours, else as the solver believes: before plain grey the jaw's points lie elsewhere
    than in the photo, before its surroundings hardly."""
    truth = make_parameters(head, (12.0, -6.0, 4.0), (10.0, -8.0, 600.0), {}, 8.0)
    context, scene = FrameContext(0, np.asarray(truth.identity), None, None), deep.scene(None)
    blank = make_deep_scene(deep, truth).observation()
    view = deep.views(blank, context)[0]
    wall = np.empty((*IMAGE_SIZE[::-1], 3), np.float32)
    wall[:, : IMAGE_SIZE[0] // 2], wall[:, IMAGE_SIZE[0] // 2 :] = np.divide((WALL_LEFT, WALL_RIGHT), 255.0)
    topology = scene.model.render.topology
    drawn = render(
        view_vertices(scene.model, view, truth), topology, view.camera, scene.albedo, view.light, wall, size=IMAGE_SIZE
    )
    photo = np.round(255.0 * np.clip(np.asarray(drawn.color), 0.0, 1.0)).astype(np.uint8)
    target = photo_landmarks(bundled_heat_maps(), photo, blank.landmarks).points
    seen = [
        look(scene, deep.views(shown, context)[0], truth).points for shown in (replace(blank, picture=photo), blank)
    ]
    before_photo, before_grey = (np.linalg.norm(target - each, axis=1)[:17].mean() for each in seen)
    assert before_grey > 1.0
    assert before_photo < 0.5 * before_grey
