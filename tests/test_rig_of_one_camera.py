"""A rig in the configuration of one camera's clip: its first view is the lens, whatever its file holds by now."""

import numpy as np
import pytest

from tests.scenes import IMAGE_SIZE
from tests.stereo_scenes import make_rig, make_stereo_scene
from workbench.config import preset
from workbench.errors import ConfigError
from workbench.geometry import write_rig
from workbench.landmarks.observations import Landmarks2D
from workbench.learning.keys import key_of
from workbench.learning.learnable import start_of
from workbench.objectives import read_sum
from workbench.session import Material, TuningSession, diagnosing
from workbench.session.material import PictureStore
from workbench.sweeps import ClipSolver, SweptClip, in_first_view, read_axis
from workbench.sweeps.acting import check_axis
from workbench.sweeps.results import result_key
from workbench.tracking import FrameObservation

FRAMES = 24
DISTANCE_MM = 350.0
TRUE_FOV_DEG = 60.0
WRONG_FOV_DEG = 18.0


def write(fov_deg, path):
    write_rig(make_rig(distance_mm=DISTANCE_MM, fov_deg=fov_deg), path)


@pytest.fixture
def rig(tmp_path):
    """A rig file of a wrong lens."""
    path = tmp_path / "rig.toml"
    write(WRONG_FOV_DEG, path)
    return path


@pytest.fixture
def config(rig):
    return preset("joint").changed(camera={"rig": str(rig)})


@pytest.fixture(scope="module")
def frames(head):
    """What the first camera sees of a head nearby, with noise."""
    rig = make_rig(distance_mm=DISTANCE_MM, fov_deg=TRUE_FOV_DEG)
    points = make_stereo_scene(head, rig, frames=FRAMES, sliding=True, seed=3).points[0]
    points = points + np.random.default_rng(0).normal(0.0, 0.3, points.shape)
    return tuple(
        FrameObservation(k, Landmarks2D(each, np.ones(68), IMAGE_SIZE), IMAGE_SIZE) for k, each in enumerate(points)
    )


def session_on(head, frames, config):
    return TuningSession(head, Material("clip", frames, PictureStore(None, [IMAGE_SIZE] * FRAMES), False), config)


def test_a_sweeps_result_belongs_to_what_the_rig_holds(config, rig):
    before = result_key(config, "clip", [range(3)], ["error"], "head")
    write(TRUE_FOV_DEG, rig)
    assert result_key(config, "clip", [range(3)], ["error"], "head") != before


def test_a_sweeps_result_belongs_to_a_rig_under_any_name_of_its_file(config, rig, monkeypatch):
    monkeypatch.chdir(rig.parent)
    same = config.changed(camera={"rig": rig.name})
    keys = {result_key(each, "clip", [range(3)], ["error"], "head") for each in (config, same)}
    assert len(keys) == 1


def test_a_tuning_goes_on_only_with_the_same_rig(head, frames, config, rig):
    clip, error = SweptClip("clip", "digest", frames, False), read_sum("error")
    before = key_of(config, clip, head, error)
    write(TRUE_FOV_DEG, rig)
    assert key_of(config, clip, head, error) != before


def test_a_tuning_goes_on_with_a_rig_under_any_name_of_its_file(head, frames, config, rig, monkeypatch):
    monkeypatch.chdir(rig.parent)
    same = config.changed(camera={"rig": rig.name})
    clip, error = SweptClip("clip", "digest", frames, False), read_sum("error")
    assert key_of(same, clip, head, error) == key_of(config, clip, head, error)


def test_a_solver_calibrates_anew_with_an_edited_rig(head, frames, config, rig):
    clip, solver = SweptClip("clip", "digest", frames, False), ClipSolver(head)
    solver.fits([config], clip, clip.shots)
    write(TRUE_FOV_DEG, rig)
    (again,), (fresh,) = (each.fits([config], clip, clip.shots) for each in (solver, ClipSolver(head)))
    np.testing.assert_array_equal(again.translation, fresh.translation)


def test_a_session_calibrates_anew_with_an_edited_rig(head, frames, config, rig):
    session = session_on(head, frames, config)
    session.fit_clip()
    write(TRUE_FOV_DEG, rig)
    np.testing.assert_array_equal(session.fit_clip().identity, session_on(head, frames, config).fit_clip().identity)


def test_a_session_fits_a_frame_with_an_edited_rig(head, frames, config, rig):
    session = session_on(head, frames, config)
    session.fit_frame(5)
    write(TRUE_FOV_DEG, rig)
    fresh = session_on(head, frames, config).fit_frame(5)
    np.testing.assert_array_equal(session.fit_frame(5).translation, fresh.translation)


def test_a_diagnosis_refers_to_the_shot_through_an_edited_rig(head, frames, config, rig, monkeypatch):
    references, make = [], diagnosing.reference_of
    monkeypatch.setattr(diagnosing, "reference_of", lambda *given: references.append(make(*given)) or references[-1])
    session = session_on(head, frames, config)
    session.diagnose(5)
    write(TRUE_FOV_DEG, rig)
    for _ in range(2):
        session.diagnose(5)
    assert len(references) == 2


@pytest.mark.parametrize(
    "axis",
    [
        "camera.fov_deg=30,40",
        "camera.fov_known=true,false",
        "camera.matrix=[[[900, 0, 9], [0, 900, 9], [0, 0, 1]]]",
        "camera=[{distortion=[0.1, 0.0, 0.0, 0.0]}]",
    ],
)
def test_what_a_rig_replaces_is_not_swept(axis, config):
    with pytest.raises(ConfigError, match="has no effect with a rig, which holds the lens"):
        check_axis(read_axis(axis), config)


def test_what_a_rig_replaces_is_not_learned(config):
    with pytest.raises(ConfigError, match="The rig holds the lens"):
        start_of(config, ["camera.fov_deg"])


def test_a_sweeps_own_rig_replaces_the_configurations(config, tmp_path):
    other = tmp_path / "other.toml"
    write(TRUE_FOV_DEG, other)
    camera = in_first_view(config, str(other)).camera
    assert (camera.rig, camera.matrix is None) == ("", False)


@pytest.mark.parametrize("lens", ["rig", "guessed"])
def test_no_diagnosis_proposes_a_field_of_view_beside_a_rig(lens, head, frames, config):
    if lens == "guessed":
        config = preset("joint").changed(camera={"fov_deg": WRONG_FOV_DEG})
    codes = {reason.code for reason in session_on(head, frames, config).diagnose(5).reasons}
    assert ("wrong_focal" in codes) == (lens == "guessed")
