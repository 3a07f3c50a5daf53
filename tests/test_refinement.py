"""Tracks are steadied (Deep Energies Sec. 7, Appendix B) and expressions re-fitted with the pose held (B.1)."""

from dataclasses import replace

import numpy as np
import pytest

from tests.films import film_config, landmark_error_px, lost
from workbench.config import Stage
from workbench.errors import ConfigError
from workbench.planning import plan_of
from workbench.tracking.flow_fitter import FlowFitter, parameters_of
from workbench.tracking.reestimation import Reestimator, reestimation_stage
from workbench.tracking.refinement import averaging_pass, passes, plate_flow_pass, refined, self_flow_pass

COUNT = 12
NOISE_PX = 1.0


def talking(index: int):
    weights = {"jawOpen": 0.25 + 0.2 * np.sin(0.8 * index), "mouthSmileLeft": 0.2, "mouthSmileRight": 0.2}
    return weights, (8.0 * np.sin(0.25 * index), 3.0 * np.sin(0.2 * index), 0.0), (2.0 * np.sin(0.2 * index), 0.0, 0.0)


def even(index: int):
    return {"jawOpen": 0.05 * index}, (0.0, 0.0, 0.0), (1.5 * index, 0.0, 2.0 * index)


@pytest.fixture(scope="module")
def film(film_maker):
    return film_maker.film(COUNT, talking)


@pytest.fixture(scope="module")
def noisy(film_maker, film):
    return [film_maker.detected(fit, NOISE_PX, seed) for seed, fit in enumerate(film.truth)]


def fitter_with(film_maker, **refinement):
    return FlowFitter(film_maker.head, plan_of(film_config(refinement=refinement)))


def steadied(film_maker, film, fits, **refinement):
    return [moment.fit for moment in refined(fitter_with(film_maker, **refinement), film.moments(fits))]


def error(fits, film):
    return np.mean([landmark_error_px(fit, truth) for fit, truth in zip(fits, film.truth, strict=True)][1:-1])


def jitter(fits, film):
    """Mean second difference of the landmarks' error: what trembles beside the true motion."""
    missed = np.stack([fit.projected - truth.projected for fit, truth in zip(fits, film.truth, strict=True)])
    return np.linalg.norm(missed[2:] - 2.0 * missed[1:-1] + missed[:-2], axis=2).mean()


@pytest.mark.long
def test_hybrid_trembles_less_and_errs_no_more(film_maker, film, noisy):
    result = steadied(film_maker, film, noisy, method="hybrid")
    assert jitter(result, film) < 0.4 * jitter(noisy, film)
    assert error(result, film) < error(noisy, film)


def test_the_pictures_flow_alone_errs_less(film_maker, film, noisy):
    result = steadied(film_maker, film, noisy, method="plate")
    assert error(result, film) < error(noisy, film)
    assert jitter(result, film) < jitter(noisy, film)


def test_averaging_leaves_even_motion_and_cuts_corners(film_maker):
    smooth = film_maker.film(6, even)
    result = steadied(film_maker, smooth, smooth.truth, method="averaging")
    for fit, truth in zip(result, smooth.truth, strict=True):
        assert fit.translation == pytest.approx(truth.translation, abs=1e-9)
        assert fit.expression == pytest.approx(truth.expression, abs=1e-9)
    corner = [replace(fit, expression=fit.expression * (fit.index >= 3)) for fit in smooth.truth]
    jaw = film_maker.head.expression_names.index("jawOpen")
    before = np.array([fit.expression[jaw] for fit in corner])
    after = np.array([fit.expression[jaw] for fit in steadied(film_maker, smooth, corner, method="averaging")])
    assert after[2] == pytest.approx(0.25 * before[3])
    assert after[3] == pytest.approx(0.5 * before[3] + 0.25 * before[4])


def test_the_weight_of_the_centre_is_a_setting(film_maker, film, noisy):
    strong = steadied(film_maker, film, noisy, method="averaging", centre=1.0)
    assert strong[4].translation == pytest.approx(noisy[4].translation)


def test_self_flow_puts_a_frame_midway(film_maker, film):
    """‖N(F₁, F₂) − N(F₂, F₃)‖ is least where every point is midway; the pictures have no say."""
    shifted = list(film.truth)
    shifted[5] = replace(shifted[5], translation=shifted[5].translation + np.array([4.0, 0.0, 0.0]))
    result = steadied(film_maker, film, shifted, method="self")
    ends = [film.truth[k].projected for k in (4, 6)]
    assert np.abs(result[5].projected - 0.5 * (ends[0] + ends[1])).mean() < 0.15
    without = [moment._replace(pictures=()) for moment in film.moments(shifted)]
    blind = [m.fit for m in refined(fitter_with(film_maker, method="self"), without)]
    assert np.array_equal(blind[5].rotation, result[5].rotation)


