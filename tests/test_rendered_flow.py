"""The flow energy with the network on photos and renders, and its derivative (Deep Energies Secs. 6 and 7)."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests import paper_formulas as paper
from tests.films import DEPTH_MM, FOV_DEG, SIZE, film_config, landmark_error_px, lost
from tests.networks import randomised
from tests.old_checkpoints import write_old_checkpoint
from tests.stereo_scenes import make_rig
from tests.test_infill import snap
from workbench.config import Stage
from workbench.energies.flow import LANDMARKS, FlowWeights
from workbench.errors import ConfigError
from workbench.face import FaceParameters, pack, typical_sizes, unpack
from workbench.face.unknowns import slots
from workbench.flow import read_flow
from workbench.geometry import Rig, pose_in_view, write_rig
from workbench.networks import named_arrays
from workbench.networks.flownet2 import empty_flownet2
from workbench.planning import plan_of
from workbench.rendering import Appearance, render_model, turned_light
from workbench.tracking.deep_programs import CHUNK
from workbench.tracking.deep_views import light_of
from workbench.tracking.flow_fitter import FlowFitter, parameters_of
from workbench.tracking.flow_solver import MOVING, FlowLimits
from workbench.tracking.infill import fill_by_flow, fill_linearly, infilled
from workbench.tracking.photo_flow import cutout_about
from workbench.tracking.point_links import Neighbour, places_of
from workbench.tracking.refinement import refined
from workbench.tracking.rendered_flow import look_at, read_grid, rendered_derivative, seen_flow
from workbench.tracking.rendered_flow_problem import MovingFrame, RenderedFlow
from workbench.tracking.rendered_flow_solver import (
    differences_of,
    flow_derivative,
    flow_residual,
    flows_at,
    solve_rendered_flow,
)

SIDE = 128
NETWORK = {"renders": "network", "estimator": "network", "side": SIDE, "iterations": 4}
STAGE = Stage(name="all", free=("rotation", "translation", "expression"), shapes=("jawOpen",), limit=1)
STEP = 0.05
"""Half the width of a central difference, in units of the unknown's typical size."""
PLAIN = {"robust": 1e4, "stay": 0.0}
SHORT = {"iterations": 3}
FLOWNET2_SIDE = 64
"""The smallest pictures that it sees."""


@pytest.fixture(scope="module")
def film(film_maker):
    return film_maker.film(7, snap)


def fitter_of(film_maker, **sections):
    """Pose and one blendshape are free: a derivative in one run of the network."""
    flow = {**NETWORK, **sections.pop("flow", {})}
    config = film_config(flow=flow, **sections).changed(stages=[STAGE])
    return FlowFitter(film_maker.head, plan_of(config))


@pytest.fixture(scope="module")
def plain(film_maker):
    return fitter_of(film_maker, flow=PLAIN)


def neighbour(film, index):
    return Neighbour(parameters_of(film.truth[index]), (film.pictures[index],))


def problem_between(fitter, film, before, here, after):
    """Frame `here` between two others, at its true place; None for a missing one."""
    start = parameters_of(film.truth[here])
    ends = tuple(None if k is None else neighbour(film, k) for k in (before, after))
    return maker_of(fitter).between(ends, (film.pictures[here],), moving_frame(fitter, film, start)), start


def maker_of(fitter):
    return RenderedFlow(fitter.model, render_model(fitter.model), fitter.linker, fitter.plan.flow)


def moving_frame(fitter, film, start):
    """A frame that nothing holds."""
    free = np.full(len(pack(start, MOVING)), np.inf)
    limits, weights = FlowLimits(-free, free, 4, 1e-4), FlowWeights(1.0, 0.0, 0.0, 1e4)
    return MovingFrame(start, start, fitter.views(film.truth[0]), weights, limits, None)


def agreement(one, other):
    """Cosine of the angle between two arrays."""
    one, other = one.ravel(), other.ravel()
    return one @ other / np.linalg.norm(one) / np.linalg.norm(other)


