"""Deep Energies as printed: the paper's formulas (`tests.paper_formulas`) against the workbench, values and gradients.

Random heat maps, landmarks, poses and flows. Where the workbench departs from the paper, a test says by how much
exactly, and compares after that conversion. Renders are in single precision, as are networks: 1e-4 there, else 1e-9.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests import paper_formulas as paper
from tests.paper_formulas import agrees
from workbench.config import preset
from workbench.energies import EnergyConstants, still
from workbench.energies.deep import DeepView, deep_residuals
from workbench.energies.flow import (
    FlowWeights,
    choose_surface,
    flow_distances,
    flow_residuals,
    points_in_views,
)
from workbench.energies.flow_link import FlowTargets, FlowView
from workbench.face import USUAL_JAW, FaceParameters, JawJoint, move_jaw, pack, unpack
from workbench.flow import surface_points
from workbench.frames import read_picture
from workbench.geometry import Camera, camera_from_fov, rotation_matrix
from workbench.networks import BETA, CropBox, crop_and_resize, landmarks_of, soft_argmax, to_picture
from workbench.planning import plan_of
from workbench.rendering import OrthographicCamera, face_vertices, render_model
from workbench.rendering.camera import to_screen
from workbench.samples import sample
from workbench.tracking.deep_target import bundled_heat_maps
from workbench.tracking.flow_fitter import FlowFitter
from workbench.tracking.interpolation import averaged, between

SINGLE = 1e-4
"""Relative, where renders or networks in single precision are inside."""
DEFAULTS = EnergyConstants()
MAP = 64
"""Pixels a side of the network's heat maps."""


@pytest.fixture(params=range(3))
def rng(request) -> np.random.Generator:
    return np.random.default_rng(request.param)


def parameters(rng, shapes=4, **parts) -> FaceParameters:
    """Unknowns of a frame, the jaw among them."""
    drawn = {
        "rotation": rng.normal(0.0, 0.4, 3),
        "translation": rng.normal((0.0, 0.0, 600.0), 20.0),
        "expression": rng.uniform(-0.2, 1.2, shapes),
        "identity": np.zeros(0),
        "jaw": rng.normal(0.0, 0.1, 6),
        "scale": np.ones(1),
    }
    return FaceParameters(**{name: jnp.asarray(part) for name, part in (drawn | parts).items()})


# The face (Sec. 3).


def test_the_jaw_joint_is_linear_blend_skinning(rng):
    points, share, pivot = rng.normal(0.0, 50.0, (30, 3)), rng.uniform(0.0, 1.0, 30), rng.normal(0.0, 20.0, 3)
    jaw = rng.normal(0.0, 0.3, 6)
    joint = JawJoint(share, pivot, np.zeros((0, 3)), np.zeros((30, 3)))

    def expected(jaw):
        return paper.skinned(points, share, pivot, paper.rotation(jaw[:3]), jaw[3:]).ravel()

    def ours(jaw):
        return move_jaw(joint, jnp.asarray(points), jnp.zeros(0), jaw).ravel()

    assert agrees(ours(jnp.asarray(jaw)), expected(jaw))
    assert agrees(jax.jacfwd(ours)(jnp.asarray(jaw)).T, paper.gradient(expected, jaw))


def test_the_jaws_corrective_is_added_in_proportion_to_the_angle(rng):
    """The paper has blendshapes and the joint alone. Ours adds one fixed displacement per opening angle."""
    points, share, corrective = rng.normal(0.0, 50.0, (30, 3)), rng.uniform(0.0, 1.0, 30), rng.normal(size=(30, 3))
    jaw, pivot = rng.normal(0.0, 0.3, 6), np.zeros(3)
    moved = move_jaw(JawJoint(share, pivot, np.zeros((0, 3)), corrective), points, np.zeros(0), jnp.asarray(jaw))
    skinned = paper.skinned(points, share, pivot, paper.rotation(jaw[:3]), jaw[3:])
    assert agrees(moved, skinned + np.degrees(jaw[0]) / USUAL_JAW.open_deg * corrective)


