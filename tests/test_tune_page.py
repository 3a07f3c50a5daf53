"""The panel's page of tuning without a browser: what is asked, what grows, and taking or discarding a result."""

import inspect
from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import IMAGE_SIZE, make_scene
from workbench.config import preset
from workbench.errors import ConfigError, InputError
from workbench.learning import Tuned
from workbench.learning.parts import read_frames
from workbench.session import Material, TuningSession
from workbench.session.learning import tune_material
from workbench.session.material import PictureStore
from workbench.widgets.tune_page import (
    HELD_OUT,
    LEARNED_ON,
    TunePage,
    conclusion,
    learnable,
    learned_changes,
    parts_texts,
    usual_parts,
)

FRAMES = 40
CONFIG = preset("joint")


def found_by(base, learn, after=0.8):
    """A result: ω_τ doubled, all points at 0.5, the objective `after` times what it was."""
    provenance = {"objective": "jitter", "learned": list(learn), "parts": {"held_out": "32:40"}}
    changed = {"weights": {"tau": 2.0 * base.weights.tau}, "landmarks": {"weights": {str(k): 0.5 for k in range(68)}}}
    values = np.linspace(1.0, 1.2, 8)
    before, later = ({"held_out": factor * values} for factor in (1.0, after))
    return Tuned(base.changed(**changed, provenance=provenance), base, before, later)


class Tuning:
    """Stands in for `session.tune`: three steps, and what it was asked for."""

    def __init__(self, session, before_step=lambda step: None):
        self._session, self._before_step, self.asked = session, before_step, []

    def __call__(self, objective, learn, progress, cancelled, **options):
        assert set(options) < set(inspect.signature(tune_material).parameters)
        self.asked.append((objective, tuple(learn), options))
        for step in range(3):
            self._before_step(step)
            if cancelled():
                break
            progress("learn", step + 1, 3, 3.0 - step, None if step == 0 else 2.0)
        return found_by(self._session.config, learn)


@pytest.fixture(scope="module")
def material(head):
    scene = make_scene(head, (0, 0, 0), {})
    observations = tuple(scene.observation(k) for k in range(FRAMES))
    return Material("clip", observations, PictureStore(None, [IMAGE_SIZE] * FRAMES), stills=False)


@pytest.fixture
def page(head, material):
    session = TuningSession(head, material, CONFIG)
    session.tune = Tuning(session)
    made = TunePage(session, lambda seconds: True, 170)
    yield made
    made.close()


def done(page):
    page.run()
    assert page.wait_idle(60)


def test_the_objective_and_what_it_cannot_see_are_in_plain_words(page):
    assert "predicted by fits that saw the other parts only" in page.words.value
    assert "cannot see: what a part does by itself" in page.objective.tooltip
    page.objective.value = "jitter + 0.5*error"
    assert "second difference" in page.words.value
    assert "distance of the model" in page.words.value
    page.objective.value = "beauty"
    assert "There is no objective" in page.said.value
    page.run()
    assert page._session.tune.asked == []


def test_what_has_a_gradient_and_acts_can_be_learned():
    assert {"weights.tau", "weights.sigma_smooth", "landmarks.weights", "camera.fov_deg"} <= set(learnable(CONFIG))
    assert "weights.range" not in learnable(CONFIG)  # it is 0
    assert "camera.fov_deg" not in learnable(CONFIG.changed(camera={"matrix": [[900, 0, 9], [0, 900, 9], [0, 0, 1]]}))
    assert learnable(preset("deep")) == ()


def test_parts_are_shown_as_first_and_last_frame_and_the_held_out_one_is_halved():
    assert usual_parts(240) == ("0-143", "144-239")
    assert parts_texts("0-143", "144-239") == {"train": "0:144", "watch": "144:192", "held_out": "192:240"}
    for texts in (("", "20-50"), ("0-13, 15-16", "20-50"), ("0-19", "soon")):
        with pytest.raises(InputError, match="Write"):
            parts_texts(*texts)


def test_the_parts_that_are_offered_have_room_to_learn_and_to_choose_the_step_in():
    assert usual_parts(55) == ("0-30", "31-54")
    for frames in range(36, 200):
        parts = {name: read_frames(text) for name, text in parts_texts(*usual_parts(frames)).items()}
        assert min(map(len, parts.values())) >= 12, frames
    with pytest.raises(InputError, match=r"Hold out at least 24 frames: half of them choose the step.*; 33-54 are 22"):
        parts_texts("0-32", "33-54")
    with pytest.raises(InputError, match="Learn on at least 12 frames; 0-10 are 11"):
        parts_texts("0-10", "11-54")