@pytest.mark.slow
def test_the_derivative_is_the_slope_of_what_the_network_sees(film, plain):
    """Through renderer and network, for either place of the frame in a pair, against central differences."""
    problem, start = problem_between(plain, film, 2, 4, 6)
    block, names = slots(start, MOVING), plain.model.expression_names
    shapes = [block["expression"].start + names.index(name) for name in ("jawOpen", "mouthSmileLeft")]
    columns = np.array([*range(block["translation"].stop), *shapes])
    vector, sizes = np.asarray(pack(start, MOVING)), typical_sizes(start, MOVING)
    numeric = []
    for column in columns:
        step = np.zeros_like(vector)
        step[column] = STEP * sizes[column]
        ends = [flows_at(problem, unpack(vector + sign * step, start, MOVING)) for sign in (1.0, -1.0)]
        numeric.append((ends[0] - ends[1]) / (2.0 * STEP))
    ours, numeric = flow_derivative(problem, start, columns), np.stack(numeric)
    for k, term in enumerate(problem.differences):
        shown = term.weights[0] > 0.0
        assert agreement(ours[:, k, 0][:, shown], numeric[:, k, 0][:, shown]) >= 0.98
        for row, slope in zip(ours[:, k, 0], numeric[:, k, 0], strict=True):
            assert agreement(row[shown], slope[shown]) > 0.9


@pytest.mark.slow
def test_the_energy_is_that_of_the_paper(film, plain):
    """Plate flow: ‖N(F1*, F2*) − N(F1, F2)‖² + ‖N(F2*, F3*) − N(F2, F3)‖², both in the direction of time, each face
    counted as 68 landmarks and pixels in percent of the outer-eye distance."""
    problem, start = problem_between(plain, film, 2, 4, 6)
    render, network = render_model(plain.model), plain.linker.estimator
    states = [parameters_of(film.truth[k]) for k in (2, 4, 6)]
    drawn = [np.asarray(look_at(render, problem.views[0], state, SIDE)) for state in states]
    boxes = cutout_about(np.concatenate([places(plain, film, state) for state in states]), SIDE)
    photos = [boxes.cut(film.pictures[k]) for k in (2, 4, 6)]
    expected = 0.0
    for k, term in enumerate(problem.differences):
        shown = term.weights[0] > 0.0
        flows = [read_grid(network(*pair[k : k + 2]))[shown].astype(float) for pair in (photos, drawn)]
        expected += paper.infill_energy(*flows) ** 2 / problem.unit_px[0] ** 2 * LANDMARKS / shown.sum()
    residual = flow_residual(
        problem, flows_at(problem, start), [np.ones(term.weights.shape) for term in problem.differences]
    )
    assert residual @ residual == pytest.approx(expected.real, rel=1e-4)


@pytest.mark.slow
def test_self_flow_compares_two_flows_of_renders(film, plain):
    """‖N(F1, F2) − N(F2, F3)‖ (Sec. 7)."""
    ends = [parameters_of(film.truth[k]) for k in (1, 3)]
    start = parameters_of(film.truth[2])
    problem = maker_of(plain).midway(*ends, moving_frame(plain, film, start))
    flows = flows_at(problem, start)
    shown = problem.differences[0].weights[0] > 0.0
    expected = paper.self_flow_energy(flows[0, 0][shown], flows[1, 0][shown]) ** 2
    (missed,) = differences_of(problem, flows)
    assert (missed[0][shown] ** 2).sum() * problem.unit_px[0] ** 2 == pytest.approx(expected.real)
    assert [pair.moves for pair in problem.pairs] == ["second", "first"]


@pytest.mark.slow
def test_a_gap_is_filled_far_better_than_by_a_straight_line(film_maker, film):
    """As published: forward, then backward over the filled frames, through the network's derivative."""
    fitter = fitter_of(film_maker, infill={"method": "flow", "passes": "back-and-forth"})
    fits = [lost(fit) if fit.index in (3, 4) else fit for fit in film.truth]
    result = [moment.fit for moment in infilled(fitter, film.moments(fits))]
    line = fill_linearly(film.truth[2], film.truth[5], 2)
    straight = [fitter.placed(film.truth[k], at) for k, at in zip((3, 4), line, strict=True)]
    by_flow, by_line = (
        np.mean([landmark_error_px(fit, film.truth[k]) for k, fit in zip((3, 4), fits, strict=True)])
        for fits in (result[3:5], straight)
    )
    assert by_flow < 0.5 * by_line


