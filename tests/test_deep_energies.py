"""Deep Energies by behaviour: its energy, its derivatives, its stages, several cameras, failures, no compilations."""

import os
import shutil
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.deep_scenes import (
    DEEP,
    FOV_DEG,
    IMAGE_SIZE,
    POINTS,
    POSE_ONLY,
    fitter_with,
    flat,
    make_deep_scene,
    make_parameters,
    rotation_error_deg,
)
from tests.other_heads import half_open, resized
from tests.stereo_scenes import make_rig
from workbench.config import PARALLEL_STAGES, PRESETS, Config, Stage, preset
from workbench.energies import still
from workbench.energies.deep import DEEP_TERMS, DeepView, deep_residuals, view_vertices
from workbench.errors import ConfigError, InputError
from workbench.face import typical_sizes, unpack
from workbench.frames import read_picture
from workbench.geometry import camera_from_fov, project, read_rig, rotation_matrix, write_rig
from workbench.landmarks.network_detector import BUNDLED, bundled_landmark_network, landmark_crop
from workbench.landmarks.observations import Landmarks2D
from workbench.networks import BETA, Fan, crop_and_resize, landmarks_of, soft_argmax, to_picture
from workbench.networks.crop import fan_box_of
from workbench.pictures.mesh import corner_sum, vertex_normals
from workbench.planning import plan_of
from workbench.rendering import (
    Appearance,
    CropCamera,
    OrthographicCamera,
    ambient_light,
    directional_light,
    render,
    shading,
)
from workbench.samples import sample
from workbench.solvers import judge, propose
from workbench.tracker import FaceTracker
from workbench.tracking import FrameContext, FrameObservation, Track
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_programs import (
    look,
    look_derivative,
    points_derivative,
    project_points,
    stage_system,
    term_energies,
)
from workbench.tracking.deep_solver import solve_stage
from workbench.tracking.deep_target import energy_network
from workbench.tracking.deep_views import FAR_MM, eyes_per_box, percent_px
from workbench.tracking.face_it_fitter import FaceItFitter
from workbench.tracking.flow_fitter import FlowFitter
from workbench.tracking.moments import Moment
from workbench.tracking.plan import StagePlan
from workbench.tracking.records import FAILURES, meta_array, stack_fits
from workbench.tracking.reestimation import Reestimator
from workbench.tracking.systems import make_fitter

CROP_SIDE = 256


@pytest.fixture(scope="session")
def shared(head):
    """One fitter whose programs all tests of this file share."""
    return DeepFitter(head, plan_of(DEEP))


@pytest.fixture
def deep(shared):
    return fitter_with(shared, DEEP)


@pytest.fixture
def points(shared):
    """By preselected points: no network, so a solve takes a tenth of a second."""
    return fitter_with(shared, POINTS)


@pytest.fixture(scope="session")
def truth(head):
    """Someone with a smile and an open mouth, 20° and some way off the start."""
    return make_parameters(head, (17.0, -8.0, 6.0), (18.0, -14.0, 600.0), {"mouthSmileLeft": 0.5}, 12.0, seed=3)


@pytest.fixture(scope="session")
def solved(shared, truth):
    """The truth's own render as photo, and all seven stages on it."""
    scene = make_deep_scene(fitter_with(shared, DEEP), truth)
    return scene, shared.solve(shared.problem(scene.observation(), scene.context()))


def plain_colour(view):
    """What is behind a render that has no photo."""
    (colour,) = np.unique(view.surroundings.picture)
    return jnp.full(3, colour, jnp.float32) / 255.0


def planned(**stage) -> StagePlan:
    """A stage as the fitter takes it."""
    return plan_of(DEEP.model_copy(update={"stages": (Stage(**stage),)})).stages[0]


def derivative_of(function, parameters, column, step):
    """Central difference in scaled unknowns."""
    vector, unravel = jax.flatten_util.ravel_pytree(parameters)
    size = typical_sizes(parameters)[column]
    above, below = (np.asarray(function(unravel(vector.at[column].add(sign * step * size))), float) for sign in (1, -1))
    return (above - below) / (2.0 * step)


# The energy.


def test_the_energy_is_the_sum_of_its_terms_as_written_out_here(head, truth):
    """After Sec. 8.1 and 8.2: W on squared errors in units of the view, edges by the lesser W, λ‖w‖² with the jaw
    counted in blendshapes, and the prior."""
    rng = np.random.default_rng(0)
    target, predicted = rng.normal(size=(2, 2, 68, 2)) * 30.0
    importance, unit = rng.uniform(0.0, 2.0, (2, 68)), np.array([1.4, 0.7])
    views = DeepView(*[None] * 3, target, importance, np.ones((2, 68)), unit, None, None)
    parameters = truth._replace(jaw=jnp.array([0.3, 0.05, -0.02, 1.0, 2.0, -3.0]))
    start = make_parameters(head, (10.0, 0.0, 0.0))
    terms = deep_residuals(views, jnp.array([2.0, 0.5, 100.0, 10.0, 3.0]), predicted, parameters, still(start))
    energy = {name: float(residual @ residual) for name, residual in terms.items()}
    error = (predicted - target) / unit[:, None, None]
    difference = np.diff(error, axis=1)
    edge = np.minimum(importance[:, 1:], importance[:, :-1])
    jaw = np.asarray(parameters.jaw)
    turned, moved = (
        np.asarray(getattr(parameters, name) - getattr(start, name)) for name in ("rotation", "translation")
    )
    expected = {
        "landmarks": 2.0 * (importance[..., None] * error**2).sum(),
        "edges": 0.5 * (edge[..., None] * difference**2).sum(),
        "regularisation": 100.0
        * (
            (np.asarray(parameters.expression) ** 2).sum()
            + ((jaw[:3] / np.radians(26.5)) ** 2).sum()
            + ((jaw[3:] / 8.0) ** 2).sum()
        ),
        "identity": 10.0 * (np.asarray(parameters.identity) ** 2).sum(),
        "prior": 3.0 * (100.0**2 * (turned**2).sum() + (moved**2).sum()),
    }
    assert tuple(terms) == DEEP_TERMS
    for name, value in expected.items():
        assert energy[name] == pytest.approx(value, rel=1e-9), name