def test_jacobi_sweeps_hand_on_noise_that_alternates_and_averaging_takes_it_out(film_maker, film):
    """The remark of the module, on truth plus an error of alternating sign."""
    sign = (-1.0) ** np.arange(COUNT)
    moved = [
        replace(fit, translation=fit.translation + s * np.array([3.0, 0.0, 0.0]))
        for fit, s in zip(film.truth, sign, strict=True)
    ]
    aside = lambda fits: np.array(  # noqa: E731
        [(fit.translation - truth.translation)[0] for fit, truth in zip(fits, film.truth, strict=True)]
    )
    by_flow = aside(steadied(film_maker, film, moved, method="plate"))[2:-2]
    assert np.sign(by_flow).tolist() == (-sign[2:-2]).tolist()
    assert np.abs(by_flow).mean() > 1.5
    averaged = aside(steadied(film_maker, film, moved, method="averaging"))[2:-2]
    assert np.abs(averaged).max() < 0.2


def test_gauss_seidel_goes_on_from_the_newest(film_maker, film, noisy):
    jacobi = steadied(film_maker, film, noisy, method="plate", sweeps=2)
    seidel = steadied(film_maker, film, noisy, method="plate", sweeps=2, order="gauss-seidel")
    assert not np.allclose(jacobi[5].rotation, seidel[5].rotation)
    assert error(seidel, film) < error(noisy, film)


def test_a_strong_prior_holds_every_frame(film_maker, film, noisy):
    held = steadied(film_maker, film, noisy, method="plate", prior=1e6)
    for fit, before in zip(held, noisy, strict=True):
        assert fit.rotation == pytest.approx(before.rotation, abs=1e-4)
        assert fit.translation == pytest.approx(before.translation, abs=1e-2)


def test_ends_cuts_and_empty_frames_stay(film_maker, film, noisy):
    fits = [replace(fit, shot=int(fit.index >= 6)) for fit in noisy]
    fits[3] = lost(fits[3])
    result = steadied(film_maker, film, fits, method="averaging")
    untouched = [k for k in range(COUNT) if result[k] is fits[k]]
    assert untouched == [0, 2, 3, 4, 5, 6, 11]


def test_landmarks_and_confidence_of_a_refined_frame_are_its_own(film_maker, film, noisy):
    result = steadied(film_maker, film, noisy, method="averaging")[4]
    assert np.array_equal(result.observed, noisy[4].observed)
    assert np.array_equal(result.confidence, noisy[4].confidence)
    assert np.isnan(result.energies).all()
    assert result.source == "detected"
    assert not np.array_equal(result.projected, noisy[4].projected)


def test_methods_are_passes_in_order():
    named = lambda **refinement: passes(plan_of(film_config(refinement=refinement)).refinement)  # noqa: E731
    assert named(method="none") == []
    assert named(method="averaging", sweeps=2) == [averaging_pass] * 2
    assert named(method="self") == [self_flow_pass]
    assert named(method="plate", sweeps=3) == [plate_flow_pass] * 3
    assert named(method="hybrid", sweeps=2) == [averaging_pass, plate_flow_pass, plate_flow_pass]


def test_a_fit_that_is_moved_takes_the_scale_along(film_maker, film):
    """What stands for the distance in parallel projection: twice the scale, twice the picture."""
    fitter = fitter_with(film_maker, method="averaging")
    like, centre = film.truth[0], np.asarray(film.truth[0].camera.principal_point_px)
    where = fitter.placed(like, parameters_of(replace(like, translation=np.array([0.0, 0.0, 6e5]))))
    twice = fitter.placed(where, parameters_of(replace(where, scale=2.0)))
    assert (where.scale, twice.scale) == (1.0, 2.0)
    np.testing.assert_allclose(twice.projected - centre, 2.0 * (where.projected - centre), rtol=1e-3, atol=1e-3)


def test_reestimation_holds_the_pose_and_finds_the_expression(film_maker, film):
    dull = [replace(fit, expression=0.5 * fit.expression) for fit in film.truth]
    stream = Reestimator(film_maker.head, plan_of(film_config())).stream(film.moments(dull))
    result = [moment.fit for moment in stream]
    jaw = film_maker.head.expression_names.index("jawOpen")
    for fit, truth in zip(result, film.truth, strict=True):
        assert fit.rotation == pytest.approx(truth.rotation, abs=1e-12)
        assert fit.translation == pytest.approx(truth.translation, abs=1e-12)
        assert fit.expression[jaw] == pytest.approx(truth.expression[jaw], abs=0.06)
        assert fit.energies.shape == truth.energies.shape


def test_filled_frames_have_nothing_to_be_fitted_to(film_maker, film):
    filled = replace(film.truth[2], source="filled", confidence=np.zeros(68))
    fits = [filled if fit.index == 2 else fit for fit in film.truth]
    result = list(Reestimator(film_maker.head, plan_of(film_config())).stream(film.moments(fits)))
    assert result[2].fit is filled


def test_the_stage_is_the_plans_own_or_its_last():
    joint = reestimation_stage(plan_of(film_config()))
    assert (joint.free, joint.first_only, joint.limit) == (("expression",), False, 30)
    from workbench.config import preset

    deep = reestimation_stage(plan_of(preset("deep")))
    assert deep.enabled
    assert deep.free == ("expression", "jaw")
    lips = Stage(name="lips", free=("rotation", "expression", "jaw_open"))
    assert reestimation_stage(plan_of(preset("deep").changed(stages=(lips,)))).free == ("expression", "jaw_open")
    rigid = film_config().model_copy(update={"stages": (Stage(name="pose", free=("rotation",)),)})
    with pytest.raises(ConfigError, match="no enabled stage frees"):
        reestimation_stage(plan_of(rigid))
