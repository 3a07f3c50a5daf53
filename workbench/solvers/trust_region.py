"""Steps by Optimistix: its dogleg or its damped Newton descent, with its classical trust region.

As in `optimistix.Dogleg` and `optimistix.LevenbergMarquardt`, on normal equations, with bounds and in a loop that is
ours. A radius of 1 is a whole Gauss–Newton step of the dogleg, and a damping of 1 in the scaled unknowns.
"""

from dataclasses import dataclass
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Bool, Float

from workbench.arrays import AnyArray, Scalar
from workbench.solvers.loop import Judgement
from workbench.solvers.normal_equations import DenseSystem

DESCENTS = {"dogleg": optx.DoglegDescent, "damped": optx.DampedNewtonDescent}
DAMPING = 1e-9
"""Share of the mean curvature added to every unknown: directions without any curvature stay where they are."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=("scale", "smallest", "largest", "is_dogleg"),
    meta_fields=("descent",),
)
@dataclass(frozen=True)
class TrustRegion:
    """A descent and its trust region."""

    scale: Float[AnyArray, "n"]
    """Typical size of each unknown: a radius compares unknowns of different units."""
    descent: Literal["dogleg", "damped", "either"] = "dogleg"
    smallest: Scalar = 1e-16
    """Radius below which no shorter step is tried."""
    largest: Scalar = jnp.inf
    is_dogleg: Bool[AnyArray, ""] | bool = True
    """Which descent "either" is: data, so one program serves both."""

    def start(self) -> Float[AnyArray, ""]:
        """Radius of the first step."""
        return jnp.asarray(1.0)

    def propose(
        self,
        system: DenseSystem,
        trust: Float[AnyArray, ""],
        x: Float[AnyArray, "n"],
        lower: Float[AnyArray, "n"],
        upper: Float[AnyArray, "n"],
    ) -> tuple[Float[AnyArray, "n"], Float[AnyArray, "n"]]:
        """The next place to try and the move that leads there; unknowns whose bounds are equal stay."""
        pushed = ((x <= lower) & (system.gradient > 0.0)) | ((x >= upper) & (system.gradient < 0.0))
        moving = ~pushed & (lower < upper)
        model = self._model(system, moving)
        if self.descent == "either":
            found = jax.lax.cond(
                self.is_dogleg, lambda: _descended("dogleg", model, trust), lambda: _descended("damped", model, trust)
            )
        else:
            found = _descended(self.descent, model, trust)
        candidate = jnp.clip(x + jnp.where(moving, found, 0.0) * self.scale, lower, upper)
        return candidate, candidate - x

    def judge(
        self, system: DenseSystem, trust: Float[AnyArray, ""], move: Float[AnyArray, "n"], value: Scalar
    ) -> Judgement:
        """As `optimistix.ClassicalTrustRegion` sees it."""
        search, scaled = optx.ClassicalTrustRegion(), move / self.scale
        model = self._model(system, jnp.ones(len(move), bool))
        state = type(search.init(scaled, model))(step_size=trust)
        evaluated = optx.FunctionInfo.Eval(0.5 * jnp.asarray(value, float))
        radius, accepted, _, _ = search.step(
            jnp.asarray(False), jnp.zeros_like(scaled), scaled, model, evaluated, state
        )
        radius = jnp.where(accepted, jnp.minimum(radius, self.largest), radius)
        return Judgement(accepted, radius, ~accepted & (radius < self.smallest))

    def _model(self, system: DenseSystem, moving: Bool[AnyArray, "n"]) -> optx.FunctionInfo.EvalGradHessian:
        """½Σr² near the place in scaled unknowns; those that stay get a unit curvature and no slope."""
        both = jnp.outer(moving, moving)
        curvature = jnp.where(both, system.matrix * jnp.outer(self.scale, self.scale), 0.0)
        damping = DAMPING * jnp.trace(curvature) / jnp.maximum(jnp.sum(moving), 1)
        damping = jnp.where(damping > 0.0, damping, 1.0)  # without any curvature the step is 0, not 0/0
        curvature = curvature + jnp.diag(jnp.where(moving, damping, 1.0))
        slope = jnp.where(moving, system.gradient * self.scale, 0.0)
        operator = lx.MatrixLinearOperator(curvature, lx.positive_semidefinite_tag)
        return optx.FunctionInfo.EvalGradHessian(0.5 * jnp.asarray(system.cost, float), slope, operator)


def _descended(descent: str, model: optx.FunctionInfo.EvalGradHessian, trust: Float[AnyArray, ""]):
    """The step of a descent, in scaled unknowns."""
    step, here = DESCENTS[descent](linear_solver=lx.Cholesky()), jnp.zeros_like(model.grad)
    return step.step(trust, step.query(here, model, step.init(here, model)))[0]
