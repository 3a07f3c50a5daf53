"""The dense network as N of Deep Energies: its answer in a picture, its derivative, its crop, and what it finds."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.deep_scenes import DEEP, flat, make_deep_scene, make_parameters, rotation_error_deg
from tests.stereo_scenes import make_rig
from workbench import fit
from workbench.config import preset
from workbench.energies import still
from workbench.energies.deep import deep_residuals, preselected_points
from workbench.errors import ConfigError, ModelError
from workbench.face import in_scheme, typical_sizes
from workbench.frames import read_picture
from workbench.geometry import write_rig
from workbench.landmarks.dense_detector import bundled_dense_network
from workbench.landmarks.schemes import DENSE
from workbench.networks import CropBox, landmarks_in, landmarks_of, to_picture
from workbench.networks.dense_network import NAME, SIDE, empty_dense_network
from workbench.networks.encoder import BLOCKS, WIDTHS
from workbench.networks.frozen import FrozenDenseNetwork
from workbench.networks.regression import covariance_of
from workbench.networks.weights import ARCHITECTURE, save_module
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_programs import look, look_derivative
from workbench.tracking.deep_target import energy_network
from workbench.tracking.deep_views import holding

CONFIG = DEEP.changed(deep={"network": "dense"})
PORTRAIT = sample("astronaut")
BOX = CropBox(np.array([224.0, 130.0]), np.float64(161.0), np.float64(0.2))
"""About the face of the portrait, turned a little."""


@pytest.fixture(scope="module")
def fitter(head):
    return DeepFitter(in_scheme(head, DENSE), plan_of(CONFIG, DENSE))


@pytest.fixture(scope="module")
def truth(fitter):
    return make_parameters(fitter.model, (17.0, -8.0, 6.0), (18.0, -14.0, 600.0), {"mouthSmileLeft": 0.5}, 12.0, seed=3)


@pytest.fixture(scope="module")
def scene(fitter, truth):
    return make_deep_scene(fitter, truth)


def test_a_crop_is_seen_as_the_frozen_network_sees_it():
    crop = np.ascontiguousarray(read_picture(PORTRAIT)[:SIDE, 96 : 96 + SIDE])
    shown = jnp.moveaxis(jnp.asarray(crop, jnp.float32) / 255.0, -1, 0)
    seen = landmarks_in(bundled_dense_network(), shown, BOX)
    frozen = FrozenDenseNetwork(replace(bundled_dense_network(), largest=None))(crop)
    np.testing.assert_allclose(seen.points, to_picture(frozen.points, BOX, SIDE), atol=1e-3)
    scale, (cosine, sine) = float(BOX.side) / SIDE, (np.cos(0.2), np.sin(0.2))
    turn = scale * np.array([[cosine, -sine], [sine, cosine]])
    expected = turn @ covariance_of(frozen.whitening) @ turn.T
    np.testing.assert_allclose(covariance_of(seen.whitening), expected, rtol=2e-3, atol=1e-3 * expected.max())


def test_places_in_the_picture_have_the_derivative_of_finite_differences():
    """In double precision, so that a step may be too small to cross the network's kinks."""
    network = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), bundled_dense_network())
    picture = jnp.asarray(read_picture(PORTRAIT), jnp.float64) / 255.0
    rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]]
    way = jnp.asarray(np.sin(rows / 9.0)[..., None] * np.cos(columns / 7.0)[..., None] * [1.0, 0.5, -0.7])

    @jax.jit
    def moved(network, step):
        return jax.jvp(lambda seen: landmarks_of(network, seen, BOX).points, (picture + step * way,), (way,))

    step, (_, slope) = 1e-6, moved(network, 0.0)
    secant = np.subtract(*(moved(network, sign * step)[0] for sign in (1.0, -1.0))) / (2.0 * step)
    np.testing.assert_allclose(slope, secant, atol=1e-3 * float(jnp.abs(slope).max()))


def test_the_forward_derivative_leads_where_real_steps_lead(fitter, scene, truth):
    """Through renderer and network, in the photo's crop: the pose, and the jaw."""
    programs = fitter.scene(None)
    (view,) = holding(fitter.views(scene.observation(), scene.context()), programs, truth)
    jaw = len(flat(truth)) - 7
    columns = np.array([0, 1, 2, 3, 4, 5, jaw, len(flat(truth))])
    forward = np.asarray(look_derivative(programs, view, truth, columns), float)
    vector, unravel = jax.flatten_util.ravel_pytree(truth)
    agreement = []
    for column, slope in zip(columns[:-1], forward, strict=False):
        way = jnp.zeros_like(vector).at[column].set(typical_sizes(truth)[column])
        ends = [np.asarray(look(programs, view, unravel(vector + sign * way / 4)).points, float) for sign in (1, -1)]
        secant = 2.0 * (ends[0] - ends[1])
        agreement.append((secant * slope).sum() / np.linalg.norm(secant) / np.linalg.norm(slope))
    assert min(agreement) > 0.7
    assert np.median(agreement) > 0.9


