"""What a landmark's covariance says in a picture: the ellipse that holds a given share of the places it may have."""

import numpy as np
from jaxtyping import Float

SHARE = 0.8
"""Of the truth that a drawn ellipse should hold."""
CORNERS = 24
"""Of the polygon that an ellipse is drawn as."""


def ellipse_radius(share: float) -> float:
    """Of the ellipse that holds this share of a Gaussian in the plane, in deviations."""
    return float(np.sqrt(-2.0 * np.log(1.0 - share)))


def ellipses(
    points: Float[np.ndarray, "n 2"], covariance: Float[np.ndarray, "n 2 2"], share: float = SHARE
) -> Float[np.ndarray, "n corners 2"]:
    """The ellipses around points that hold this `share` of their distributions, as polygons in the points' pixels."""
    angles = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    circle = ellipse_radius(share) * np.stack([np.cos(angles), np.sin(angles)])
    return points[:, None] + np.swapaxes(np.linalg.cholesky(covariance) @ circle, 1, 2)