def test_the_normal_equations_are_those_of_the_residuals(points, truth):
    """Cost, Jᵀr and JᵀJ from landmarks' derivative: as by differentiating everything at once."""
    scene = make_deep_scene(points, truth)
    views = jax.tree.map(lambda part: jnp.asarray(part)[None], points.views(scene.observation(), scene.context())[0])
    start = points.start(np.asarray(truth.identity))
    omega, context = jnp.array([1.0, 0.5, 100.0, 10.0, 1.0]), still(start)
    view = jax.tree.map(lambda part: part[0], views)
    predicted = np.asarray(project_points(points.scene(None), view, start), float)[None]
    derivative = np.asarray(points_derivative(points.scene(None), view, start), float)[None]
    system = stage_system(views, omega, predicted, derivative, start, context)
    energies = np.asarray(term_energies(views, omega, predicted, start, context))
    assert float(system.cost) == pytest.approx(energies.sum())

    def energy(vector):
        moved = unpack(jnp.asarray(vector), start)
        seen = predicted + np.einsum(
            "n,vnij->vij", (np.asarray(vector) - flat(start)) / typical_sizes(start), derivative
        )
        return float(np.asarray(term_energies(views, omega, seen, moved, context)).sum())

    # Landmarks linear in the unknowns: the energy is exactly quadratic.
    rng = np.random.default_rng(1)
    step = rng.normal(size=len(flat(start))) * 0.1 * typical_sizes(start)
    value = float(system.cost) + 2.0 * step @ np.asarray(system.gradient) + step @ np.asarray(system.matrix) @ step
    assert energy(jnp.asarray(flat(start) + step)) == pytest.approx(value, rel=1e-6)


# What the network sees.


@pytest.mark.long
def test_a_rendered_crop_is_seen_as_the_crop_of_a_render(deep, truth):
    """Two routes to N(F): the crop rendered at the network's size, or cut out of the whole picture and shrunk.

    The whole picture is smooth by many samples instead of by its contours: a third way, whose program is small.
    """
    scene = make_deep_scene(deep, truth)
    view, programs = deep.views(scene.observation(), scene.context())[0], deep.scene(None)
    seen = look(programs, view, truth)
    vertices = view_vertices(programs.model, view, truth)
    topology = programs.model.render.topology
    arguments = vertices, topology, view.camera, programs.albedo, view.light, plain_colour(view)
    whole = render(*arguments, size=IMAGE_SIZE, samples=2, antialias=False)
    cut = jax.jit(landmarks_of)(programs.network, whole.color, seen.box).points
    apart = np.linalg.norm(np.asarray(cut) - np.asarray(seen.points), axis=1)
    assert float(seen.box.side) > 300.0
    assert apart.mean() < 0.4  # of a face of 300 px
    assert apart.max() < 2.0


@pytest.mark.long
def test_a_face_that_the_pictures_border_cuts_is_cut_in_its_render_too(deep, truth):
    """The crop is black beyond the picture, in the photo and in the render alike, so that the border cancels out."""
    low = truth._replace(translation=truth.translation + np.array([0.0, 110.0, 0.0]))
    view, programs = deep.views(make_deep_scene(deep, low).observation(), _context(low))[0], deep.scene(None)
    seen = look(programs, view, low)
    rows, columns = np.mgrid[:CROP_SIDE, :CROP_SIDE].reshape(2, -1).astype(float)
    places = np.asarray(to_picture(np.stack([columns, rows], axis=-1), seen.box, CROP_SIDE))
    y = places[:, 1].reshape(CROP_SIDE, CROP_SIDE)
    beyond = y > IMAGE_SIZE[1]
    assert 0.1 < beyond.mean() < 0.6
    np.testing.assert_array_equal(np.asarray(seen.picture)[beyond], 0.0)
    borderless = look(programs, view._replace(image_size=2.0 * view.image_size), low)
    inside = y < IMAGE_SIZE[1] - 1
    np.testing.assert_array_equal(np.asarray(seen.picture)[inside], np.asarray(borderless.picture)[inside])
    assert np.abs(np.asarray(seen.points - borderless.points))[:17].max() > 1.0


def test_the_network_sees_the_model_near_its_preselected_points(deep, truth):
    scene = make_deep_scene(deep, truth)
    view, programs = deep.views(scene.observation(), scene.context())[0], deep.scene(None)
    apart = np.linalg.norm(scene.landmarks[0].points - np.asarray(project_points(programs, view, truth)), axis=1)
    assert apart[17:].mean() < 3.0
    assert 0.1 < apart.mean() < 5.0
    assert np.median(np.asarray(look(programs, view, truth).confidence)) > 0.8


@pytest.mark.parametrize("column", [0, 1, 2, 3, 4, 5, "mouthSmileLeft", "jaw", "scale"])
def test_the_points_derivative_is_that_of_finite_differences(points, truth, column):
    view, programs = points.views(make_deep_scene(points, truth).observation(), _context(truth))[0], points.scene(None)
    column = _column(points, column)
    exact = np.asarray(points_derivative(programs, view, truth))[column]
    near = derivative_of(lambda moved: project_points(programs, view, moved), truth, column, 0.03)
    moves = np.ones(68, bool)
    if column in (0, 1, 2):  # the contour slides along the face; that place is constant in the derivative
        moves[:17] = False
    np.testing.assert_allclose(near[moves], exact[moves], atol=0.02 * np.abs(exact).max() + 0.02)


