"""Tuning from its start to its file: interrupted, gone on with, by search and by gradient, in a session and outside."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from tests.short_clips import observations, write_clip
from workbench.cli import app
from workbench.cli import tuning as command
from workbench.config import preset, read_config
from workbench.errors import ConfigError, InputError, MissingDependencyError
from workbench.face import FaceModel, load_default_head
from workbench.learning import Parts, Tuned, Wanted, parts_of_clip, search, tuned, tuning
from workbench.learning.descent import Learning, begin, descended, store, stored
from workbench.learning.examples import stretches_in
from workbench.learning.learnable import FARTHEST, limits_of, start_of
from workbench.learning.learnable import FOV as FOV_PATH
from workbench.learning.learnable import learned as scaled
from workbench.learning.search import Searched
from workbench.objectives import Truth, read_sum
from workbench.session import learning, open_session
from workbench.sweeps import SweptClip, read_axis
from workbench.sweeps.solving import ClipSolver

FOV = {"camera": {"fov_deg": 33.0}}
AXIS = "weights.tau=log(1e-3,10)"
LIMIT = "stages.pose and expression.limit=5,30"
PARTS = {"train": "0:24", "watch": "24:36", "held_out": "36:48"}


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    return write_clip(tmp_path_factory.mktemp("clip") / "talk.csv", range(40, 88))


@pytest.fixture
def session(clip):
    return open_session(clip, preset("joint").changed(**FOV))


def valley(logs, example):
    """An objective with its least where every logarithm is the example, and its slope."""
    (log,) = logs.values()
    return jnp.mean((log - example) ** 2), {path: 2.0 * (log - example) / len(log) for path in logs}


def learned(steps, begun=None, stop_at=None, file=None):
    def tell(learning, _):
        if len(learning.values) == stop_at:
            raise KeyboardInterrupt

    begun = begun or begin("key", {"weights.tau": np.zeros(1)}, None)
    return descended(valley, begun, [1.0, 1.2, 0.8, 1.1], away_from_one, steps, tell, file)


def away_from_one(logs):
    (log,) = logs.values()
    return float(np.mean((log - 1.0) ** 2))


def test_descent_comes_near_the_least():
    found = learned(24)
    assert abs(found.kept["weights.tau"][0] - 1.0) < 0.1
    assert found.best_value == min(value for value in found.watched if value is not None)


def test_an_interrupted_descent_keeps_its_best_and_goes_on_to_the_same_end(tmp_path):
    whole, file = learned(24), tmp_path / "a.json"
    half = learned(24, stop_at=10, file=file)
    assert len(half.values) == 10
    assert half.best_value == min(value for value in half.watched if value is not None)
    taken_up = stored(file, "key")
    assert taken_up == half
    assert learned(24, begun=taken_up) == whole


def test_a_stopped_descent_keeps_its_best():
    begun, seen = begin("key", {"weights.tau": np.zeros(1)}, None), []
    found = descended(
        valley, begun, [1.0], away_from_one, 24, lambda *told: seen.append(told), None, lambda: len(seen) == 4
    )
    assert len(found.values) == 4
    assert found.kept == {"weights.tau": pytest.approx(learned(24, stop_at=4).kept["weights.tau"], abs=0.3)}


def test_a_stretch_without_a_finite_slope_does_not_count():
    def broken(logs, example):
        value, slope = valley(logs, example)
        return (value, slope) if example < 1.15 else (jnp.nan, slope)

    begun = begin("key", {"weights.tau": np.zeros(1)}, None)
    found = descended(broken, begun, [1.2, 1.0], None, 1, lambda *_: None)
    assert found.values == [1.0]


def test_a_search_finds_better_values_keeps_its_best_and_goes_on(session, tmp_path):
    seen, best = [], []

    def stop(what, done, total, value, watched):
        seen.append((what, done, total))
        best.append(value)
        if done == 3:
            raise KeyboardInterrupt

    place, options = tmp_path / "talk-learned.toml", {"search": [AXIS, LIMIT], **PARTS}
    first = session.tune("jitter + error", place=place, trials=5, progress=stop, **options)
    assert seen == [("search", k, 5) for k in (1, 2, 3)]
    assert [*first.config.provenance.learned] == ["weights.tau", "stages.pose and expression.limit"]
    seen.clear()
    second = session.tune("jitter + error", place=place, trials=5, resume=True, progress=stop, **options)
    assert seen == [("search", 4, 5), ("search", 5, 5)]
    assert best == sorted(best, reverse=True)
    assert set(second.before) == set(PARTS)
    with pytest.raises(ConfigError, match="keeps its study in a file"):
        session.tune("jitter", trials=1, **options)
    # Without a labelled frame there is nothing to search by.
    np.savez(tmp_path / "labels.npz", landmarks=np.full((48, 68, 2), np.nan))
    with pytest.raises(InputError, match="The objective labels has no value on these frames"):
        session.tune("labels", place=tmp_path / "none.toml", truth=tmp_path / "labels.npz", **options)


class ByTau(ClipSolver):
    """Stands in for fits: a value is how far log ω_τ is from that of 0.3, plus 1; counts what was measured."""

    clip = SweptClip("clip", "digest", (), False)
    stretches = (range(0, 12), range(12, 24), range(24, 36))

    def __init__(self, monkeypatch, folder):
        super().__init__(load_default_head())
        monkeypatch.setattr(search, "value_of", self.value_of)
        self.journal, self.asked = folder / "a.study.log", []

    def value_of(self, solver, config, clip, windows, objectives):
        self.asked.append(config.weights.tau)
        return 1.0 + abs(float(np.log(config.weights.tau / 0.3)))

    def searched(self, *axes, base=0.3, objective="error", clip=clip, trials=3, tell=lambda *told: None):
        config = preset("joint").changed(weights={"tau": base})
        return search.searched(
            self,
            config,
            tuple(map(read_axis, axes)),
            read_sum(objective),
            clip,
            self.stretches,
            trials,
            self.journal,
            tell,
        )


@pytest.fixture
def by_tau(monkeypatch, tmp_path):
    return ByTau(monkeypatch, tmp_path)


def test_a_search_keeps_the_start_unless_a_trial_is_better(by_tau):
    told = []
    found = by_tau.searched("weights.tau=log(5,100)", tell=lambda done, total, best: told.append(best))
    assert found.config.weights.tau == 0.3
    assert told == [1.0, 1.0, 1.0]
    assert by_tau.asked[:3] == [0.3, 0.3, 0.3]
    by_tau.searched("weights.tau=log(5,100)", trials=4)
    assert by_tau.asked.count(0.3) == 3  # the study knows what the start is worth
    by_tau.journal.unlink()
    assert by_tau.searched("weights.tau=0.1,0.3", base=50.0).config.weights.tau in (0.1, 0.3)


@pytest.mark.parametrize(
    "other",
    [
        {"objective": "jitter"},
        {"base": 0.4},
        {"clip": SweptClip("clip", "another", (), False)},
        {"axes": ["weights.range=log(1,2)"]},
        {"axes": ["weights.tau=5,10"]},
    ],
    ids=lambda other: next(iter(other)),
)
def test_a_search_of_something_else_is_not_gone_on_with(by_tau, other):
    by_tau.searched("weights.tau=log(5,100)")
    before = len(by_tau.asked)
    axes = other.get("axes", ["weights.tau=log(5,100)"])
    other = {name: value for name, value in other.items() if name != "axes"}
    with pytest.raises(
        InputError, match="was searched with another configuration, clip, objective, part or space; start again"
    ):
        by_tau.searched(*axes, **other)
    assert len(by_tau.asked) == before


def test_a_search_that_goes_on_draws_other_points_than_it_began_with(by_tau):
    by_tau.searched(AXIS, trials=4)
    begun = by_tau.asked[:]
    by_tau.asked.clear()
    by_tau.searched(AXIS, trials=8)
    assert len(begun) > 4
    assert not set(begun[1:]) & set(by_tau.asked)


def test_a_journal_that_is_torn_or_none_is_one_sentence(by_tau):
    by_tau.searched("weights.tau=log(5,100)")
    for content in (by_tau.journal.read_text()[:-20], "hello\n", "[1]\n", "{}\n"):
        by_tau.journal.write_text(content)
        with pytest.raises(InputError, match=r"a.study.log is not a stored search .*--overwrite instead of --resume"):
            by_tau.searched("weights.tau=log(5,100)")


@pytest.mark.parametrize(
    ("axis", "said"),
    [
        ("landmarks.detector=dlib,network", "landmarks are found once per clip"),
        ("infill.longest=1..9", "has no effect here"),
        ("preset=joint,dense", "start from it with --preset dense"),
    ],
)
def test_what_has_no_effect_is_not_searched(axis, said):
    with pytest.raises(ConfigError, match=said):
        search.check_searchable(preset("joint"), [read_axis(axis)])


class TestASearchBeforeAGradient:
    """`learn_on` keeps what it began from; the search finds the start that it is told to."""

    @pytest.fixture(autouse=True)
    def stand_ins(self, monkeypatch, tmp_path):
        self.found, self.begun, self.place = Searched(preset("joint"), False), [], tmp_path / "a.toml"
        monkeypatch.setattr(tuning, "searched", lambda *given: self.found)
        monkeypatch.setattr(tuning, "measured", lambda *given: [{"held_out": np.ones(9)}] * 2)
        monkeypatch.setattr(tuning, "stretches_in", lambda *given: [range(0, 12)])
        monkeypatch.setattr(tuning, "example_of", lambda *given: 1.0)
        monkeypatch.setattr(tuning, "watched_on", lambda *given: lambda logs: 1.0)
        monkeypatch.setattr(tuning, "compiled_slope", lambda *given: valley)

        def descended_once(slope, begun, *rest):
            self.begun.append(begun)
            found = replace(begun, values=[*begun.values, 1.0])
            store(found, self.place.with_suffix(".learning.json"))
            return found

        monkeypatch.setattr(tuning, "descended", descended_once)

    def tuned(self, resume=False, learn="weights.sigma_smooth", objective="jitter", base="joint", axes=(AXIS,)):
        clip = SweptClip("clip", "digest", tuple(observations(range(12))), False)
        wanted = Wanted(read_sum(objective), parts_of_clip(60), (learn,), tuple(map(read_axis, axes)))
        return tuned(load_default_head(), preset(base), clip, wanted, place=self.place, resume=resume)

    def test_the_gradient_waits_for_a_search_that_was_interrupted(self):
        self.found = Searched(preset("joint"), True)
        result = self.tuned()
        assert (self.begun, result.learning) == ([], None)
        assert result.config.provenance.learned == ["weights.tau"]

    def test_the_gradient_goes_on_from_the_same_start_and_begins_anew_from_another(self):
        self.tuned()
        self.tuned(resume=True)
        assert [len(begun.values) for begun in self.begun] == [0, 1]
        self.found = Searched(preset("joint").changed(weights={"tau": 0.7}), False)
        self.tuned(resume=True)
        assert len(self.begun[-1].values) == 0

    def test_a_tuning_that_begins_anew_leaves_nothing_of_the_earlier_one_to_go_on_with(self):
        self.tuned()
        self.found = Searched(preset("joint"), True)
        self.tuned()
        self.found = Searched(preset("joint"), False)
        self.tuned(resume=True)
        assert [len(begun.values) for begun in self.begun] == [0, 0]

    @pytest.mark.parametrize(
        "slip", [{"learn": "weights.tua"}, {"objective": "iterations"}, {"base": "face-it"}], ids=str
    )
    def test_what_cannot_be_learned_is_said_before_the_search_and_costs_nothing(self, slip, monkeypatch):
        self.tuned()
        asked = []
        monkeypatch.setattr(tuning, "searched", lambda *given: asked.append(given))
        with pytest.raises(ConfigError, match=r"gradient|derivative"):
            self.tuned(**slip)
        assert not asked
        assert self.place.with_suffix(".learning.json").exists()

    @pytest.mark.parametrize(
        "axes",
        [
            ("weights.tua=1,2",),
            (AXIS, "landmarks.weights=[{robust=1.0}, {rbust=1.0}]"),
            ("camera.fov_deg=lin(25,300)",),
            ("stages.0.limit=-1..30",),
            ("preset=joint,deep",),
        ],
        ids=str,
    )
    def test_a_slip_in_what_is_searched_costs_nothing(self, axes):
        self.tuned()
        self.place.with_suffix(".study.log").write_text("hours of trials")
        with pytest.raises(ConfigError):
            self.tuned(axes=axes)
        assert all(file.exists() for file in tuning.kept_beside(self.place))

    @pytest.mark.parametrize("lacking", ["optuna", "optax"])
    def test_a_tuning_that_lacks_a_package_costs_nothing(self, lacking, monkeypatch):
        self.tuned()
        monkeypatch.setattr("importlib.util.find_spec", lambda module: None if module == lacking else module)
        with pytest.raises(MissingDependencyError, match=f"{lacking} is not installed"):
            self.tuned()
        assert self.place.with_suffix(".learning.json").exists()

    def test_frames_to_watch_without_a_face_are_told_before_the_search(self, monkeypatch):
        self.tuned()
        asked = []
        monkeypatch.setattr(tuning, "searched", lambda *given: asked.append(given))
        monkeypatch.setattr(tuning, "stretches_in", stretches_in)
        clip = SweptClip("clip", "digest", tuple(observations(range(36), gaps=range(12, 24))), False)
        parts = Parts(train=range(12), watch=range(12, 24), held_out=range(24, 36))
        wanted = Wanted(read_sum("jitter"), parts, ("weights.sigma_smooth",), (read_axis(AXIS),))
        with pytest.raises(InputError, match=r"choose the step, 12:24, have no run of 12 with a face.*--watch"):
            tuned(load_default_head(), preset("joint"), clip, wanted, place=self.place)
        assert not asked
        assert self.place.with_suffix(".learning.json").exists()

    def test_a_learning_belongs_to_its_face_model(self, monkeypatch):
        self.tuned()
        monkeypatch.setattr(FaceModel, "fingerprint", lambda model: "another")
        self.tuned(resume=True)
        assert len(self.begun[-1].values) == 0


def test_a_field_of_view_is_learned_within_what_a_camera_can_have():
    config, seen = preset("joint"), []

    def wider(logs, example):
        return jnp.asarray(1.0), {path: -jnp.ones_like(log) for path, log in logs.items()}

    def watched(logs):
        seen.append(scaled(config, logs).camera.fov_deg)
        return 1.0

    begun, limits = begin("key", start_of(config, [FOV_PATH]), None), limits_of(config, [FOV_PATH])
    descended(wider, begun, [1.0], watched, 24, lambda *told: None, limits=limits)
    assert max(seen) == 170.0
    assert limits_of(config, ["weights.tau"]) == {"weights.tau": (-FARTHEST, FARTHEST)}


def test_a_session_goes_on_only_with_the_same_truth_and_confidences():
    clip = SweptClip("clip", "session", tuple(observations(range(3))), False)
    faces = [seen.landmarks for seen in clip.observations]
    surer = [replace(seen, landmarks=replace(face, confidence=0.5 * face.confidence))
             for seen, face in zip(clip.observations, faces, strict=True)]  # fmt: skip
    others = [replace(clip, observations=tuple(surer)), replace(clip, truth=Truth(rotation=np.zeros((3, 3))))]
    assert len({learning._digest(each) for each in (clip, *others)}) == 3
    assert learning._digest(clip) == learning._digest(replace(clip, name="another name"))


def test_the_command_searches_and_writes_a_configuration_that_says_so(clip, tmp_path):
    out = tmp_path / "found.toml"
    parts = [f"--{name.replace('_', '-')}={frames}" for name, frames in PARTS.items()]
    asked = ["tune", str(clip), "--objective", "jitter+error", "--search", AXIS, "--trials", "2", "--out", str(out)]
    told = CliRunner().invoke(app, [*asked, *parts])
    assert told.exit_code == 0, told.output
    assert "held-out" in told.output
    assert ("No trial was better than the start." in told.output) == ("weights.tau" not in told.output)
    found = read_config(out)
    assert found.provenance.objective == "jitter + error"
    assert found.provenance.parts["held_out"] == "36:48"
    assert any(line.startswith(f"{clip} sha256:") for line in found.provenance.inputs)
    assert out.with_suffix(".study.log").exists()
    again = CliRunner().invoke(app, [*asked, *parts])
    assert again.exit_code != 0
    found_before = out.read_text()
    out.unlink()  # as after an interruption, when only the study is there
    anew = CliRunner().invoke(app, [*asked, *parts])
    assert anew.exit_code != 0
    assert "--resume" in str(anew.exception)
    out.write_text(found_before)
    other = [text if text != "jitter+error" else "error" for text in (*asked, *parts)]
    refused = CliRunner().invoke(app, [*other, "--resume"])
    assert "--overwrite instead of --resume" in str(refused.exception)
    more = CliRunner().invoke(app, [*asked[:-4], "--trials", "3", "--out", str(out), "--resume", *parts])
    assert more.exit_code == 0, more.output
    as_told = CliRunner().invoke(app, [*other, "--overwrite"])
    assert as_told.exit_code == 0, as_told.output


@pytest.mark.parametrize(("done", "said"), [(1, "interrupted after 1 of 3 steps; --resume"), (3, "No step was better")])
def test_what_a_descent_found_is_told_with_how_far_it_came(capsys, done, said):
    config = preset("joint")
    provenance = {"objective": "jitter", "learned": ["weights.tau"], "parts": {"held_out": "0:8"}}
    numbers = {"before": {"held_out": 1.0}, "after": {"held_out": 1.0}}
    learning = Learning("key", {"weights.tau": [0.0]}, {}, values=[1.0] * done, best={"weights.tau": [0.0]})
    same = {"held_out": np.ones(8)}
    found = Tuned(config.changed(provenance=provenance | numbers), config, same, same, learning)
    command._print(found, Path("found.toml"), True, 3)
    assert said in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("cut", "kept", "said"),
    [
        ("observed", False, "nothing was tuned yet"),
        ("tuned", False, "nothing was tuned yet"),
        ("tuned", True, "what was tuned so far is kept; --resume continues it"),
    ],
)
def test_an_interruption_before_there_is_a_best_says_what_is_kept(run, clip, tmp_path, monkeypatch, cut, kept, said):
    def interrupted(*_):
        if kept:
            (tmp_path / "found.study.log").touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(f"workbench.learning.{cut}", interrupted)
    code, _, err = run("tune", str(clip), "--objective", "jitter", "--search", AXIS, "--out", "found.toml")
    assert (code, err.strip()) == (130, f"interrupted: {said}")


def test_a_session_that_searches_without_a_place_is_told_the_option_that_it_has(session):
    with pytest.raises(ConfigError, match="place=") as refused:
        session.tune("error", search=[AXIS], **PARTS)
    assert "out=" not in str(refused.value)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "nothing to tune"),
        (["--learn", "weights.taau"], "has no gradient"),
        (["--learn", "weights.tau", "--train", "0:20", "--held-out", "10:40"], "share frame 10"),
        (["--search", "weights.taau=1,2"], "taau"),
        (["--search", "weights.tau=log(1,2,0)"], "weights.tau"),
        (["--learn", "weights.tau", "--preset", "face-it"], "step or a kink"),
        (
            ["--learn", "weights.tau", "--objective", "flow", "--train", "0:24", "--held-out", "24:48"],
            "needs the clip's",
        ),
        (["--learn", "weights.tau", "--objective", "rotation"], "needs the true rotation"),
    ],
)
def test_what_cannot_be_tuned_is_said_in_a_sentence(clip, tmp_path, options, said):
    told = CliRunner().invoke(
        app, ["tune", str(clip), "--objective", "jitter", *options, "--out", str(tmp_path / "a.toml")]
    )
    assert told.exit_code != 0
    assert said in str(told.exception or told.output)
    assert not (tmp_path / "a.toml").exists()
