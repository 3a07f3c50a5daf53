"""The implicit gradient against central differences: the fits of 50 random frames, by every ω and all 68 point weights.

The value is the largest relative error of one frame's derivative of all unknowns by one weight. Left out of it is what
differences cannot measure: a weight whose step takes an unknown onto a bound or off it, where the fit has a kink. The
details count these, and say how far Gauss–Newton's JᵀJ in the place of the whole Hessian is off.
"""

import argparse
import sys

import jax
import jax.numpy as jnp
import numpy as np
from result import print_result

from workbench.config import preset
from workbench.energies import residuals
from workbench.face import load_default_head, unpack
from workbench.learning import implicit
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.sweeps.stored_clips import ClipSource, observe
from workbench.tracking import FaceItFitter, Walk
from workbench.tracking.frame_solver import BLOCKS, stage_problem, within_range

FRAMES, STEP = 50, 1e-4
POLISHED = 2
"""Newton's steps after those of a fit."""
FELT = 1e-6
"""Share of the largest derivative of a frame below which one is only the rounding of differences."""
CONFIG = preset("joint").changed(camera={"fov_deg": 33.0}, weights={"range": 1.0})


def main() -> None:
    """Measure, telling how far it is, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=FRAMES)
    wanted = parser.parse_args().frames
    plan = plan_of(CONFIG)
    stage, problems = plan.stages[-1], clip_problems(plan)
    used = [k for k, name in enumerate(plan.terms) if stage.omega[k] > 0.0 and name != "identity"]
    derivatives = derivatives_of(plan, stage, used)
    rows = []
    chosen = np.random.default_rng(0).choice(np.arange(3, len(problems)), min(wanted, len(problems) - 3), replace=False)
    for done, k in enumerate(chosen, 1):
        each = problems[k]
        parts = derivatives((each.camera, each.person, each.settings, each.frame))
        rows.append(compared(*map(np.asarray, parts)))
        print(f"\r{done} of {len(chosen)} frames", end="" if done < len(chosen) else "\n", file=sys.stderr, flush=True)
    report(rows, [plan.terms[k] for k in used])


def clip_problems(plan):
    """What the solver is given for every frame of the sample clip, with what came before."""
    head = load_default_head()
    clip = observe(ClipSource(str(sample("performance")), str(sample("performance-landmarks"))), CONFIG, head)
    fitter = FaceItFitter(head, plan)
    walk, problems = Walk(fitter), []
    walk.begin_shot(fitter.calibrate(clip.observations[:90], 12))
    for observation in clip.observations:
        context = walk.context(observation)
        problems.append(fitter.problem(observation, context))
        walk.fit(observation, context)
    return problems


def derivatives_of(plan, stage, used):
    """One compiled program for every frame: the fit's derivative by the logarithms of the ω `used` and the 68 weights.

    It gives the derivative with the whole Hessian, by differences and with JᵀJ, which steps cross a kink, and which
    unknowns rest on a bound.
    """

    def problem_of(logs, seen):
        camera, person, settings, frame = seen
        omega = stage.omega * jnp.exp(jnp.zeros(len(plan.terms)).at[jnp.array(used)].set(logs[: len(used)]))
        weights = stage.landmark_weights * jnp.exp(logs[len(used) :])
        return stage_problem(camera, person, within_range(settings, person), weights, omega, frame, start_of(seen))

    def start_of(seen):
        return jax.tree.map(jnp.asarray, seen[3].start)

    def box_of(seen):
        settings = within_range(seen[2], seen[1])
        lower, upper = (jnp.concatenate([jnp.full(6, side * jnp.inf), jnp.broadcast_to(bound, settings.lower.shape)])
                        for side, bound in ((-1.0, settings.lower), (1.0, settings.upper)))  # fmt: skip
        return implicit.Box(lower, upper)

    def slope(logs, x, seen):
        return implicit.slope_of(problem_of(logs, seen), x, start_of(seen), BLOCKS, plan.terms)

    @jax.jit
    def derivatives(seen):
        box, start, none = box_of(seen), start_of(seen), jnp.zeros(len(used) + 68)

        def fit(logs, begin):
            return implicit.optimum(BLOCKS, plan.terms, problem_of(logs, seen), begin, box)

        def resting(logs, x):
            return implicit.resting(x, slope(logs, x, seen), box.lower, box.upper)

        def exact_fit(logs, begin):
            # Depth is held so loosely that what is left of the force still moves it by a millionth of a millimetre,
            # which a difference divides by its step.
            x = fit(logs, begin)
            for _ in range(POLISHED):
                curvature = implicit.curvature_of(problem_of(logs, seen), x, start, BLOCKS, plan.terms)
                x = jnp.clip(x + solved(curvature, resting(logs, x), -slope(logs, x, seen)), box.lower, box.upper)
            return x

        x = exact_fit(none, start)
        # The fits beside it begin at the one between them: they end where it does, with a few steps.
        middle = unpack(x, start, BLOCKS)
        fixed = resting(none, x)

        def difference(step):
            ahead, behind = exact_fit(step, middle), exact_fit(-step, middle)
            kink = jnp.any(resting(step, ahead) != fixed) | jnp.any(resting(-step, behind) != fixed)
            return (ahead - behind) / (2.0 * STEP), kink

        moves, kinks = jax.lax.map(difference, STEP * jnp.eye(len(none)))
        turned = jax.jacfwd(slope)(none, x, seen)

        def all_residuals(x):
            parts = residuals(problem_of(none, seen), unpack(x, start, BLOCKS), BLOCKS, plan.terms)
            return jnp.concatenate(list(parts.values()))

        jacobian = jax.jacfwd(all_residuals)(x)
        gauss = solved(2.0 * jacobian.T @ jacobian, fixed, -turned)
        return jax.jacfwd(fit)(none, middle), moves.T, gauss, kinks, fixed

    return derivatives


def solved(matrix, fixed, right):
    """The solution of a linear system among the unknowns that are free; 0 for the others."""
    free = ~fixed[:, None] & ~fixed[None, :]
    return jnp.linalg.solve(jnp.where(free, matrix, 0.0) + jnp.diag(fixed * 1.0), (right.T * ~fixed).T)


def compared(found, differences, gauss, kinks, fixed):
    """Relative errors of a frame's derivatives, a number a weight, NaN where differences measure nothing."""
    sizes = np.linalg.norm(differences, axis=0)
    measured = (sizes > FELT * sizes.max()) & ~kinks
    with np.errstate(invalid="ignore", divide="ignore"):
        exact, normal = (
            np.where(measured, np.linalg.norm(each - differences, axis=0) / sizes, np.nan) for each in (found, gauss)
        )
    return exact, normal, int(kinks.sum()), int(fixed.sum())


def report(rows, terms) -> None:
    """Print the errors over frames and weights."""
    exact, normal = (np.array([row[k] for row in rows]) for k in (0, 1))
    kinks, resting = (np.array([row[k] for row in rows]) for k in (2, 3))
    details = {
        "frames": len(rows),
        "omega": terms,
        "derivatives": int(np.isfinite(exact).sum()),
        "across_a_kink": int(kinks.sum()),
        "not_felt": int(exact.size - np.isfinite(exact).sum() - kinks.sum()),
        "on_a_bound": [int(resting.min()), int(resting.max())],
        "median": float(np.nanmedian(exact)),
        "largest_by_omega": float(np.nanmax(exact[:, : len(terms)])),
        "largest_by_point": float(np.nanmax(exact[:, len(terms) :])),
        "above_goal": int(np.sum(exact > 1e-4)),
        "gauss_newton_median": float(np.nanmedian(normal)),
        "gauss_newton_largest": float(np.nanmax(normal)),
    }
    against = "central differences of whole fits"
    print_result("gradient_differences", float(np.nanmax(exact)), "relative error", "<= 1e-4", against, details)


if __name__ == "__main__":
    main()
