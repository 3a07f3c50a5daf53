"""A model without an identity basis, as a folder of OBJ files is: no identity is calibrated, and all else works."""

import numpy as np
import pytest

import workbench
from tests.live_pictures import sample_frames
from tests.other_heads import with_one_identity
from tests.scenes import make_scene, turning_clip
from workbench.config import DEFAULT_PRESET, preset
from workbench.errors import InputError
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord
from workbench.session import TuningSession
from workbench.session.live import LiveSession
from workbench.tracker import FaceTracker

FRAMES = 12


@pytest.fixture(scope="module")
def one(head):
    return with_one_identity(head)


@pytest.fixture(scope="module")
def clip(one):
    return turning_clip(one, FRAMES, -10.0)


@pytest.fixture(scope="module")
def session(one, clip):
    return TuningSession(one, clip)


def test_it_is_tracked_with_the_default_preset(one, clip, tmp_path):
    with LandmarkCsvWriter(tmp_path / "clip.csv", confidence=False) as writer:
        for seen in clip.observations:
            writer.write(LandmarkRecord(seen.index, "", seen.landmarks, seen.image_size))
    config = preset(DEFAULT_PRESET)
    result = workbench.track(tmp_path / "clip.csv", tmp_path / "run", one, config, pictures=False)
    assert result.summary["reprojection_error"]["all_68_percent_of_eye_distance"]["mean"] < 1.0


def test_its_frames_wait_for_no_calibration(one):
    tracker = FaceTracker(one, preset(DEFAULT_PRESET))
    assert len(tracker.push(make_scene(one).observation())) == 1


def test_a_session_fits_and_sweeps_it_alike(session):
    swept = session.sweep("weights.tau=0.1,1", objectives=["error"])
    assert swept.means("error")[0] == pytest.approx(session.metrics()["all_68_percent_mean"], abs=1e-3)


def test_a_diagnosis_doubts_neither_its_face_nor_the_lens_by_other_faces(session):
    found = {reason.code for reason in session.diagnose(3).reasons}
    assert not found & {"wrong_identity", "wrong_focal"}


def test_deep_energies_calibrates_no_shape_either(one):
    fitter = FaceTracker(one, preset("deep-points")).fitter
    seen = [fitter.neutral_observation((640, 480))]
    assert fitter.calibrate(seen, 1).identity.shape == (0,)


def test_deep_energies_with_the_models_colours_calibrates_nothing(one):
    config = preset("deep-points").changed(deep={"appearance": "model"})
    assert not FaceTracker(one, config).fitter.calibrates


def test_live_its_shape_is_the_mean_face_and_a_neutral_face_changes_nothing(one):
    session = LiveSession(one)
    with pytest.raises(InputError, match="one-identity has no identity basis"):
        session.calibrate_neutral()


def test_live_it_is_ready_before_the_first_frame(one):
    session = LiveSession(one)
    session.warm_up()
    assert np.isfinite(session.step(sample_frames(1)[0]).fit.expression).all()