@pytest.mark.long
def test_the_forward_derivative_is_that_of_a_crop_that_stands_still(deep, truth):
    """D is constant in the derivative (Sec. 4); and it points to where a real step leads, if not exactly there."""
    view, programs = deep.views(make_deep_scene(deep, truth).observation(), _context(truth))[0], deep.scene(None)
    box = look(programs, view, truth).box
    columns = np.array([0, 1, 2, 3, 4, 5, _column(deep, "jaw"), len(flat(truth))])
    forward = np.asarray(look_derivative(programs, view, truth, columns), float)
    assert (forward[-1] == 0.0).all()  # beyond the unknowns: padding
    vector, unravel = jax.flatten_util.ravel_pytree(truth)
    photo = crop_and_resize(jnp.ones((*IMAGE_SIZE[::-1], 1), jnp.float32), box, CROP_SIDE)  # black beyond the picture

    @jax.jit
    def held(vector, tangent):
        def points(vector):
            vertices = view_vertices(programs.model, view, unravel(vector))
            camera = CropCamera(view.camera, box, jnp.float32(CROP_SIDE))
            topology, size = programs.model.render.topology, (CROP_SIDE, CROP_SIDE)
            drawn = render(vertices, topology, camera, programs.albedo, view.light, plain_colour(view), size=size)
            heat_maps = programs.network(photo * jnp.moveaxis(drawn.color, -1, 0))
            return to_picture(soft_argmax(heat_maps), box, heat_maps.shape[-1])

        return jax.jvp(points, (vector,), (tangent,))

    agreement = []
    for column, slope in zip(columns[:-1], forward, strict=False):
        way = jnp.zeros_like(vector).at[column].set(typical_sizes(truth)[column])
        np.testing.assert_allclose(held(vector, way)[1], slope, rtol=0.01, atol=0.01 * np.abs(slope).max())
        ends = [np.asarray(held(vector + sign * way / 2, way)[0], float) for sign in (1.0, -1.0)]
        secant = ends[0] - ends[1]
        agreement.append((secant * slope).sum() / np.linalg.norm(secant) / np.linalg.norm(slope))
    assert min(agreement) > 0.6
    assert np.median(agreement) > 0.8


def _column(fitter, name):
    """Place of an unknown in the flat row."""
    if isinstance(name, int):
        return name
    shapes, people = fitter.model.expression_names, len(fitter.model.identity_deltas)
    if name in shapes:
        return 6 + shapes.index(name)
    return 6 + len(shapes) + people + {"jaw": 0, "scale": 6}[name]


def _context(truth):
    from workbench.tracking import FrameContext

    return FrameContext(0, np.asarray(truth.identity), None, None)


# Other face models.


FAN = object.__new__(Fan)
"""A 3D-FAN of which only the crop is asked."""


def test_the_detectors_weights_may_be_the_network_too():
    assert energy_network("landmarks") is bundled_landmark_network()
    assert energy_network("landmarks") is not energy_network("heat-maps")


def test_an_ensemble_sees_the_geometric_mean_of_what_its_networks_see():
    picture = np.asarray(read_picture(sample("astronaut")), np.float32)[30:286, 96:352].transpose(2, 0, 1) / 255.0
    parts = [energy_network(name) for name in ("heat-maps", "landmarks")]
    both = [np.asarray(jax.nn.softmax(BETA * part(picture).reshape(68, -1)), float) for part in parts]
    mean = np.sqrt(both[0] * both[1])
    ensemble = energy_network("ensemble")
    seen = np.asarray(jax.nn.softmax(BETA * ensemble(picture).reshape(68, -1)), float)
    np.testing.assert_allclose(seen, mean / mean.sum(axis=1, keepdims=True), atol=1e-3)


def test_our_preset_has_the_ensemble_and_the_papers_have_one_network():
    assert preset("deep").deep.network == "ensemble"
    papers = ("deep-energies", "preselected-points", "orthographic")
    assert {preset(name).deep.network for name in papers} == {"heat-maps"}


def test_a_file_of_weights_that_is_written_again_is_read_again(tmp_path):
    file, kinds = tmp_path / "own.safetensors", ("heat_maps", "landmarks")
    for written, kind in enumerate(kinds, start=1):
        shutil.copyfile(BUNDLED / f"{kind}.safetensors", file)
        os.utime(file, (written, written))
        own, bundled = (jax.tree.leaves(energy_network(name)) for name in (str(file), kind.replace("_", "-")))
        assert all(np.array_equal(*pair) for pair in zip(own, bundled, strict=True))
    assert energy_network(str(file)) is energy_network(str(file))


@pytest.mark.parametrize(
    "network",
    [*(energy_network(name) for name in ("heat-maps", "landmarks", "ensemble")), FAN],
    ids=["ours", "the detector's", "both", "3D-FAN"],
)
def test_a_percent_is_one_of_the_models_own_eyes(network, head):
    """As many pixels as ever for the default head and larger ones, more for a face whose eyes are farther apart."""
    neutral = head.landmarks.of(head.neutral)[:, :2]
    side = float((fan_box_of if network is FAN else landmark_crop)(neutral).side)
    eyes = eyes_per_box(head, network)
    assert eyes == 0.726
    assert percent_px(network, eyes, neutral) == 0.01 * 0.726 / 1.6 * side
    assert eyes_per_box(resized(head, 1.3), network) == pytest.approx(0.726, rel=1e-9)
    long = replace(head, neutral=head.neutral * [1.0, 1.2, 1.0])
    wide = replace(head, neutral=head.neutral * [1.2, 1.0, 1.0])
    assert eyes_per_box(long, network) < 0.95 * eyes < 1.05 * eyes < 1.1 * eyes_per_box(wide, network)


def test_a_fit_counts_and_bounds_the_jaw_as_its_model_does(head):
    model = half_open(head)
    fitter = DeepFitter(model, plan_of(POINTS))
    context = FrameContext(0, fitter.mean_identity(), None, None)
    problem = fitter.problem(fitter.neutral_observation(IMAGE_SIZE), context)
    assert problem.history.jaw_unit == problem.scene.model.render.jaw.unit == model.jaw_unit
    stage = fitter._stage_problem(problem, problem.views, planned(name="jaw", free=("jaw",)))
    jaw = slice(_column(fitter, "jaw"), _column(fitter, "jaw") + 6)
    assert np.array([stage.lower[jaw], stage.upper[jaw]]).tolist() == model.jaw_range.tolist()


@pytest.mark.slow
def test_a_small_head_with_a_narrow_jaw_shape_is_fitted_as_well(head):
    """Without λ, which pulls at blendshapes and jaw alike, the jaw opens as far as the truth does."""
    model = half_open(resized(head, 0.8))
    fitter = DeepFitter(model, plan_of(POINTS.changed(deep={"regularisation": 0.0})))
    opened = 0.6 * model.jaw_unit.open_deg
    truth = make_parameters(model, (17.0, -8.0, 6.0), (18.0, -14.0, 600.0), {"mouthSmileLeft": 0.5}, opened, seed=3)
    scene = make_deep_scene(fitter, truth)
    found = fitter.solve(fitter.problem(scene.observation(), scene.context())).parameters
    assert rotation_error_deg(found, truth) < 0.5
    assert np.degrees(float(found.jaw[0])) == pytest.approx(opened, rel=0.05)


