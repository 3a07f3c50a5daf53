"""The 68 landmarks with the two pupils: the scheme, the detector that sees them, files, and the preset `gaze`."""

from dataclasses import replace

import numpy as np
import pytest

from workbench.config import preset
from workbench.errors import ConfigError, InputError
from workbench.face import GAZE_NAMES, in_scheme, landmark_model
from workbench.frames import open_frames
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.eyes import EyeDetector, bundled_eye_network
from workbench.landmarks.files import LandmarkRecord, read_landmark_file, write_landmark_file
from workbench.landmarks.network_detector import NetworkDetector
from workbench.landmarks.pupil_detector import PupilDetector
from workbench.landmarks.scheme import IBUG68
from workbench.landmarks.schemes import DENSE, IBUG68_PUPILS, PUPILS, detector_scheme, scheme_named, scheme_of_count
from workbench.pipeline import track
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.session import TuningSession, material_of_track
from workbench.session.knobs import changed_by, inert_among, value_of
from workbench.tracker import FaceTracker
from workbench.tracking import Track
from workbench.widgets import TuningPanel

SIZE = (640, 480)
FRAMES = (40, 43)
CONFIG = preset("gaze").changed(identity={"calibrate": False})


@pytest.fixture(scope="module")
def seeing_head(head):
    return in_scheme(head, IBUG68_PUPILS)


@pytest.fixture(scope="module")
def picture():
    return next(open_frames(sample("performance")).iterate(48)).picture


@pytest.fixture(scope="module")
def run(head, tmp_path_factory):
    config = preset("gaze").changed(identity={"window": 2, "frames": 2})
    return track(sample("performance"), tmp_path_factory.mktemp("gaze"), head, config, pictures=False, frames=FRAMES)


def looking(seeing_head, number=0, **weights):
    """The head before the camera, its eyes turned, seen without error."""
    tracker = FaceTracker(seeing_head, CONFIG)
    names = seeing_head.expression_names
    rest = tracker.fitter.neutral_observation(SIZE)
    expression = np.array([weights.get(name, 0.0) for name in names])
    moved = seeing_head.landmarks.of(seeing_head.vertices(expression) - seeing_head.vertices(0.0 * expression))
    # From the front a millimetre is so many pixels; the pupils move in depth by a tenth of one.
    landmarks = rest.landmarks
    corners = seeing_head.landmarks.of(seeing_head.neutral)[[36, 45], :2]
    scale = np.linalg.norm(np.diff(landmarks.points[[36, 45]], axis=0)) / np.linalg.norm(np.diff(corners, axis=0))
    return replace(rest, index=number, landmarks=replace(landmarks, points=landmarks.points + scale * moved[:, :2]))


def gaze_units(fit, names):
    return {name: fit.expression[names.index(name)] for name in GAZE_NAMES}


def found_face(picture):
    return NetworkDetector().detect_faces(picture, "quick")[0].box


class TestScheme:
    def test_it_is_the_beginning_of_the_dense_one(self):
        assert len(IBUG68_PUPILS) == 70
        assert IBUG68_PUPILS.point_names == DENSE.point_names[:70]
        assert IBUG68_PUPILS.mirror == DENSE.mirror[:70]
        assert IBUG68_PUPILS.groups["irises"] == IBUG68_PUPILS.groups["pupils"] == PUPILS
        assert IBUG68_PUPILS.groups["inner"] == IBUG68.groups["inner"]
        assert not IBUG68_PUPILS.has_covariances

    def test_it_is_known_by_its_count_and_its_name(self):
        assert scheme_of_count(70) is scheme_named("ibug68+pupils") is IBUG68_PUPILS

    @pytest.mark.parametrize("name", ["network", "network+pupils", "dense"])
    def test_a_detector_answers_the_points_of_its_scheme(self, name, picture):
        assert make_detector(name).align(picture, found_face(picture)).scheme is detector_scheme(name)

    def test_a_head_has_the_pupils_of_the_dense_one_and_its_eyes_turn(self, head, seeing_head):
        dense = in_scheme(head, DENSE)
        assert np.array_equal(seeing_head.landmarks.of(dense.neutral), dense.landmarks.of(dense.neutral)[:70])
        assert np.array_equal(in_scheme(dense, IBUG68_PUPILS).landmarks.vertices, seeing_head.landmarks.vertices)
        assert np.array_equal(in_scheme(seeing_head, DENSE).landmarks.vertices, dense.landmarks.vertices)
        assert np.array_equal(in_scheme(seeing_head, IBUG68).landmarks.vertices, head.landmarks.vertices)
        assert seeing_head.fingerprint() == dense.fingerprint()
        np.testing.assert_array_equal(landmark_model(seeing_head).gaze, landmark_model(dense).gaze)


