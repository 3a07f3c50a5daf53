"""Constants inside of the terms, as traced numbers."""

from typing import NamedTuple

from workbench.arrays import Scalar


class EnergyConstants(NamedTuple):
    """Constants inside of the terms; the defaults are those of a configuration."""

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
    weighted_edges: Scalar = 1.0
    """E_2: 1: an edge counts as the lesser weight of its ends; 0: all edges between landmarks that
    take part alike, as in the paper."""