@pytest.mark.slow
@pytest.mark.parametrize("method", ["plate", "self"])
def test_a_frame_that_is_off_is_drawn_back(film_maker, film, method):
    fitter = fitter_of(film_maker, refinement={"method": method})
    off = film.truth[2].translation + np.array([2.0, 1.0, 0.0])
    wrong = fitter.placed(film.truth[2], parameters_of(film.truth[2])._replace(translation=off))
    fits = [film.truth[1], wrong, film.truth[3]]
    moments = [moment for moment in film.moments([film.truth[0], *fits, *film.truth[4:]]) if 1 <= moment.fit.index <= 3]
    result = [moment.fit for moment in refined(fitter, moments)]
    assert landmark_error_px(result[1], film.truth[2]) < 0.5 * landmark_error_px(wrong, film.truth[2])


def test_the_second_pass_starts_from_what_the_first_has_filled(film_maker, film, monkeypatch):
    """Back and forth (Sec. 8.3): the second pass ends at the other anchor, and its frames start where they are."""
    fitter = fitter_of(film_maker, flow={"renders": "exact"}, infill={"method": "flow", "passes": "back-and-forth"})
    asked = []

    def between(neighbours, pictures, start, prior, views, **_):
        known, nothing = neighbours
        assert nothing is None
        found = start._replace(translation=start.translation + 1.0)
        asked.append((known.parameters, start, found))
        return SimpleNamespace(parameters=found)

    monkeypatch.setattr(fitter, "between", between)
    ends = film.moments()[2], film.moments()[5]
    path = fill_by_flow(fitter, *ends, [(picture,) for picture in film.pictures[3:5]])
    first, second, third, fourth = asked
    assert first[0] is first[1]
    assert (second[0], second[1]) == (first[2], first[2])
    assert np.array_equal(third[0].translation, ends[1].fit.translation)
    assert (third[1], fourth[0], fourth[1]) == (second[2], third[2], first[2])
    assert (path[0], path[1]) == (fourth[2], third[2])


def test_an_estimator_without_a_derivative_is_refused(film_maker):
    with pytest.raises(ConfigError, match=r"set flow\.estimator to"):
        fitter_of(film_maker, flow={"estimator": "dis"})


def test_pixels_beyond_the_border_do_not_count(film, plain):
    """A cut-out repeats the picture's border; the render goes on."""
    around = parameters_of(film.truth[2])
    away = around._replace(translation=around.translation + np.array([120.0, 0.0, 0.0]))
    shares = []
    for start in (around, away):
        known = Neighbour(start, (film.pictures[2],))
        problem = maker_of(plain).between((known, None), (film.pictures[3],), moving_frame(plain, film, start))
        shares.append(problem.differences[0].weights[0])
    assert shares[0].any()
    assert 0 < shares[1].sum() < shares[0].sum()
    assert not shares[1][:, -1].any()


def test_nothing_free_leaves_the_frame_where_it_is(film, plain):
    problem, start = problem_between(plain, film, 2, 4, None)
    fixed = np.asarray(pack(start, MOVING))
    solution = solve_rendered_flow(replace(problem, limits=FlowLimits(fixed, fixed, 4, 1e-4)), start)
    assert np.array_equal(solution.parameters.translation, start.translation)
    assert int(solution.iterations) == 0


def places(fitter, film, state):
    """The surface points in the only view, pixels."""
    return np.asarray(places_of(fitter.linker.points, fitter.views(film.truth[0]), state), float)[0]


# One anchor, two cameras, another network.


def turning(index: int):
    """A head that turns and moves to the side."""
    return {"jawOpen": 0.3}, (5.0 * index - 8.0, 0.0, 0.0), (2.0 * index, 0.0, 0.0)


@pytest.fixture(scope="module")
def turn(film_maker):
    return film_maker.film(4, turning)


@pytest.mark.slow
@pytest.mark.parametrize(("anchor", "gap"), [(1, (2, 3)), (2, (0, 1))], ids=["after the anchor", "before it"])
def test_a_gap_with_one_anchor_is_followed_from_there(film_maker, turn, anchor, gap):
    """A clip that ends, or begins, with lost frames: each is solved from the one nearer to the anchor (Appendix A)."""
    fitter = fitter_of(film_maker, flow=SHORT, infill={"method": "flow"})
    fits = [lost(fit) if fit.index in gap else fit for fit in turn.truth]
    result = [moment.fit for moment in infilled(fitter, turn.moments(fits))]
    for k in gap:
        stayed = landmark_error_px(turn.truth[anchor], turn.truth[k])
        assert landmark_error_px(result[k], turn.truth[k]) < 0.5 * stayed


