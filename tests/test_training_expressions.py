"""What expressions usually are is learned from random expressions and from tracks."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import make_scene
from workbench.config import preset
from workbench.errors import InputError
from workbench.face import load_default_head
from workbench.face.usual_expressions import read_moments
from workbench.planning import plan_of
from workbench.tracking import FaceItFitter, FrameContext, Track
from workbench.tracking.records import stack_fits
from workbench.training.expressions import (
    AMOUNT,
    FITTED,
    ExpressionRecipe,
    fitted_weights,
    learn_expressions,
    partly_fitted,
    second_moment,
    weights_of,
)
from workbench.training.scenes import random_expression

NAMES = load_default_head().expression_names


def smiling(weight: float) -> np.ndarray:
    return np.array([weight * name.startswith("mouthSmile") for name in NAMES])


def track_of(head, expressions: list[np.ndarray]) -> Track:
    """A track whose fits have these weights; no face where they are not known."""
    fitter, scene = FaceItFitter(head, plan_of(preset("joint"))), make_scene(head)
    fit, _ = fitter.fit(scene.observation(), FrameContext(0, np.zeros(50), None, None))
    fits = [
        replace(fit, index=k, expression=each, confidence=fit.confidence * np.isfinite(each[0]))
        for k, each in enumerate(expressions)
    ]
    return Track(meta={"expression_names": list(head.expression_names)}, **stack_fits(fits))


def test_the_second_moment_of_expressions():
    np.testing.assert_allclose(
        second_moment(np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 0.0]])), np.array([[1.25, 0.25], [0.25, 0.25]]) / 3
    )


def test_tracks_count_as_much_as_random_expressions_and_each_alike(tmp_path, head):
    (tmp_path / "tracks").mkdir()
    for name, smiles in (("short", [1.0]), ("long", [0.5, 0.5, 0.5])):
        track_of(head, [smiling(smile) for smile in smiles]).save(tmp_path / "tracks" / f"{name}.npz")
    moments = read_moments(learn_expressions(tmp_path, ExpressionRecipe(drawn=40), report=lambda said: None))
    names = load_default_head(gaze=True).expression_names
    rng = np.random.default_rng(3)
    drawn = second_moment(np.array([random_expression(names, rng) for _ in range(40)]))
    left, right = (names.index(f"mouthSmile{side}") for side in ("Left", "Right"))
    assert moments.names == names
    assert moments.second[left, right] == pytest.approx(0.5 * (drawn[left, right] + (1.0 + 0.25) / 2), rel=1e-6)
    table = (tmp_path / "expressions_tables.md").read_text(encoding="utf-8")
    assert "mouthSmileLeft, mouthSmileRight" in table


def test_a_track_without_a_fit_is_named(head, tmp_path):
    track = track_of(head, [np.full(44, np.nan)])
    with pytest.raises(InputError, match=r"empty\.npz has no fitted frame"):
        weights_of(track, tmp_path / "empty.npz", NAMES)


def test_a_track_of_other_blendshapes_is_named(head, tmp_path):
    track = track_of(head, [smiling(1.0)])
    track = replace(track, meta={"expression_names": [f"expression_{k}" for k in range(44)]})
    with pytest.raises(InputError, match=r"flame\.npz has none of the head's blendshapes \(its first are expr"):
        weights_of(track, tmp_path / "flame.npz", NAMES)


def test_of_a_runs_folder_the_track_alone_counts_and_one_track_is_no_plural(tmp_path, head):
    run, interrupted = tmp_path / "tracks" / "talk", tmp_path / "tracks" / "begun" / "track.npz.parts"
    run.mkdir(parents=True)
    interrupted.mkdir(parents=True)
    track = track_of(head, [smiling(1.0)])
    for path in (run / "track.npz", run / "unrefined.npz", interrupted / "000000.npz"):
        track.save(path)
    assert len(fitted_weights(tmp_path, NAMES)) == 1
    said = []
    learn_expressions(tmp_path, ExpressionRecipe(drawn=4), report=said.append)
    assert said == ["learned from 4 random expressions and from 1 track"]


def test_pictures_show_the_expressions_of_tracks_each_track_as_often_and_to_either_side(tmp_path, head):
    (tmp_path / "tracks").mkdir()
    smirk = np.array([0.4 * (name == "mouthSmileLeft") for name in NAMES])
    open_mouth = np.array([0.4 * (name == "jawOpen") for name in NAMES])
    for name, shown in (("short", [smirk]), ("long", [open_mouth] * 9)):
        track_of(head, shown).save(tmp_path / "tracks" / f"{name}.npz")
    names = load_default_head(gaze=True).expression_names
    fits = fitted_weights(tmp_path, names)
    assert [len(track) for track in fits] == [9, 1]

    def gazing(names, rng):
        return np.array([0.25 * name.startswith("eyeLook") for name in names])

    rng = np.random.default_rng(4)
    draw = partly_fitted(gazing, fits)
    drawn = np.array([draw(names, rng) for _ in range(3000)])
    looks = [name.startswith("eyeLook") for name in names]
    np.testing.assert_array_equal(drawn[:, looks], 0.25)
    amounts = {name: drawn[:, names.index(name)] for name in ("jawOpen", "mouthSmileLeft", "mouthSmileRight")}
    shares = {name: (amount > 0.0).mean() for name, amount in amounts.items()}
    assert sum(shares.values()) == pytest.approx(FITTED, abs=0.03)
    assert shares["jawOpen"] == pytest.approx(FITTED / 2, abs=0.03)
    assert shares["mouthSmileRight"] == pytest.approx(FITTED / 4, abs=0.03)
    for amount in amounts.values():
        shown = amount[amount > 0.0]
        assert shown.min() >= 0.4 * AMOUNT[0]
        assert shown.max() <= 0.4 * AMOUNT[1]
    assert partly_fitted(gazing, []) is gazing


def test_random_expressions_move_jaw_and_mouth_to_one_side_or_the_other():
    rng = np.random.default_rng(0)
    drawn = np.array([random_expression(NAMES, rng) for _ in range(3000)])
    for way in ("jaw", "mouth"):
        left, right = (drawn[:, NAMES.index(f"{way}{side}")] for side in ("Left", "Right"))
        assert not (left * right).any()
        assert (left > 0.3).sum() > 30
        assert (right > 0.3).sum() > 30
