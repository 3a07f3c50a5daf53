"""Flow and predictor fused: a scalar Kalman filter for each landmark."""

import numpy as np
from jaxtyping import Float

from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.point_flow import CarriedPoints
from workbench.landmarks.tracker_options import TrackerOptions

LIDS = np.isin(np.arange(68), (37, 38, 40, 41, 43, 44, 46, 47))
LID_NOISE = 10.0
"""Times the flow's noise on the lids: in a blink the lid runs over the eye, whose texture flow follows instead."""
FLOW_NOISE = np.where(LIDS, LID_NOISE, 1.0)


def fused(
    flow: CarriedPoints,
    measured: Landmarks2D,
    variance: Float[np.ndarray, "68"],
    side: float,
    options: TrackerOptions,
) -> tuple[Landmarks2D, Float[np.ndarray, "68"]]:
    """A Kalman step for each point: flow predicts, the predictor measures.

    `side` is that of the face box in pixels, `variance` that of the points before, in its squares. Returns the points,
    with the predictor's confidence times the agreement of both, and their variance now.
    """
    difference = np.linalg.norm(measured.points - flow.points, axis=1) / side
    lost = np.where(flow.valid, 0.0, 10 * options.predictor_noise_sides)
    variance = variance + (options.flow_noise_sides * FLOW_NOISE) ** 2 + flow.round_trip.clip(max=1) ** 2 + lost**2
    noise = options.predictor_noise_sides**2 * (1 - 2 * np.log(measured.confidence.clip(1e-3)))
    # What flow and predictor cannot both explain is real motion that the flow missed, as a blink: open the gate.
    surplus = difference**2 - options.surprise**2 * (variance + noise)
    variance = variance + surplus.clip(min=0)
    gain = variance / (variance + noise)
    points = flow.points + gain[:, None] * (measured.points - flow.points)
    agreement = np.exp(-0.5 * (difference / (10 * options.predictor_noise_sides)) ** 2)
    agreement[LIDS] = 1.0  # flow is no witness of them
    return Landmarks2D(points, measured.confidence * agreement, measured.image_size), (1 - gain) * variance