def test_the_rendered_head_is_eq_1(head, rng):
    """x_R = R(θ)·x(w) + t; θ is an angle-axis vector here, three Euler angles in the paper: the same rotations."""
    theta = rng.uniform(-0.7, 0.7, 3)
    turn = Rotation.from_euler("xyz", theta)
    at = parameters(rng, len(head.expression_names), identity=np.zeros(len(head.identity_deltas)), jaw=np.zeros(6))
    at = at._replace(rotation=jnp.asarray(turn.as_rotvec()), expression=jnp.zeros(len(head.expression_names)))
    expected = paper.rigid(head.neutral, turn.as_matrix(), np.asarray(at.translation))
    assert agrees(face_vertices(render_model(head), at), expected, SINGLE)


def test_the_parallel_projection_is_a_scale_and_a_shift(rng):
    """App. C.2. Ours scales the head and looks at it with a camera of fixed scale: the product is the paper's."""
    points, scale, shift = rng.normal(0.0, 80.0, (40, 3)), rng.uniform(0.5, 3.0), rng.uniform(100.0, 400.0, 2)
    head_scale = rng.uniform(0.5, 2.0)
    seen = to_screen(OrthographicCamera(np.full(2, scale), shift), jnp.asarray(head_scale * points)).pixels
    assert agrees(seen, paper.orthographic(points, scale * head_scale, shift), SINGLE)
    slope = jax.jacfwd(lambda point: to_screen(OrthographicCamera(np.full(2, scale), shift), point[None]).pixels[0])
    expected = paper.gradient(lambda point: paper.orthographic(point, scale, shift), points[0])
    assert agrees(slope(jnp.asarray(points[0])).T, expected, SINGLE)


# What the network sees (Sec. 4).


def heat_maps(rng, count=5, side=MAP) -> np.ndarray:
    """Noise with one bump a map, away from the border."""
    maps = rng.uniform(0.0, 0.05, (count, side, side))
    for k, (row, column) in enumerate(rng.integers(2, side - 2, (count, 2))):
        maps[k, row - 1 : row + 2, column - 1 : column + 2] += rng.uniform(0.1, 0.2, (3, 3))
    return maps


def test_the_soft_argmax_is_eq_3(rng):
    maps = heat_maps(rng)
    assert BETA == paper.BETA
    assert agrees(soft_argmax(jnp.asarray(maps)), np.array([paper.soft_argmax(one) for one in maps]))


def test_the_soft_argmax_has_the_derivative_of_eq_3(rng):
    """With the place of the maximum held, as an argmax has no derivative."""
    (one,) = heat_maps(rng, 1, 9)
    slopes = jax.jacrev(lambda values: soft_argmax(values.reshape(1, 9, 9))[0])(jnp.asarray(one.ravel()))
    assert agrees(slopes.T, paper.gradient(lambda values: paper.soft_argmax(values.reshape(9, 9)), one.ravel()))


def whole_pixels(rng, side: int) -> tuple[tuple[int, int, int, int], CropBox]:
    """A square of whole pixels inside of a picture: as edges, and as the workbench has it."""
    left, top = (int(value) for value in rng.integers(2, 20, 2))
    # The centre of pixel k is at k: a box of pixels 0 and 1 is centred at 0.5.
    centre = np.array([left, top]) + 0.5 * side - 0.5
    return (left, top, left + side, top + side), CropBox(centre, np.float64(side), np.float64(0.0))


@pytest.mark.parametrize("side", [64, 48], ids=["by whole numbers", "between pixels"])
def test_crop_and_resize_are_c_and_s_and_linear(rng, side):
    """Shrunk, every sample lies between pixels of the crop: C and S literally. Both are linear in the picture, so
    that the derivative of one picture by another is the crop of that other one."""
    picture, tangent = rng.uniform(size=(2, 90, 90, 1))
    edges, box = whole_pixels(rng, side)

    def ours(picture):
        return crop_and_resize(picture, box, 32)[0]

    seen, pushed = jax.jvp(ours, (jnp.asarray(picture),), (jnp.asarray(tangent),))
    assert agrees(seen, paper.resize(paper.crop(picture[..., 0], edges), 32))
    assert agrees(pushed, paper.resize(paper.crop(tangent[..., 0], edges), 32))


