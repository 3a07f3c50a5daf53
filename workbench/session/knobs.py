"""The configuration values that have a control in the panel: path, range and meaning of each."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from workbench.config import Config
from workbench.config.schedules import ALL_GROUPS, weights_in_turn
from workbench.energies.terms import NODES, TABLE, Term, factor
from workbench.landmarks.scheme import GROUPS, POINT_COUNT, LandmarkScheme
from workbench.landmarks.schemes import DENSE, detector_scheme
from workbench.session.knob_words import Words, plain_words

Kind = Literal["log", "linear", "whole", "switch", "choice"]
Value = float | int | bool | str


@dataclass(frozen=True)
class Knob:
    """One control. `path` is `section.key`, or a special name handled by `value_of` and `changed_by`."""

    path: str
    label: str
    tip: str
    """One line with its equation."""
    kind: Kind
    low: float | int = 0.0
    high: float | int = 1.0
    """For a "log" knob: the smallest value above zero and the largest; zero comes below the smallest."""
    step: float | int = 0.0
    choices: tuple[str, ...] = ()
    level: int = 0
    """Depth in the hierarchy of ω (Eqs. 5–7)."""

    @property
    def words(self) -> Words:
        """A plain name, and what happens when the knob is raised."""
        return plain_words(self.path, self.tip.partition(": ")[2])

    @property
    def help(self) -> str:
        """Two lines: what happens when it is raised, then the equation."""
        return f"{self.words.effect}\n{self.tip}"

    def matches(self, text: str) -> bool:
        """Whether every word of a search is in its name, its plain words or its help."""
        told = f"{self.path} {self.label} {self.words.name} {self.help}".lower().replace("_", " ")
        return all(word in told for word in text.lower().replace("_", " ").split())


def _of_term(term: Term, system: str = "face-it") -> Knob:
    """The slider of a term's ω."""
    source = f", {term.equation}" if term.equation else ""
    path, tip, (low, high) = term.omega_key(system), f"{term.formula}: {term.says}{source}", term.slider
    return Knob(path, term.omega_symbol, tip, "log", low, high, level=int(path.startswith("weights.")))


