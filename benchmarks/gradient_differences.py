"""The implicit gradient against central differences: each fit of 50 random frames by every ω and all 68 point weights.

    python benchmarks/gradient_differences.py

Prints, over frames, the relative error of the derivative of all unknowns, with the whole Hessian and with JᵀJ in its
place, and how many weights rest on a bound.
"""

import jax
import jax.numpy as jnp
import numpy as np

from workbench.config import preset
from workbench.energies import normal_system
from workbench.face import load_default_head, unpack
from workbench.learning import implicit
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.sweeps.stored_clips import ClipSource, observe
from workbench.tracking import FaceItFitter, Walk
from workbench.tracking.frame_solver import BLOCKS, stage_problem, within_range

FRAMES, STEP = 50, 1e-4
CONFIG = preset("joint").changed(camera={"fov_deg": 33.0}, weights={"range": 1.0})


def main() -> None:
    head, plan = load_default_head(), plan_of(CONFIG)
    clip = observe(ClipSource(str(sample("performance")), str(sample("performance-landmarks"))), CONFIG, head)
    fitter = FaceItFitter(head, plan)
    walk, stage, problems = Walk(fitter), plan.stages[-1], []
    walk.begin_shot(fitter.calibrate(clip.observations[:90], 12))
    for observation in clip.observations:
        context = walk.context(observation)
        problems.append(fitter.problem(observation, context))
        walk.fit(observation, context)
    used = [k for k, name in enumerate(plan.terms) if stage.omega[k] > 0.0 and name != "identity"]

    def problem_of(logs, seen):
        camera, person, settings, frame = seen
        omega = stage.omega * jnp.exp(jnp.zeros(len(plan.terms)).at[jnp.array(used)].set(logs[: len(used)]))
        weights = stage.landmark_weights * jnp.exp(logs[len(used) :])
        start = jax.tree.map(jnp.asarray, frame.start)
        return stage_problem(camera, person, within_range(settings, person), weights, omega, frame, start), start

    def box_of(seen):
        settings = within_range(seen[2], seen[1])
        lower, upper = (jnp.concatenate([jnp.full(6, s * jnp.inf), jnp.broadcast_to(bound, settings.lower.shape)])
                        for s, bound in ((-1.0, settings.lower), (1.0, settings.upper)))  # fmt: skip
        return implicit.Box(lower, upper)

    def fit(logs, seen):
        problem, start = problem_of(logs, seen)
        return implicit.optimum(BLOCKS, plan.terms, problem, start, box_of(seen))

    @jax.jit
    def both(seen):
        none = jnp.zeros(len(used) + 68)
        found, box = jax.jacfwd(fit)(none, seen), box_of(seen)
        moves = jax.lax.map(lambda step: fit(step, seen) - fit(-step, seen), STEP * jnp.eye(len(none)))
        x = fit(none, seen)
        problem, start = problem_of(none, seen)
        slope = implicit.slope_of(problem, x, start, BLOCKS, plan.terms)
        fixed = implicit.resting(x, slope, box.lower, box.upper)
        turned = jax.jacfwd(lambda logs: implicit.slope_of(problem_of(logs, seen)[0], x, start, BLOCKS, plan.terms))(
            none
        )
        normal = 2.0 * normal_system(problem, unpack(x, start, BLOCKS), BLOCKS, plan.terms).matrix
        free = ~fixed[:, None] & ~fixed[None, :]
        gauss = -jnp.linalg.solve(jnp.where(free, normal, 0.0) + jnp.diag(fixed * 1.0), turned * ~fixed[:, None])
        return found, moves.T / (2.0 * STEP), gauss, fixed

    errors, gauss_errors, columns, rests = [], [], [], []
    for k in np.random.default_rng(0).choice(np.arange(3, len(problems)), FRAMES, replace=False):
        each = problems[k]
        parts = both((each.camera_on_device, each.person, each.settings, each.frame))
        found, differences, gauss, fixed = map(np.asarray, parts)
        sizes = np.linalg.norm(differences, axis=0)
        columns.append((np.linalg.norm(found - differences, axis=0) / np.maximum(sizes, 1e-6 * sizes.max())).max())
        errors.append(np.linalg.norm(found - differences) / np.linalg.norm(differences))
        gauss_errors.append(np.linalg.norm(gauss - differences) / np.linalg.norm(differences))
        rests.append(fixed.sum())
    print(f"terms {[plan.terms[k] for k in used]}, {len(errors)} frames, on a bound {min(rests)} to {max(rests)}")
    for name, values in (("whole Hessian", errors), ("worst single parameter", columns), ("JᵀJ", gauss_errors)):
        print(f"{name}: median {np.median(values):.1e}, largest {np.max(values):.1e}, "
              f"above 1e-4 in {np.sum(np.array(values) > 1e-4)}")  # fmt: skip


if __name__ == "__main__":
    main()