def test_an_enlarged_crop_reads_the_pixels_beyond_its_edge(rng):
    """S of the paper knows the crop alone; ours is one resampling of the picture, whose outermost samples, less than
    half a pixel from the edge, read the neighbours outside. All others are C and S literally."""
    picture = rng.uniform(size=(90, 90, 1))
    edges, box = whole_pixels(rng, 32)
    ours, literal = (
        np.asarray(crop_and_resize(picture, box, 64)[0]),
        paper.resize(paper.crop(picture[..., 0], edges), 64),
    )
    assert agrees(ours[1:-1, 1:-1], literal[1:-1, 1:-1])
    left, top, right, bottom = edges
    wider = paper.resize(paper.crop(picture[..., 0], (left - 1, top - 1, right + 1, bottom + 1)), 68)[2:-2, 2:-2]
    assert agrees(ours, wider)


def test_the_way_back_to_the_picture_is_4_m_and_a_constant_half_pixel(rng):
    """C⁻¹(S⁻¹(4·m̂)) as printed takes the corner of a heat map's pixel for its middle. Ours keeps the middles:
    half a pixel of the heat map more, half a pixel of the picture less, the same for all landmarks of a crop."""
    positions, side = rng.uniform(0.0, MAP - 1.0, (68, 2)), 150
    edges, box = whole_pixels(rng, side)
    constant = 0.5 * side / MAP - 0.5
    assert agrees(to_picture(jnp.asarray(positions), box, MAP), paper.full_resolution(positions, edges) + constant)
    slope = jax.jacfwd(lambda place: to_picture(place[None], box, MAP)[0])(jnp.asarray(positions[0]))
    assert agrees(slope.T, paper.gradient(lambda place: paper.full_resolution(place, edges), positions[0]))


def test_the_bundled_networks_landmarks_are_eq_3_of_its_heat_maps():
    """N as a whole on a photo, in single precision."""
    picture = np.asarray(read_picture(sample("astronaut")), np.float32) / 255.0
    edges, side = (150, 30, 300, 180), 150
    box = CropBox(np.array([224.5, 104.5]), np.float64(side), np.float64(0.0))
    seen = landmarks_of(bundled_heat_maps(), jnp.asarray(picture), box)
    maps = np.asarray(seen.heat_maps, float)
    peaks = np.array([np.unravel_index(one.argmax(), one.shape) for one in maps])
    inside = ((peaks > 0) & (peaks < maps.shape[-1] - 1)).all(axis=1)
    assert inside.sum() >= 60  # at the border of a map the paper says nothing
    constant = 0.5 * side / maps.shape[-1] - 0.5
    expected = [
        paper.full_resolution(paper.soft_argmax(one) * (MAP / maps.shape[-1]), edges) + constant for one in maps[inside]
    ]
    assert agrees(np.asarray(seen.points)[inside], np.array(expected), SINGLE)


# The energies of landmarks (Secs. 4, 5, 8.1, 8.2, 8.4).


def view(target, weights, unit_px=1.0) -> DeepView:
    """What the energy reads of a camera; stacked, for one view or several."""
    return DeepView(*[None] * 3, target, weights, np.ones(np.shape(weights)), np.broadcast_to(
        unit_px, len(target)), None, None)  # fmt: skip


def terms(predicted, views: DeepView, names: tuple[str, ...], omega=None, at=None, start=None, constants=DEFAULTS):
    """Residuals of the named terms; every weight is 1 by default."""
    at = FaceParameters(*(jnp.zeros(count) for count in (3, 3, 2, 0))) if at is None else at
    omega = np.ones(len(names)) if omega is None else omega
    context = still(at if start is None else start, constants)
    return deep_residuals(views, jnp.asarray(omega), predicted, at, context, names)


def slopes(predicted, views, name: str) -> np.ndarray:
    """Gradient of a term's energy by the landmarks N(F)."""

    def energy(flat):
        return jnp.sum(terms(flat.reshape(predicted.shape), views, (name,))[name] ** 2)

    return jax.grad(energy)(jnp.asarray(predicted.ravel()))


