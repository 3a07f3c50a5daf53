"""The settings of fitters and temporal passes: values of a configuration, checked and read once at the start.

Nothing here or in lower layers knows configuration files; `workbench.planning` makes a plan from a configuration. The
factors of terms and the landmark weights are already computed: a stage holds the numbers that multiply its energy.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from workbench.energies import EnergyConstants
from workbench.geometry import Camera, Rig, camera_from_fov, camera_from_matrix, resized_view
from workbench.landmarks.observations import Landmarks2D
from workbench.rendering import CharacterLook


@dataclass(frozen=True, eq=False)
class CameraPlan:
    """One camera, given or guessed, or a rig."""

    fov_deg: float
    matrix: Float[np.ndarray, "3 3"] | None
    """OpenCV's camera matrix, pixels; replaces the field of view."""
    distortion: Float[np.ndarray, "_"]
    """OpenCV's coefficients, of either camera."""
    parallel: bool
    """Orthographic: the head's scale replaces its distance."""
    rig: Rig | None
    """Several cameras; replaces the one above."""

    def of(self, image_size: tuple[int, int]) -> Camera:
        """The single camera for pictures of this size (width, height), or the rig's first one.

        Raises `InputError` for pictures that are not scaled copies of those that the rig was calibrated with.
        """
        if self.rig is not None:
            return resized_view(self.rig.views[0], image_size).camera
        if self.matrix is not None:
            return camera_from_matrix(self.matrix, self.distortion)
        return camera_from_fov(image_size, self.fov_deg, self.distortion)

    @property
    def of_rig(self) -> str:
        """The rig's first view with all digits, for keys: a configuration holds its file's path alone; else empty."""
        if self.rig is None:
            return ""
        view = self.rig.views[0]
        return repr((view.image_size, *(np.asarray(part).tolist() for part in view.camera)))


@dataclass(frozen=True, eq=False)
class StagePlan:
    """One solve."""

    name: str
    enabled: bool
    first_only: bool
    """Whether it runs only on the first frame of a shot."""
    free: tuple[str, ...]
    shapes: tuple[str, ...]
    """Free blendshapes by name or prefix, or first:N; empty: all."""
    limit: int
    """Maximum number of iterations."""
    landmark_weights: Float[np.ndarray, "points"]
    """Weight of each landmark: the product of group and point factors."""
    omega: Float[np.ndarray, "t"]
    """Factor in front of each of the plan's terms; 0 if the stage leaves it out."""


@dataclass(frozen=True)
class SolverPlan:
    """How the stages of FACE IT! are solved; both systems use the bounds and the unit."""

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
    size: float
    expression: float
    jaw: float
    limits: tuple[int, int]


@dataclass(frozen=True)
class DeepPlan:
    """Settings used only by Deep Energies."""

    energy: str
    derivative: str
    start: str
    distance_mm: float
    appearance: str
    network: str
    """N: one of the bundled networks by its name, or a weights file."""
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
    """Infill of frames without a usable fit."""

    method: str
    passes: str
    rounds: int
    lids: str
    longest: int
    largest_error: float
    frames: tuple[tuple[int, int], ...]
    """First and last frame of each range to fill although it has fits."""

    def named(self, frame: int) -> bool:
        """Whether a frame is to be filled although it has a fit."""
        return any(first <= frame <= last for first, last in self.frames)


@dataclass(frozen=True)
class RefinementPlan:
    """Refinement, which makes tracks steadier."""

    method: str
    sweeps: int
    order: str
    centre: float
    prior: float


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that determines a fit, except model and observations."""

    system: str
    terms: tuple[str, ...]
    """Names of the energy's terms."""
    linked: bool
    """Whether a term of an enabled stage links a frame to previous ones."""
    compares_pictures: bool
    """Whether one of these compares a frame's pictures with those of the frame before."""
    stages: tuple[StagePlan, ...]
    camera: CameraPlan
    solver: SolverPlan
    constants: EnergyConstants
    sliding: bool
    """Whether the jaw contour slides along the face with the yaw."""
    point_weights: Float[np.ndarray, "points"]
    """Factor of each landmark in every stage and in the identity."""
    confident: bool
    """Whether each point counts by its detection's confidence, else all that were detected alike."""
    identity: IdentityPlan
    deep: DeepPlan
    flow: FlowPlan
    infill: InfillPlan
    refinement: RefinementPlan
    look: CharacterLook | None = None
    """How renders show the face; None: in one colour per vertex, and nothing before it."""
    by_points: "Plan | None" = None
    """The FACE IT! plan that gives Deep Energies its identity, appearance and first pose."""

    def counts(self, confidence: Float[np.ndarray, "points"]) -> Float[np.ndarray, "points"]:
        """What each squared error counts, from the detections' confidence."""
        return confidence if self.confident else (confidence > 0.0).astype(float)

    def measured(
        self, landmarks: Landmarks2D
    ) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points 2 2"] | None]:
        """What each squared error counts, and what whitens it: where a covariance does, the confidence does not too."""
        if landmarks.covariance is None or not self.confident:
            return self.counts(landmarks.confidence), None
        return (landmarks.confidence > 0.0).astype(float), whitening_of(landmarks.covariance)

    def running(self, start: bool) -> tuple[StagePlan, ...]:
        """The stages that run on the first frame of a shot (`start`) or on a later one."""
        return tuple(stage for stage in self.stages if stage.enabled and (start or not stage.first_only))


def whitening_of(covariance: Float[np.ndarray, "points 2 2"]) -> Float[np.ndarray, "points 2 2"]:
    """W, upper triangular, with (WᵀW)⁻¹ the covariance: what takes errors of it to unit variance."""
    yy, xy = covariance[:, 1, 1], covariance[:, 0, 1]
    across = 1.0 / np.sqrt(covariance[:, 0, 0] - xy**2 / yy)
    whitening = np.zeros_like(covariance)
    whitening[:, 0, 0], whitening[:, 0, 1], whitening[:, 1, 1] = across, -across * xy / yy, 1.0 / np.sqrt(yy)
    return whitening
