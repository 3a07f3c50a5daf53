"""The playground without a browser: sliders are set from Python, also from another thread."""

import threading
import time

import cv2
import numpy as np
import pytest

from workbench.config import FACE_IT_PRESETS, PRESETS, preset
from workbench.errors import InputError
from workbench.frames import read_picture
from workbench.landmarks.files import read_landmark_file
from workbench.samples import sample
from workbench.tracker import FaceTracker
from workbench.tracking import FrameObservation
from workbench.tracking.frame_solver import solve_frame
from workbench.tracking.identity import calibrate_identity
from workbench.widgets import FitPlayground, adjusted
from workbench.widgets.playground import SIDE_PX, start_values

MOVES = {"sigma_smooth": 3.5, "rho": 4, "epsilon": 2, "jaw": 0.2, "fov_deg": 25.0}


@pytest.fixture(scope="module")
def portrait():
    landmarks = next(read_landmark_file(sample("astronaut-landmarks"))).landmarks
    return read_picture(sample("astronaut")), landmarks


@pytest.fixture
def playground(head, portrait):
    made = FitPlayground(*portrait, head)
    yield made
    made.close()


def shown(playground) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(playground.image.value, np.uint8), cv2.IMREAD_COLOR).astype(float)


def test_the_picture_shows_overlay_and_head_side_by_side(playground):
    picture = shown(playground)
    assert picture.shape == (SIDE_PX, 2 * SIDE_PX, 3)
    assert picture[:, :SIDE_PX].std() > 20
    assert picture[:, SIDE_PX:].std() > 20


def test_the_first_fit_is_the_one_of_the_preset(playground, head, portrait):
    observation = FrameObservation(0, portrait[1], portrait[1].image_size)
    alone = FaceTracker(head, preset("joint"), stills=True).push(observation)[0]
    np.testing.assert_array_equal(playground.fit.expression, alone.expression)
    assert f"{alone.errors[0]:.2f} px" in playground.status.value


@pytest.mark.parametrize("name", MOVES)
def test_every_slider_changes_configuration_and_picture_at_once(playground, name):
    config, picture, fit = playground.config, playground.image.value, playground.fit
    playground.sliders[name].value = MOVES[name]
    assert playground.config != config
    assert playground.fit is not fit
    assert playground.image.value != picture or name == "rho"  # the pose may have converged sooner


def test_no_expression_step_leaves_a_neutral_face(playground):
    playground.sliders["epsilon"].value = 0
    playground.sliders["rho"].value = 0
    assert np.abs(playground.fit.iterations).sum() == 0


def test_sliders_work_from_another_thread(playground):
    before = shown(playground)
    thread = threading.Thread(target=lambda: setattr(playground.sliders["epsilon"], "value", 1))
    thread.start()
    thread.join(timeout=60)
    assert not thread.is_alive()
    after = shown(playground)
    changed = np.mean(np.abs(after - before).max(axis=2) > 8)
    assert 0.005 < changed < 0.6
    assert after[:, SIDE_PX:].std() > 20


def test_two_threads_end_with_the_sliders_and_the_fit_in_agreement(playground):
    def drag(name, values):
        for value in values:
            playground.sliders[name].value = value

    threads = [
        threading.Thread(target=drag, args=("fov_deg", range(20, 60, 4))),
        threading.Thread(target=drag, args=("sigma_smooth", range(0, 40, 4))),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=120)
    assert playground.config.camera.fov_deg == playground.sliders["fov_deg"].value == 56
    assert playground.config.weights.sigma_smooth == playground.sliders["sigma_smooth"].value == 36


def test_moving_numeric_sliders_compiles_nothing(playground):
    for name, value in MOVES.items():
        playground.sliders[name].value = value
    solves, calibrations = solve_frame._cache_size(), calibrate_identity._cache_size()
    for name, value in start_values(preset("joint")).items():
        playground.sliders[name].value = value
    assert (solve_frame._cache_size(), calibrate_identity._cache_size()) == (solves, calibrations)


def test_a_preset_moves_the_sliders_and_fits_once(playground, monkeypatch):
    fits = []
    monkeypatch.setattr(playground, "refit", lambda: fits.append(playground.config))
    playground.preset.value = "face-it"
    assert len(fits) == 1
    assert playground.sliders["sigma_smooth"].value == PRESETS["face-it"].weights.sigma_smooth


def test_a_preset_brings_its_bounds_and_stages(playground):
    playground.preset.value = "face-it"
    assert not playground.config.solver.bounded
    assert playground.config.weights.beta == PRESETS["face-it"].weights.beta
    assert len(playground.config.stages) == 3
    playground.preset.value = "joint"
    assert len(playground.config.stages) == 2
    playground.preset.value = "calibrated"
    assert len(playground.config.stages) == 5
    assert playground.fit.expression.min() >= 0.0


def test_a_configuration_with_a_name_of_its_own_is_in_the_menu(head, portrait):
    config = preset("joint").changed(preset="mine", weights={"sigma_smooth": 7.0})
    made = FitPlayground(*portrait, head, config)
    assert made.preset.value == "mine"
    made.preset.value = "face-it"
    made.preset.value = "mine"
    assert made.config.weights.sigma_smooth == 7.0
    made.close()


def test_deep_energies_is_refused(head, portrait):
    with pytest.raises(InputError, match=r"Deep Energies takes seconds per fit.*use one of"):
        FitPlayground(*portrait, head, preset("deep"))


def test_numbers_that_cannot_be_used_are_explained_and_the_next_move_recovers(playground):
    playground.sliders["fov_deg"].max = 400.0
    picture = playground.image.value
    playground.sliders["fov_deg"].value = 300.0
    assert "fov_deg" in playground.status.value
    assert playground.image.value == picture
    playground.sliders["fov_deg"].value = 50.0
    assert "error" in playground.status.value


def test_a_move_is_quick_once_compiled(playground):
    playground.sliders["sigma_smooth"].value = 5.0
    began = time.perf_counter()
    for value in (6.0, 7.0, 8.0):
        playground.sliders["sigma_smooth"].value = value
    assert (time.perf_counter() - began) / 3 < 1.0


def test_the_representation_is_short(playground):
    assert repr(playground) == "FitPlayground('joint', 'default-head')"


@pytest.mark.parametrize("name", FACE_IT_PRESETS)
def test_slider_start_values_give_back_the_preset(name):
    config = preset(name)
    same = adjusted(config, **start_values(config))
    assert [stage.landmark_weights() for stage in same.stages] == [stage.landmark_weights() for stage in config.stages]
    assert [stage.limit for stage in same.stages] == [stage.limit for stage in config.stages]
    assert same.weights == config.weights
    assert same.camera == config.camera
    assert same.identity == config.identity


def test_jaw_zero_takes_the_contour_out_of_every_stage():
    config = adjusted(preset("face-it"), **{**start_values(preset("face-it")), "jaw": 0.0})
    for stage in config.stages:
        assert stage.landmark_weights()[:17] == [0.0] * 17
    assert config.identity.jaw == 0.0
