"""Deep Energies Fig. 7: blur misleads the network along the jaw, and flow from the neighbours repairs the solve."""

import numpy as np
import pytest

from workbench.reproduction import Study
from workbench.reproduction.clip_solves import seen_in
from workbench.reproduction.rendered_clip import clip_pictures, clip_truth, errors_of_pose_and_jaw, true_parameters
from workbench.reproduction.wrong_markers import BLUR_DEG, BLUR_PX, FRAME, jolted, worked_failure


def test_a_jolt_draws_a_point_out_into_a_line_around_it():
    dot = np.zeros((101, 101, 3), np.uint8)
    dot[50, 50] = 255
    rows, columns = np.nonzero(jolted(dot, BLUR_PX)[..., 0])
    np.testing.assert_allclose([rows.mean(), columns.mean()], 50.0, atol=0.1)
    assert np.hypot(np.ptp(rows), np.ptp(columns)) == pytest.approx(BLUR_PX - 1, abs=2.0)
    slope_deg = np.degrees(np.arctan(np.polyfit(columns, rows, 1)[0]))
    assert abs(slope_deg) == pytest.approx(BLUR_DEG, abs=2.0)


def test_a_jolt_leads_the_network_astray_along_the_jaw_before_all():
    seen = seen_in(jolted(clip_pictures((FRAME,))[FRAME], BLUR_PX), FRAME)
    apart = np.linalg.norm(seen.landmarks.points - clip_truth().landmarks[FRAME], axis=1)
    assert apart[:17].mean() > 5.0 * apart[17:].mean()
    assert seen.landmarks.confidence[:17].mean() < 0.5 * seen.landmarks.confidence[17:].mean()


@pytest.mark.parametrize("frame", [0, FRAME])
def test_the_true_parameters_of_a_frame_have_its_pose(frame):
    rotation, across, depth, _ = errors_of_pose_and_jaw(true_parameters(frame), frame)
    assert max(rotation, across, depth) < 1e-9


@pytest.mark.long
@pytest.mark.slow
def test_the_solve_overfits_to_wrong_markers_and_flow_repairs_it(tmp_path):
    result = worked_failure(Study(tmp_path, quick=True))
    errors = {row[0]: np.array(row[1:6], float) for row in result.tables[0].rows}
    depth, jaw, landmarks = 2, 3, 4
    whole, without_jaw, filled = (
        errors[label] for label in ("expression estimation", "jaw at weight 0", "filled by flow")
    )
    assert filled[landmarks] < 0.4 * whole[landmarks]
    assert filled[depth] < 0.3 * whole[depth]
    assert filled[jaw] < 0.3 * whole[jaw]
    assert without_jaw[landmarks] < 0.7 * whole[landmarks]
    called = {row[0]: row[6] for row in result.tables[0].rows}
    assert called["expression estimation"] == "jaw and face disagree"
