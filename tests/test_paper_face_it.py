"""FACE IT! as printed: the paper's formulas (`tests.paper_formulas`) against the workbench, values and gradients.

Random faces, cameras and landmarks. Where the workbench departs from the paper, a test says by how much exactly, and
compares after that conversion.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests import paper_formulas as paper
from tests.paper_formulas import agrees
from workbench.config import preset
from workbench.energies import (
    EnergyConstants,
    EnergyProblem,
    Observation,
    TermContext,
    beta_curve,
    beta_slope,
    energy,
    energy_by_term,
    normal_system,
    residuals,
    stage_factors,
)
from workbench.face import FaceParameters, PointModel, absolute_form, delta_form, rigid_alignment, targets_to_deltas
from workbench.geometry import camera_from_matrix, project, rotation_matrix

SHAPES = 44
POSE, EXPRESSION = ("rotation", "translation"), ("expression",)
TERMS = ("landmarks", "tau", "beta", "sigma")


class Scene(NamedTuple):
    """A face of 68 points with 44 targets, its landmarks in a picture, and two earlier poses; millimetres, pixels."""

    neutral: np.ndarray
    targets: np.ndarray
    intrinsics: np.ndarray
    landmarks: np.ndarray
    r: np.ndarray
    t: np.ndarray
    w: np.ndarray
    earlier: np.ndarray
    before: np.ndarray

    @property
    def parameters(self) -> FaceParameters:
        """The unknowns as the workbench has them."""
        return FaceParameters(*(jnp.asarray(part) for part in (self.r, self.t, self.w, np.zeros(0))))


@pytest.fixture(params=range(3))
def scene(request) -> Scene:
    rng = np.random.default_rng(request.param)
    neutral = rng.normal(0.0, 40.0, (68, 3))
    return Scene(
        neutral=neutral,
        targets=neutral + rng.normal(0.0, 5.0, (SHAPES, 68, 3)),
        intrinsics=np.array([[810.0, 0.0, 322.5], [0.0, 790.0, 236.5], [0.0, 0.0, 1.0]]),
        landmarks=rng.uniform(150.0, 450.0, (68, 2)),
        r=rng.normal(0.0, 0.4, 3),
        t=rng.normal(0.0, 20.0, 3) + np.array([0.0, 0.0, 600.0]),
        w=rng.uniform(-0.3, 1.3, SHAPES),
        earlier=rng.normal(size=6),
        before=rng.normal(size=6),
    )


def problem(scene: Scene, omega, weights=None, unit_px=1.0, rotation_mm=1.0, history=1.0) -> EnergyProblem:
    """The scene as the workbench has it, by default in the paper's units: pixels, no confidences, a radian as 1."""
    constants = EnergyConstants(rotation_mm=rotation_mm)
    return EnergyProblem(
        camera=camera_from_matrix(scene.intrinsics),
        points=PointModel(scene.neutral, scene.targets - scene.neutral, np.zeros((0, 68, 3))),
        observation=Observation(
            jnp.asarray(scene.landmarks),
            jnp.ones(68) if weights is None else jnp.asarray(weights),
            jnp.asarray(unit_px),
        ),
        omega=jnp.asarray(omega, float),
        context=TermContext(
            constants, jnp.asarray(scene.earlier), jnp.asarray(scene.before), jnp.asarray(history), scene.parameters
        ),
    )