# The stages.


def test_the_seven_stages_find_the_truth_from_a_frontal_start(solved, truth):
    scene, solution = solved
    found = solution.parameters
    assert rotation_error_deg(solution.start, truth) > 18.0
    assert rotation_error_deg(found, truth) < 1.5
    assert abs(float(found.translation[2] / truth.translation[2]) - 1.0) < 0.02
    assert abs(np.degrees(float(found.jaw[0] - truth.jaw[0]))) < 3.0
    errors = np.linalg.norm(solution.results[-1].prediction.points[0] - scene.landmarks[0].points, axis=1)
    assert errors.mean() < 1.0


def test_an_open_mouth_no_longer_turns_the_head_once_the_jaw_is_free(solved, truth):
    """Fig. 6: the rigid stages explain the chin by the pose, the jaw stages put that right."""
    names = [stage.name for stage in solved[1].stages]
    rigid = solved[1].results[names.index("rigid, all")].parameters
    assert rotation_error_deg(solved[1].parameters, truth) < rotation_error_deg(rigid, truth)


def test_a_stage_moves_only_what_it_frees(solved, shared):
    before = flat(solved[1].start)
    for stage, result in zip(solved[1].stages, solved[1].results, strict=True):
        after, free = flat(result.parameters), shared.free(stage)
        np.testing.assert_array_equal(after[~free], before[~free], err_msg=stage.name)
        assert (after[free] != before[free]).any(), stage.name
        before = after


def test_no_stage_raises_its_energy_and_none_exceeds_its_limit(solved):
    for stage, result in zip(solved[1].stages, solved[1].results, strict=True):
        assert result.iterations <= stage.limit
        totals = [step.energies.sum() for step in result.path]
        assert (np.diff(totals) <= 0.0).all(), stage.name
        assert totals[-1] == pytest.approx(result.energies.sum())


def test_weights_and_jaw_keep_their_ranges(solved, head):
    for result in solved[1].results:
        expression = np.asarray(result.parameters.expression)
        assert expression.min() >= 0.0
        assert expression.max() <= 1.0
        assert -0.05 <= float(result.parameters.jaw[0]) <= 0.7


def test_a_bound_that_the_energy_pushes_against_is_met_exactly(points, truth):
    scene = make_deep_scene(points, truth)
    stage = planned(name="jaw", free=("jaw_open",), limit=20)
    views = points.views(scene.observation(), scene.context(), stage)
    start = truth._replace(jaw=jnp.zeros(6))
    given = replace(points.problem(scene.observation(), scene.context()), history=still(truth))
    problem = points._stage_problem(given, views, stage)
    column = _column(points, "jaw")
    upper = problem.upper.copy()
    upper[column] = 0.1
    assert float(solve_stage(problem, start).parameters.jaw[0]) == pytest.approx(float(truth.jaw[0]), abs=2e-3)
    assert float(solve_stage(replace(problem, upper=upper), start).parameters.jaw[0]) == 0.1


def test_a_start_outside_the_bounds_is_put_on_them_and_fitted_from_there(points, truth):
    """As a track without bounds has it: there the energy is low, and any step into the bounds raises it."""
    smile, funnel = (_column(points, name) - 6 for name in ("mouthSmileLeft", "mouthFunnel"))
    unbounded = truth._replace(expression=truth.expression.at[smile].set(1.5))
    scene = make_deep_scene(points, unbounded._replace(expression=unbounded.expression.at[funnel].set(0.4)))
    stage = planned(name="weights", free=("expression",), limit=20)
    views = points.views(scene.observation(), scene.context(), stage)
    problem = points._stage_problem(points.problem(scene.observation(), scene.context()), views, stage)
    weights = slice(6, 6 + len(truth.expression))
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[weights], upper[weights] = 0.0, 1.0
    found = solve_stage(replace(problem, lower=lower, upper=upper), unbounded).parameters.expression
    assert found.min() >= 0.0
    assert found[smile] == 1.0
    assert found[funnel] > 0.2


def test_lambda_pulls_the_weights_and_the_jaw_to_rest(points, truth):
    scene = make_deep_scene(points, truth)
    sizes = []
    for weight in (0.0, 1e3, 1e5):
        fitter_with(points, POINTS.changed(deep={"regularisation": weight}))
        found = points.solve(points.problem(scene.observation(), scene.context())).parameters
        sizes.append(np.linalg.norm(found.expression) + abs(float(found.jaw[0])) / points.model.jaw_unit.vector[0])
    assert sizes[0] > sizes[1] > sizes[2]
    assert sizes[2] < 0.1


def test_the_prior_holds_the_pose_that_a_stage_starts_from(points, truth):
    scene = make_deep_scene(points, truth)
    stages = [Stage(name="pose", free=("rotation", "translation"), terms=("prior",), limit=20).model_dump()]
    moved = []
    for weight in (0.0, 10.0, 1e6):
        fitter_with(points, POINTS.changed(deep={"prior": weight}, stages=stages))
        found = points.solve(points.problem(scene.observation(), scene.context())).parameters
        moved.append(float(jnp.linalg.norm(found.rotation)))
    assert moved[0] > moved[1] > moved[2]
    assert moved[2] < 0.01


def test_the_options_are_one_energy(shared, truth):
    """Points, deep and mixed: a share per landmark between two predictions of the same parameters."""
    seen = {}
    for energy in ("deep", "points", "mixed"):
        fitter = fitter_with(shared, DEEP.changed(deep={"energy": energy}))
        scene = make_deep_scene(fitter, truth)
        doubtful = replace(scene.landmarks[0], confidence=np.linspace(0.0, 1.0, 68))
        view = fitter.views(replace(scene.observation(), landmarks=doubtful), scene.context())[0]
        seen[energy] = scene.landmarks[0].points, np.asarray(view.share)
    np.testing.assert_array_equal(seen["deep"][1], 1.0)
    np.testing.assert_array_equal(seen["points"][1], 0.0)
    np.testing.assert_array_equal(seen["mixed"][1], np.linspace(0.0, 1.0, 68))
    np.testing.assert_allclose(seen["mixed"][0], seen["deep"][0])  # all certain: the network's


