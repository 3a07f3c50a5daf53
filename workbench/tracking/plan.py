"""What fitters and passes over time are told: the values of a configuration, checked and read once, at the door.

Nothing here or below knows of configuration files; `workbench.planning` makes a plan of a configuration. Terms' factors
and landmark weights are worked out already: a stage holds the numbers that its energy is weighed with.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from workbench.energies import EnergyConstants
from workbench.geometry import Camera, Rig, camera_from_fov, camera_from_matrix


@dataclass(frozen=True, eq=False)
class CameraPlan:
    """One camera, given or guessed, or a rig."""

    fov_deg: float
    matrix: Float[np.ndarray, "3 3"] | None
    """OpenCV's camera matrix, pixels; replaces the field of view."""
    distortion: Float[np.ndarray, "_"]
    parallel: bool
    """Orthographic: the head's scale replaces its distance."""
    rig: Rig | None
    """Several cameras; replaces the one above."""

    def of(self, image_size: tuple[int, int]) -> Camera:
        """The one camera for pictures of this size (width, height)."""
        if self.matrix is not None:
            return camera_from_matrix(self.matrix, self.distortion)
        return camera_from_fov(image_size, self.fov_deg)


@dataclass(frozen=True, eq=False)
class StagePlan:
    """One solve."""

    name: str
    enabled: bool
    first_only: bool
    """Whether it runs on the first frame of a shot only."""
    free: tuple[str, ...]
    shapes: tuple[str, ...]
    """Free blendshapes by name or start of name, or first:N; empty: all."""
    limit: int
    """Most iterations."""
    landmark_weights: Float[np.ndarray, "68"]
    """What each landmark counts, group and point factors multiplied."""
    omega: Float[np.ndarray, "t"]
    """Factor in front of each of the plan's terms; 0 where the stage leaves one out."""


@dataclass(frozen=True)
class SolverPlan:
    """How FACE IT!'s stages are solved; both systems heed the bounds and the unit."""

    method: str
    bounded: bool
    tolerance: float
    percent: bool
    """Residuals in percent of the outer-eye distance, else in pixels."""


@dataclass(frozen=True)
class IdentityPlan:
    """Calibration of a shot's face shape."""

    calibrate: bool
    weight: float
    expression: float
    jaw: float
    limits: tuple[int, int]


@dataclass(frozen=True)
class DeepPlan:
    """What only Deep Energies reads."""

    energy: str
    derivative: str
    start: str
    distance_mm: float
    appearance: str
    network: str
    """Weights file of N; empty: the bundled one."""
    tolerance: float
    largest_error: float
    largest_disagreement: float


@dataclass(frozen=True)
class FlowPlan:
    """Optical flow between neighbouring frames."""

    estimator: str
    side: int
    points: int
    renders: str
    robust: float
    stay: float
    iterations: int


@dataclass(frozen=True)
class InfillPlan:
    """Frames without a usable fit."""

    method: str
    rounds: int
    longest: int
    largest_error: float
    frames: tuple[tuple[int, int], ...]
    """First and last of each part that is filled although it has fits."""

    def named(self, frame: int) -> bool:
        """Whether a frame is filled although it has a fit."""
        return any(first <= frame <= last for first, last in self.frames)


@dataclass(frozen=True)
class RefinementPlan:
    """Steadier tracks."""

    method: str
    sweeps: int
    order: str
    centre: float
    prior: float


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that decides a fit, but model and observations."""

    system: str
    terms: tuple[str, ...]
    """Names of the energy's terms."""
    linked: bool
    """Whether a term of a stage that runs links a frame to the ones before."""
    stages: tuple[StagePlan, ...]
    camera: CameraPlan
    solver: SolverPlan
    constants: EnergyConstants
    sliding: bool
    """Whether the jaw contour slides along the face with the yaw."""
    point_weights: Float[np.ndarray, "68"]
    """Factor of each landmark in every stage and in the identity."""
    identity: IdentityPlan
    deep: DeepPlan
    flow: FlowPlan
    infill: InfillPlan
    refinement: RefinementPlan
    by_points: "Plan | None" = None
    """FACE IT!'s plan for identity, appearance and first pose of Deep Energies."""

    def running(self, start: bool) -> tuple[StagePlan, ...]:
        """The stages that run on the first frame of a shot (`start`) or on a later one."""
        return tuple(stage for stage in self.stages if stage.enabled and (start or not stage.first_only))