def term(scene: Scene, name: str, free: tuple[str, ...], **units) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of one term alone, and the gradient of the sum of their squares by the free parameters."""
    only = problem(scene, [float(name == other) for other in TERMS], **units)
    system = normal_system(only, scene.parameters, free, TERMS)
    return np.asarray(residuals(only, scene.parameters, free, TERMS)[name]), 2.0 * np.asarray(system.gradient)


# The face and the camera (Sec. 3).


def test_the_delta_form_is_eq_3_and_the_absolute_form_eq_1(scene):
    expected = paper.blendshape_face(scene.neutral, scene.targets, scene.w)
    deltas = targets_to_deltas(scene.neutral, scene.targets)
    assert agrees(delta_form(scene.neutral, deltas, scene.w), expected)
    absolute = np.append(1.0 - scene.w.sum(), scene.w)  # the neutral's own weight turns Eq. 1 into Eq. 3
    assert agrees(absolute_form(np.concatenate([scene.neutral[None], scene.targets]), absolute), expected)


@pytest.mark.parametrize("mirror", [1.0, -1.0], ids=["a rotated target", "a mirrored target"])
def test_the_alignment_of_targets_is_eq_4_about_their_centres(scene, mirror):
    """The paper prints a rotation alone. Ours first moves both centres to the origin and adds the translation that
    this takes; for centred targets it is zero and the rotation is that of Eq. 4."""
    source = scene.targets[0] - scene.targets[0].mean(axis=0)
    target = (mirror * scene.targets[1] - mirror * scene.targets[1].mean(axis=0)) @ paper.rotation(scene.r)
    rotation, translation = rigid_alignment(source, target)
    assert agrees(rotation, paper.procrustes_rotation(source, target))
    assert np.abs(translation).max() < 1e-12
    moved, shift = rigid_alignment(source, target + scene.t)
    assert agrees(moved, rotation)
    assert agrees(shift, scene.t)


def test_angle_axis_vectors_are_rodrigues_rotations(scene):
    assert agrees(rotation_matrix(jnp.asarray(scene.r)), paper.rotation(scene.r))
    turned = jax.jacfwd(lambda r: rotation_matrix(r).ravel())(jnp.asarray(scene.r))
    assert agrees(turned.T, paper.gradient(lambda r: paper.rotation(r).ravel(), scene.r))


def test_pi_is_the_perspective_projection(scene):
    points = scene.neutral + scene.t
    camera = camera_from_matrix(scene.intrinsics)
    assert agrees(project(camera, jnp.asarray(points)), paper.perspective(points, scene.intrinsics))
    slopes = jax.jacfwd(lambda point: project(camera, point))(jnp.asarray(points[0]))
    assert agrees(slopes.T, paper.gradient(lambda point: paper.perspective(point, scene.intrinsics), points[0]))


# The terms (Sec. 4).


def pose_energy(scene: Scene):
    """E_pose of the scene's face as a function of (r, t)."""
    points = paper.blendshape_face(scene.neutral, scene.targets, scene.w)
    return lambda pose: paper.pose_energy(pose[:3], pose[3:], points, scene.landmarks, scene.intrinsics)


def fit_energy(scene: Scene):
    """E_fit as a function of w."""
    pose = (scene.r, scene.t)
    return lambda w: paper.fit_energy(w, scene.neutral, scene.targets, pose, scene.landmarks, scene.intrinsics)


def test_e_pose_is_eq_8(scene):
    ours, slope = term(scene, "landmarks", POSE)
    pose = np.concatenate([scene.r, scene.t])
    assert agrees(ours @ ours, pose_energy(scene)(pose))
    assert agrees(slope, paper.gradient(pose_energy(scene), pose))


def test_e_fit_is_eq_10_under_the_pose_of_eq_8(scene):
    """Eq. 10 prints no pose; π(b_0 + B·w) has a meaning only behind that of Eq. 8."""
    ours, slope = term(scene, "landmarks", EXPRESSION)
    assert agrees(ours @ ours, fit_energy(scene)(scene.w))
    assert agrees(slope, paper.gradient(fit_energy(scene), scene.w))


def test_confidences_multiply_squared_distances_and_units_divide_distances(scene):
    """The paper has neither: Σ c_i ‖π(R·P_i + t) − p_i‖² / u² becomes Eq. 8 with every c_i = 1 and u = 1 pixel."""
    confidence, unit_px = np.random.default_rng(9).uniform(0.0, 1.0, 68), 1.7
    ours, _ = term(scene, "landmarks", POSE, weights=confidence, unit_px=unit_px)
    seen = paper.perspective(
        paper.rigid(paper.blendshape_face(scene.neutral, scene.targets, scene.w), paper.rotation(scene.r), scene.t),
        scene.intrinsics,
    )
    expected = np.sqrt(confidence)[:, None] * (seen - scene.landmarks) / unit_px
    assert agrees(ours, expected.ravel())


def test_e_tau_is_one_summand_of_eq_9(scene):
    """Eq. 9 sums over 68 landmarks what does not depend on them: the paper's E_τ is 68 times ours, at one radian
    counted as one millimetre."""
    ours, slope = term(scene, "tau", POSE)
    pose = np.concatenate([scene.r, scene.t])

    def expected(pose):
        return paper.smoothness_energy(scene.earlier, scene.before, pose)

    assert agrees(68 * (ours @ ours), expected(pose))
    assert agrees(68 * slope, paper.gradient(expected, pose))


def test_a_radian_counts_as_millimetres_in_e_tau(scene):
    """The paper adds radians to the unit of t as they are; `rotation_mm` is Eq. 9 of r in that many millimetres."""
    ours, _ = term(scene, "tau", POSE, rotation_mm=100.0)
    scale = np.array([100.0] * 3 + [1.0] * 3)
    pose = np.concatenate([scene.r, scene.t])
    assert agrees(68 * (ours @ ours), paper.smoothness_energy(*(scale * part for part in (
        scene.earlier, scene.before, pose))))  # fmt: skip


def test_without_two_earlier_frames_there_is_no_e_tau(scene):
    ours, _ = term(scene, "tau", POSE, history=0.0)
    assert not ours.any()