def test_e_1_is_w_times_the_difference_where_our_weights_are_w_squared(rng):
    """W multiplies residuals in Sec. 8.1, and our landmark weights (times the detections' confidence) squared errors:
    they are the paper's with W = diag(√weight). Errors count in `unit_px`, one pixel in the paper."""
    target, predicted, w = rng.normal(size=(1, 68, 2)), rng.normal(size=(1, 68, 2)), rng.uniform(0.0, 2.0, 68)
    ours = terms(predicted, view(target, w[None] ** 2), ("landmarks",))["landmarks"]
    assert agrees(ours, paper.landmark_residuals(predicted[0], target[0], w).ravel())

    def expected(flat):
        return paper.squared(paper.landmark_residuals(flat.reshape(68, 2), target[0], w))

    assert agrees(
        slopes(predicted, view(target, w[None] ** 2), "landmarks"), paper.gradient(expected, predicted.ravel())
    )
    percent = terms(predicted, view(target, w[None] ** 2, 1.4), ("landmarks",))["landmarks"]
    assert agrees(1.4 * percent, ours)


def test_e_1_with_weights_of_one_is_the_squared_norm_of_eq_2(rng):
    target, predicted = rng.normal(size=(2, 1, 68, 2))
    ours = terms(predicted, view(target, np.ones((1, 68))), ("landmarks",))["landmarks"]
    assert agrees(ours @ ours, paper.infill_energy(target, predicted) ** 2)


def test_e_2_is_the_differences_of_neighbours_with_the_other_sign(rng):
    """As printed the sum over i collapses to its two ends; as a residual for each i, which preserves edges, it is ours
    but for the sign, which a square does not see."""
    target, predicted = rng.normal(size=(2, 1, 68, 2))
    views = view(target, np.ones((1, 68)))
    printed = paper.edge_residuals(predicted[0], target[0])
    assert agrees(printed.sum(axis=0), (target[0, -1] - target[0, 0]) - (predicted[0, -1] - predicted[0, 0]))
    assert agrees(-terms(predicted, views, ("edges",))["edges"], printed.ravel())

    def expected(flat):
        return paper.squared(paper.edge_residuals(flat.reshape(68, 2), target[0]))

    assert agrees(slopes(predicted, views, "edges"), paper.gradient(expected, predicted.ravel()))


def test_the_published_e_2_has_no_weights_but_leaves_out_what_takes_no_part(rng):
    """A landmark of weight 0, and a view without a face, have no edges."""
    target, predicted = rng.normal(size=(2, 2, 68, 2))
    weights = np.stack([rng.uniform(0.1, 2.0, 68), np.zeros(68)])
    published = EnergyConstants(weighted_edges=0.0)

    def ours(weights):
        return np.asarray(terms(predicted, view(target, weights), ("edges",), constants=published)["edges"])

    whole = ours(weights).reshape(2, 67, 2)
    assert agrees(-whole[0], paper.edge_residuals(predicted[0], target[0]))
    assert not whole[1].any()
    weights[0, 30] = 0.0
    muted = ours(weights).reshape(2, 67, 2)
    assert not muted[0, 29:31].any()
    assert agrees(np.delete(muted[0], (29, 30), axis=0), np.delete(whole[0], (29, 30), axis=0))


def test_an_edge_counts_as_its_less_certain_end_by_default(rng):
    """The paper's E_2 has no weights. Ours multiplies each squared difference by the lesser of its two landmarks'
    weights, and the whole by ω_edges."""
    target, predicted, weights = rng.normal(size=(1, 68, 2)), rng.normal(size=(1, 68, 2)), rng.uniform(0.0, 2.0, 68)
    ours = terms(predicted, view(target, weights[None]), ("edges",), omega=[0.5])["edges"]
    lesser = np.minimum(weights[1:], weights[:-1])
    expected = np.sqrt(0.5 * lesser)[:, None] * -paper.edge_residuals(predicted[0], target[0])
    assert agrees(ours, expected.ravel())


