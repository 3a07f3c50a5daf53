"""`workbench.fit`: one picture in memory, with the numbers of a run."""

import numpy as np
import pytest

import workbench
from workbench import one_picture
from workbench.config import preset
from workbench.errors import ConfigError, InputError
from workbench.landmarks.files import LandmarkRecord, write_landmark_file
from workbench.landmarks.observations import Landmarks2D
from workbench.pictures.mesh import to_pixels
from workbench.samples import sample
from workbench.tracking.face_it_fitter import FaceItFitter
from workbench.tracking.records import ARRAYS, stack_fits

KEPT = [name for name in ARRAYS if name not in ("milliseconds", "source")]
"""What may not differ from a run; it took another time, and its landmarks came from elsewhere."""


@pytest.fixture(scope="module")
def portrait():
    return workbench.read_picture(sample("astronaut"))


@pytest.fixture(scope="module")
def points():
    (record,) = workbench.read_landmark_file(sample("astronaut-landmarks"))
    return record.landmarks


@pytest.fixture(scope="module")
def found(portrait):
    return workbench.fit(portrait)


def arrays(fit) -> dict[str, np.ndarray]:
    columns = stack_fits([fit])
    return {name: columns[name] for name in KEPT}


def assert_the_same(fit, other):
    for name, value in arrays(fit).items():
        np.testing.assert_array_equal(value, arrays(other)[name], err_msg=name)


def test_a_picture_gives_the_numbers_of_a_run(found, head, tmp_path):
    run = workbench.track(sample("astronaut"), tmp_path, head, workbench.preset("joint"), pictures=False)
    assert_the_same(found.frame, run.track[0])
    assert found.frame.source == run.track[0].source == "detected"


@pytest.mark.parametrize("preset", ["face-it", pytest.param("deep", marks=pytest.mark.long)])
def test_with_given_landmarks_too_in_both_systems(preset, portrait, points, head, tmp_path):
    config = workbench.preset(preset)
    config = config.changed(deep={"energy": "points"}) if preset == "deep" else config
    given = sample("astronaut-landmarks")
    run = workbench.track(sample("astronaut"), tmp_path, head, config, pictures=False, landmarks=given)
    fit = workbench.fit(portrait, landmarks=points, config=config)
    assert_the_same(fit.frame, run.track[0])


def test_what_was_fitted_before_leaves_no_trace(found, portrait, points):
    workbench.fit(portrait[:, ::-1])
    assert_the_same(workbench.fit(portrait).frame, found.frame)


def test_the_record_names_its_numbers(found, head):
    assert found.yaw_pitch_roll == pytest.approx(tuple(found.frame.angles_deg))
    assert list(found.weights) == list(head.expression_names)
    assert found.weights["mouthSmileLeft"] > 0.2
    assert found.error_percent < 3.0
    assert 0.0 < found.error_px < 3.0
    assert found.failure == ""
    np.testing.assert_array_equal(found.landmarks.points, found.frame.observed)


def test_the_mesh_before_the_camera_projects_onto_the_landmarks(found):
    tip = found.model.landmarks.of(found.vertices_camera)[30]
    np.testing.assert_allclose(to_pixels(found.frame.camera, tip[None])[0], found.frame.projected[30], atol=1e-6)
    assert found.vertices_head.shape == found.vertices_camera.shape == (found.triangles.max() + 1, 3)
    assert np.abs(found.vertices_head.mean(axis=0)).max() < 100.0 < found.vertices_camera[:, 2].min()


@pytest.mark.long
def test_with_pupils_weights_mesh_and_figure_are_of_the_eyes_too(portrait, points):
    pupils = [points.points[eye].mean(axis=0) for eye in (slice(36, 42), slice(42, 48))]
    fit = workbench.fit(portrait, landmarks=np.vstack([points.points, pupils]), config="gaze")
    assert len(fit.weights) == 52
    assert "eyeLookInLeft" in fit.weights
    assert fit.vertices_camera.shape == (fit.triangles.max() + 1, 3)
    places = fit.model.landmarks.of(fit.vertices_camera)
    np.testing.assert_allclose(to_pixels(fit.frame.camera, places)[17:], fit.frame.projected[17:], atol=1e-6)
    assert len(fit.figure().axes) == 2


def test_landmarks_come_as_a_record_a_file_or_an_array(portrait, points, tmp_path):
    path = tmp_path / "points.pts"
    write_landmark_file(path, [LandmarkRecord(0, "points", points, points.image_size)])
    record = workbench.fit(portrait, landmarks=points)
    assert_the_same(
        workbench.fit(str(sample("astronaut")), landmarks=sample("astronaut-landmarks")).frame, record.frame
    )
    array = workbench.fit(portrait, landmarks=points.points)
    assert array.landmarks.confidence.min() == 1.0
    file = workbench.fit(sample("astronaut"), landmarks=str(path))
    assert file.frame.image_size == (512, 512)
    assert file.yaw_pitch_roll == pytest.approx(array.yaw_pitch_roll, abs=0.02)


