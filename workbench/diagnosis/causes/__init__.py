"""Every cause of a bad frame as a small function that tries its hypothesis on a `Trial`."""

from workbench.diagnosis.causes.configuration import (
    not_converged,
    pose_expression_tradeoff,
    tau_fights_data,
    weights_at_bounds,
)
from workbench.diagnosis.causes.groups import face_outside, group_biased, jaw_disagrees, occluded
from workbench.diagnosis.causes.motion import frozen_detector, low_flow_consistency, motion_blur
from workbench.diagnosis.causes.order import mirrored_order, points_swapped
from workbench.diagnosis.causes.person import wrong_focal, wrong_identity

INPUT_CAUSES = (
    mirrored_order,
    points_swapped,
    face_outside,
    frozen_detector,
    low_flow_consistency,
    motion_blur,
    occluded,
    group_biased,
    jaw_disagrees,
    wrong_focal,
    wrong_identity,
)
"""In the landmarks, the pictures, the face and the lens; in no particular order: each is tried on every frame."""
SCHEDULE_CAUSES = (not_converged, tau_fights_data, weights_at_bounds, pose_expression_tradeoff)
"""In how the energy is weighted and minimised."""