@dataclass(frozen=True, eq=False)
class StereoTurn:
    """The turning head before two cameras, 35° apart."""

    rig: Rig
    path: Path
    states: list[FaceParameters]
    """In the frame of the first camera."""
    pictures: list[tuple[np.ndarray, ...]]
    """By frame, of both."""

    def neighbour(self, index: int) -> Neighbour:
        return Neighbour(self.states[index], self.pictures[index])


@pytest.fixture(scope="module")
def stereo(film_maker, turn, tmp_path_factory):
    rig = make_rig((0.0, 35.0), distance_mm=DEPTH_MM, image_size=SIZE, fov_deg=FOV_DEG)
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    write_rig(rig, path)
    states = [parameters_of(fit) for fit in turn.truth[:3]]
    aside = [film_maker.picture(beside(state, rig)) for state in states]
    return StereoTurn(rig, path, states, list(zip(turn.pictures, aside, strict=False)))


def beside(state: FaceParameters, rig: Rig) -> FaceParameters:
    """The same head in the frame of the second camera."""
    rotation, translation = pose_in_view(state.rotation, state.translation, rig.placed_view(1))
    return state._replace(rotation=np.asarray(rotation), translation=np.asarray(translation))


def problem_of(fitter, fit, ends, pictures, start, light=None):
    """A frame that starts at `start` between two neighbours, which nothing holds, in this light."""
    free = np.full(len(pack(start, MOVING)), np.inf)
    limits, weights = FlowLimits(-free, free, 4, 1e-4), FlowWeights(1.0, 0.0, 0.0, 1e4)
    colors = np.asarray(render_model(fitter.model).colors)
    appearance = None if light is None else Appearance(colors, np.asarray(light), np.ones(len(colors)), 0.0)
    frame = MovingFrame(start, start, fitter.views(fit), weights, limits, appearance)
    return maker_of(fitter).between(ends, pictures, frame)


@pytest.mark.slow
def test_each_of_two_views_is_compared_as_by_a_camera_of_its_own(film_maker, turn, stereo):
    """Flow, photos' flow, mask, unit and the derivative by the translation, which the rig turns into the view."""
    both = fitter_of(film_maker, flow=SHORT, camera={"rig": str(stereo.path)})
    alone = fitter_of(film_maker, flow=SHORT)
    ends = stereo.neighbour(0), stereo.neighbour(2)
    start, columns = stereo.states[1], np.arange(3, 6)
    problem = problem_of(both, turn.truth[1], ends, stereo.pictures[1], start)
    flows, moved = flows_at(problem, start), flow_derivative(problem, start, columns)
    assert flows.shape[:2] == (2, 2)
    for view in range(2):
        seen = (lambda state: beside(state, stereo.rig)) if view else (lambda state: state)
        own_ends = tuple(Neighbour(seen(end.parameters), end.pictures[view : view + 1]) for end in ends)
        light = turned_light(light_of(None), stereo.rig.views[view].rotation_view_world)
        own = problem_of(alone, turn.truth[1], own_ends, stereo.pictures[1][view : view + 1], seen(start), light)
        np.testing.assert_allclose(flows[:, view], flows_at(own, seen(start))[:, 0], atol=0.02)
        turned = np.tensordot(
            stereo.rig.views[view].rotation_view_world, flow_derivative(own, seen(start), columns), axes=(0, 0)
        )
        assert agreement(moved[:, :, view], turned[:, :, 0]) > 0.99
        assert problem.unit_px[view] == pytest.approx(own.unit_px[0], rel=0.01)
        for term, other in zip(problem.differences, own.differences, strict=True):
            np.testing.assert_allclose(term.target[view], other.target[0], atol=0.02)
            assert np.abs(term.weights[view] - other.weights[0]).mean() < 0.01