class TestDetector:
    def test_it_adds_the_pupils_to_what_the_network_detector_says(self, picture):
        few, more = (make_detector(name).align(picture, found_face(picture)) for name in ("network", "network+pupils"))
        np.testing.assert_array_equal(more.points[:68], few.points)
        np.testing.assert_array_equal(more.confidence[:68], few.confidence)
        eyes = EyeDetector().see(picture, few.points)
        np.testing.assert_allclose(more.points[68:], eyes.points[:, 0], atol=0.5)
        assert more.covariance is None
        assert (more.confidence[68:] > 0.8).all()

    def test_pupils_behind_shut_lids_have_no_confidence(self, picture):
        network = bundled_eye_network()
        weight, bias = network.head.weight.at[-1].set(0.0), network.head.bias.at[-1].set(-30.0)
        shut = PupilDetector(replace(network, head=replace(network.head, weight=weight, bias=bias)))
        seen = shut.align(picture, found_face(picture))
        assert (seen.confidence[68:] < 0.02).all()
        assert (seen.confidence[:68] > 0.0).any()


class TestFit:
    @pytest.mark.parametrize("units", [("eyeLookOutLeft", "eyeLookInRight"), ("eyeLookUpLeft", "eyeLookUpRight")])
    def test_eyes_turn_to_where_the_pupils_are(self, seeing_head, units):
        (fit,) = FaceTracker(seeing_head, CONFIG).push(looking(seeing_head, **dict.fromkeys(units, 0.5)))
        found = gaze_units(fit, seeing_head.expression_names)
        assert all(0.35 < found.pop(unit) < 0.6 for unit in units)
        assert max(found.values()) < 0.1

    def test_landmarks_without_pupils_are_told(self, head, run, tmp_path):
        result = track(sample("performance-landmarks"), tmp_path, head, CONFIG, pictures=False, frames=FRAMES)
        (note,) = result.notes
        assert "These landmarks have no pupils: eyes do not turn" in note
        assert "detector network+pupils or dense" in note
        assert run.notes == ()

    def test_pupils_that_nobody_sees_leave_the_gaze_where_it_was(self, seeing_head):
        names = seeing_head.expression_names
        first = looking(seeing_head, eyeLookOutLeft=0.5, eyeLookInRight=0.5)
        back = looking(seeing_head, number=1)
        hidden = np.r_[np.ones(68), 0.0, 0.0]
        held = replace(back, landmarks=replace(back.landmarks, confidence=hidden))
        before, after = (
            gaze_units(fit, names)["eyeLookOutLeft"] for fit in FaceTracker(seeing_head, CONFIG).fit_all([first, held])
        )
        assert before > 0.35
        assert after == pytest.approx(before, abs=0.02)
        *_, free = FaceTracker(seeing_head, CONFIG).fit_all([first, back])
        assert gaze_units(free, names)["eyeLookOutLeft"] < 0.1

    def test_every_stage_holds_the_gaze_of_the_frame_before(self, seeing_head):
        """Not that of the stage before, along which it would drift from stage to stage."""
        last = CONFIG.stages[-1]
        stages = [*CONFIG.stages, *(last.model_copy(update={"name": f"again {number}"}) for number in range(4))]
        config = CONFIG.changed(stages=[stage.model_dump() for stage in stages])
        first = looking(seeing_head, eyeLookOutLeft=0.5, eyeLookInRight=0.5)
        back = looking(seeing_head, number=1)
        held = replace(back, landmarks=replace(back.landmarks, confidence=np.r_[np.ones(68), 0.0, 0.0]))
        before, after = FaceTracker(seeing_head, config).fit_all([first, held])
        degrees = np.linalg.norm(landmark_model(seeing_head).gaze, axis=0)
        omega = dict(zip(config.terms, config.factors(last), strict=True))["gaze"]
        expected = omega * np.sum((degrees * (after.expression - before.expression)) ** 2)
        assert after.energies[-1, config.terms.index("gaze")] == pytest.approx(expected, rel=1e-6)

    def test_a_pupil_that_is_half_sure_is_held_a_little(self, seeing_head):
        """Between both: the surer the pupil, the more of a glance is followed."""
        names = seeing_head.expression_names
        first, glance = looking(seeing_head), looking(seeing_head, number=1, eyeLookOutLeft=0.5, eyeLookInRight=0.5)

        def followed(confidence):
            seen = replace(glance.landmarks, confidence=np.r_[np.ones(68), confidence, confidence])
            *_, fit = FaceTracker(seeing_head, CONFIG).fit_all([first, replace(glance, landmarks=seen)])
            return gaze_units(fit, names)["eyeLookOutLeft"]

        amounts = [followed(confidence) for confidence in (0.0, 0.2, 0.5, 1.0)]
        assert amounts == sorted(amounts)
        assert amounts[0] < 0.02 < amounts[-1] - amounts[1]

    def test_landmarks_without_pupils_are_refused_under_a_head_that_has_them(self, head, seeing_head):
        with pytest.raises(InputError, match="frame 0 are the 70 of 'ibug68\\+pupils', those of the face model the 68"):
            FaceTracker(head, CONFIG).push(looking(seeing_head))

    def test_deep_energies_names_the_detector_it_can_use(self):
        with pytest.raises(ConfigError, match=r'the 70 of \'ibug68\+pupils\'; set landmarks\.detector = "network"'):
            plan_of(preset("deep"), IBUG68_PUPILS)


