"""Failed frames are filled from their neighbours (Deep Energies Sec. 6, 8.3, Appendix A)."""

from dataclasses import replace

import numpy as np
import pytest

from tests.films import FOV_DEG, SIZE, FilmMaker, film_config, landmark_error_px, lost
from tests.stereo_scenes import make_rig
from workbench.errors import ConfigError, InputError
from workbench.flow import DisFlow
from workbench.geometry import Rig, pose_in_view
from workbench.geometry.rig_files import write_rig
from workbench.planning import infill_plan, plan_of
from workbench.tracking import moments as moments_module
from workbench.tracking.flow_fitter import FlowFitter, parameters_of
from workbench.tracking.infill import fill_by_flow, fill_linearly, infilled, usable, usable_frames
from workbench.tracking.moments import Moment, PictureSpool, moments
from workbench.tracking.point_links import Neighbour
from workbench.tracking.records import Track, stack_fits

OPEN_UNTIL = 4


def snap(index: int):
    """A mouth held open that snaps shut, while the head turns evenly."""
    jaw = float(np.interp(index, [OPEN_UNTIL, OPEN_UNTIL + 1, OPEN_UNTIL + 2], [0.6, 0.15, 0.0]))
    return {"jawOpen": jaw}, (1.5 * index - 6.0, 0.0, 0.0), (0.6 * index, 0.0, 0.0)


@pytest.fixture(scope="module")
def film(film_maker):
    return film_maker.film(10, snap)


def fitter_of(film_maker, **infill):
    return FlowFitter(film_maker.head, plan_of(film_config(infill={"method": "flow", **infill})))


def with_lost(film, frames):
    return film.moments([lost(fit) if fit.index in frames else fit for fit in film.truth])


def errors(result, film, frames):
    return np.array([landmark_error_px(result[k].fit, film.truth[k]) for k in frames])


def test_a_gap_is_filled_far_better_than_by_a_straight_line(film_maker, film):
    gap = (3, 4, 5)
    by_flow = list(infilled(fitter_of(film_maker), with_lost(film, gap)))
    by_line = list(infilled(fitter_of(film_maker, method="linear"), with_lost(film, gap)))
    assert errors(by_flow, film, gap).mean() < 0.5 * errors(by_line, film, gap).mean()
    jaw = film_maker.head.expression_names.index("jawOpen")
    assert by_flow[4].fit.expression[jaw] > 0.45
    assert by_line[4].fit.expression[jaw] < 0.4


def test_linear_and_spline_are_what_they_are_called(film_maker, film):
    gap = (3, 4)
    line = [moment.fit for moment in infilled(fitter_of(film_maker, method="linear"), with_lost(film, gap))]
    third = film.truth[2].translation + (film.truth[5].translation - film.truth[2].translation) / 3
    assert line[3].translation == pytest.approx(third)
    curve = [moment.fit for moment in infilled(fitter_of(film_maker, method="spline"), with_lost(film, gap))]
    assert curve[3].rotation == pytest.approx(film.truth[3].rotation, abs=1e-6)


def test_every_frame_comes_out_once_in_order_and_good_ones_untouched(film_maker, film):
    for method in ("flow", "linear", "spline"):
        result = list(infilled(fitter_of(film_maker, method=method), with_lost(film, (0, 4, 6, 9))))
        assert [moment.fit.index for moment in result] == list(range(10))
        assert all(moment.fit.found for moment in result)
        for k in (1, 2, 3, 5, 7, 8):
            assert result[k].fit is film.truth[k]
        for moment, picture in zip(result, film.pictures, strict=True):
            assert np.array_equal(moment.pictures[0], picture)


def test_at_the_ends_of_a_clip_one_anchor_is_enough(film_maker, film):
    ends = (0, 1, 8, 9)
    result = list(infilled(fitter_of(film_maker), with_lost(film, ends)))
    held = list(infilled(fitter_of(film_maker, method="linear"), with_lost(film, ends)))
    assert errors(result, film, ends).mean() < 0.5 * errors(held, film, ends).mean()
    assert held[9].fit.rotation == pytest.approx(film.truth[7].rotation)


def test_a_filled_frame_says_that_it_was(film_maker, film):
    result = list(infilled(fitter_of(film_maker), with_lost(film, (4,))))[4].fit
    assert (result.source, result.failure, result.found) == ("filled", "", True)
    assert result.confidence.max() == 0.0
    assert np.array_equal(result.observed, result.projected)
    assert np.isnan(result.energies).all()
    assert result.landmarks is None
    assert film.truth[4].landmarks is not None
    assert result.identity == pytest.approx(film.truth[3].identity)


@pytest.mark.parametrize("why", ["failed", "named", "far off"])
def test_bad_fits_are_filled_too(film_maker, film, why):
    fits = list(film.truth)
    wrong = replace(fits[4], rotation=fits[4].rotation + 0.3)
    if why == "failed":
        wrong = replace(wrong, failure="large error")
    if why == "far off":
        wrong = replace(wrong, projected=wrong.projected + 15.0)
    fits[4] = wrong
    named = {"frames": [(4, 4)]} if why == "named" else {}
    result = [moment.fit for moment in infilled(fitter_of(film_maker, **named), film.moments(fits))]
    assert result[4].source == "filled"
    assert result[4].rotation == pytest.approx(film.truth[4].rotation, abs=0.02)
    assert all(result[k] is fits[k] for k in range(10) if k != 4)


