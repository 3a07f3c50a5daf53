"""Learning: gradients through the solver against differences, what has none, parts, bootstrap, and what is stored."""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from workbench.config import PRESETS, config_toml, preset
from workbench.errors import ConfigError, InputError
from workbench.face import load_default_head
from workbench.learning import objective
from workbench.learning.chain import fitted_stretch
from workbench.learning.descent import begin, store, stored
from workbench.learning.examples import Example, example_of, size_of, stretches_in
from workbench.learning.learnable import check_smooth, learned, start_of, weighing_of
from workbench.learning.parts import parts_of_clip, read_frames
from workbench.learning.report import change_of
from workbench.objectives import read_sum
from workbench.planning import plan_of
from workbench.runtime import SMALL_ARRAYS
from workbench.samples import sample
from workbench.sweeps import ClipSolver
from workbench.sweeps.solving import check_swept
from workbench.sweeps.stored_clips import ClipSource, observe

CONFIG = preset("joint").changed(camera={"fov_deg": 33.0})
STEP = 1e-4


@pytest.fixture(scope="module")
def clip():
    source = ClipSource(str(sample("performance")), str(sample("performance-landmarks")))
    return observe(source, CONFIG, load_default_head(), "clip")


def test_the_gradient_is_that_of_differences_with_bounds_active_and_through_time(clip):
    solver, plan = ClipSolver(load_default_head()), plan_of(CONFIG)
    example = example_of(solver, CONFIG, clip, range(40, 44))
    stretch = jax.tree.map(lambda leaf: leaf[0], example.stretches)
    camera = plan.camera.of(clip.observations[0].image_size)
    logs = start_of(CONFIG, ["weights.tau", "weights.sigma_smooth", "landmarks.weights"])
    towards = np.random.default_rng(0).normal(size=51)

    def last_frame(logs):
        fits = fitted_stretch(plan.stages, plan.terms, weighing_of(CONFIG, logs, camera), stretch)
        return fits.projected[-1].mean() + fits.parameters.expression[-1] @ towards[:44], fits.parameters.expression

    # One program for the gradient and, by its value, for the differences.
    both = jax.jit(jax.value_and_grad(last_frame, has_aux=True), compiler_options=SMALL_ARRAYS)
    (_, weights), slope = both({path: jnp.array(log) for path, log in logs.items()})
    assert (np.asarray(weights[-1]) == 0.0).sum() > 5
    for path, point in (("weights.tau", 0), ("weights.sigma_smooth", 0), ("landmarks.weights", 60)):
        moved = [{name: log.copy() for name, log in logs.items()} for _ in range(2)]
        moved[0][path][point] += STEP
        moved[1][path][point] -= STEP
        difference = (both(moved[0])[0][0] - both(moved[1])[0][0]) / (2.0 * STEP)
        np.testing.assert_allclose(slope[path][point], difference, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize(
    ("config", "path", "said"),
    [
        (preset("face-it"), "weights.tau", "step or a kink"),
        (preset("deep"), "weights.tau", "FACE IT!'s"),
        (CONFIG, "solver.tolerance", "has no gradient"),
        (CONFIG, "weights.range", "is 0"),
    ],
)
def test_what_has_no_gradient_is_said(config, path, said):
    with pytest.raises(ConfigError, match=said):
        start_of(config, [path])


@pytest.mark.parametrize("check", [check_smooth, check_swept])
def test_whoever_starts_from_a_renderer_is_sent_to_the_presets_that_work(check):
    with pytest.raises(ConfigError) as refused:
        check(preset("deep"))

    def works(name):
        try:
            return check(preset(name)) is None
        except ConfigError:
            return False

    named = re.search(r"start from (.*) \(--preset\)", str(refused.value))[1]
    assert set(re.split(", | or ", named)) == set(filter(works, PRESETS))


def test_learned_factors_scale_what_was_there():
    found = learned(CONFIG, {"weights.tau": np.log([2.0]), "landmarks.weights": np.log(np.full(68, 0.5))})
    assert found.weights.tau == pytest.approx(2.0 * CONFIG.weights.tau)
    assert found.point_weights() == [0.5] * 68


def test_parts_of_a_clip_do_not_overlap():
    usual = parts_of_clip(100)
    assert [len(part) for part in usual.named.values()] == [60, 20, 20]
    assert parts_of_clip(400, read_frames("0:300"), None, read_frames("300:400")).watch is None
    with pytest.raises(InputError, match="share frame 250"):
        parts_of_clip(400, range(300), None, range(250, 400))
    with pytest.raises(InputError, match="the clip has 0:100"):
        parts_of_clip(100, range(50), None, range(60, 120))
    with pytest.raises(InputError, match="reports"):
        parts_of_clip(100, range(50))
    with pytest.raises(InputError, match="with or without --watch"):
        parts_of_clip(100, watch=range(50))
    with pytest.raises(ConfigError, match="FIRST:END"):
        read_frames("5:5")
    with pytest.raises(InputError, match=r"too short to tune on: 1 frame\(s\)"):
        parts_of_clip(1)


def test_each_part_of_a_short_clip_has_frames_for_a_stretch_where_that_can_be():
    for frames in range(36, 200):
        parts = parts_of_clip(frames).named
        assert min(map(len, parts.values())) >= 12, frames
        assert sum(map(len, parts.values())) == frames
    assert parts_of_clip(55).named == {"train": range(31), "watch": range(31, 43), "held_out": range(43, 55)}
    assert [len(part) for part in parts_of_clip(20).named.values()] == [12, 4, 4]  # enough for a search


def test_the_interval_of_a_change_holds_it():
    before = np.abs(np.random.default_rng(0).normal(2.0, 0.3, 200))
    change = change_of(before, 0.8 * before)
    assert change.percent == pytest.approx(-20.0, abs=0.01)
    assert change.low <= change.percent <= change.high
    at_ends = np.ones(19)
    at_ends[[0, -1]] = 10.0
    worse = change_of(np.ones(19), at_ends)
    assert worse.low < worse.percent < worse.high
    nothing = change_of(before, np.random.default_rng(1).permutation(before))
    assert nothing.low < 0.0 < nothing.high


@pytest.mark.filterwarnings("error")
def test_a_change_that_is_not_known_is_said_in_words():
    for before, after in ((np.zeros(5), np.ones(5)), (np.full(5, np.nan), np.ones(5))):
        assert str(change_of(before, after)).startswith("unknown, because no frame has a value before and after, or")
    assert str(change_of(np.ones(4), np.full(4, 1.1))) == "+10.0 % (too few frames for an interval)"
    rarely = np.array([1.0, *np.zeros(60)])
    assert np.isfinite(change_of(rarely, rarely)).all()


def test_an_objective_without_a_value_on_a_stretch_is_not_perfect_there(monkeypatch):
    monkeypatch.setattr(objective, "fitted_stretch", lambda stages, terms, weighing, stretch: stretch)
    monkeypatch.setattr(objective, "_as_clip", lambda *given: None)
    monkeypatch.setattr(objective, "measure", lambda name: lambda clip, fits: jnp.array([1.0, 3.0, *[jnp.nan] * 10]))
    value = objective.example_value(CONFIG, read_sum("labels"), plan_of(CONFIG).camera.of((640, 480)))
    assert value({}, Example(np.zeros(1), None, np.arange(12) < 2)) == 2.0
    assert np.isnan(value({}, Example(np.zeros(1), None, np.arange(12) >= 2)))


def test_stretches_neither_cross_cuts_nor_gaps(clip):
    observations = list(clip.observations[:40])
    observations[5] = replace(observations[5], cut=True)
    observations[20] = replace(observations[20], landmarks=None)
    torn = replace(clip, observations=tuple(observations))
    assert stretches_in(torn, range(40), "train") == [range(5, 17), range(21, 33)]
    with pytest.raises(InputError, match=r"frames to learn on, 10:25, have no run of 12.*\(--train"):
        stretches_in(torn, range(10, 25), "train")
    with pytest.raises(InputError, match=r"frames that choose the step, 10:25, have no run of 12.*\(--watch"):
        stretches_in(torn, range(10, 25), "watch")


def test_a_gradient_refuses_pictures_of_two_sizes(clip):
    larger = [replace(frame, image_size=(1280, 960)) for frame in clip.observations[12:24]]
    mixed = replace(clip, observations=(*clip.observations[:12], *larger))
    assert size_of(mixed, [range(12, 24)]) == (1280, 960)
    with pytest.raises(InputError, match=r"differ in size.*--train"):
        size_of(mixed, [range(12), range(12, 24)])


def test_a_learning_is_stored_and_taken_up_only_for_the_same_thing(tmp_path):
    begun = begin("key", {"weights.tau": np.zeros(1)}, 2.5)
    store(begun, tmp_path / "a.json")
    assert stored(tmp_path / "a.json", "key") == begun
    with pytest.raises(InputError, match="another configuration"):
        stored(tmp_path / "a.json", "other")
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(InputError, match="not a stored learning"):
        stored(tmp_path / "a.json", "key")


def test_a_configuration_says_what_it_was_tuned_on():
    found = CONFIG.changed(provenance={"objective": "jitter", "parts": {"train": "0:300"}, "learned": ["weights.tau"]})
    assert 'objective = "jitter"' in config_toml(found)
    assert "objective" not in config_toml(CONFIG.changed(provenance={"exported": "now"}))