OMEGA = (
    *(
        Knob(f"weights.{node.name}", node.symbol, f"{node.formula}: {node.says}, {node.source}", "log", 1e-3, 1e3,
             level=node.level)
        for node in NODES
    ),
    *(_of_term(term) for term in TABLE.values() if term.of == "parameters" and not term.key),
)  # fmt: skip
SOLVE = (
    Knob("rho", "ρ", "iterations of the stages that free only the pose (Eq. 8; the paper: 15)", "whole", 0, 100),
    Knob("epsilon", "ε", "iterations of the stages that free weights (Eq. 10; the paper: 15)", "whole", 0, 100),
    Knob("solver.tolerance", "tolerance", "stop when a step lowers E by less than this fraction", "log", 1e-14, 1e-1),
    Knob("solver.method", "solver", "lm: ours, which solves along bounds; the two of Optimistix stop there", "choice",
         choices=("lm", "optimistix-lm", "optimistix-dogleg")),
    Knob("solver.bounded", "0 ≤ w ≤ 1", "keep every weight in [0, 1]", "switch"),
    Knob("landmarks.confidence", "confidences", "each point counts by its detection's confidence; off: all alike, as "
         "in the papers", "switch"),
    Knob("solver.unit", "unit", "landmark residuals in pixels, or in % of the outer-eye distance", "choice",
         choices=("px", "percent")),
    Knob("contour.mode", "jaw contour", "sliding: the 17 jaw points follow the silhouette with the yaw", "choice",
         choices=("sliding", "fixed")),
)  # fmt: skip
CAMERA = (
    Knob("camera.fov_deg", "fov, °", "along the longer side; focal length f = side / (2·tan(fov/2))",
         "linear", 5.0, 120.0, 0.5),
)  # fmt: skip
IDENTITY = (
    Knob("identity.calibrate", "calibrate", "estimate one face shape per shot (or photo) before fitting", "switch"),
    _of_term(TABLE["identity"]),
    Knob("identity.size", "ω_size", "(the head's size over the mean head's, in percent)² in calibration",
         "log", 1e-2, 1e4),
    Knob("identity.expression", "ω_expression", "L1 norm of the weights during calibration; the rest is identity",
         "log", 1e-2, 1e4),
    Knob("identity.jaw", "jaw weight", "landmark weight of the jaw contour in calibration's second pass",
         "linear", 0.0, 3.0, 0.05),
)  # fmt: skip
CONSTANTS = (
    Knob("constants.a", "a", "E_β: upper bound; the paper: 1.002", "linear", 0.5, 2.0, 0.001),
    Knob("constants.b", "b", "E_β: width of its steps; the paper: 2·10⁻⁵", "log", 1e-6, 1.0),
    Knob("constants.c", "c", "E_β: offset; the paper: 2.5", "linear", -5.0, 5.0, 0.05),
    Knob("constants.delta", "δ", "smoothed L1: quadratic below this weight", "log", 1e-4, 1.0),
    Knob(
        "constants.rotation_mm",
        "mm per rad",
        "E_τ: millimetres equivalent to one radian; the paper: 1",
        "log",
        1.0,
        1e4,
    ),
    Knob(
        "constants.weighted_edges",
        "weighted edges",
        "E_2: each edge counts with the smaller weight of its ends; off: all alike, as in the paper",
        "switch",
    ),
)
LANDMARK_GROUPS = ("jaw", "right_brow", "left_brow", "nose", "right_eye", "left_eye", "outer_lips", "inner_lips")
LANDMARKS = (
    *(
        Knob(f"group.{name}", name.replace("_", " "), f"factor of the {len(GROUPS[name])} points in every stage; "
             "0 mutes", "linear", 0.0, 3.0, 0.05)
        for name in LANDMARK_GROUPS
    ),
    Knob("group.irises", "irises", "factor of pupils and irises in every stage (detectors dense, network+pupils); "
         "0 mutes", "linear", 0.0, 5.0, 0.05),
    Knob("group.dense", "further points", "factor of the points beyond the 68 in every stage (detector dense), but for "
         "the irises; 0 mutes", "linear", 0.0, 1.0, 0.01),
)  # fmt: skip
FURTHER_GROUPS = ("dense", "irises")
"""Groups of points beyond the 68, in this order after all others: later entries win."""
DEEP = (
    Knob("deep.network", "network", "N: ensemble: 68 points, the mean of the next two; heat-maps: 68; landmarks: 68, "
         "by the detector's newer weights; dense: 377, each with its covariance, from landmarks of the detector dense",
         "choice",
         choices=("ensemble", "heat-maps", "landmarks", "dense")),
    Knob("deep.energy", "energy", "N(F*) − N(F): detected in the render, Eq. 2; points on the mesh, C.1; or mixed",
         "choice", choices=("deep", "points", "mixed")),
    Knob("deep.derivative", "derivative", "forward: through renderer and network; broyden: from mesh points, corrected",
         "choice", choices=("broyden", "forward", "differences")),
    Knob("deep.start", "start", "frontal in the middle of the picture, or the pose from the landmarks", "choice",
         choices=("frontal", "landmarks")),
    *(_of_term(term) for term in TABLE.values() if term.key.startswith("deep.")),
    Knob("deep.lambda_reading", "λ in", "energy: λ‖w‖²; residual: ‖λw‖², as Sec. 8.2 prints it", "choice",
         choices=("energy", "residual")),
    Knob("deep.tolerance", "tolerance", "a stage stops when a step lowers E by a smaller fraction", "log", 1e-6, 1e-1),
)  # fmt: skip
METHODS = (
    Knob("infill.method", "infill", "fills failed frames from their neighbours: by optical flow, Sec. 6, 8.3; or "
         "interpolated, App. A", "choice", choices=("none", "flow", "linear", "spline")),
    Knob("refinement.method", "refine", "steadier: average of three (App. B), self flow, plate flow (Sec. 7); hybrid: "
         "averaging, then plate", "choice", choices=("none", "averaging", "self", "plate", "hybrid")),
)  # fmt: skip
TIME = (
    Knob("refinement.sweeps", "sweeps", "how often refinement solves each frame; hybrid averages once", "whole",
         1, 20),
    Knob("refinement.reestimate", "re-estimate", "number of expression re-fits with the pose held, App. "
         "B.1", "whole", 0, 10),
    Knob("refinement.order", "order", "jacobi: neighbours from the previous sweep; gauss-seidel: the latest ones",
         "choice", choices=("jacobi", "gauss-seidel")),
    Knob("refinement.prior", "prior", "flow: weight holding each pose near its earlier value; mm, 1 rad as 100", "log",
         1e-3, 1e3),
    Knob("refinement.centre", "centre", "averaging: weight of the frame itself; its neighbours share the rest",
         "linear", 0.05, 1.0, 0.05),
    Knob("infill.passes", "passes", "flow infill: meet: from both ends, then between both neighbours; back-and-forth: "
         "forward, then backward over the filled frames, Sec. 8.3", "choice", choices=("meet", "back-and-forth")),
    Knob("infill.rounds", "rounds", "flow infill: further passes through a gap, back and forth", "whole", 1, 10),
    Knob("infill.lids", "lids", "flow infill: eyelids as the landmark network sees them, or as flow has them", "choice",
         choices=("network", "flow")),
    Knob("infill.largest_error", "bad above", "a fit has failed above this mean error, % of the eye distance",
         "linear", 0.5, 50.0, 0.5),
    Knob("flow.estimator", "flow", "of the pictures: OpenCV's DIS or Farnebäck, or our network (slower)", "choice",
         choices=("dis", "farneback", "network")),
    Knob("flow.renders", "renders", "flow of the renders: the mesh's exact one; as estimated; by the network with its "
         "own derivative, Sec. 6 (needs a network, slow)", "choice", choices=("exact", "estimated", "network")),
    _of_term(TABLE["stay"]),
)  # fmt: skip
KNOBS = (*OMEGA, *SOLVE, *CAMERA, *IDENTITY, *CONSTANTS, *LANDMARKS, *DEEP, *METHODS, *TIME)