@pytest.mark.parametrize(("reading", "power"), [("energy", 1), ("residual", 2)])
def test_lambda_has_two_readings(reading, power, rng):
    """Sec. 8.2 prints the vector λw, whose square is λ²‖w‖², and calls it L2 regularisation, λ‖w‖²."""
    config = preset("deep-energies").changed(deep={"lambda_reading": reading})
    stage = next(stage for stage in config.stages if "regularisation" in stage.terms)
    weight = config.factors(stage)[config.terms.index("regularisation")]
    at, nothing = parameters(rng, jaw=np.zeros(0)), np.zeros((1, 68, 2))
    ours = terms(nothing, view(nothing, np.ones((1, 68))), ("regularisation",), [weight], at)["regularisation"]
    assert agrees(ours @ ours, paper.LAMBDA**power * paper.squared(np.asarray(at.expression)))


def test_lambda_times_w_as_a_residual_is_our_weight_lambda_squared(rng):
    """Both readings of Sec. 8.2 are values of one weight: the vector λw beside E_1 is λ²‖w‖², the penalty that the
    text calls L2 regularisation λ‖w‖². Errors in units of u pixels divide either by u²."""
    at, views = parameters(rng, jaw=np.zeros(0)), view(np.zeros((1, 68, 2)), np.ones((1, 68)))
    w, nothing = np.asarray(at.expression), np.zeros((1, 68, 2))

    def ours(weight):
        return terms(nothing, views, ("regularisation",), [weight], at)["regularisation"]

    assert agrees(ours(paper.LAMBDA**2), paper.regularisation(w))
    assert agrees(ours(paper.LAMBDA) @ ours(paper.LAMBDA), paper.LAMBDA * paper.squared(w))
    unit = 1.4
    predicted = rng.normal(size=(1, 68, 2))
    names = ("landmarks", "regularisation")
    pixels = terms(predicted, views, names, [1.0, paper.LAMBDA**2], at)
    percent = terms(predicted, view(nothing, np.ones((1, 68)), unit), names, [1.0, paper.LAMBDA**2 / unit**2], at)
    for name in names:
        assert agrees(unit * percent[name], pixels[name])


def test_the_jaw_counts_in_blendshapes_under_lambda(rng):
    """The paper's jaw is among w. Ours has an angle and millimetres; the model's `jaw_unit` counts as weight 1."""
    at, views = parameters(rng), view(np.zeros((1, 68, 2)), np.ones((1, 68)))
    jaw = np.asarray(at.jaw) / [*[np.radians(26.5)] * 3, *[8.0] * 3]
    ours = terms(np.zeros((1, 68, 2)), views, ("regularisation",), [paper.LAMBDA**2], at)["regularisation"]
    assert agrees(ours, paper.regularisation(np.append(at.expression, jaw)))


def test_the_rigid_prior_penalises_deviations_from_the_start(rng):
    """Secs. 5 and 7 describe it without a formula; ours counts a radian as 100 mm."""
    at, start = parameters(rng), parameters(rng)
    views, strength = view(np.zeros((1, 68, 2)), np.ones((1, 68))), 3.0
    ours = terms(np.zeros((1, 68, 2)), views, ("prior",), [strength**2], at, start)["prior"]
    scale = np.array([100.0] * 3 + [1.0] * 3)
    pose, initial = (scale * np.concatenate([one.rotation, one.translation]) for one in (at, start))
    assert agrees(ours, paper.deviation(pose, initial, strength))


def test_the_prior_of_sec_7_penalises_deviations_of_weights_and_jaw(rng):
    """Without a formula as well; the jaw counts in blendshapes."""
    at, start = parameters(rng), parameters(rng)
    views, strength = view(np.zeros((1, 68, 2)), np.ones((1, 68))), 3.0
    ours = terms(np.zeros((1, 68, 2)), views, ("stay",), [strength**2], at, start)["stay"]
    counted = np.repeat([1.0, np.radians(26.5), 8.0], [len(at.expression), 3, 3])
    moved, initial = (np.concatenate([one.expression, one.jaw]) / counted for one in (at, start))
    assert agrees(ours, paper.deviation(moved, initial, strength))


