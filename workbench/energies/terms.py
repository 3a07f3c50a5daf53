"""The table of terms: the whole energy of both systems, a row a term.

A term is a file with its residual and its row, and an entry here. From the row follow its ω in configurations with
comment and schema, the panel's slider and tooltip, its curve in charts and traces, and its line in the documentation.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from workbench.energies.edges import EDGES
from workbench.energies.landmarks import LANDMARKS
from workbench.energies.magnitude import IDENTITY, REGULARISATION
from workbench.energies.range import BETA, RANGE
from workbench.energies.sparsity import SIGMA, SIGMA_SMOOTH
from workbench.energies.stay import PRIOR, STAY
from workbench.energies.temporal import TAU
from workbench.energies.term import Term

TABLE: dict[str, Term] = {
    term.name: term
    for term in (LANDMARKS, EDGES, TAU, BETA, SIGMA, SIGMA_SMOOTH, RANGE, REGULARISATION, IDENTITY, PRIOR, STAY)
}
"""In the order of residuals, records and charts."""


class Node(NamedTuple):
    """A weight in the hierarchy that is no term's own: it multiplies those below it."""

    name: str
    symbol: str
    source: str
    says: str
    formula: str
    level: int


NODES = (
    Node("sparse", "ω_sparse", "Eqs. 5, 6", "all landmark terms", "ω_sparse·(ω_pose·E_pose + ω_fit·E_fit)", 0),
    Node("pose", "ω_pose", "Eq. 8", "reprojection while the pose alone is free", "Σ‖π(R·b_0 + t) − p‖²", 1),
    Node("fit", "ω_fit", "Eq. 10", "reprojection while the weights are free", "Σ‖π(R·(b_0 + B·w) + t) − p‖²", 1),
    Node("prior", "ω_prior", "Eqs. 5, 7", "all prior terms", "ω_prior·(ω_τ·E_τ + ω_β·E_β + ω_σ·E_σ)", 0),
)
"""FACE IT! Eqs. 5-7. Deep Energies has no hierarchy: of these it reads ω_prior alone, for the terms below it that its
stages name."""


def table_page() -> str:
    """The table as a page of Markdown."""
    head = ("term", "name", "ω", "what it is", "formula", "from", "in every stage of")
    rows = [
        (
            *(term.symbol, f"`{term.name}`", _place(term), term.says, term.formula, term.source or "ours"),
            ", ".join(term.systems) or "neither system: a stage names it",
        )
        for term in TABLE.values()
    ]
    nodes = [f"- `weights.{node.name}`, {node.symbol}: {node.says} ({node.source})." for node in NODES]
    return "\n".join(
        [
            "# Terms of the energy",
            "",
            'Every term can be switched on in any stage of either system: `terms = ["tau"]` in a `[[stages]]` table.',
            "The factor in front of a term is the product of ω down its branch.",
            "",
            _table_row(head),
            "|---" * len(head) + "|",
            *map(_table_row, rows),
            "",
            "Weights that multiply those below them (FACE IT! Eqs. 5-7):",
            "",
            *nodes,
            "",
        ]
    )


def _table_row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _place(term: Term) -> str:
    places = dict.fromkeys(term.omega_key(system) for system in ("face-it", "deep-energies"))
    return "`weights.sparse` and below" if term.name == "landmarks" else ", ".join(f"`{place}`" for place in places)


def terms_of(system: str, named: Iterable[str] = ()) -> tuple[str, ...]:
    """Names of the terms that a system has or lists, and of those that its stages name besides."""
    named = set(named)
    return tuple(name for name, term in TABLE.items() if system in (*term.systems, *term.listed) or name in named)


def factor(term: Term, omega: Mapping[str, float], system: str, pose_only: bool) -> float:
    """What stands in front of a term: the product down its branch.

    `omega` holds the weights by their place in a configuration, as `weights.tau`.
    """
    if term.name == "landmarks":
        if system == "deep-energies":
            return 1.0
        return omega["weights.sparse"] * omega["weights.pose" if pose_only else "weights.fit"]
    key = term.omega_key(system)
    below = term.branch == "prior" and (system == "face-it" or key.startswith("weights."))
    return omega["weights.prior"] * omega[key] if below else omega[key]


def stage_factors(
    omega: Mapping[str, float], system: str, free: Iterable[str], named: Iterable[str], terms: tuple[str, ...]
) -> list[float]:
    """The factor of each of `terms` in a stage: 0 for those that are neither the system's own nor named by it."""
    pose_only, named = not {"expression", "identity"} & set(free), set(named)
    return [
        factor(TABLE[name], omega, system, pose_only) if system in TABLE[name].systems or name in named else 0.0
        for name in terms
    ]
