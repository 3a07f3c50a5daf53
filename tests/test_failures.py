"""Why a fit should not be used, and errors in percent: one definition each, wherever they are shown."""

from dataclasses import replace

import numpy as np
import pytest

from tests.performances import GAP, performance
from tests.scenes import make_scene
from workbench.config import preset
from workbench.diagnosis import flag_frames
from workbench.export.clip import without_failures
from workbench.export.report import worst_frames
from workbench.export.summary import summary_of
from workbench.landmarks.scheme import outer_eye_distance
from workbench.pictures import OverlayParts, draw_overlay
from workbench.planning import infill_plan, plan_of
from workbench.solvers import Status
from workbench.tracking import FaceItFitter, FrameContext
from workbench.tracking.face_it_solution import record_of
from workbench.tracking.failures import NO_FACE, failure_of_residuals, failures_of, why_failed
from workbench.tracking.infill import usable_frames
from workbench.tracking.records import Fits, Track, frame_errors
from workbench.tracking.track_layout import LAYOUT
from workbench.widgets.status_line import status_of

RECORDED, FAR, UNSEEN, BROKEN = 2, 3, 7, 8


@pytest.fixture(scope="module")
def track(head):
    """A performance with a frame without a face and four that went wrong, each in its own way."""
    made = performance(head)
    failure, projected = made.failure.copy(), made.projected.copy()
    confidence, rotation = made.confidence.copy(), made.rotation.copy()
    failure[RECORDED] = 1
    projected[[FAR, UNSEEN]] += 60.0
    confidence[UNSEEN] = 0.0
    rotation[BROKEN] = np.nan
    return replace(made, failure=failure, projected=projected, confidence=confidence, rotation=rotation)


class TestFailures:
    def test_each_has_its_reason(self, track):
        assert dict(enumerate(failures_of(track))) == dict.fromkeys(range(len(track)), "") | {
            GAP: NO_FACE,
            RECORDED: "jaw and face disagree",
            BROKEN: "not finite",
        }

    def test_a_large_error_is_one_beyond_the_limit_of_who_asks(self, track):
        error = frame_errors(track)[FAR, 3]
        assert failures_of(track, largest_error=error + 0.1)[FAR] == ""
        assert failures_of(track, largest_error=error - 0.1)[FAR] == "large error"
        assert failures_of(track, largest_error=error - 0.1)[UNSEEN] == ""  # another camera of a rig saw it

    def test_a_fit_whose_energy_is_no_number_has_failed(self, head):
        """Its pose is the start's, and finite."""
        plan = plan_of(preset("calibrated"))
        fitter = FaceItFitter(head, plan)
        context = FrameContext(0, fitter.mean_identity(), None, None)
        solution = fitter.solve(fitter.problem(make_scene(head).observation(), context))
        assert why_failed(record_of(solution, plan)) == ""
        status = np.full_like(solution.report.status, Status.NOT_FINITE.value)
        fit = record_of(replace(solution, report=solution.report._replace(status=status)), plan)
        assert np.isfinite(fit.rotation).all()
        assert why_failed(fit) == "not finite"

    def test_of_no_frames_there_are_none(self, track):
        columns = {name: getattr(track, name)[:0] for name in LAYOUT}
        assert failures_of(Track(meta=track.meta, **columns)).shape == (0,)

    def test_a_frame_fails_as_its_track_says(self, track):
        for limit in (5.0, np.inf):
            assert [why_failed(track[k], limit) for k in range(len(track))] == failures_of(track, limit).tolist()

    def test_residuals_fail_by_size_by_disagreement_and_by_not_being_numbers(self):
        percent = np.full((4, 68), 2.0)
        percent[1, :17] = 9.0
        percent[2] = 9.0
        percent[3, 5] = np.nan
        assert failure_of_residuals(percent, 5.0, largest_disagreement=4.0).tolist() == [0, 1, 2, 3]
        assert failure_of_residuals(percent, 5.0).tolist() == [0, 0, 2, 3]

    def test_infill_exports_summary_report_and_diagnosis_agree(self, track):
        failed = {RECORDED, BROKEN}
        assert set(np.flatnonzero(~usable_frames(track, infill_plan(preset("joint"))))) == {*failed, GAP, FAR}
        assert set(np.flatnonzero(~without_failures(track).found)) == {*failed, GAP}
        assert summary_of([track])["frames_failed"] == {"jaw and face disagree": 1, "not finite": 1}
        flags = flag_frames(track)
        assert {k for k in range(len(track)) if "the fit failed" in flags.text[k]} == failed
        assert flags.text[RECORDED].startswith("the fit failed: jaw and face disagree")
        assert worst_frames(track, flags)[0] in failed

    def test_panel_and_overlay_say_why(self, track):
        fit = track[RECORDED]
        assert ">failed: jaw and face disagree</span>" in status_of(fit, len(track))
        assert "not seen in this view" in status_of(track[UNSEEN], len(track))
        width, height = fit.image_size
        paper = np.full((height, width, 3), 60, np.uint8)
        only_text = OverlayParts(False, False, False, False, axes=False, legend=False)
        bands = [
            (draw_overlay(paper, replace(fit, failure=why), parts=only_text).mean(2) > 100).sum()
            for why in ("", fit.failure)
        ]
        assert bands[1] > 1.3 * bands[0]  # more letters


class TestErrorsInPercent:
    def test_they_are_of_the_distance_between_the_observed_eyes(self, track):
        fit = track[FAR]
        expected = (
            100.0 * np.hypot(*(fit.projected - fit.observed).T) / np.hypot(*(fit.observed[45] - fit.observed[36]))
        )
        np.testing.assert_allclose(fit.residuals_percent, expected, rtol=1e-12)
        np.testing.assert_allclose(track.residuals_percent[FAR], expected, rtol=1e-12)
        np.testing.assert_allclose(
            outer_eye_distance(track.observed)[FAR], outer_eye_distance(fit.observed), rtol=1e-12
        )

    def test_the_errors_of_a_frame_are_their_means(self, track):
        percent = track.residuals_percent[FAR]
        np.testing.assert_allclose(track[FAR].errors[1:], [percent[17:].mean(), percent.mean()], rtol=1e-12)

    def test_of_a_frame_they_are_those_of_its_track_and_none_where_nothing_was_seen(self, track):
        every = [fit.errors for fit in Fits(track)]
        np.testing.assert_array_equal(frame_errors(track)[:, 1:], every)
        assert np.isnan(every).all(axis=1).tolist() == (~track.seen).tolist()

    def test_a_flagged_error_is_the_one_in_the_tables(self, track):
        error = frame_errors(track)[FAR, 2]
        assert f"error {error:.1f} % of the eye distance" in flag_frames(track).text[FAR]