def test_several_cameras_duplicate_the_energy(rng):
    """Sec. 8.4."""
    target, predicted, w = rng.normal(size=(3, 68, 2)), rng.normal(size=(3, 68, 2)), rng.uniform(0.0, 2.0, (3, 68))
    ours = terms(predicted, view(target, w**2), ("landmarks",))["landmarks"]
    each = [paper.squared(paper.landmark_residuals(*one)) for one in zip(predicted, target, w, strict=True)]
    assert agrees(ours @ ours, sum(each))


# Flow (Secs. 6, 7).


@pytest.fixture(scope="module")
def surface(head):
    """Points on the default head."""
    return surface_points(render_model(head), *choose_surface(head, 60))


def one_view() -> FlowView:
    camera = Camera(*(np.asarray(part, float)[None] for part in camera_from_fov((640, 480), 45.0)))
    return FlowView(camera, np.eye(3)[None], np.zeros((1, 3)))


def states(head, rng, count=3) -> list[FaceParameters]:
    """A head in motion."""
    identity = np.zeros(len(head.identity_deltas))
    shapes = len(head.expression_names)
    near = [0.1, -0.1, 0.05], [5.0, -3.0, 600.0]
    return [
        parameters(
            rng,
            identity=identity,
            expression=rng.uniform(0.0, 0.3, shapes),
            rotation=near[0] + rng.normal(0.0, 0.03, 3),
            translation=near[1] + rng.normal(0.0, 5.0, 3),
        )
        for _ in range(count)
    ]


def places(surface, state) -> np.ndarray:
    """Where the renders show the points, pixels."""
    return np.asarray(points_in_views(surface, one_view(), state)[0][0], float)


def flow_energy(surface, state, sides, weight=1.0):
    """Our flow energy in the paper's units: (target, bias) of each side, every point in full, pixels."""
    targets = np.stack([side[0] for side in sides])[:, None]
    bias = np.stack([side[1] for side in sides])[:, None]
    count = targets.shape[2]
    data = FlowTargets(targets, np.full(targets.shape[:3], weight), bias, np.ones(1))
    # All points of a view count as 68 landmarks: each in full under this weight.
    omega = FlowWeights(*(np.asarray(value, float) for value in (count / 68.0, 0.0, 0.0, np.inf)))
    found = flow_residuals(surface, one_view(), data, omega, np.ones(data.weights.shape), state, state)
    return jnp.sum(found["flow"] ** 2)


def slope_and_chain(surface, state, energy, expected) -> tuple[np.ndarray, np.ndarray]:
    """Gradients by all unknowns: ours, and the paper's by the chain rule through the points' derivative."""
    names = ("rotation", "translation", "expression", "jaw")
    vector = pack(state, names)
    ours = jax.grad(lambda vector: energy(unpack(vector, state, names)))(vector)
    at, back = jax.vjp(lambda vector: points_in_views(surface, one_view(), unpack(vector, state, names))[0], vector)
    outer = paper.gradient(lambda flat: expected(flat.reshape(at.shape[1:])), np.asarray(at, float).ravel())
    (papers,) = back(jnp.asarray(outer.reshape(at.shape), at.dtype))
    return np.asarray(ours), np.asarray(papers)


def test_infill_compares_the_flows_of_two_photos_and_two_renders(head, surface, rng):
    """‖N(F1*, F2*) − N(F1, F2)‖² of Sec. 6 at the surface points, N(F1, F2) the exact flow of the mesh. The paper
    compares every pixel of 512 × 512; a least-squares solver squares the norm."""
    first, second = states(head, rng, 2)
    start = places(surface, first)
    photo = rng.normal(0.0, 3.0, start.shape)

    def energy(state):
        return flow_energy(surface, state, [(start + photo, np.zeros_like(start))])

    def expected(at):
        return paper.infill_energy(photo, at - start) ** 2

    assert agrees(energy(second), expected(places(surface, second)))
    ours, papers = slope_and_chain(surface, second, energy, expected)
    assert agrees(ours, papers, SINGLE)