@pytest.mark.parametrize("frames", [1, 35])
def test_a_clip_that_is_too_short_says_so_before_tune_can_be_pressed(head, material, frames):
    session = TuningSession(head, replace(material, observations=material.observations[:frames]), CONFIG)
    session.tune = Tuning(session)
    page = TunePage(session, lambda seconds: True, 170)
    assert page.go.disabled
    assert "at least 36 frames: 12 to learn on and 24 held out" in page.said.value
    assert f"This one has {frames}." in page.said.value
    done(page)
    assert session.tune.asked == []
    page.close()


def test_parts_in_which_faces_are_missing_are_named_as_they_are_typed(head, material):
    observations = list(material.observations)
    observations[20] = replace(observations[20], landmarks=None)
    session = TuningSession(head, replace(material, observations=tuple(observations)), CONFIG)
    session.tune = Tuning(session)
    page = TunePage(session, lambda seconds: True, 170)
    assert not page.go.disabled
    done(page)
    assert "The first half of the held-out frames, 16-27, have no run of 12 with a face" in page.said.value
    page.held_out.value = "16-40"
    done(page)
    assert "The clip has frames 0-39; choose within them." in page.said.value
    assert session.tune.asked == []
    page.close()


def test_it_learns_what_is_chosen_and_the_curve_grows_with_the_held_out_value(page):
    page.steps.value = 3
    page.learn["weights.sigma_smooth"].value = False
    done(page)
    objective, learn, options = page._session.tune.asked[0]
    assert (objective, learn) == ("left-out-parts", ("weights.tau",))
    assert options == {"train": "0:16", "watch": "16:28", "held_out": "28:40", "steps": 3}
    sent = page.chart._series
    assert sent["names"] == [LEARNED_ON, HELD_OUT]
    np.testing.assert_array_equal(
        np.frombuffer(sent["data"], np.float32).reshape(3, 3), [[1, 2, 3], [3, 2, 1], [np.nan, 2, 2]]
    )
    assert "On frames 32-39, held out: −20.0 %" in page.said.value
    assert "better" in page.said.value


def test_take_is_one_undo_step_that_changes_what_was_learned_alone(page):
    session = page._session
    done(page)
    session.set(camera={"fov_deg": 50.0})
    assert not page.take.disabled
    page.take.click()
    assert session.config.weights.tau == 2.0 * CONFIG.weights.tau
    assert session.config.camera.fov_deg == 50.0
    assert session.config.landmarks == CONFIG.landmarks
    assert session.undo_label == "tuned: jitter"
    assert page.take.disabled
    session.undo()
    assert session.config == CONFIG.changed(camera={"fov_deg": 50.0})


def test_the_curve_is_of_the_objective_that_runs_whatever_the_menu_shows_meanwhile(page):
    page._session.tune = Tuning(page._session, lambda step: setattr(page.objective, "value", "jitter"))
    done(page)
    assert page.chart._series["y_label"] == "left-out-parts"


def test_discard_changes_nothing(page):
    done(page)
    page.discard.click()
    assert page._session.config == CONFIG
    assert page.take.disabled
    assert "nothing has changed" in page.said.value


def test_stop_ends_after_a_step_and_judges_the_best_so_far(page):
    running = []

    def stop_in_the_second(step):
        running.append(page.running and not page.stop.disabled)
        if step == 1:
            page.stop.click()

    page._session.tune = Tuning(page._session, stop_in_the_second)
    assert page.stop.disabled
    done(page)
    assert (running, page.running) == ([True, True], False)
    assert page.stop.disabled
    assert page.chart._series["count"] == 1
    assert page.result is not None
    assert page.progress.layout.visibility == "hidden"


def test_refused_requests_are_said_in_a_sentence(page):
    def refuses(*_, **__):
        raise ConfigError("weights.beta is above 0.")

    page.held_out.value = "soon"
    done(page)
    assert "Write frames as 40-52" in page.said.value
    page.held_out.value = "16-39"
    page._session.tune = refuses
    done(page)
    assert "weights.beta is above 0." in page.said.value
    assert page.take.disabled
    assert page.stop.disabled
    for button in page.learn.values():
        button.value = False
    page.run()
    assert "Choose what to learn first" in page.said.value


def test_the_conclusion_says_whether_the_change_is_sure():
    better = found_by(CONFIG, ["weights.tau", "landmarks.weights"])
    assert ", better." in conclusion(better)
    assert "steady head 0.1 → 0.2; point weights 0.5 to 0.5" in conclusion(better)
    assert ", worse." in conclusion(found_by(CONFIG, ["weights.tau"], after=1.3))
    assert "not surely" in conclusion(found_by(CONFIG, ["weights.tau"], after=1.0))
    assert set(learned_changes(better)) == {"weights", "landmarks"}
