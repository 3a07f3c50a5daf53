"""The table of terms: the whole energy of both systems, one row per term.

A term is a residual in a file of this package, and a row here. From the row follow its ω in configurations with comment
and schema, the panel's slider and tooltip, its curve in charts and traces, and its line in the documentation.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple


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
    residual: str
    """Module and function in this package: its squares sum to the term, before ω. A name, so that configurations can be
    read without JAX."""
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
    compares_pictures: bool = False
    """Whether it compares a frame's pictures with those of the frame before."""
    of_pupils: bool = False
    """Whether it is zero where the landmarks have no pupils."""
    key: str = ""
    """The key of its ω in a configuration, as `weights.tau`; empty: `weights.` and the name."""
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
    smooth: bool = True
    """Whether fits move smoothly with its ω. A step or a kink holds them where no derivative is."""

    @property
    def omega_symbol(self) -> str:
        """What a slider of its ω is called."""
        return self.weight or self.symbol.replace("E_", "ω_")

    @property
    def equation(self) -> str:
        """Its source without the paper's name, for places that belong to one paper."""
        return self.source.replace("FACE IT! ", "").replace("Deep Energies ", "")

    def omega_key(self, system: str) -> str:
        """The key of its ω in a configuration of this system."""
        own = self.key or f"weights.{self.name}"
        return self.deep_key or own if system == "deep-energies" else own


ROWS = (
    Term(
        name="landmarks",
        symbol="E_pose, E_fit, E_1",
        source="FACE IT! Eqs. 8, 10; Deep Energies Eq. 2",
        says="model landmarks against observed ones",
        formula="Σ‖π(R·(b_0 + B·w) + t) − p‖²",
        residual="landmarks:landmark_residual",
        of="landmarks",
        systems=("face-it", "deep-energies"),
        branch="sparse",
    ),
    Term(
        name="edges",
        symbol="E_2",
        source="Deep Energies Sec. 8.1",
        says="differences of consecutive landmarks, which preserve edges",
        formula="Σ‖(p_i+1 − p_i) − (p*_i+1 − p*_i)‖²",
        residual="edges:edge_residual",
        of="landmarks",
        listed=("deep-energies",),
        key="deep.edges",
        weight="ω_edges",
        branch="",
        default=0.5,
        slider=(1e-3, 1e2),
        constants=("weighted_edges",),
    ),
    Term(
        name="tau",
        symbol="E_τ",
        source="FACE IT! Eq. 9",
        says="second difference of the pose",
        formula="‖[r|t]_t−2 − 2[r|t]_t−1 + [r|t]_t‖²",
        residual="temporal:tau_residual",
        unknowns=("rotation", "translation"),
        structure="diagonal",
        systems=("face-it",),
        links_frames=True,
        default=0.1,
        presets={"face-it": 0.01},
        constants=("rotation_mm",),
    ),
    Term(
        name="beta",
        symbol="E_β",
        source="FACE IT! Eq. 12",
        says="the paper's range term",
        formula="(Σ arctan steps at 0 and 1)²",
        residual="range:beta_residual",
        unknowns=("expression",),
        structure="single",
        systems=("face-it",),
        presets={"face-it": 3000.0},
        slider=(1e-4, 1e5),
        constants=("a", "b", "c"),
        smooth=False,
    ),
    Term(
        name="sigma",
        symbol="E_σ",
        source="FACE IT! Eq. 11",
        says="the paper's single-residual L1 norm",
        formula="(Σ|w|)²",
        residual="sparsity:sigma_residual",
        unknowns=("expression",),
        structure="single",
        systems=("face-it",),
        presets={"face-it": 1.0},
        smooth=False,
    ),
    Term(
        name="sigma_smooth",
        symbol="E_σ L1",
        source="after FACE IT! Eq. 11",
        says="smoothed separable L1 norm, one residual per weight",
        formula="Σ √(w² + δ²) − δ",
        residual="sparsity:sigma_smooth_residual",
        unknowns=("expression",),
        structure="diagonal",
        systems=("face-it",),
        presets={"calibrated": 20.0, "joint": 20.0, "gaze": 20.0, "dense": 12.0},
        slider=(1e-3, 1e3),
        constants=("delta",),
    ),
    Term(
        name="range",
        symbol="E_range",
        source="",
        says="quadratic penalty outside [0, 1]",
        formula="Σ (distance of w from [0, 1])²",
        residual="range:range_residual",
        unknowns=("expression",),
        structure="diagonal",
        systems=("face-it",),
        slider=(1e-3, 1e5),
    ),
    Term(
        name="regularisation",
        symbol="λ‖w‖²",
        source="Deep Energies Sec. 8.2",
        says="holds blendshapes and jaw near 0; `deep.lambda_reading` says how λ multiplies",
        formula="‖w‖²",
        residual="magnitude:magnitude_residual",
        unknowns=("expression", "jaw"),
        listed=("deep-energies",),
        key="deep.regularisation",
        weight="λ",
        branch="",
        default=30.0,
        slider=(1e-2, 1e4),
    ),
    Term(
        name="identity",
        symbol="E_identity",
        source="",
        says="keeps to the mean face",
        formula="‖identity‖²",
        residual="magnitude:identity_residual",
        unknowns=("identity",),
        structure="diagonal",
        systems=("face-it", "deep-energies"),
        key="identity.weight",
        deep_key="deep.identity",
        default=5.0,
        slider=(1e-2, 1e4),
    ),
    Term(
        name="prior",
        symbol="E_prior",
        source="Deep Energies Sec. 5",
        says="staying near the pose that the stage starts from",
        formula="‖[r|t] − [r|t]_start‖²",
        residual="stay:pose_residual",
        unknowns=("rotation", "translation"),
        structure="diagonal",
        listed=("deep-energies",),
        key="deep.prior",
        branch="",
        default=1.0,
        slider=(1e-3, 1e3),
        constants=("rotation_mm",),
    ),
    Term(
        name="stay",
        symbol="E_stay",
        source="Deep Energies Sec. 7",
        says="blendshapes and jaw staying where they are expected",
        formula="‖w − w_start‖²",
        residual="stay:expression_residual",
        unknowns=("expression", "jaw"),
        key="flow.stay",
        branch="",
        default=20.0,
        slider=(1e-1, 1e4),
    ),
    Term(
        name="vergence",
        symbol="E_vergence",
        source="",
        says="both eyes looking the same way; in degrees, of landmarks that show pupils",
        formula="‖g_left − g_right‖²",
        residual="gaze:vergence_residual",
        unknowns=("expression",),
        of_pupils=True,
        default=0.5,
    ),
    Term(
        name="opposites",
        symbol="E_opposites",
        source="",
        says="no eye turned two opposite ways at once; in degrees",
        formula="Σ √((g⁺·g⁻)² + 1) − 1",
        residual="gaze:opposites_residual",
        unknowns=("expression",),
        of_pupils=True,
        default=1.0,
        presets={"gaze": 3.0, "dense": 3.0},
    ),
    Term(
        name="gaze",
        symbol="E_gaze",
        source="",
        says="eyes that are both shut or hidden looking where they looked in the frame before; in degrees",
        formula="hidden·Σ(g_k,t − g_k,t−1)²",
        residual="gaze:gaze_residual",
        unknowns=("expression",),
        of_pupils=True,
        structure="diagonal",
        links_frames=True,
        default=3.0,
    ),
    Term(
        name="symmetry",
        symbol="E_symmetry",
        source="",
        says="both sides of the face doing the same",
        formula="Σ (w_left − w_right)²",
        residual="expressions:symmetry_residual",
        unknowns=("expression",),
        default=20.0,
    ),
    Term(
        name="usual",
        symbol="E_usual",
        source="",
        says="blendshapes acting together as they usually do: a Gaussian learned from many expressions",
        formula="wᵀ S⁻¹ w",
        residual="expressions:usual_residual",
        unknowns=("expression",),
        default=1.0,
    ),
    Term(
        name="flow",
        symbol="E_flow",
        source="Deep Energies Secs. 6, 7",
        says="the face moving from the frame before as the pictures' optical flow does",
        formula="Σ c²·log(1 + ‖x_t − x_t−1 − N(F*_t−1, F*_t)‖² / c²)",
        residual="flow:flow_residual",
        links_frames=True,
        compares_pictures=True,
        default=1.0,
    ),
)
TABLE: dict[str, Term] = {term.name: term for term in ROWS}
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
    Node("pose", "ω_pose", "Eq. 8", "reprojection while the pose alone is free", "Σ‖π(R·(b_0 + B·w) + t) − p‖²", 1),
    Node("fit", "ω_fit", "Eq. 10", "reprojection while the weights are free", "Σ‖π(R·(b_0 + B·w) + t) − p‖²", 1),
    Node("prior", "ω_prior", "Eqs. 5, 7", "all prior terms", "ω_prior·(ω_τ·E_τ + ω_β·E_β + ω_σ·E_σ)", 0),
)
"""FACE IT! Eqs. 5-7. Deep Energies has no hierarchy: of these it reads ω_prior alone, for the terms below it that its
stages name."""