def test_muted_landmarks_have_no_say(points, truth):
    scene = make_deep_scene(points, truth)
    wrong = scene.landmarks[0].points.copy()
    wrong[17:27] += 60.0
    observation = replace(scene.observation(), landmarks=replace(scene.landmarks[0], points=wrong))
    fooled = points.solve(points.problem(observation, scene.context())).parameters
    fitter_with(points, POINTS.changed(landmarks={"weights": {"brows": 0.0}}))
    told = points.solve(points.problem(observation, scene.context())).parameters
    assert rotation_error_deg(told, truth) < 1.0 < rotation_error_deg(fooled, truth)


def test_a_fit_does_not_depend_on_other_frames(points, truth, head):
    one = make_deep_scene(points, truth)
    other = make_deep_scene(points, make_parameters(head, (-20.0, 5.0, 0.0), (-30.0, 10.0, 700.0), seed=3))
    fits = [points.fit(scene.observation(), scene.context())[0] for scene in (one, other, one)]
    np.testing.assert_array_equal(fits[0].rotation, fits[2].rotation)
    np.testing.assert_array_equal(fits[0].jaw, fits[2].jaw)
    assert not np.array_equal(fits[0].rotation, fits[1].rotation)


@pytest.mark.long
@pytest.mark.parametrize("derivative", ["forward", "differences"])
def test_other_derivatives_of_the_network_find_the_pose_too(shared, solved, truth, derivative):
    scene, _ = solved
    fitter = fitter_with(shared, DEEP.changed(deep={"derivative": derivative}, stages=_dumped(POSE_ONLY, limit=6)))
    near = truth._replace(rotation=truth.rotation + 0.08, translation=truth.translation + jnp.array([4.0, 3.0, 15.0]))
    found = fitter.solve(fitter.problem(scene.observation(), scene.context()._replace(start=near))).parameters
    assert rotation_error_deg(near, truth) > 6.0
    assert rotation_error_deg(found, truth) < 2.0


def _dumped(stages, **changes):
    return [{**stage.model_dump(), **changes} for stage in stages]


def test_moving_numbers_compiles_nothing(shared, solved):
    scene, _ = solved
    programs = (look, project_points, points_derivative, stage_system, term_energies, propose, judge)
    config = DEEP.changed(stages=_dumped(DEEP.stages[:1], limit=2))
    fitter = fitter_with(shared, config)
    fitter.fit(scene.observation(), scene.context())
    before = [program._cache_size() for program in programs]
    changes = (
        {"deep": {"edges": 2.0, "regularisation": 3.0, "prior": 0.2, "identity": 1.0, "tolerance": 0.1}},
        {"deep": {"energy": "points"}, "camera": {"fov_deg": 50.0}, "contour": {"mode": "fixed"}},
        {"deep": {"energy": "mixed", "distance_mm": 700.0}, "landmarks": {"weights": {"eyes": 0.3}}},
        {"solver": {"unit": "px", "bounded": False}},
        {"stages": _dumped(DEEP.stages[4:5], limit=3, landmarks={"all": 0.5, "8": 4.0})},
    )
    for change in changes:
        config = config.changed(**change)
        fitter.configure(plan_of(config))
        fitter.fit(scene.observation(), scene.context())
    assert [program._cache_size() for program in programs] == before


# Failure is a result.


def test_a_good_fit_has_no_failure(points, truth):
    scene = make_deep_scene(points, truth)
    fit, _ = points.fit(scene.observation(), scene.context())
    assert (fit.found, fit.failure) == (True, "")


def test_a_jaw_elsewhere_than_the_face_is_a_disagreement(points, truth):
    """A contour that caught on a collar: the face is met, the jaw is not."""
    scene = make_deep_scene(points, truth)
    wrong = scene.landmarks[0].points.copy()
    wrong[:17] += [90.0, 0.0]
    observation = replace(scene.observation(), landmarks=replace(scene.landmarks[0], points=wrong))
    fitter_with(points, POINTS.changed(landmarks={"weights": {"jaw": 0.01}}))
    assert points.fit(observation, scene.context())[0].failure == FAILURES[1]


def test_landmarks_that_no_face_has_leave_a_large_error(points, truth):
    scene = make_deep_scene(points, truth)
    wrong = scene.landmarks[0].points + np.random.default_rng(0).normal(0.0, 15.0, (68, 2))
    observation = replace(scene.observation(), landmarks=replace(scene.landmarks[0], points=wrong))
    assert points.fit(observation, scene.context())[0].failure == FAILURES[2]


def test_the_ranges_of_failure_are_configured(points, truth):
    scene = make_deep_scene(points, truth)
    fitter_with(points, POINTS.changed(deep={"largest_error": 0.0}))
    assert points.fit(scene.observation(), scene.context())[0].failure == FAILURES[2]


def test_a_frame_without_a_face_is_empty(points, truth):
    observation = replace(make_deep_scene(points, truth).observation(), landmarks=None)
    fit, _ = points.fit(observation, _context(truth))
    assert not fit.found
    assert np.isnan(fit.rotation).all()
    assert np.isnan(fit.jaw).all()
    assert fit.energies.shape == (7, len(DEEP_TERMS))
    with pytest.raises(InputError, match="no landmarks"):
        points.explain(observation, _context(truth))


# Several cameras.


@pytest.fixture(scope="session")
def rig_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    write_rig(make_rig((0.0, 30.0), 650.0, IMAGE_SIZE, 40.0), path)
    return path


def _stereo_scene(fitter, head, noise_px=0.0, seed=0):
    scene = make_deep_scene(fitter, make_parameters(head, (12.0, -6.0, 4.0), (10.0, -8.0, 620.0), jaw_deg=8.0, seed=4))
    rng = np.random.default_rng(seed)
    noisy = [replace(seen, points=seen.points + rng.normal(0.0, 1.0, (68, 2)) * noise_px) for seen in scene.landmarks]
    return replace(scene, landmarks=tuple(noisy))


def test_two_views_find_the_truth_and_place_it_better_than_one(shared, head, rig_file):
    """Noise of 1.5 px: the second camera sees the first one's depth from the side."""
    errors = {1: [], 2: []}
    for seed in range(3):
        fitter = fitter_with(shared, POINTS.changed(camera={"rig": str(rig_file)}))
        scene = _stereo_scene(fitter, head, 1.5, seed)
        truth = scene.parameters
        two = fitter.solve(fitter.problem(scene.observation(), scene.context())).parameters
        fitter_with(shared, POINTS)
        alone = replace(scene.observation(), others=())
        one = fitter.solve(fitter.problem(alone, scene.context())).parameters
        for views, found in ((1, one), (2, two)):
            errors[views].append(float(jnp.linalg.norm(found.translation - truth.translation)))
            assert rotation_error_deg(found, truth) < 2.0
    assert np.mean(errors[2]) < 0.5 * np.mean(errors[1])