class TestKnobs:
    def test_the_weights_of_further_points_have_sliders_where_the_detector_sees_them(self):
        further = {"group.irises", "group.dense"}
        assert further & inert_among(preset("joint"), further) == further
        assert inert_among(preset("gaze"), further) == {"group.dense"}
        assert inert_among(preset("dense"), further) == set()
        assert [value_of(preset("gaze"), path) for path in sorted(further)] == [1.0, 3.0]

    @pytest.mark.parametrize("path", ["group.dense", "group.irises", "group.right_eye"])
    def test_moving_one_leaves_what_the_others_weigh(self, path):
        """Groups overlap, and later ones win: the irises keep theirs, and further points do not follow an eye's 68."""
        before = preset("dense")
        after = before.changed(**changed_by(before, path, 0.5))
        group = set(DENSE.groups[path.removeprefix("group.")])
        moved = {"group.irises": group, "group.dense": group - set(DENSE.groups["irises"])}
        moved = moved.get(path, {point for point in group if point < 68})
        weights = zip(before.point_weights(DENSE), after.point_weights(DENSE), strict=True)
        for point, (old, new) in enumerate(weights):
            assert new == (0.5 if point in moved else old)


class TestFiles:
    def test_a_track_and_its_landmarks_say_their_scheme(self, run):
        stored = Track.load(run.folder / "track.npz")
        assert stored.meta["scheme"] == "ibug68+pupils"
        assert stored[0].scheme is IBUG68_PUPILS
        assert stored.covariance.shape == (len(stored), 0, 2, 2)
        assert set(GAZE_NAMES) <= set(stored.expression_names)
        assert next(read_landmark_file(run.folder / "landmarks.csv")).landmarks.scheme is IBUG68_PUPILS

    @pytest.mark.parametrize("suffix", [".csv", ".json"])
    def test_landmark_files_hold_them(self, suffix, seeing_head, tmp_path):
        landmarks = looking(seeing_head).landmarks
        write_landmark_file(tmp_path / f"seventy{suffix}", [LandmarkRecord(0, "a", landmarks, SIZE)])
        (read,) = read_landmark_file(tmp_path / f"seventy{suffix}")
        np.testing.assert_allclose(read.landmarks.points, landmarks.points, atol=6e-4)

    @pytest.mark.long
    def test_a_session_fits_the_same(self, run, head):
        config = preset("gaze").changed(identity={"window": 2, "frames": 2})
        session = TuningSession(head, material_of_track(run.track), config)
        assert np.array_equal(session.fit_clip().projected, run.track.projected)
        assert np.array_equal(session.diagnose(1).fit.projected, session.track[1].projected)

    @pytest.mark.long
    def test_the_panel_shows_them(self, run, head):
        config = preset("gaze").changed(identity={"window": 2, "frames": 2})
        panel = TuningPanel(TuningSession(head, material_of_track(run.track), config))
        assert panel.wait_idle(300)
        panel.go(1)
        assert panel.wait_idle(300)
        assert panel.fit.observed.shape == (70, 2)
        panel.turn("group.irises", 1.0)
        assert panel.wait_idle(300)
        assert "irises" not in panel.session.config.landmarks.weights
        panel.close()
