"""Re-fit of the expression with the pose held, after a temporal refinement (Deep Energies Appendix B.1)."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from workbench.errors import ConfigError, InputError
from workbench.face import FaceModel
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.surroundings import Surroundings, seen_around
from workbench.rendering import Appearance
from workbench.tracking.fitting import FrameContext
from workbench.tracking.flow_fitter import parameters_of
from workbench.tracking.moments import Moment, view_sizes
from workbench.tracking.observation import FrameObservation
from workbench.tracking.plan import Plan, StagePlan
from workbench.tracking.records import FrameFit
from workbench.tracking.systems import make_fitter

NAME = "re-estimation"


def reestimation_stage(plan: Plan) -> StagePlan:
    """The stage that fits the expression with the pose held: the plan's stage of that name, or its last one.

    Raises `ConfigError` if no stage frees the expression.
    """
    named = next((stage for stage in plan.stages if stage.name == NAME), None)
    if named is not None:
        return replace(named, enabled=True)
    able = [stage for stage in plan.stages if stage.enabled and "expression" in stage.free]
    if not able:
        raise ConfigError("Re-estimation fits the expression, but no enabled stage frees it; enable one that does.")
    last = able[-1]
    kept = tuple(name for name in last.free if name in ("expression", "jaw", "jaw_open"))
    return replace(last, name=NAME, free=kept, first_only=False)


class Reestimator:
    """Fits the expressions of a stream's frames to their own landmarks, with the poses held."""

    def __init__(self, model: FaceModel, plan: Plan):
        """Raises `ConfigError` if no stage of the plan frees the expression."""
        self._fitter = make_fitter(model, replace(plan, stages=(reestimation_stage(plan),)))
        self._rig = plan.camera.rig
        self._appearances: dict[int, Appearance | None] = {}

    def stream(
        self, stream: Iterable[Moment], advanced: Callable[[FrameFit], None] = lambda fit: None
    ) -> Iterator[Moment]:
        """Each frame with its expression re-fitted; frames without landmarks of their own are unchanged."""
        for moment in stream:
            confidences = (moment.fit.confidence, *moment.fit.others[..., 2])
            seen = moment.fit.found and max(np.nan_to_num(each).max() for each in confidences) > 0.0
            yield moment._replace(fit=self.fit(moment)) if seen else moment
            advanced(moment.fit)

    def fit(self, moment: Moment) -> FrameFit:
        """The frame with its expression re-fitted to its landmarks and everything else unchanged."""
        before = moment.fit
        landmarks, others = before.landmarks, self._others(moment)
        observation = FrameObservation(
            before.index,
            landmarks,
            before.image_size,
            before.source,
            picture=moment.pictures[0] if moment.pictures else None,
            others=others,
            surroundings=self._surroundings(moment, (landmarks, *others)),
        )
        start = parameters_of(before)
        context = FrameContext(
            before.shot, np.asarray(before.identity, float), start, None, self._appearance(moment, observation)
        )
        found, _ = self._fitter.fit(observation, context)
        rows = len(before.status)
        return replace(
            found,
            energies=np.full_like(before.energies, np.nan),
            status=np.full(rows, -1),
            iterations=np.zeros(rows, before.iterations.dtype),
            milliseconds=before.milliseconds,
            others=before.others,
            covariance=before.covariance,
        )

    def _surroundings(self, moment: Moment, landmarks: Sequence[Landmarks2D | None]) -> tuple[Surroundings, ...]:
        """What is behind the renders in each view; nothing where none are drawn, or without pictures."""
        if not (self._fitter.renders and moment.pictures):
            return ()
        return tuple(seen_around(*view) for view in zip(moment.pictures, landmarks, strict=True))

    def _others(self, moment: Moment) -> tuple[Landmarks2D | None, ...]:
        """The other views' landmarks; none in tracks of older workbenches, which stored the reference view's alone.

        Raises `InputError` for a track of another number of views than the rig has.
        """
        stored, views = moment.fit.others, () if self._rig is None else self._rig.views[1:]
        if not len(stored):
            return (None,) * len(views)
        if len(stored) != len(views):
            raise InputError(
                f"The track has landmarks of {1 + len(stored)} views, but the rig has {1 + len(views)}; use the rig "
                "that the track was made with."
            )
        sizes = view_sizes(moment.fit, self._rig, moment.pictures)[1:]
        return tuple(_of_view(*pair) for pair in zip(stored, sizes, strict=True))

    def _appearance(self, moment: Moment, observation: FrameObservation) -> Appearance | None:
        if moment.fit.shot not in self._appearances:
            identity = np.asarray(moment.fit.identity, float)
            self._appearances[moment.fit.shot] = self._fitter.appearance([observation], identity)
        return self._appearances[moment.fit.shot]


def _of_view(stored: Float[np.ndarray, "points 3"], size: tuple[int, int]) -> Landmarks2D | None:
    """Another view's stored landmarks, which have no covariances; None where it saw no face."""
    return Landmarks2D(stored[:, :2], stored[:, 2], size) if np.nan_to_num(stored[:, 2]).max() > 0.0 else None