@pytest.mark.slow
def test_the_second_camera_finds_the_depth(film_maker, turn, stereo):
    """Better than the first alone, which has nothing but the face's size for it; from either side of the truth."""
    true = stereo.states[1]
    off = {}
    for name, count, camera in (("one", 1, {}), ("two", 2, {"camera": {"rig": str(stereo.path)}})):
        fitter = fitter_of(film_maker, flow=SHORT, **camera)
        end, views = Neighbour(stereo.states[0], stereo.pictures[0][:count]), fitter.views(turn.truth[1])
        starts = [true._replace(translation=true.translation + np.array([0.0, 0.0, z])) for z in (12.0, -12.0)]
        found = [fitter.between((end, None), stereo.pictures[1][:count], start, start, views) for start in starts]
        off[name] = np.linalg.norm([each.parameters.translation[2] - true.translation[2] for each in found])
    assert off["two"] < 1.5
    assert off["two"] < 0.5 * off["one"]


@pytest.fixture(scope="module")
def flownet2_file(tmp_path_factory):
    """A narrow FlowNet2 with random weights, as a file of the published kind."""
    arrays = {name: np.asarray(array) for name, array in named_arrays(randomised(empty_flownet2(4))).items()}
    return write_old_checkpoint(tmp_path_factory.mktemp("flownet2") / "FlowNet2_checkpoint.pth.tar", arrays)


@pytest.fixture(scope="module")
def by_flownet2(film_maker, flownet2_file):
    flow = {**PLAIN, "estimator": str(flownet2_file), "side": FLOWNET2_SIDE, "iterations": 6}
    return fitter_of(film_maker, flow=flow)


@pytest.mark.slow
def test_flownet2_sees_photos_and_renders_and_has_the_derivative(turn, by_flownet2, flownet2_file):
    """The published network as `flow.estimator`: its own flows are compared, and its own slope is taken."""
    side, own = FLOWNET2_SIDE, read_flow(flownet2_file, FLOWNET2_SIDE)
    states = [parameters_of(fit) for fit in turn.truth[:2]]
    known, start = Neighbour(states[0], (turn.pictures[0],)), states[1]
    problem = problem_of(by_flownet2, turn.truth[1], (known, None), (turn.pictures[1],), start)
    cutout = cutout_about(np.concatenate([places(by_flownet2, turn, state) for state in states]), side)
    photos = [cutout.cut(picture) for picture in turn.pictures[:2]]
    drawn = [np.asarray(look_at(problem.model, problem.views[0], state, side)) for state in states]
    np.testing.assert_allclose(problem.differences[0].target[0], read_grid(own(*photos)), atol=1e-3)
    np.testing.assert_allclose(flows_at(problem, start)[0, 0], read_grid(own(*drawn)), atol=1e-3)
    columns = np.array([0, 3, 5])
    padded = np.array([*columns, *[-1] * (CHUNK - len(columns))])
    changes = np.asarray(rendered_derivative(problem.model, problem.views[0], start, padded, pixels=side))
    for ours, change in zip(flow_derivative(problem, start, columns)[:, 0, 0], changes, strict=False):
        step = 1e-3 / np.abs(change).max()
        pictures = (drawn[1] + sign * step * change for sign in (1.0, -1.0))
        ends = [np.asarray(seen_flow(own.network, drawn[0], here, moves="second", side=side)) for here in pictures]
        np.testing.assert_allclose(ours, (ends[0] - ends[1]) / (2.0 * step), atol=0.05 * np.abs(ours).max())


@pytest.mark.slow
def test_a_frame_is_drawn_back_through_flownet2(turn, by_flownet2):
    """Even random weights tell where in the picture the frame is, if renders look like the photos; how far away it is,
    pictures of 64 pixels do not tell them."""
    true = parameters_of(turn.truth[1])
    known = Neighbour(parameters_of(turn.truth[0]), (turn.pictures[0],))
    views, appearance = by_flownet2.views(turn.truth[1]), by_flownet2.appearance(turn.truth[0], turn.pictures[0])
    for off in np.array([[4.0, -3.0, 0.0], [-4.0, 3.0, 0.0]]):
        start = true._replace(translation=true.translation + off)
        found = by_flownet2.between((known, None), (turn.pictures[1],), start, start, views, appearance=appearance)
        left = found.parameters.translation - true.translation
        assert np.linalg.norm(left[:2]) < 0.5 * np.linalg.norm(off)