def test_a_render_near_the_photo_is_seen_in_its_crop_and_another_in_its_own(fitter, scene, truth):
    programs, views = fitter.scene(None), fitter.views(scene.observation(), scene.context())
    start = fitter.start(np.asarray(truth.identity))
    elsewhere = start._replace(translation=jnp.array([90.0, 0.0, 600.0]))
    (near,), (far,) = (holding(views, programs, at) for at in (truth, elsewhere))
    moved = truth._replace(translation=truth.translation + jnp.array([4.0, 0.0, 0.0]))
    boxes = [look(programs, view, moved).box for view in (near, far)]
    np.testing.assert_allclose(boxes[0].centre, views[0].crop.centre, atol=1e-3)
    own = np.asarray(preselected_points(programs.model, views[0], moved, 0.0))
    assert abs(float(boxes[1].centre[0]) - own[17:68, 0].mean()) < 0.1 * float(boxes[1].side)
    assert np.linalg.norm(np.subtract(boxes[0].centre, boxes[1].centre)) > 2.0


def test_the_stages_find_the_truth_from_a_frontal_start(fitter, scene, truth):
    solution = fitter.solve(fitter.problem(scene.observation(), scene.context()))
    found = solution.parameters
    assert rotation_error_deg(solution.start, truth) > 18.0
    assert rotation_error_deg(found, truth) < 1.5
    assert abs(float(found.translation[2] / truth.translation[2]) - 1.0) < 0.02
    assert abs(np.degrees(float(found.jaw[0] - truth.jaw[0]))) < 3.0
    record = fitter.record(solution)
    assert record.covariance.shape == (377, 2, 2)
    assert record.failure == ""


def test_landmarks_count_in_standard_deviations_and_edges_in_percent(fitter, scene, truth):
    """Twice the deviation is a quarter of E_1; E_2 is of the 68 points alone, and irises move nothing."""
    observation, context, stage = scene.observation(), scene.context(), fitter.plan.stages[1]
    irises, offsets = list(DENSE.groups["irises"]), np.random.default_rng(5).normal(size=(377, 2))

    def energies(covariance, offsets):
        seen = observation.landmarks
        moved = replace(seen, points=seen.points + offsets, covariance=covariance * seen.covariance)
        (view,) = fitter.views(replace(observation, landmarks=moved), context, stage)
        stacked = jax.tree.map(lambda part: jnp.asarray(part)[None], view)
        predicted = jnp.asarray(seen.points)[None]
        parts = deep_residuals(stacked, jnp.ones(5), predicted, truth, still(truth))
        return {name: float(parts[name] @ parts[name]) for name in ("landmarks", "edges")}

    sure, unsure = energies(1.0, offsets), energies(4.0, offsets)
    assert unsure["landmarks"] == pytest.approx(sure["landmarks"] / 4.0)
    assert unsure["edges"] == pytest.approx(sure["edges"], rel=0.05)
    offsets[irises] += 20.0
    assert energies(1.0, offsets) == sure
    offsets[68:] += 20.0
    dense = energies(1.0, offsets)
    assert dense["landmarks"] > 2.0 * sure["landmarks"]
    assert dense["edges"] == sure["edges"]


def test_one_picture_is_fitted_at_all_its_points():
    found = fit(PORTRAIT, config=preset("deep").changed(deep={"network": "dense", "start": "landmarks"}))
    assert found.frame.observed.shape == (377, 2)
    assert np.isfinite(found.frame.covariance).all()
    assert found.failure == ""
    assert found.error_percent < 5.0


def test_what_it_cannot_be_is_refused(tmp_path):
    write_rig(make_rig(), tmp_path / "rig.toml")
    with pytest.raises(ConfigError, match=r"A dense network looks through one camera; set deep\.network"):
        plan_of(CONFIG.changed(camera={"rig": str(tmp_path / "rig.toml")}), DENSE)
    size = {WIDTHS: json.dumps([4, 6, 8, 10]), BLOCKS: "1"}
    few = empty_dense_network((4, 6, 8, 10), 1, 3, 5, 7)
    save_module(tmp_path / "few.safetensors", few, {ARCHITECTURE: NAME, **size})
    with pytest.raises(ModelError, match="should answer the 377 points of the scheme 'dense', it answers 7"):
        energy_network(str(tmp_path / "few.safetensors"))
