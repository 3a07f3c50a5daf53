"""A frame under Deep Energies before and after its stages: the problem, the solution, and its record."""

from dataclasses import dataclass, replace

import jax
import numpy as np

from workbench.energies import TermContext
from workbench.energies.deep import DeepView
from workbench.face import FaceParameters
from workbench.geometry import Camera
from workbench.landmarks.schemes import scheme_of_count
from workbench.networks import EnergyNetwork
from workbench.solvers import Status
from workbench.tracking.deep_programs import DeepScene
from workbench.tracking.deep_solver import StageResult
from workbench.tracking.deep_views import FAR_MM, percent_px
from workbench.tracking.failures import failure_of_residuals
from workbench.tracking.fitting import FrameProblem, FrameSolution, StageTrace, landmarks_of_others
from workbench.tracking.plan import Plan, StagePlan
from workbench.tracking.records import FAILURES, FrameFit, recorded_covariance


@dataclass(frozen=True)
class DeepProblem(FrameProblem):
    """The input of the stages for one frame; without a face in any view there is nothing to solve."""

    stages: tuple[StagePlan, ...]
    scene: DeepScene | None = None
    views: tuple[DeepView, ...] = ()
    """One view per camera, with all landmarks at full weight."""
    start: FaceParameters | None = None
    history: TermContext | None = None


@dataclass(frozen=True)
class DeepSolution(FrameSolution):
    """The results of the stages on a frame; empty if there was nothing to solve."""

    problem: DeepProblem
    results: tuple[StageResult, ...]
    views: tuple[DeepView, ...]
    """The views as used in the last stage."""
    seconds: tuple[float, ...]
    """Duration of each stage."""

    @property
    def stages(self) -> tuple[StagePlan, ...]:
        """The stages that ran."""
        return self.problem.stages[: len(self.results)]

    @property
    def start(self) -> FaceParameters:
        """The start of the first stage."""
        return self.problem.start

    @property
    def parameters(self) -> FaceParameters:
        """The result of the last stage."""
        return self.results[-1].parameters

    def stopped(self, steps: int) -> "DeepSolution":
        """The solution after `steps` accepted steps, counted across all stages."""
        results, left = [], max(steps, 0)
        for result in self.results:
            kept = min(left, len(result.path) - 1)
            results.append(result.stopped(kept))
            left -= kept
            if kept < len(result.path) - 1 or left == 0:
                break
        return replace(self, results=tuple(results), seconds=self.seconds[: len(results)])

    def traces(self) -> tuple[StageTrace, ...]:
        """The accepted steps, by stage; residuals in the reference view."""
        target = self.problem.observation.landmarks.points
        return tuple(
            StageTrace(
                stage.name,
                np.stack([step.energies for step in result.path]),
                np.stack([np.linalg.norm(step.points[0] - target, axis=1) for step in result.path]),
            )
            for stage, result in zip(self.stages, self.results, strict=True)
        )


def record_of(solution: DeepSolution, plan: Plan, network: EnergyNetwork, eyes: float, camera: Camera) -> FrameFit:
    """The record of a solution with results, for tables, pictures and exports; `camera` is stored in the record.

    `eyes` is the model's `eyes_per_box`.
    """
    observation, context = solution.problem.observation, solution.problem.context
    results, rows = solution.results, len(solution.problem.stages)
    parameters = jax.tree.map(lambda part: np.array(part, float), solution.parameters)
    prediction = results[-1].prediction
    translation, scale = parameters.translation, float(parameters.scale[0])
    if plan.camera.parallel:
        translation = np.array([translation[0], translation[1], FAR_MM])
    landmarks = observation.landmarks
    # A view without a face has no residual: its confidence of 0 keeps it out of all means.
    observed = prediction.points[0] if landmarks is None else landmarks.points
    covariance = None if landmarks is None else landmarks.covariance
    rotation = np.array(parameters.rotation)
    return FrameFit(
        index=observation.index,
        found=True,
        shot=context.shot,
        source=observation.source,
        image_size=observation.image_size,
        camera=camera,
        rotation=rotation,
        translation=translation,
        expression=parameters.expression,
        identity=parameters.identity,
        observed=observed,
        confidence=np.zeros(len(observed)) if landmarks is None else landmarks.confidence,
        projected=prediction.points[0],
        energies=_rows([result.energies for result in results], rows, np.nan),
        status=_rows([int(result.status.value) for result in results], rows, -1),
        iterations=_rows([result.iterations for result in results], rows, 0),
        milliseconds=np.array([*observation.milliseconds, 1e3 * sum(solution.seconds)]),
        jaw=parameters.jaw,
        scale=scale,
        failure=_failure(solution, plan, network, eyes),
        others=landmarks_of_others(observation),
        covariance=recorded_covariance(covariance, scheme_of_count(len(observed))),
    )


def _failure(solution: DeepSolution, plan: Plan, network: EnergyNetwork, eyes: float) -> str:
    """Why the result should not be used, from its errors in the first view that shows a failure."""
    result = solution.results[-1]
    if result.status is Status.NOT_FINITE:
        return FAILURES[3]
    percent = [
        np.linalg.norm(points - np.asarray(view.target), axis=1) / percent_px(network, eyes, np.asarray(view.target))
        for view, points in zip(solution.views, result.prediction.points, strict=True)
        if np.any(np.asarray(view.weights) > 0.0)
    ]
    if not percent:
        return ""
    limits = plan.deep.largest_error, plan.deep.largest_disagreement
    return FAILURES[next(filter(None, failure_of_residuals(np.stack(percent), *limits)), 0)]


def _rows(values: list, count: int, missing: float | int) -> np.ndarray:
    """Values of the stages that ran, padded to the number of all stages."""
    known = np.asarray(values)
    return np.concatenate([known, np.full((count - len(known), *known.shape[1:]), missing, known.dtype)])