def test_reestimation_looks_at_all_views_of_a_rig(shared, head, rig_file):
    """App. B.1 on a stored fit: with landmarks of the other view alone, and of both, the jaw is found again."""
    config = POINTS.changed(camera={"rig": str(rig_file)})
    fitter = fitter_with(shared, config)
    scene = _stereo_scene(fitter, head)
    fit, _ = fitter.fit(scene.observation(), scene.context())
    assert fit.others.shape == (1, 68, 3)
    np.testing.assert_array_equal(fit.others[0, :, :2], scene.landmarks[1].points)
    shut = replace(fit, jaw=np.zeros(6), rotation=np.array(scene.parameters.rotation),
                   translation=np.array(scene.parameters.translation))  # fmt: skip
    hidden = replace(shut, confidence=np.zeros(68))
    again = Reestimator(head, plan_of(config))
    for before in (shut, hidden):
        (found,) = (moment.fit for moment in again.stream([Moment(before, ())]))
        np.testing.assert_array_equal(found.rotation, before.rotation)
        assert np.degrees(found.jaw[0]) == pytest.approx(8.0, abs=1.5)
    with pytest.raises(InputError, match="The track has landmarks of 3 views, but the rig has 2"):
        again.fit(Moment(replace(shut, others=np.zeros((2, 68, 3))), ()))
    older = [replace(each, others=np.zeros((0, 68, 3))) for each in (shut, hidden)]
    found = [moment.fit for moment in again.stream(Moment(each, ()) for each in older)]
    assert found[1] is older[1]
    assert np.degrees(found[0].jaw[0]) == pytest.approx(8.0, abs=1.5)
    assert [len(each.others) for each in found] == [0, 0]  # so that a track of both can be written


def test_a_view_without_a_detection_drops_out(shared, head, rig_file):
    fitter = fitter_with(shared, POINTS.changed(camera={"rig": str(rig_file)}))
    scene = _stereo_scene(fitter, head)
    half = fitter.fit(replace(scene.observation(), others=(None,)), scene.context())[0]
    fitter_with(shared, POINTS)
    alone = fitter.fit(replace(scene.observation(), others=()), scene.context())[0]
    np.testing.assert_allclose(half.translation, alone.translation, atol=1e-3)
    np.testing.assert_allclose(half.rotation, alone.rotation, atol=1e-5)
    fitter_with(shared, POINTS.changed(camera={"rig": str(rig_file)}))
    other = fitter.fit(replace(scene.observation(), landmarks=None), scene.context())[0]
    assert other.found
    assert not other.confidence.any()
    assert other.landmarks is None  # what stands for them is the model's own
    np.testing.assert_allclose(other.rotation, np.asarray(scene.parameters.rotation), atol=0.03)


def test_scaled_down_pictures_of_a_rig_give_the_same_head(shared, head, rig_file):
    """Half the size in the one view, a third in the other: each view's camera is that of its pictures."""
    fitter = fitter_with(shared, POINTS.changed(camera={"rig": str(rig_file)}))
    scene = _stereo_scene(fitter, head)
    whole = fitter.fit(scene.observation(), scene.context())[0]
    first, second = (_scaled_down(seen, by) for seen, by in zip(scene.landmarks, (2, 3), strict=True))
    small = FrameObservation(0, first, first.image_size, others=(second,))
    found = fitter.fit(small, scene.context())[0]
    np.testing.assert_allclose(found.translation, whole.translation, atol=0.01)
    np.testing.assert_allclose(found.rotation, whole.rotation, atol=1e-4)
    np.testing.assert_allclose(found.camera.focal_px, whole.camera.focal_px / 2)
    shut = replace(found, jaw=np.zeros(6))
    pictures = tuple(np.zeros((height, width, 3), np.uint8) for width, height in ((360, 270), (240, 180)))
    again = Reestimator(head, fitter.plan).fit(Moment(shut, pictures))
    assert np.degrees(again.jaw[0]) == pytest.approx(8.0, abs=1.5)
    cameras = FlowFitter(head, fitter.plan).views(found, pictures).camera
    np.testing.assert_allclose(cameras.focal_px, whole.camera.focal_px / np.array([[2.0], [3.0]]))
    cut = FrameObservation(0, replace(first, image_size=(270, 270)), (270, 270), others=(second,))
    with pytest.raises(InputError, match="not scaled copies"):
        fitter.fit(cut, scene.context())


