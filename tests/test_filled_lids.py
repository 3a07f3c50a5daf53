"""Eyelids of filled frames: as far open as the landmark network sees them, where flow has put the face."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from workbench.config import Stage, preset
from workbench.face import FaceParameters
from workbench.frames import open_frames
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.tracking import FaceItFitter, FrameContext, FrameObservation
from workbench.tracking.filled_lids import free_blinks, with_seen_lids
from workbench.tracking.flow_fitter import FlowFitter, parameters_of
from workbench.tracking.infill import fill_by_flow, fill_linearly
from workbench.tracking.moments import Moment

FIRST, SHUT, LAST = 103, slice(3, 6), 111
"""The eyes of the bundled clip shut in frames 106 to 108."""
CONFIG = preset("joint").changed(camera={"fov_deg": 33.0}, infill={"method": "flow"})


@dataclass(frozen=True, eq=False)
class Blink:
    """Frames of the bundled clip as a perfect solver would record them."""

    fitter: FlowFitter
    blinks: tuple[int, ...]
    moments: list[Moment]

    def weights(self, path) -> np.ndarray:
        """The blinks of these parameters, right and left."""
        return np.array([np.asarray(at.expression)[list(self.blinks)] for at in path])

    def filled(self, lids: str) -> list[FaceParameters]:
        """All but the first and the last frame, filled."""
        plan = replace(self.fitter.plan, infill=replace(self.fitter.plan.infill, lids=lids))
        fitter = FlowFitter(self.fitter.model, plan)
        inside = [moment.pictures for moment in self.moments[1:-1]]
        return fill_by_flow(fitter, self.moments[0], self.moments[-1], inside)

    def seen(self, known: tuple[int, ...], path, pictures):
        """The path with its lids as they are seen."""
        ends = [(parameters_of(self.moments[k].fit), self.moments[k].pictures[0]) for k in known]
        fit = self.moments[known[0]].fit
        return with_seen_lids(self.blinks, lambda at: self.fitter.landmarks(fit, at), ends, path, pictures)


@pytest.fixture(scope="module")
def blink(head):
    fitter, frames = FlowFitter(head, plan_of(CONFIG)), open_frames(sample("performance"))
    solver = FaceItFitter(head, plan_of(CONFIG))
    moments = []
    with np.load(sample("performance-truth"), allow_pickle=False) as truth:
        for frame in frames.iterate(FIRST):
            if frame.index > LAST:
                break
            identity = truth["identity"]
            pose = truth["rotation"][frame.index], truth["translation"][frame.index]
            at = FaceParameters(*pose, truth["expression"][frame.index], identity, np.zeros(6), np.ones(1))
            empty = FrameObservation(frame.index, None, frames.image_size)
            like, _ = solver.fit(empty, FrameContext(0, identity, None, None))
            fit = fitter.placed(replace(like, found=True, source="detected", identity=identity), at)
            fit = replace(fit, observed=fit.projected, confidence=np.ones(68))
            moments.append(Moment(fit, (frame.picture,)))
    return Blink(fitter, free_blinks(head.expression_names, np.ones(len(head.expression_names), bool)), moments)


@pytest.fixture(scope="module")
def by_flow(blink):
    return blink.filled("flow")


@pytest.mark.long
def test_a_blink_inside_a_gap_is_seen_and_nothing_else_is_changed(blink, by_flow):
    path = blink.filled("network")
    truth = blink.weights(parameters_of(moment.fit) for moment in blink.moments[1:-1])
    off, off_by_flow = (np.abs(blink.weights(each) - truth).mean() for each in (path, by_flow))
    assert off_by_flow > 0.25
    assert off < 0.5 * off_by_flow
    assert blink.weights(path)[2:5].min() > 0.7
    others = np.setdiff1d(np.arange(len(by_flow[0].expression)), blink.blinks)
    for at, before in zip(path, by_flow, strict=True):
        assert np.array_equal(np.asarray(at.expression)[others], np.asarray(before.expression)[others])
        assert np.array_equal(at.rotation, before.rotation)
        assert np.array_equal(at.translation, before.translation)


def test_one_good_frame_is_enough(blink):
    path = [parameters_of(blink.moments[0].fit)] * 3
    shut = blink.moments[SHUT]
    found = blink.seen((0,), path, [moment.pictures[0] for moment in shut])
    assert blink.weights(found).min() > 0.7


def test_lids_that_are_seen_where_they_are_stay_exactly_as_they_are(blink):
    inside = blink.moments[1:-1]
    path = [parameters_of(moment.fit) for moment in inside]
    found = blink.seen((0, len(inside) + 1), path, [moment.pictures[0] for moment in inside])
    assert found[0] is path[0]
    assert found[-1] is path[-1]


def test_a_look_that_sees_no_eyes_changes_nothing(blink):
    path = [parameters_of(blink.moments[0].fit)]
    grey = np.full_like(blink.moments[0].pictures[0], 90)
    assert blink.seen((0,), path, [grey])[0] is path[0]


def test_shut_eyes_do_not_tell_what_open_is(blink):
    path = [parameters_of(blink.moments[SHUT.start].fit)]
    assert blink.seen((SHUT.start + 1,), path, [blink.moments[0].pictures[0]])[0] is path[0]


def test_blinks_that_the_plan_holds_are_left_to_flow(blink, by_flow):
    stage = Stage(name="mouth", free=("rotation", "translation", "expression"), shapes=("jawOpen",), limit=5)
    held = FlowFitter(blink.fitter.model, plan_of(CONFIG.changed(stages=[stage])))
    ends = blink.moments[0], blink.moments[-1]
    path = fill_by_flow(held, *ends, [moment.pictures for moment in blink.moments[1:-1]])
    straight = blink.weights(fill_linearly(ends[0].fit, ends[1].fit, len(path)))
    assert blink.weights(path) == pytest.approx(straight, abs=0.05)


def test_both_blinks_must_be_free():
    names = ("eyeBlinkLeft", "jawOpen", "eyeBlinkRight")
    assert free_blinks(names, np.ones(3, bool)) == (2, 0)
    assert free_blinks(names, np.array([False, True, True])) == ()
    assert free_blinks(names[:2], np.ones(2, bool)) == ()
