"""What a term of the energy is: one row of the table in `terms`, and what a residual may look at."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.arrays import AnyArray, Scalar
from workbench.energies.constants import EnergyConstants
from workbench.face.parameters import FaceParameters


class LandmarkErrors(NamedTuple):
    """Model landmarks minus observed ones, in every view of a frame."""

    error: Float[AnyArray, "*views 68 2"]
    root: Float[AnyArray, "*views 68"]
    """√ of what each landmark's squared error counts."""
    unit: Scalar = 1.0
    """What counts as 1, in the unit of the errors."""


class TermContext(NamedTuple):
    """What a term may know of a frame besides the parameters."""

    constants: EnergyConstants
    before_last_pose: Float[AnyArray, "6"]
    """[r | t] of the frame before the last one; radians, millimetres."""
    last_pose: Float[AnyArray, "6"]
    history: Float[AnyArray, ""]
    """1 where both poses exist, else 0: no E_τ on the first two frames of a shot."""
    start: FaceParameters
    """Where the stage starts, or where an expectation has the face."""


OfLandmarks = Callable[[LandmarkErrors], Float[Array, "n"]]
OfParameters = Callable[[FaceParameters, TermContext], Float[Array, "n"]]


@dataclass(frozen=True)
class Term:
    """One term. Everything that names, explains, weighs or sums terms reads these rows."""

    name: str
    """In configurations, traces and records."""
    symbol: str
    source: str
    """Paper and equation; empty for a term of our own."""
    says: str
    """One sentence without a full stop: what the term is, or holds against."""
    formula: str
    residual: OfLandmarks | OfParameters
    """Its squares sum to the term, before ω."""
    of: Literal["landmarks", "parameters"] = "parameters"
    unknowns: tuple[str, ...] = ("rotation", "translation", "expression", "identity", "jaw", "scale")
    """Blocks of `FaceParameters` that it depends on; where none of them is free it is left out."""
    structure: Literal["dense", "diagonal", "single"] = "dense"
    """diagonal: residual i depends on the i-th unknown alone; single: one residual. Both make cheap normal equations.
    The derivative itself is always automatic."""
    systems: tuple[str, ...] = ()
    """Systems that have the term in every stage. Elsewhere a stage names it."""
    listed: tuple[str, ...] = ()
    """Systems that list the term in records and charts even where no stage names it."""
    links_frames: bool = False
    """Whether it looks at the frame before."""
    key: str = ""
    """Where its ω lies in a configuration, as `weights.tau`; empty: `weights.` and the name."""
    deep_key: str = ""
    """The same under Deep Energies, where that differs."""
    weight: str = ""
    """Symbol of its ω; empty: that of the term with ω for E."""
    branch: Literal["sparse", "prior", ""] = "prior"
    """The node of the hierarchy (FACE IT! Eqs. 5-7) whose ω multiplies its own; empty: none."""
    default: float = 0.0
    presets: dict[str, float] = field(default_factory=dict)
    """ω in presets that have another than the default."""
    slider: tuple[float, float] = (1e-4, 1e3)
    """Least ω above zero and largest one, on a logarithmic scale."""
    constants: tuple[str, ...] = ()
    """Constants that it reads, for panels that grey out what has no effect."""

    @property
    def omega_symbol(self) -> str:
        """What a slider of its ω is called."""
        return self.weight or self.symbol.replace("E_", "ω_")

    @property
    def equation(self) -> str:
        """Its source without the paper's name, for places that belong to one paper."""
        return self.source.replace("FACE IT! ", "").replace("Deep Energies ", "")

    def omega_key(self, system: str) -> str:
        """Where its ω lies in a configuration of this system."""
        own = self.key or f"weights.{self.name}"
        return self.deep_key or own if system == "deep-energies" else own

    def values(self, errors: LandmarkErrors, parameters: FaceParameters, context: TermContext) -> Float[Array, "n"]:
        """The residual from whatever it looks at."""
        return self.residual(errors) if self.of == "landmarks" else self.residual(parameters, context)


def still(start: FaceParameters, constants: EnergyConstants = EnergyConstants()) -> TermContext:  # noqa: B008
    """The context of a frame without any before it."""
    return TermContext(constants, jnp.zeros(6), jnp.zeros(6), jnp.zeros(()), start)