def table_page() -> str:
    """The table as a page of Markdown, a section per term."""
    nodes = [f"- `weights.{node.name}`, {node.symbol}: {node.says} ({node.source})." for node in NODES]
    return "\n".join(
        [
            "# Terms of the energy",
            "",
            'Every term can be switched on in any stage of either system: `terms = ["tau"]` in a `[[stages]]` table.',
            "The factor in front of a term is the product of ω down its branch. Weights that multiply those below them",
            "(FACE IT! Eqs. 5-7):",
            "",
            *nodes,
            "",
            *(line for term in TABLE.values() for line in _section(term)),
        ]
    )


def _section(term: Term) -> tuple[str, ...]:
    systems = f"every stage of {' and '.join(term.systems)}" if term.systems else "stages that name it"
    return (
        f"## {term.symbol}: `{term.name}`",
        "",
        f"`{term.formula}`",
        "",
        f"{term.says[0].upper()}{term.says[1:]}. Source: {term.source or 'ours'}.",
        f"Weight: {_place(term)}. In {systems}.",
        "",
    )


def _place(term: Term) -> str:
    places = dict.fromkeys(term.omega_key(system) for system in ("face-it", "deep-energies"))
    return "`weights.sparse` and below" if term.name == "landmarks" else ", ".join(f"`{place}`" for place in places)


def terms_of(system: str, named: Iterable[str] = ()) -> tuple[str, ...]:
    """Names of the terms that a system has or lists, and of those that its stages name in addition."""
    named = set(named)
    return tuple(name for name, term in TABLE.items() if system in (*term.systems, *term.listed) or name in named)


def factor(term: Term, omega: Mapping[str, float], system: str, pose_only: bool) -> float:
    """The factor in front of a term: the product down its branch.

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
