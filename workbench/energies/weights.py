"""The hierarchy of ω (FACE IT! Eqs. 5–7) and the shape constants of the terms, as traced numbers."""

from typing import NamedTuple

from workbench.arrays import Scalar


class EnergyWeights(NamedTuple):
    """ω of every term; the factor in front of a term is the product down its branch."""

    sparse: Scalar = 1.0
    pose: Scalar = 1.0
    fit: Scalar = 1.0
    prior: Scalar = 1.0
    tau: Scalar = 0.1
    beta: Scalar = 0.01
    sigma: Scalar = 0.01
    sigma_smooth: Scalar = 0.0
    """Smoothed separable L1 in place of the paper's single residual."""
    range: Scalar = 0.0
    """Quadratic penalty outside [0, 1]: pulls weights back, which the paper's E_β hardly does."""
    identity: Scalar = 1.0

    def effective(self) -> dict[str, Scalar]:
        """The factor in front of each term, by term name."""
        data, prior = self.sparse, self.prior
        return {
            "pose": data * self.pose,
            "fit": data * self.fit,
            "tau": prior * self.tau,
            "beta": prior * self.beta,
            "sigma": prior * self.sigma,
            "sigma_smooth": prior * self.sigma_smooth,
            "range": prior * self.range,
            "identity": prior * self.identity,
        }


class EnergyConstants(NamedTuple):
    """Constants inside the terms."""

    a: Scalar = 1.002
    """E_β (Eq. 12): upper bound."""
    b: Scalar = 2e-5
    """E_β: width of its two steps."""
    c: Scalar = 2.5
    """E_β: offset."""
    delta: Scalar = 0.01
    """Smoothed L1: weight below which it turns quadratic."""
    rotation_mm: Scalar = 100.0
    """E_τ: millimetres that one radian counts as, so that r and t are comparable."""
