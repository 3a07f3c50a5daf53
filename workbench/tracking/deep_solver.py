"""One stage of Deep Energies: dogleg on the difference between the network's landmarks in photo and render.

There are three ways to the derivative of the network's landmarks in the render:

* `forward`: exact, in forward mode through renderer, crop, network and soft-argmax, as in the paper. The network's
  output jumps slightly as edges cross pixels, so the slope at one point says little about a step of millimetres.
* `differences`: central differences over half the typical size of each unknown: the slope over the length of a step.
* `broyden`: the derivative of the preselected points, corrected by the observed effect of each step. No extra renders.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from workbench.energies.context import TermContext
from workbench.energies.deep import DeepView, NetworkView
from workbench.face import FaceParameters, pack, typical_sizes, unpack
from workbench.runtime import COMPUTING
from workbench.solvers import Status, TrustRegion, init, judge, propose
from workbench.tracking.deep_programs import (
    CHUNK,
    DeepScene,
    look,
    look_derivative,
    points_derivative,
    project_points,
    stage_system,
    term_energies,
)

Derivative = Literal["forward", "differences", "broyden"]
DIFFERENCE_STEP = 0.5
"""Half the width of a central difference, in units of the unknown's typical size."""
SMALLEST_RADIUS = 1e-2
"""Fraction of a Gauss–Newton step below which a stage stops, because the network's output is not smooth below it."""


class Prediction(NamedTuple):
    """The model's landmarks in every view, and the two sources that they are mixed from."""

    points: Float[np.ndarray, "views points 2"]
    """Mixture of network and preselected landmarks, by each view's share."""
    preselected: Float[np.ndarray, "views points 2"]
    looks: tuple[NetworkView | None, ...]
    """None for views that do not use the network."""


class Iteration(NamedTuple):
    """One accepted iterate of a stage."""

    parameters: FaceParameters
    energies: Float[np.ndarray, "t"]
    """Energy of each of the problem's terms."""
    points: Float[np.ndarray, "views points 2"]


@dataclass(frozen=True)
class StageResult:
    """The result of a stage."""

    parameters: FaceParameters
    prediction: Prediction
    energies: Float[np.ndarray, "t"]
    status: Status
    iterations: int
    evaluations: int
    """Network evaluations on renders, including those for finite differences."""
    path: tuple[Iteration, ...]
    """The start and every accepted step."""

    def stopped(self, steps: int) -> "StageResult":
        """The result after `steps` accepted steps."""
        if steps >= len(self.path) - 1:
            return self
        at = self.path[steps]
        prediction = self.prediction._replace(points=at.points)
        return replace(
            self,
            parameters=at.parameters,
            prediction=prediction,
            energies=at.energies,
            status=Status.ITERATION_LIMIT,
            iterations=steps,
            path=self.path[: steps + 1],
        )


@dataclass(frozen=True)
class StageProblem:
    """The energy that one stage minimises."""

    scene: DeepScene
    views: tuple[DeepView, ...]
    terms: tuple[str, ...]
    omega: Float[np.ndarray, "t"]
    """Factor in front of each of `terms`."""
    context: TermContext
    """State of the previous frames; the stage's start is added."""
    free: Bool[np.ndarray, "n"]
    """Mask over the vector of unknowns (`face/unknowns.py`)."""
    lower: Float[np.ndarray, "n"]
    upper: Float[np.ndarray, "n"]
    limit: int
    tolerance: float
    derivative: Derivative

    @property
    def stacked(self) -> DeepView:
        """The views as one record with a leading axis."""
        return jax.tree.map(lambda *parts: jnp.stack([jnp.asarray(part) for part in parts]), *self.views)


def predict(scene: DeepScene, views: tuple[DeepView, ...], parameters: FaceParameters) -> Prediction:
    """Landmarks of the model in every view; the network runs only for views that give it a share."""
    points, preselected, looks = [], [], []
    for view in views:
        with COMPUTING:
            projected = np.asarray(project_points(scene, view, parameters), float)
            seen = look(scene, view, parameters) if np.any(np.asarray(view.share) > 0.0) else None
        share = np.asarray(view.share, float)[:, None]
        mixed = projected if seen is None else share * np.asarray(seen.points, float) + (1.0 - share) * projected
        points.append(mixed)
        preselected.append(projected)
        looks.append(seen)
    return Prediction(np.stack(points), np.stack(preselected), tuple(looks))


