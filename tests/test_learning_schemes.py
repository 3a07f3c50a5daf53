"""Learning on landmarks beyond the 68: its gradient goes through all points, whitened by their covariances."""

import jax
import numpy as np

from tests.scheme_clips import clip_for, config_of
from workbench.face import load_default_head
from workbench.landmarks.schemes import DENSE
from workbench.learning.chain import fitted_stretch
from workbench.learning.examples import example_of
from workbench.learning.learnable import learned, start_of, weighing_of
from workbench.planning import plan_of
from workbench.runtime import SMALL_ARRAYS
from workbench.sweeps import ClipSolver

STEP = 1e-4
CONFIG = config_of("dense")


def test_the_gradient_of_fits_to_all_points_is_that_of_differences():
    clip, plan = clip_for("dense"), plan_of(CONFIG, DENSE)
    example = example_of(ClipSolver(load_default_head()), CONFIG, clip, range(3))
    stretch = jax.tree.map(lambda leaf: leaf[0], example.stretches)
    camera = plan.camera.of(clip.observations[0].image_size)
    logs = start_of(CONFIG, ["weights.sigma_smooth", "weights.vergence", "landmarks.weights"])

    def last_frame(logs):
        weighing = weighing_of(CONFIG, logs, camera, DENSE)
        fits = fitted_stretch(plan.stages, plan.terms, weighing, stretch)
        return fits.projected[-1].mean() + fits.parameters.expression[-1].sum()

    both = jax.jit(jax.value_and_grad(last_frame), compiler_options=SMALL_ARRAYS)
    _, slope = both({path: np.asarray(log) for path, log in logs.items()})
    for path, point in (("weights.sigma_smooth", 0), ("weights.vergence", 0), ("landmarks.weights", 60)):
        moved = [{each: log.copy() for each, log in logs.items()} for _ in range(2)]
        moved[0][path][point] += STEP
        moved[1][path][point] -= STEP
        difference = (both(moved[0])[0] - both(moved[1])[0]) / (2.0 * STEP)
        np.testing.assert_allclose(slope[path][point], difference, rtol=1e-3, atol=1e-7)


def test_learned_factors_leave_what_further_points_weigh():
    found = learned(CONFIG, {"landmarks.weights": np.log(np.full(68, 0.5))})
    assert found.point_weights(DENSE)[:68] == [0.5] * 68
    assert found.point_weights(DENSE)[68:] == CONFIG.point_weights(DENSE)[68:]