def test_gaps_longer_than_allowed_stay_empty(film_maker, film):
    result = [m.fit for m in infilled(fitter_of(film_maker, longest=1), with_lost(film, (2, 5, 6)))]
    assert [fit.found for fit in result] == [k not in (5, 6) for k in range(10)]


def test_nothing_flows_over_a_cut(film_maker, film):
    fits = [replace(fit, shot=int(fit.index >= 5)) for fit in film.truth]
    fits = [lost(fit) if fit.index in (3, 4, 5) else fit for fit in fits]
    result = [m.fit for m in infilled(fitter_of(film_maker, method="linear"), film.moments(fits))]
    assert result[4].translation == pytest.approx(film.truth[2].translation)
    assert result[5].translation == pytest.approx(film.truth[6].translation)
    assert [fit.shot for fit in result] == [0] * 5 + [1] * 5


def test_a_shot_without_a_good_frame_stays_empty(film_maker, film):
    fits = [replace(fit, shot=int(fit.index >= 5)) for fit in film.truth]
    fits = [lost(fit) if fit.index >= 5 else fit for fit in fits]
    result = [m.fit for m in infilled(fitter_of(film_maker), film.moments(fits))]
    assert [fit.found for fit in result] == [True] * 5 + [False] * 5
    with pytest.raises(InputError, match="this shot has none"):
        fill_by_flow(film_maker.flow, None, None, [])
    with pytest.raises(InputError, match="this shot has none"):
        fill_linearly(None, None, 2)


def test_frames_are_asked_for_as_they_are_needed(film_maker, film):
    asked = []

    def stream():
        for moment in with_lost(film, (4, 5)):
            asked.append(moment.fit.index)
            yield moment

    result = infilled(fitter_of(film_maker, method="linear"), stream())
    for _ in range(3):
        next(result)
    assert asked == [0, 1, 2]
    assert [next(result).fit.index, next(result).fit.index] == [3, 4]
    assert asked == [0, 1, 2, 3, 4, 5, 6]


@pytest.mark.long
def test_renders_may_go_through_the_estimator_of_the_photos(film_maker, film):
    config = film_config(infill={"method": "flow"}, flow={"renders": "estimated"})
    gap = (4, 5)
    result = list(infilled(FlowFitter(film_maker.head, plan_of(config)), with_lost(film, gap)))
    line = list(infilled(fitter_of(film_maker, method="linear"), with_lost(film, gap)))
    assert errors(result, film, gap).mean() < 0.7 * errors(line, film, gap).mean()


def test_more_rounds_and_other_estimators_are_settings(film_maker, film):
    gap = (4, 5)
    line = list(infilled(fitter_of(film_maker, method="linear"), with_lost(film, gap)))
    for estimator, rounds in (("farneback", 1), ("network", 2)):
        config = film_config(infill={"method": "flow", "rounds": rounds}, flow={"estimator": estimator})
        result = list(infilled(FlowFitter(film_maker.head, plan_of(config)), with_lost(film, gap)))
        assert errors(result, film, gap).mean() < errors(line, film, gap).mean()
    with pytest.raises(ConfigError, match="flow estimators are"):
        FlowFitter(film_maker.head, plan_of(film_config(flow={"estimator": "guess"})))


def test_usable_fits_are_those_that_hit_their_landmarks(film, film_maker):
    infill = infill_plan(film_config())
    fit = film.truth[0]
    assert usable(fit, infill)
    assert not usable(lost(fit), infill)
    assert not usable(replace(fit, failure="not finite"), infill)
    # Without landmarks of its own (another view saw the face) nothing speaks against it.
    assert usable(replace(fit, confidence=np.zeros(68), projected=fit.projected + 50.0), infill)


def test_the_usable_frames_of_a_track_are_its_usable_fits(film):
    fit, other = film.truth[0], film.truth[1]
    far = replace(fit, projected=fit.projected + 50.0)
    fits = [fit, lost(fit), replace(fit, failure="not finite"), replace(far, confidence=np.zeros(68)), far, other]
    infill = infill_plan(film_config(infill={"frames": ((other.index, other.index),)}))
    found = usable_frames(Track(meta={}, **stack_fits(fits)), infill).tolist()
    assert found == [usable(each, infill) for each in fits] == [True, False, False, True, False, False]


def test_each_view_brings_one_picture(film_maker, film):
    neighbour = Moment(film.truth[0], film.pictures[:1])
    views = film_maker.flow.views(film.truth[0])
    known = Neighbour(parameters_of(neighbour.fit), neighbour.pictures)
    with pytest.raises(InputError, match="There are 1 views, but 1 and 2 pictures"):
        film_maker.flow.links(known, film.pictures[:2], known.parameters, views)
    by_network = FlowFitter(film_maker.head, plan_of(film_config(flow={"renders": "network", "estimator": "network"})))
    with pytest.raises(InputError, match="There are 1 views, but 1 and 2 pictures"):
        by_network.between((known, None), film.pictures[:2], known.parameters, known.parameters, views)