def test_an_estimators_word_on_the_renders_replaces_the_exact_flow(head, surface, rng):
    """flow.renders = "estimated": N is the estimator's on both sides, as printed. Its derivative by the second render
    is taken to be that of the exact flow, which the paper has from the network."""
    first, second = states(head, rng, 2)
    start, end = places(surface, first), places(surface, second)
    photo, said = rng.normal(0.0, 3.0, (2, *start.shape))
    ours = flow_energy(surface, second, [(start + photo, said - (end - start))])
    assert agrees(ours, paper.infill_energy(photo, said) ** 2)


def test_plate_flow_is_both_terms_of_sec_7_the_second_one_backwards(head, surface, rng):
    """The paper adds ‖N(F2*, F3*) − N(F2, F3)‖. Ours asks for the flow from the third to the second frame, at the
    third's points. Exact flow backwards is minus the flow forwards; the energies are one for photos whose is too.
    The paper adds two norms, a least-squares solver their squares."""
    first, second, third = states(head, rng)
    ends = [places(surface, state) for state in (first, third)]
    photos = rng.normal(0.0, 3.0, (2, *ends[0].shape))  # N(F1*, F2*) and N(F2*, F3*)
    backwards = -photos[1]
    sides = [(ends[0] + photos[0], np.zeros_like(ends[0])), (ends[1] + backwards, np.zeros_like(ends[0]))]

    def energy(state):
        return flow_energy(surface, state, sides)

    def flows(at):
        return at - ends[0], ends[1] - at

    def expected(at):
        return sum(paper.infill_energy(photo, flow) ** 2 for photo, flow in zip(photos, flows(at), strict=True))

    at = places(surface, second)
    assert agrees(energy(second), expected(at))
    ours, papers = slope_and_chain(surface, second, energy, expected)
    assert agrees(ours, papers, SINGLE)
    norms = [paper.infill_energy(photo, flow) for photo, flow in zip(photos, flows(at), strict=True)]
    assert agrees(paper.plate_flow_energy(photos, flows(at)), sum(norms))


def test_self_flow_is_the_second_difference_of_the_points(head, surface, rng):
    """‖N(F1, F2) − N(F2, F3)‖² of Sec. 7 with the mesh's exact flow: four times the squared distance from midway."""
    first, second, third = states(head, rng)
    ends = [places(surface, state) for state in (first, third)]
    middle = 0.5 * (ends[0] + ends[1])

    def energy(state):
        return flow_energy(surface, state, [(middle, np.zeros_like(middle))], weight=4.0)

    def expected(at):
        return paper.self_flow_energy(at - ends[0], ends[1] - at) ** 2

    assert agrees(energy(second), expected(places(surface, second)))
    ours, papers = slope_and_chain(surface, second, energy, expected)
    assert agrees(ours, papers, SINGLE)


def test_the_self_flow_pass_aims_at_that_middle(head, rng):
    """What the pass over a track minimises has the weight and the targets of the test above."""
    fitter = FlowFitter(head, plan_of(preset("joint")))
    surface = surface_points(render_model(head), *choose_surface(head, fitter.plan.flow.points))
    first, second, third = states(head, rng)
    targets = fitter.midway_targets(first, third, one_view())
    ends = [places(surface, state) for state in (first, third)]
    assert not targets.weights[1:].any()
    missed = np.asarray(flow_distances(surface, one_view(), targets, second), float)[0, 0] * targets.unit_px[0]
    at = places(surface, second)
    energy = (targets.weights[0, 0] * (missed**2).sum(axis=-1)).sum()
    assert agrees(energy, paper.self_flow_energy(at - ends[0], ends[1] - at) ** 2, SINGLE)


# Between and over frames (Apps. A, B).


