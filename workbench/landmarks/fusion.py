"""Flow and predictor fused: a scalar Kalman filter for each landmark."""

from dataclasses import replace
from functools import cache

import numpy as np
from jaxtyping import Bool, Float

from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.point_flow import CarriedPoints
from workbench.landmarks.scheme import POINT_COUNT, LandmarkScheme
from workbench.landmarks.tracker_options import TrackerOptions

LIDS = (37, 38, 40, 41, 43, 44, 46, 47)
LID_NOISE = 10.0
"""Times the flow's noise on the lids: in a blink the lid runs over the eye, whose texture flow follows instead."""


def fused(
    flow: CarriedPoints,
    measured: Landmarks2D,
    variance: Float[np.ndarray, "points"],
    side: float,
    options: TrackerOptions,
) -> tuple[Landmarks2D, Float[np.ndarray, "points"]]:
    """A Kalman step for each point: flow predicts, the predictor measures.

    `side` is that of the face box in pixels, `variance` that of the points before, in its squares. Returns the points,
    with the predictor's confidence times the agreement of both, and their variance now.
    """
    lids = _lids(measured.scheme)
    flow_noise = options.flow_noise_sides * np.where(lids, LID_NOISE, 1.0)
    difference = np.linalg.norm(measured.points - flow.points, axis=1) / side
    lost = np.where(flow.valid, 0.0, 10 * options.predictor_noise_sides)
    variance = variance + flow_noise**2 + flow.round_trip.clip(max=1) ** 2 + lost**2
    noise = options.predictor_noise_sides**2 * (1 - 2 * np.log(measured.confidence.clip(1e-3)))
    # What flow and predictor cannot both explain is real motion that the flow missed, as a blink: open the gate.
    surplus = difference**2 - options.surprise**2 * (variance + noise)
    variance = variance + surplus.clip(min=0)
    gain = variance / (variance + noise)
    points = flow.points + gain[:, None] * (measured.points - flow.points)
    agreement = np.exp(-0.5 * (difference / (10 * options.predictor_noise_sides)) ** 2)
    agreement[lids] = 1.0  # flow is no witness of them
    return replace(measured, points=points, confidence=measured.confidence * agreement), (1 - gain) * variance


@cache
def _lids(scheme: LandmarkScheme) -> Bool[np.ndarray, "points"]:
    """The lids between the corners, and all that a blink covers."""
    mask = np.isin(np.arange(len(scheme)), LIDS)
    mask[POINT_COUNT:] = scheme.group_mask("eyes")[POINT_COUNT:]
    return mask | scheme.group_mask("irises") if "irises" in scheme.groups else mask