@pytest.mark.long
def test_two_cameras_fill_a_gap_together(head, tmp_path):
    """The second camera sees depth; the first alone hardly does."""
    rig = make_rig((0.0, 35.0), distance_mm=480.0, image_size=SIZE, fov_deg=FOV_DEG)
    write_rig(rig, tmp_path / "rig.toml")
    config = film_config(infill={"method": "flow"}, camera={"rig": str(tmp_path / "rig.toml")})
    maker = FilmMaker(head)
    nodding = lambda k: ({"jawOpen": 0.4}, (0.0, 0.0, 0.0), (0.0, -20.0, 6.0 * abs(k - 3)))  # noqa: E731
    film = maker.film(7, nodding)
    seen = []
    for fit, picture in zip(film.truth, film.pictures, strict=True):
        state = parameters_of(fit)
        rotation, translation = pose_in_view(state.rotation, state.translation, rig.placed_view(1))
        other = maker.picture(state._replace(rotation=rotation, translation=translation))
        seen.append(Moment(lost(fit) if fit.index in (2, 3, 4) else fit, (picture, other)))
    result = [moment.fit for moment in infilled(FlowFitter(head, plan_of(config)), seen)]
    depth = [fit.translation[2] - truth.translation[2] for fit, truth in zip(result, film.truth, strict=True)]
    assert np.abs(depth[2:5]).max() < 2.5
    alone = [m._replace(pictures=m.pictures[:1]) for m in seen]
    line = [m.fit for m in infilled(fitter_of(maker, method="linear"), alone)]
    assert abs(line[3].translation[2] - film.truth[3].translation[2]) > 10.0


class Watching:
    """An estimator that keeps the pairs of pictures it was given."""

    name = "watching"

    def __init__(self):
        self.pairs = []

    def __call__(self, first, second):
        self.pairs.append((first, second))
        return DisFlow()(first, second)


@pytest.mark.long
def test_renders_for_the_estimator_are_lit_by_one_light_in_all_views(film_maker, film):
    """A second camera beside the first, upside down, sees nearly the same renders upside down."""
    first = make_rig((0.0,), image_size=SIZE, fov_deg=FOV_DEG).views[0]
    over = np.diag([-1.0, -1.0, 1.0])
    aside = np.array([5.0, 0.0, 0.0])  # two cameras of a rig may not stand in one place
    turned = over @ first.rotation_view_world, over @ first.translation_view_world_mm + aside
    second = replace(first, name="over", rotation_view_world=turned[0], translation_view_world_mm=turned[1])
    plan = plan_of(film_config(flow={"renders": "estimated"}))
    plan = replace(plan, camera=replace(plan.camera, rig=Rig((first, second))))
    fitter = FlowFitter(film_maker.head, plan)
    fitter.linker.estimator = watching = Watching()
    known, wanted = (parameters_of(film.truth[k]) for k in (0, 1))
    pictures = [(film.pictures[k], film.pictures[k][::-1, ::-1]) for k in (0, 1)]
    views, neighbour = fitter.views(film.truth[0]), Neighbour(known, pictures[0])
    links = fitter.links(neighbour, pictures[1], wanted, views)
    of_photos = len(watching.pairs)
    fitter.solve(((neighbour, links), None), wanted, known, views)
    upright, upside_down = (np.asarray(pair[0], float) for pair in watching.pairs[of_photos : of_photos + 2])
    assert upright.std() > 10.0
    assert np.abs(upright - upside_down[::-1, ::-1]).mean() < 1.0


def test_pictures_that_end_before_the_fits_are_told(film):
    with pytest.raises(InputError, match="has a frame 9, but its pictures end earlier"):
        list(moments(film.truth, [type(film.frames())(film.pictures[:9])]))


def test_pictures_of_another_size_than_the_tracked_ones_are_told(film):
    half = [picture[::2, ::2] for picture in film.pictures]
    width, height = film.truth[0].image_size
    told = f"Frame 0 is {width // 2}x{height // 2} in the pictures, and was {width}x{height} when it was tracked"
    with pytest.raises(InputError, match=told):
        list(moments(film.truth, [type(film.frames())(half)]))


def test_pictures_wait_on_disk_as_in_memory(film, monkeypatch):
    monkeypatch.setattr(moments_module, "MEMORY_BYTES", 100_000)
    spool = PictureSpool()
    for picture in film.pictures:
        spool.append((picture, picture[::2, ::2]))
    assert spool._file._rolled
    for k in (7, 0, 9, 3):
        whole, small = spool[k]
        assert np.array_equal(whole, film.pictures[k])
        assert np.array_equal(small, film.pictures[k][::2, ::2])
    assert len(spool) == 10
    spool.close()
