"""Tuning from its start to its file: interrupted, gone on with, by search and by gradient, in a session and outside."""

import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from tests.short_clips import write_clip
from workbench.cli import app
from workbench.config import preset, read_config
from workbench.errors import ConfigError, InputError
from workbench.learning.descent import begin, descended, stored
from workbench.session import open_session

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


def test_the_command_searches_and_writes_a_configuration_that_says_so(clip, tmp_path):
    out = tmp_path / "found.toml"
    parts = [f"--{name.replace('_', '-')}={frames}" for name, frames in PARTS.items()]
    asked = ["tune", str(clip), "--objective", "jitter+error", "--search", AXIS, "--trials", "2", "--out", str(out)]
    told = CliRunner().invoke(app, [*asked, *parts])
    assert told.exit_code == 0, told.output
    assert "held-out" in told.output
    found = read_config(out)
    assert found.provenance.objective == "jitter + error"
    assert found.provenance.parts["held_out"] == "36:48"
    assert any(line.startswith(f"{clip} sha256:") for line in found.provenance.inputs)
    assert out.with_suffix(".study.log").exists()
    again = CliRunner().invoke(app, [*asked, *parts])
    assert again.exit_code != 0
    more = CliRunner().invoke(app, [*asked[:-4], "--trials", "3", "--out", str(out), "--resume", *parts])
    assert more.exit_code == 0, more.output


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "nothing to tune"),
        (["--learn", "weights.taau"], "has no gradient"),
        (["--learn", "weights.tau", "--train", "0:20", "--held-out", "10:40"], "share frame 10"),
        (["--search", "weights.taau=1,2"], "taau"),
        (["--search", "weights.tau=log(1,2,0)"], "weights.tau"),
        (["--learn", "weights.tau", "--preset", "face-it"], "step or a kink"),
    ],
)
def test_what_cannot_be_tuned_is_said_in_a_sentence(clip, tmp_path, options, said):
    told = CliRunner().invoke(
        app, ["tune", str(clip), "--objective", "jitter", *options, "--out", str(tmp_path / "a.toml")]
    )
    assert told.exit_code != 0
    assert said in str(told.exception or told.output)
    assert not (tmp_path / "a.toml").exists()