def solve_stage(
    problem: StageProblem, start: FaceParameters, cancelled: Callable[[], bool] = lambda: False
) -> StageResult:
    """Up to `limit` dogleg steps from `start`, or from where the bounds leave it, which a fit without bounds ignored;
    each evaluates the network and its derivative once in every view."""
    vector, sizes = np.asarray(pack(start)), typical_sizes(start, jaw_unit=problem.context.jaw_unit)
    lower, upper = (np.where(problem.free, bound, vector) for bound in (problem.lower, problem.upper))
    vector = np.clip(vector, lower, upper)
    views, stage = problem.stacked, _Stage(problem, start)
    parameters = unpack(vector, start)
    prediction = predict(problem.scene, problem.views, parameters)
    energies = stage.energies(views, prediction, parameters)
    path = [Iteration(parameters, energies, prediction.points)]
    method = TrustRegion(sizes, smallest=SMALLEST_RADIUS, largest=1.0)
    state, derivative, count = init(method, vector, energies.sum()), None, 0
    while int(state.status) == Status.RUNNING and count < problem.limit and not cancelled():
        if derivative is None:
            derivative = stage.derivative(parameters, prediction)
        system = stage_system(
            views, problem.omega, prediction.points, derivative, parameters, stage.context, problem.terms
        )
        candidate, move = propose(method, system, state, lower, upper)
        tried_parameters = unpack(candidate, start)
        tried = predict(problem.scene, problem.views, tried_parameters)
        tried_energies = stage.energies(views, tried, tried_parameters)
        state = judge(method, system, state, candidate, move, tried_energies.sum(), problem.tolerance)
        count += 1
        if not np.isfinite(tried_energies).all():
            state = state._replace(status=Status.NOT_FINITE)
            break
        if problem.derivative == "broyden":
            derivative = broyden(derivative, np.asarray(move) / sizes, tried.points - prediction.points)
        if state.accepted:
            parameters, prediction, energies = tried_parameters, tried, tried_energies
            path.append(Iteration(parameters, energies, prediction.points))
            if problem.derivative != "broyden":
                derivative = None
    # Below the smallest radius the network's output is not smooth, so there is nothing left to gain.
    ends = {Status.RUNNING: Status.ITERATION_LIMIT, Status.STALLED: Status.CONVERGED}
    status = Status(int(state.status))
    evaluations = stage.evaluations + count + 1
    return StageResult(parameters, prediction, energies, ends.get(status, status), count, evaluations, tuple(path))


def broyden(
    derivative: Float[np.ndarray, "views n points 2"],
    step: Float[np.ndarray, "n"],
    change: Float[np.ndarray, "views points 2"],
) -> Float[np.ndarray, "views n points 2"]:
    """The derivative closest to the current one that explains the observed change (Broyden's rank-one update)."""
    length = step @ step
    if length == 0.0:
        return derivative
    missing = change - np.einsum("n,vnij->vij", step, derivative)
    return derivative + step[None, :, None, None] * missing[:, None] / length


class _Stage:
    """Counts evaluations and makes derivatives for one stage."""

    def __init__(self, problem: StageProblem, start: FaceParameters):
        self._problem = problem
        self.context = problem.context._replace(start=start)
        self.evaluations = 0

    def energies(self, views: DeepView, prediction: Prediction, parameters: FaceParameters) -> np.ndarray:
        with COMPUTING:
            omega, terms = self._problem.omega, self._problem.terms
            return np.asarray(term_energies(views, omega, prediction.points, parameters, self.context, terms), float)

    def derivative(self, parameters: FaceParameters, prediction: Prediction) -> Float[np.ndarray, "views n points 2"]:
        """Derivative of the mixed landmarks by the scaled unknowns; the network's part only by the free ones."""
        return np.stack([self._of_view(view, parameters) for view in self._problem.views])

    def _of_view(self, view: DeepView, parameters: FaceParameters) -> Float[np.ndarray, "n points 2"]:
        problem = self._problem
        with COMPUTING:
            of_points = np.asarray(points_derivative(problem.scene, view, parameters), float)
        share = np.asarray(view.share, float)[:, None]
        if problem.derivative == "broyden" or not np.any(share > 0.0):
            return of_points
        columns = np.flatnonzero(problem.free)
        seen = np.zeros_like(of_points)
        make = self._forward if problem.derivative == "forward" else self._differences
        seen[columns] = make(view, parameters, columns)
        return share * seen + (1.0 - share) * of_points

    def _forward(self, view, parameters, columns):
        padded = np.full(-(-len(columns) // CHUNK) * CHUNK, len(self._problem.free))
        padded[: len(columns)] = columns
        with COMPUTING:
            parts = [
                np.asarray(look_derivative(self._problem.scene, view, parameters, chunk), float)
                for chunk in padded.reshape(-1, CHUNK)
            ]
        return np.concatenate(parts)[: len(columns)]

    def _differences(self, view, parameters, columns):
        vector = pack(parameters)
        steps = DIFFERENCE_STEP * typical_sizes(parameters, jaw_unit=self.context.jaw_unit)
        rows = []
        for column in columns:
            ends = []
            for sign in (1.0, -1.0):
                with COMPUTING:
                    moved = unpack(vector.at[column].add(sign * steps[column]), parameters)
                    ends.append(np.asarray(look(self._problem.scene, view, moved).points, float))
            rows.append((ends[0] - ends[1]) / (2.0 * DIFFERENCE_STEP))
        self.evaluations += 2 * len(columns)
        return np.stack(rows)