def _scaled_down(seen, by):
    size = tuple(length // by for length in seen.image_size)
    return Landmarks2D((seen.points + 0.5) / by - 0.5, seen.confidence, size)


def test_identity_and_start_come_through_the_rigs_first_camera(shared, head, tmp_path):
    """Its lens is known: neither a guessed field of view nor a free size of the head takes its place."""
    write_rig(make_rig((0.0, 30.0), 1300.0, IMAGE_SIZE, 20.0), tmp_path / "rig.toml")
    config = preset("deep-points").changed(
        camera={"rig": str(tmp_path / "rig.toml")}, deep={"start": "landmarks", "appearance": "model"}
    )
    fitter = fitter_with(shared, config)
    scene = make_deep_scene(fitter, make_parameters(head, (10.0, 0.0, 0.0), (30.0, 10.0, 1300.0)))
    start = fitter.problem(scene.observation(), scene.context()).start
    np.testing.assert_allclose(start.translation, scene.parameters.translation, rtol=0.03, atol=10.0)
    assert fitter.plan.by_points.identity == fitter.plan.identity


@pytest.mark.long
def test_frames_that_only_another_view_sees_wait_for_the_face_shape(head, rig_file):
    """The reference view's first face brings it; where none comes within a window, they are fitted without."""
    brief = {"window": 2, "frames": 2}
    config = POINTS.changed(camera={"rig": str(rig_file)}, identity=brief, stages=POSE_ONLY)
    tracker = FaceTracker(head, config)
    scene = _stereo_scene(tracker.fitter, head)
    seen = [scene.observation(k) for k in range(6)]
    aside = [replace(each, landmarks=None) for each in seen]
    assert not list(tracker.prepare(aside[0]))
    assert not list(tracker.prepare(seen[1]))
    shapes = [context.identity for _, context in tracker.prepare(seen[2])]
    assert len(shapes) == 3
    assert all(np.array_equal(shape, shapes[-1]) and shape.any() for shape in shapes)
    tracker = FaceTracker(head, config)
    assert [len(list(tracker.prepare(each))) for each in aside[:4]] == [0, 2, 0, 2]


def test_a_rig_wants_landmarks_of_every_view(shared, head, rig_file):
    fitter = fitter_with(shared, POINTS.changed(camera={"rig": str(rig_file)}))
    scene = _stereo_scene(fitter, head)
    with pytest.raises(InputError, match="one clip for each view"):
        fitter.fit(replace(scene.observation(), others=()), scene.context())


def test_a_rigs_views_are_lit_by_one_light(shared, head, tmp_path):
    """What a white face would show at each vertex is the same in all views, wherever a view has its axes."""
    write_rig(make_rig((0.0, 60.0, -35.0), 650.0, IMAGE_SIZE, 40.0), tmp_path / "rig.toml")
    fitter = fitter_with(shared, POINTS.changed(camera={"rig": str(tmp_path / "rig.toml")}))
    lamp = ambient_light(0.3) + directional_light((-1.0, -0.7, -0.4), 0.7)
    appearance = Appearance(np.asarray(fitter.scene(None).albedo), lamp, np.ones(len(head.neutral)), 0.0)
    seen = make_deep_scene(fitter, make_parameters(head))
    views = fitter.views(seen.observation(), seen.context()._replace(appearance=appearance))
    sums = corner_sum(head.triangles, len(head.neutral))
    normals = vertex_normals(head.neutral, head.triangles, sums)
    shown = [np.stack(shading(view.light, tuple((normals @ np.asarray(view.rotation).T).T))) for view in views]
    assert shown[0].std() > 0.1
    for other in shown[1:]:
        np.testing.assert_allclose(other, shown[0], atol=1e-4)


# Views without perspective.


@pytest.mark.filterwarnings("ignore:The stages free first")
def test_the_parallel_view_finds_rotation_scale_place_and_shape(shared, head):
    """Appendix C.2 on a truth seen by that very camera: four stages from the mean face."""
    config = preset("deep-parallel").changed(camera={"fov_deg": 40.0}, deep={"energy": "points"})
    fitter = fitter_with(shared, config)
    truth = make_parameters(head, (14.0, -6.0, 5.0), (12.0, -9.0, 650.0))
    shape = np.zeros(len(truth.identity))
    shape[:3] = 1.0, -0.7, 0.5
    truth = truth._replace(scale=jnp.array([1.1]), identity=jnp.asarray(shape))
    scene = make_deep_scene(fitter, truth)
    mean = scene.context()._replace(identity=fitter.mean_identity())
    fit, _ = fitter.fit(scene.observation(), mean)
    assert len(fit.energies) == len(PARALLEL_STAGES)
    assert fit.failure == ""
    assert np.degrees(np.linalg.norm(fit.rotation - np.asarray(truth.rotation))) < 2.0
    assert fit.scale == pytest.approx(1.1, rel=0.05)  # some of a head's size is in its shape
    np.testing.assert_allclose(fit.translation[:2], truth.translation[:2], atol=1.5)
    assert fit.errors[0] < 1.0
    assert not fit.identity[10:].any()
    assert not fit.expression[10:].any()


@pytest.mark.filterwarnings("ignore:The stages free first")
def test_a_fit_that_starts_from_parameters_starts_from_their_scale(shared, head):
    """As a re-estimation does, which holds the pose: in a parallel view the scale is a part of it."""
    fitter = fitter_with(shared, preset("deep-parallel").changed(camera={"fov_deg": 40.0}, deep={"energy": "points"}))
    truth = make_parameters(head, (14.0, -6.0, 5.0), (12.0, -9.0, 650.0))._replace(scale=jnp.array([1.3]))
    scene = make_deep_scene(fitter, truth)
    begun = fitter.problem(scene.observation(), scene.context()._replace(start=truth)).start
    assert np.asarray(begun.scale).tolist() == [1.3]
    without = truth._replace(scale=np.zeros(0))
    assert np.asarray(fitter.problem(scene.observation(), scene.context()._replace(start=without)).start.scale) == 1.0


@pytest.mark.filterwarnings("ignore:The stages free first")
def test_a_parallel_view_is_recorded_as_a_camera_far_away(shared, head):
    config = preset("deep-parallel").changed(camera={"fov_deg": 40.0}, deep={"energy": "points"})
    fitter = fitter_with(shared, config)
    truth = make_parameters(head, (14.0, -6.0, 5.0), (12.0, -9.0, 650.0))
    scene = make_deep_scene(fitter, truth)
    assert isinstance(fitter.views(scene.observation(), scene.context())[0].camera, OrthographicCamera)
    fit, _ = fitter.fit(scene.observation(), scene.context())
    assert fit.translation[2] == FAR_MM
    person = fitter.model.personal(fit.identity)
    nose = person.vertices(fit.expression)[person.landmarks.vertices[30]]
    nose = (nose * person.landmarks.barycentric[30][:, None]).sum(axis=0) * fit.scale
    seen = project(fit.camera, nose[None] @ np.asarray(rotation_matrix(fit.rotation)).T + fit.translation)
    np.testing.assert_allclose(np.asarray(seen)[0], fit.projected[30], atol=0.3)


# Configuration.


def test_stages_free_named_blendshapes_and_parts_of_the_jaw(deep):
    names = deep.model.expression_names
    mouth = deep.free(planned(name="m", free=("expression", "jaw_open"), shapes=("mouth",)))
    assert mouth[6 : 6 + len(names)].tolist() == [name.startswith("mouth") for name in names]
    assert mouth[_column(deep, "jaw") : _column(deep, "jaw") + 6].tolist() == [True, *[False] * 5]
    ten = deep.free(planned(name="s", free=("identity",), shapes=("first:10",)))
    assert ten.sum() == 10
    assert not ten[: 6 + len(names)].any()
    assert deep.free(planned(name="r", free=("rotation", "translation", "scale"))).sum() == 7


def test_unknown_blendshapes_are_refused(deep):
    with pytest.raises(ConfigError, match=r"'odd' frees the blendshapes 'brow_up'.*does not have; name blendshapes"):
        deep.free(planned(name="odd", free=("expression",), shapes=("brow_up",)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"stages": _dumped((Stage(name="j", free=("jaw",)),))}, "stage 'j' frees 'jaw', which needs system"),
        ({"camera": {"projection": "orthographic"}}, "an orthographic camera needs system"),
    ],
)
def test_face_it_has_neither_jaw_nor_parallel_views(change, words):
    with pytest.raises(ConfigError, match=words):
        preset("joint").changed(**change)