def label_of(path: str) -> str:
    """What undo calls a change of a knob: its symbol and its plain name."""
    knob = next(knob for knob in KNOBS if knob.path == path)
    return f"{knob.label}, {knob.words.name}"


def inert_among(config: Config, paths: Iterable[str], scheme: LandmarkScheme | None = None) -> frozenset[str]:
    """The knobs among these that have no effect under this configuration's system and stages.

    `scheme`: of the landmarks that there are; None: of those that the configuration's detector finds.
    """
    scheme = detector_scheme(config.landmarks.detector) if scheme is None else scheme
    traits, terms, system = config.traits, config.summed_terms, config.system
    ones = dict.fromkeys(config.omega(), 1.0)
    enabled = (stage for stage in config.stages if stage.enabled)
    stages = (zip(config.terms, config.factors(stage), strict=True) for stage in enabled)
    weighty = {name for stage in stages for name, weight in stage if weight}

    def acts(path: str) -> bool:
        section, _, key = path.rpartition(".")
        if path == "deep.lambda_reading":
            return acts("deep.regularisation")
        if section == "constants":
            return any(key in TABLE[name].constants for name in weighty)
        if section in ("weights", "deep") and path in ones:
            # An ω acts if it multiplies a term that is in some stage.
            without = {**ones, path: 0.0}
            return any(
                factor(TABLE[name], without, system, pose_only) == 0.0 for name in terms for pose_only in (True, False)
            )
        if section == "group" and key in FURTHER_GROUPS:
            # Renders hold the gaze.
            return key in scheme.groups and not (key == "irises" and traits.renders)
        if path == "camera.fov_deg" and (config.camera.matrix is not None or config.camera.rig):
            return False
        return traits.reads(path)

    return frozenset(path for path in paths if not acts(path))