def test_between_frames_all_is_linear_but_the_rotation_which_is_spherical(rng):
    first, last, share = parameters(rng), parameters(rng), float(rng.uniform())
    ours = between(first, last, share)
    for name in ("translation", "expression", "jaw"):
        assert agrees(
            getattr(ours, name), paper.lerp(*(np.asarray(getattr(one, name)) for one in (first, last)), share)
        )
    ends = [paper.quaternion(paper.rotation(np.asarray(one.rotation))) for one in (first, last)]
    expected = paper.matrix(paper.slerp(*ends, share))
    assert agrees(rotation_matrix(jnp.asarray(ours.rotation)), expected)


def test_the_spherical_way_is_the_shorter_one():
    """Two rotations by 170° about opposite axes are 20° apart."""
    ends = [np.array([0.0, np.radians(170.0), 0.0]), np.array([0.0, np.radians(-170.0), 0.0])]
    rng = np.random.default_rng(0)
    ours = between(*(parameters(rng, rotation=end) for end in ends), 0.25)
    quaternions = [paper.quaternion(paper.rotation(end)) for end in ends]
    expected = paper.matrix(paper.slerp(*quaternions, 0.25))
    assert agrees(rotation_matrix(jnp.asarray(ours.rotation)), expected)
    assert agrees(expected, paper.rotation(np.array([0.0, np.radians(175.0), 0.0])))


def test_a_window_of_three_frames_is_averaged_rotations_as_markley_does(rng):
    window, weights = [parameters(rng) for _ in range(3)], rng.uniform(0.1, 1.0, 3)
    ours = averaged(window, weights.tolist())
    for name in ("translation", "expression", "jaw"):
        stacked = np.stack([np.asarray(getattr(one, name)) for one in window])
        assert agrees(getattr(ours, name), paper.window_average(stacked, weights))
    quaternions = np.stack([paper.quaternion(paper.rotation(np.asarray(one.rotation))) for one in window])
    expected = paper.matrix(paper.mean_quaternion(quaternions, weights))
    assert agrees(rotation_matrix(jnp.asarray(ours.rotation)), expected)


# Settings (Secs. 4, 7, 8, App. C.2).


@pytest.mark.parametrize("name", ["deep-energies", "preselected-points", "orthographic"])
def test_the_presets_with_the_papers_names_have_nothing_of_ours(name):
    """Pixels, no bounds, no confidences, E_2 without weights, λ = 100, the derivative through the network."""
    config = preset(name)
    assert (config.solver.unit, config.solver.bounded, config.landmarks.confidence) == ("px", False, False)
    assert (config.constants.weighted_edges, config.constants.rotation_mm) == (False, 1.0)
    assert (config.deep.derivative, config.deep.edges, config.contour.mode) == ("forward", 1.0, "fixed")
    assert (config.deep.regularisation, config.deep.lambda_reading) == (paper.LAMBDA, "energy")
    assert config.deep.energy == ("points" if name == "preselected-points" else "deep")
    if name == "orthographic":
        named = {term for stage in config.stages for term in stage.terms}
        assert not named & {"regularisation", "prior", "stay"}
        assert config.deep.identity == 0.0


def test_the_stages_free_what_sec_8_says():
    """Iteration limits and landmark weights are ours: the paper prints none."""
    pose = {"rotation", "translation"}
    stages = [stage for stage in preset("deep-energies").stages if stage.enabled]
    assert [(set(stage.free), set(stage.landmarks)) for stage in stages[:4]] == [
        ({"translation"}, {"non_jaw"}),
        (pose, {"non_jaw"}),
        (pose, {"jaw"}),
        (pose, {"all"}),
    ]
    assert [set(stage.free) for stage in stages[4:]] == [
        {*pose, "jaw_open"},
        {"jaw"},
        {*pose, "expression", "jaw"},
    ]


def test_the_parallel_stages_are_those_of_app_c_2():
    stages = preset("orthographic").stages
    assert [set(stage.free) for stage in stages] == [
        {"translation"},
        {"translation", "rotation", "scale"},
        {"translation", "rotation", "identity"},
        {"translation", "rotation", "expression"},
    ]
    assert {shape for stage in stages for shape in stage.shapes} == {"first:10"}


@pytest.mark.long
def test_averaging_weighs_the_current_frame_more_heavily():
    centre = preset("deep").refinement.centre
    assert centre > 0.5 * (1.0 - centre)