def test_the_figure_shows_points_and_mesh_under_their_numbers(found):
    figure = found.figure()
    left, right = (axis.get_title() for axis in figure.axes)
    assert left == f"error {found.error_px:.1f} px, {found.error_percent:.1f} % of the eye distance"
    assert right.startswith("yaw")
    shown = [axis.images[0].get_array() for axis in figure.axes]
    assert shown[0].shape == shown[1].shape
    assert (shown[0] != shown[1]).any()


def test_detector_and_solver_are_made_once(portrait, points, monkeypatch):
    made = []
    make = one_picture.FaceTracker

    def counted(*arguments, **options):
        made.append(arguments)
        return make(*arguments, **options)

    monkeypatch.setattr(one_picture, "FaceTracker", counted)
    one_picture._tracker.cache_clear()
    for _ in range(2):
        workbench.fit(portrait, landmarks=points)
    assert len(made) == 1
    one_picture._tracker.cache_clear()


def test_a_fit_that_failed_does_not_spoil_the_next(portrait, points, monkeypatch):
    expected = workbench.fit(portrait, landmarks=points)

    def broken(*_):
        raise InputError("broken")

    with monkeypatch.context() as patch:
        patch.setattr(FaceItFitter, "calibrate", broken)
        with pytest.raises(InputError, match="broken"):
            workbench.fit(portrait, landmarks=points)
    assert_the_same(workbench.fit(portrait, landmarks=points).frame, expected.frame)


def test_the_order_of_landmark_weights_counts(portrait, points):
    """Later entries overrule earlier ones, so that these two configurations are not equal."""
    widely_last, jaw_last = (
        workbench.preset("joint").changed(landmarks={"weights": weights})
        for weights in ({"jaw": 0.1, "all": 1.0}, {"all": 1.0, "jaw": 0.1})
    )
    fits = [workbench.fit(portrait, landmarks=points, config=config) for config in (widely_last, jaw_last)]
    assert fits[0].frame.expression != pytest.approx(fits[1].frame.expression, abs=1e-6)


class Blind:
    """A detector that sees no face."""

    name = "blind"

    def detect_faces(self, picture, effort="full"):
        return []

    def align(self, picture, box): ...

    def refine(self, picture, points): ...


def test_a_picture_without_a_face_is_refused_in_one_sentence(portrait):
    with pytest.raises(InputError, match="No face was found by the detector 'blind'; turn the picture"):
        workbench.fit(portrait, detector=Blind())
    named = preset("joint").changed(landmarks={"face": (20, 30)})
    with pytest.raises(InputError, match="No face was found at 20,30; name a point"):
        workbench.fit(portrait, config=named, detector=Blind())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (np.zeros((4, 4, 3)), "uint8.*got float64"),
        (np.zeros((4, 4), np.uint8), r"shape \(4, 4\)"),
        (np.zeros((0, 4, 3), np.uint8), r"shape \(0, 4, 3\)"),
        (np.zeros((4, 4, 4), np.uint8), r"shape \(4, 4, 4\)"),
        ("no-such-picture.png", "no-such-picture.png"),
    ],
)
def test_what_is_no_picture_is_refused(given, message):
    with pytest.raises(InputError, match=message):
        workbench.fit(given)


def test_what_does_not_belong_to_one_picture_is_refused(portrait, points, tmp_path):
    with pytest.raises(InputError, match="68"):
        workbench.fit(portrait, landmarks=points.points[:60])
    with pytest.raises(InputError, match="512 × 512 pixels, the picture has 512 × 400"):
        workbench.fit(portrait[:400], landmarks=points)
    with pytest.raises(InputError, match="one face in one picture, it has 240 frames"):
        workbench.fit(portrait, landmarks=sample("performance-landmarks"))
    write_landmark_file(tmp_path / "none.csv", [LandmarkRecord(0, "points", None, points.image_size)])
    with pytest.raises(InputError, match=r"none\.csv has no face in its frame"):
        workbench.fit(portrait, landmarks=tmp_path / "none.csv")
    for nowhere in (np.zeros((68, 2)), Landmarks2D(np.full((68, 2), 5.0), np.ones(68), points.image_size)):
        with pytest.raises(InputError, match="All landmarks coincide"):
            workbench.fit(portrait, landmarks=nowhere)
    with pytest.raises(InputError, match="no neighbours in time"):
        workbench.fit(portrait, config=workbench.preset("joint").changed(infill={"method": "linear"}))
    with pytest.raises(InputError, match="one view"):
        workbench.fit(portrait, config=workbench.preset("deep").changed(camera={"rig": "rig.toml"}))
    with pytest.raises(ConfigError, match="no preset"):
        workbench.fit(portrait, config="no-such-preset")