def value_of(config: Config, path: str) -> Value:
    """The value that a knob shows for this configuration."""
    if path in ("rho", "epsilon"):
        limits = [stage.limit for stage in config.stages if _frees_weights(stage) == (path == "epsilon")]
        return limits[-1] if limits else 15
    section, key = path.split(".")
    if section == "group":
        factor = _group_factor(config, config.landmarks.weights, key)
        return config.landmarks.weights.get(key, 1.0) if factor is None else factor
    return getattr(getattr(config, section), key)


def changed_by(config: Config, path: str, value: Value) -> dict[str, Any]:
    """Arguments for `Config.changed` that set a knob, with any values that must change with it."""
    if path in ("rho", "epsilon"):
        stages = [
            stage.model_copy(update={"limit": int(value)}) if _frees_weights(stage) == (path == "epsilon") else stage
            for stage in config.stages
        ]
        return {"stages": [stage.model_dump() for stage in stages]}
    section, key = path.split(".")
    if section == "group":
        return {"landmarks": {"weights": _with_group(config, key, float(value))}}
    changes: dict[str, Any] = {section: {key: value}}
    if path == "camera.fov_deg" and config.camera.matrix is not None:
        changes["camera"] |= {"matrix": None, "distortion": []}
    return changes


def _with_group(config: Config, group: str, factor: float) -> dict[str, float]:
    """The landmark weights with another factor of a group; without an entry of it where that changes nothing.

    Later entries win: its own comes after the groups that it is part of, and before its parts and single points.
    Further points come last, as a group of the 68 may have some of them, too.
    """
    entries = [entry for entry in config.landmarks.weights.items() if entry[0] != group]
    ranks = {name: rank for rank, name in enumerate(FURTHER_GROUPS, 1)}
    groups = sorted((entry for entry in entries if not entry[0].isdigit()), key=lambda entry: ranks.get(entry[0], 0))
    points, rank = _points_of(config, group), ranks.get(group, 0)
    wider = [
        place
        for place, (name, _) in enumerate(groups, 1)
        if ranks.get(name, 0) < rank or points <= _points_of(config, name)
    ]
    place = max(wider, default=0)
    before, after = dict(groups[:place]), dict(groups[place:])
    own = {} if factor == 1.0 and _group_factor(config, before, group) == 1.0 else {group: factor}
    return before | own | after | {name: single for name, single in entries if name.isdigit()}


def _group_factor(config: Config, weights: Mapping[str, float], group: str) -> float | None:
    """The factor that entries of groups give all points of a group; None where these differ."""
    entries = {name: factor for name, factor in weights.items() if not name.isdigit()}
    factors = weights_in_turn(entries, config.subsets, 1.0, DENSE)
    found = {factors[point] for point in _points_of(config, group)}
    return found.pop() if len(found) == 1 else None


def _points_of(config: Config, group: str) -> frozenset[int]:
    """The points of a group or subset; of parts of the 68 these alone, as those beyond have sliders of their own."""
    points = {**ALL_GROUPS, **DENSE.groups, **config.subsets}[group]
    return frozenset(point for point in points if point < POINT_COUNT) or frozenset(points)


def effective_weights(config: Config) -> dict[str, float]:
    """The product of ω down the branch, for each path of `OMEGA` that is a leaf."""
    omega = config.omega()
    products = {
        f"weights.{name}": factor(TABLE["landmarks"], omega, "face-it", name == "pose") for name in ("pose", "fit")
    }
    leaves = [term for term in TABLE.values() if term.of == "parameters" and not term.key]
    return products | {term.omega_key(config.system): factor(term, omega, config.system, False) for term in leaves}


def _frees_weights(stage) -> bool:
    return "expression" in stage.free