def test_face_it_looks_through_the_rigs_first_camera(head, rig_file):
    camera = read_rig(rig_file).views[0].camera
    fitter = FaceItFitter(head, plan_of(preset("joint").changed(camera={"rig": str(rig_file)})))
    seen = fitter.plan.camera.of(read_rig(rig_file).views[0].image_size)
    np.testing.assert_array_equal(seen.focal_px, camera.focal_px)
    assert not preset("joint").changed(camera={"rig": str(rig_file)}).camera.guessed


@pytest.mark.filterwarnings("ignore:The stages free first")
def test_a_rig_has_perspective_cameras(head, rig_file):
    with pytest.raises(ConfigError, match="rig's cameras are perspective"):
        make_fitter(head, plan_of(preset("deep-parallel").changed(camera={"rig": str(rig_file)})))


def test_presets_of_both_systems_survive_their_file(tmp_path):
    from workbench.config import read_config, write_config

    for name in PRESETS:
        write_config(preset(name), tmp_path / "config.toml")
        assert read_config(tmp_path / "config.toml") == preset(name)
    assert isinstance(preset("deep"), Config)


# Records.


@pytest.fixture
def tracked(head, points, truth):
    """Two frames by the tracker, the second without a face, the third wrong."""
    scene = make_deep_scene(points, truth)
    wrong = replace(scene.landmarks[0], points=scene.landmarks[0].points[::-1].copy())
    observations = [
        scene.observation(0),
        replace(scene.observation(1), landmarks=None),
        replace(scene.observation(2), landmarks=wrong),
    ]
    tracker = FaceTracker(head, POINTS.changed(identity={"calibrate": False}))
    return list(tracker.fit_all(observations))


def test_a_track_keeps_jaw_scale_and_failure(head, tracked, tmp_path):
    names = list(head.expression_names)
    meta = {"format": "face-energy-workbench-track", "format_version": 2, "expression_names": names}
    Track(**stack_fits(tracked), meta=meta).save(tmp_path / "track.npz")
    loaded = Track.load(tmp_path / "track.npz")
    for before, after in zip(tracked, loaded, strict=False):
        np.testing.assert_array_equal(after.jaw, before.jaw)
        assert (after.failure, after.scale) == (before.failure, before.scale)
    assert loaded[2].failure != ""
    assert np.isnan(loaded[1].jaw).all()


def test_a_track_from_before_the_jaw_loads(head, tracked, tmp_path):
    arrays = stack_fits(tracked)
    for name in ("jaw", "scale", "failure"):
        del arrays[name]
    meta = meta_array({"expression_names": list(head.expression_names)})
    np.savez_compressed(tmp_path / "old.npz", meta=meta, **arrays)
    loaded = Track.load(tmp_path / "old.npz")
    assert not loaded.jaw.any()
    assert (loaded.scale == 1.0).all()
    assert [loaded[k].failure for k in range(3)] == ["", "", ""]


def test_explaining_shows_every_step_of_every_stage(points, truth):
    scene = make_deep_scene(points, truth)
    fit, traces = points.explain(scene.observation(), scene.context())
    assert [trace.stage for trace in traces] == [stage.name for stage in POINTS.stages if stage.enabled]
    for trace, energies in zip(traces, fit.energies, strict=True):
        assert trace.energies.shape[1] == len(DEEP_TERMS)
        np.testing.assert_allclose(trace.energies[-1], energies)
    np.testing.assert_allclose(traces[-1].residuals_px[-1], fit.residuals_px, atol=1e-9)


def test_starting_from_landmarks_begins_near_the_truth(points, truth):
    scene = make_deep_scene(points, truth)
    fitter_with(points, POINTS.changed(deep={"start": "landmarks"}))
    begun = points.solve(points.problem(scene.observation(), scene.context())).start
    assert rotation_error_deg(begun, truth) < 6.0


@pytest.mark.filterwarnings("ignore:The stages free first")
def test_without_perspective_the_landmarks_start_is_as_large_and_where_the_face_is(shared, head):
    """A head at twice the preset's distance, off the middle: it is half as large as one at that distance."""
    fitter = fitter_with(
        shared, preset("deep-parallel").changed(camera={"fov_deg": FOV_DEG}, deep={"start": "landmarks"})
    )
    neutral = head.landmarks.of(head.neutral)
    points = np.asarray(project(camera_from_fov(IMAGE_SIZE, FOV_DEG), neutral + np.array([150.0, -50.0, 1200.0])))
    seen = FrameObservation(0, Landmarks2D(points, np.ones(68), IMAGE_SIZE), IMAGE_SIZE)
    problem = fitter.problem(seen, FrameContext(0, fitter.mean_identity(), None, None))
    start = np.asarray(project_points(problem.scene, problem.views[0], problem.start))
    assert np.linalg.norm(start - points, axis=1).mean() < 0.1 * np.linalg.norm(points[36] - points[45])


def test_a_cancelled_solve_stops_where_it_is(points, truth):
    scene = make_deep_scene(points, truth)
    solution = points.solve(points.problem(scene.observation(), scene.context()), cancelled=lambda: True)
    np.testing.assert_array_equal(flat(solution.parameters), flat(solution.start))


def test_the_image_size_compiles_nothing(points, truth):
    scene = make_deep_scene(points, truth)
    before = project_points._cache_size()
    larger = Landmarks2D(2.0 * scene.landmarks[0].points, np.ones(68), (1440, 1080))
    observation = replace(scene.observation(), landmarks=larger, image_size=(1440, 1080))
    fit, _ = points.fit(observation, scene.context())
    assert project_points._cache_size() == before
    assert rotation_error_deg(truth._replace(rotation=fit.rotation), truth) < 1.5
