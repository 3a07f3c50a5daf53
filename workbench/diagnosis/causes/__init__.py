"""The causes of bad frames, each a small function that tests its hypothesis on a `Trial`."""

from workbench.diagnosis.causes.confidence import doubted_part
from workbench.diagnosis.causes.configuration import (
    not_converged,
    pose_expression_tradeoff,
    tau_fights_data,
    weights_at_bounds,
)
from workbench.diagnosis.causes.gaze import stray_pupil
from workbench.diagnosis.causes.groups import face_outside, group_biased, jaw_disagrees, occluded
from workbench.diagnosis.causes.motion import frozen_detector, low_flow_consistency, motion_blur
from workbench.diagnosis.causes.order import mirrored_order, points_swapped
from workbench.diagnosis.causes.person import wrong_focal, wrong_identity
from workbench.diagnosis.causes.picture import (
    blurred_face,
    covered,
    dark_face,
    jump,
    pose_jump,
    turned_away,
    unseen_cut,
)

INPUT_CAUSES = (
    mirrored_order,
    points_swapped,
    face_outside,
    frozen_detector,
    low_flow_consistency,
    motion_blur,
    covered,
    doubted_part,
    blurred_face,
    dark_face,
    turned_away,
    unseen_cut,
    jump,
    pose_jump,
    occluded,
    group_biased,
    jaw_disagrees,
    stray_pupil,
    wrong_focal,
    wrong_identity,
)
"""Causes in the landmarks, the pictures, the face and the lens. The order is arbitrary: all are tried on each frame."""
SCHEDULE_CAUSES = (not_converged, tau_fights_data, weights_at_bounds, pose_expression_tradeoff)
"""Causes in how the energy is weighted and minimised."""