def test_e_sigma_is_eq_11_without_the_factor_n_and_counts_squared(scene):
    """Eq. 11 sums ‖w‖₁ over k = 1..n, which gives n·Σ|w|. Our residual is Σ|w|; a least-squares solver squares it,
    and so does the paper's, whose E_σ is one residual: E_σ² = n²·(Σ|w|)²."""
    ours, slope = term(scene, "sigma", EXPRESSION)
    assert ours.shape == (1,)
    assert agrees(SHAPES * ours[0], paper.sparsity_energy(scene.w))
    assert agrees(SHAPES**2 * slope, paper.gradient(lambda w: paper.sparsity_energy(w) ** 2, scene.w))


def test_e_beta_is_eq_12_summed_over_the_weights_and_counts_squared(scene):
    """Eq. 12 has a vector on its right; the paper's single residual for it is taken as the sum."""
    for place, near in enumerate((1.002, -0.002, 1.002 + 1e-5, -0.002 - 3e-5)):
        scene.w[place] = near
    ours, slope = term(scene, "beta", EXPRESSION)
    assert ours.shape == (1,)
    assert agrees(ours[0], paper.range_energy(scene.w))
    assert agrees(slope, paper.gradient(lambda w: paper.range_energy(w) ** 2, scene.w))


def test_the_curve_of_fig_2_is_that_of_eq_12():
    w = np.concatenate([np.linspace(-0.5, 1.5, 201), [1.002, -0.002]])
    expected = np.array([paper.range_energy(value) for value in w])
    assert agrees(beta_curve(jnp.asarray(w), EnergyConstants()), expected)
    slopes = np.diag(paper.gradient(lambda w: np.array([paper.range_energy(value) for value in w]), w))
    assert agrees(beta_slope(jnp.asarray(w), EnergyConstants()), slopes)


# The whole (Eqs. 5 to 7).


@pytest.mark.parametrize("free", [POSE, EXPRESSION, (*POSE, *EXPRESSION)], ids=["pose", "expression", "both"])
def test_the_whole_energy_is_that_of_eqs_5_to_7(scene, free):
    """E_pose and E_fit are one residual here, counted by ω_pose while the pose alone is free and by ω_fit otherwise,
    as the paper solves them in turn. E_τ, E_β and E_σ enter as the tests above convert them."""
    rng = np.random.default_rng(5)
    omega = {name: rng.uniform(0.5, 2.0) for name in ("sparse", "pose", "fit", "prior", "tau", "beta", "sigma")}
    rows = {f"weights.{name}": value for name, value in omega.items()}
    whole = problem(scene, stage_factors(rows, "face-it", free, (), TERMS))
    pose_only = free == POSE

    def expected(unknowns):
        pose = unknowns[:6] if "rotation" in free else np.concatenate([scene.r, scene.t])
        w = unknowns[-SHAPES:] if "expression" in free else scene.w
        moved = scene._replace(r=pose[:3], t=pose[3:], w=w)
        energies = {
            "pose": pose_energy(moved)(pose) if pose_only else 0.0,
            "fit": 0.0 if pose_only else fit_energy(moved)(w),
            "tau": paper.smoothness_energy(scene.earlier, scene.before, pose) / 68 * ("rotation" in free),
            "beta": 0.0 if pose_only else paper.range_energy(w) ** 2,
            "sigma": 0.0 if pose_only else (paper.sparsity_energy(w) / SHAPES) ** 2,
        }
        return paper.total_energy(energies, omega)

    blocks = {"rotation": scene.r, "translation": scene.t, "expression": scene.w}
    unknowns = np.concatenate([blocks[name] for name in free])
    assert agrees(energy(whole, scene.parameters, free, TERMS), expected(unknowns))
    assert agrees(energy_by_term(whole, scene.parameters, free, TERMS).sum(), expected(unknowns))
    system = normal_system(whole, scene.parameters, free, TERMS)
    assert agrees(system.cost, expected(unknowns))
    assert agrees(2.0 * system.gradient, paper.gradient(expected, unknowns))


def test_there_are_50_unknowns_and_136_6_1_and_1_residuals(scene):
    free = (*POSE, *EXPRESSION)
    found = residuals(problem(scene, np.ones(4)), scene.parameters, free, TERMS)
    assert {name: len(part) for name, part in found.items()} == {"landmarks": 136, "tau": 6, "beta": 1, "sigma": 1}
    assert normal_system(problem(scene, np.ones(4)), scene.parameters, free, TERMS).matrix.shape == (50, 50)


def test_the_preset_has_the_printed_constants_iterations_and_units():
    config = preset("face-it")
    assert (config.constants.a, config.constants.b, config.constants.c) == (paper.A, paper.B, paper.C)
    assert [stage.limit for stage in config.stages if stage.when == "always"] == [15, 15]  # ρ and ε
    assert [stage.free for stage in config.stages if stage.when == "always"] == [POSE, EXPRESSION]
    assert (config.solver.method, config.solver.unit, config.solver.bounded) == ("lm", "px", False)
    assert not config.landmarks.confidence
    assert config.constants.rotation_mm == 1.0
    assert config.contour.mode == "fixed"
    assert not config.identity.calibrate
