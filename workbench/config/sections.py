"""The sections of a configuration: each value with its default, its range and its comment in a file."""

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, create_model, field_validator, model_validator

from workbench.energies.terms import NODES, TABLE, Term
from workbench.face.characters import PLAIN, character_names, is_character

NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
FrameKey = Annotated[str, Field(pattern=r"^(0|[1-9][0-9]*)$")]
PointKey = Annotated[str, Field(pattern=r"^([0-9]|[1-9][0-9]|[12][0-9]{2}|3[0-6][0-9]|37[0-6])$")]
"""A point number from 0 to 376, the last of the largest landmark scheme, as text because TOML keys are text."""
Detector = Literal[
    "auto", "dlib+network", "network", "network+pupils", "dense", "dlib", "dlib-hog", "dlib-cnn", "mediapipe"
]
MatrixRow = Annotated[list[float], Field(min_length=3, max_length=3)]
Iterations = Annotated[int, Field(ge=0, le=500)]


class Section(BaseModel):
    """A part of a configuration: unknown keys and non-finite numbers are rejected."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    in_turn: ClassVar[tuple[str, ...]] = ()
    """The tables in which later entries overrule earlier ones, so that their order counts."""

    def __eq__(self, other: Any) -> bool:
        alike = super().__eq__(other)
        if alike is not True:  # false, or NotImplemented beside what is no section
            return alike
        return all(list(getattr(self, name)) == list(getattr(other, name)) for name in self.in_turn)


class CameraConfig(Section):
    """Camera: given as a matrix, or derived from a field of view."""

    fov_deg: Annotated[float, Field(gt=0.0, lt=180.0)] = Field(
        45.0, description="Field of view along the longer side, degrees; a guess unless you know it."
    )
    fov_known: bool = Field(
        False, description="true: fov_deg is the lens's own even if it is 45, which otherwise counts as a guess."
    )
    matrix: Annotated[list[MatrixRow], Field(min_length=3, max_length=3)] | None = Field(
        None, description="OpenCV camera matrix in pixels; replaces fov_deg."
    )
    distortion: list[float] = Field([], description="OpenCV distortion, 0, 4, 5 or 8 coefficients.")
    projection: Literal["perspective", "orthographic"] = Field(
        "perspective",
        description="orthographic: no perspective, as with a telephoto lens; the head's scale replaces z.",
    )
    rig: str = Field("", description="Rig file of several cameras (Deep Energies); replaces the camera above.")

    @model_validator(mode="after")
    def _is_a_lens(self):
        if self.matrix is not None or self.distortion:
            from workbench.geometry.camera import camera_from_matrix  # here: it imports JAX

            camera_from_matrix(np.eye(3) if self.matrix is None else np.array(self.matrix), np.array(self.distortion))
        return self

    @property
    def guessed(self) -> bool:
        """Whether nothing is known about the lens."""
        if self.matrix is not None or self.rig or self.fov_known:
            return False
        return self.fov_deg == type(self).model_fields["fov_deg"].default


def _omega(name: str) -> Any:
    """The configuration field of a term's ω, with default and comment from the table."""
    term = TABLE[name]
    source = f" ({term.equation})" if term.equation else ""
    return Field(term.default, description=f"{term.omega_symbol}: {term.says}{source}.")


def own_weights() -> list[Term]:
    """The terms whose ω is in the section `weights`."""
    return [term for term in TABLE.values() if term.of != "landmarks" and not term.key]


WeightsConfig = create_model(
    "WeightsConfig",
    __base__=Section,
    __doc__="ω in the hierarchy of FACE IT! Eqs. 5-7: a term's factor is the product down its branch.",
    **{
        node.name: (NonNegative, Field(1.0, description=f"{node.symbol}: {node.says} ({node.source})."))
        for node in NODES
    },
    **{term.name: (NonNegative, _omega(term.name)) for term in own_weights()},
)


class ConstantsConfig(Section):
    """Constants inside the terms."""

    a: float = Field(1.002, description="E_β: upper bound.")
    b: Annotated[float, Field(gt=0.0)] = Field(2e-5, description="E_β: width of its steps.")
    c: float = Field(2.5, description="E_β: offset.")
    delta: Annotated[float, Field(gt=0.0)] = Field(0.01, description="Smoothed L1: quadratic below this weight.")
    rotation_mm: NonNegative = Field(
        100.0, description="E_τ and E_prior: millimetres equivalent to one radian; 1: as published."
    )
    weighted_edges: bool = Field(
        True,
        description="E_2: an edge counts with the smaller weight of its ends; false: all with a weight count alike.",
    )


class SolverConfig(Section):
    """How each stage is solved."""

    method: Literal["lm", "optimistix-lm", "optimistix-dogleg"] = Field(
        "lm", description="lm: ours, which holds bounds with an active set; the two of Optimistix clip steps at them."
    )
    bounded: bool = Field(True, description="Keep every weight in [0, 1] (false: only the terms limit them).")
    tolerance: NonNegative = Field(1e-6, description="Stop when a step lowers the energy by less than this fraction.")
    unit: Literal["px", "percent"] = Field(
        "percent", description="Unit of landmark residuals: pixels, or percent of the outer-eye distance."
    )


class ContourConfig(Section):
    """The jaw contour."""

    mode: Literal["sliding", "fixed"] = Field(
        "sliding", description="sliding: the 17 jaw points slide along the face with the yaw; fixed: they do not."
    )


class IdentityConfig(Section):
    """Calibration of the subject's face shape before tracking."""

    calibrate: bool = Field(
        True, description="Estimate one identity per shot (or photo); false: the model's mean face."
    )
    window: Annotated[int, Field(ge=1, le=1000)] = Field(90, description="Frames of a shot to choose from.")
    frames: Annotated[int, Field(ge=1, le=24)] = Field(12, description="Frames of the window that are used.")
    weight: NonNegative = _omega("identity")
    size: NonNegative = Field(
        1.0, description="ω of (the head's size over the mean head's, in percent)²; used where the lens is known."
    )
    expression: NonNegative = Field(40.0, description="ω of the smoothed L1 norm of the weights during calibration.")
    jaw: NonNegative = Field(0.3, description="Landmark weight of the jaw contour in the second pass.")
    limits: tuple[Iterations, Iterations] = Field((30, 15), description="Iterations of the two passes.")


class HeadConfig(Section):
    """How the default head is drawn; fits depend on it only with deep.appearance = "character"."""

    character: str = Field(
        PLAIN,
        description="Character that the 3D head is drawn as: plain, a ready one, or the file or folder of your own.",
    )

    @field_validator("character")
    @classmethod
    def _is_there(cls, name: str) -> str:
        if name != PLAIN and not is_character(name):
            raise ValueError(
                f"there is no character or file {name!r}; name a ready one ({PLAIN}, {', '.join(character_names())}) "
                "or the path of your own"
            )
        return name


class LandmarksConfig(Section):
    """Detection and tracking of the points."""

    in_turn = ("weights",)
    of_clip: ClassVar[tuple[str, ...]] = ("detector", "face_landmarker", "face", "moved")
    """The keys that belong to the clip, how its points were found and which were moved by hand: presets leave them."""

    detector: Detector = Field(
        "auto",
        description="Face detector and predictor; auto: network. dense: points of the whole face with a covariance "
        "each, network+pupils: 68 and the pupils, the others: 68.",
    )
    face_landmarker: str = Field("", description="MediaPipe's model face_landmarker.task, for the detector mediapipe.")
    face: tuple[float, float] | None = Field(
        None,
        description="A pixel inside the face to track, in the first frame that shows it (a rig's first view); a photo "
        "without a face there has none. Default, and in other views: the largest.",
    )
    confidence: bool = Field(
        True, description="Weigh each point by the detector's confidence; false: all alike, as published."
    )
    weights: dict[str, NonNegative] = Field(
        {}, description="Factor by group, subset or point number, in every stage and in the identity; 0 mutes."
    )
    moved: dict[FrameKey, dict[PointKey, tuple[float, float]]] = Field(
        {}, description="Detections corrected by hand: frame number, then point number, then position in pixels."
    )

    @property
    def missed_face(self) -> str:
        """The message if a point names the face and none was found there; empty if no point does."""
        if self.face is None:
            return ""
        x, y = self.face
        return (
            f"No face was found at {x:g},{y:g}; name a point inside the face (landmarks.face, --face), in pixels of "
            "the first frame that shows it, or leave the point out to follow the largest."
        )

    def kept_by_presets(self) -> dict[str, Any]:
        """The values of `of_clip`."""
        return {name: getattr(self, name) for name in self.of_clip}


class DeepConfig(Section):
    """Deep Energies: photo and render go through one network (Sec. 4 to 8); FACE IT! uses none of this."""

    energy: Literal["deep", "points", "mixed"] = Field(
        "deep",
        description="Landmarks of the model: detected in its render, preselected on its mesh, or mixed by confidence.",
    )
    derivative: Literal["broyden", "forward", "differences"] = Field(
        "broyden",
        description="forward: through renderer and network, as published; broyden: approximate, some ten times faster.",
    )
    start: Literal["frontal", "landmarks"] = Field(
        "frontal",
        description="frontal: facing the camera in the middle of the picture; landmarks: pose from the landmarks.",
    )
    distance_mm: Annotated[float, Field(gt=0.0)] = Field(650.0, description="Distance of the frontal start.")
    appearance: Literal["estimate", "model", "character"] = Field(
        "estimate",
        description="Colours and light: estimated from the most neutral frame; the model's own; or head.character: "
        "its skin as a texture, its hair outside of the face, the light estimated.",
    )
    network: str = Field(
        "heat-maps",
        description="What looks at photo and render: heat-maps (68 points), landmarks (68, the detector's newer "
        "weights), ensemble (68, the mean of both), dense (377, each with its covariance), or the weights of a network "
        "(.safetensors).",
    )
    edges: NonNegative = _omega("edges")
    regularisation: NonNegative = _omega("regularisation")
    lambda_reading: Literal["energy", "residual"] = Field(
        "energy", description="energy: λ‖w‖²; residual: ‖λw‖², the vector λw that Sec. 8.2 prints."
    )
    tolerance: NonNegative = Field(
        1e-3, description="A stage stops when a step lowers the energy by less than this fraction."
    )
    identity: NonNegative = Field(10.0, description="Weight of ‖identity‖² in stages that free it.")
    prior: NonNegative = _omega("prior")
    largest_error: NonNegative = Field(
        6.0, description="A fit has failed above this mean landmark error, % of eye distance."
    )
    largest_disagreement: NonNegative = Field(
        12.0,
        description="A fit has failed if the mean errors of jaw and other landmarks differ by more, % of eye distance.",
    )

    @field_validator("network")
    @classmethod
    def _is_named(cls, name: str) -> str:
        """Files of older versions left the name of the heat maps empty."""
        return name or "heat-maps"


class FlowConfig(Section):
    """Optical flow between neighbouring frames, for infill and refinement (Deep Energies Sec. 6 and 7)."""

    estimator: str = Field("dis", min_length=1, description="dis, farneback, network, or the path of a weights file.")
    side: Annotated[int, Field(ge=64, le=1024)] = Field(
        384, description="Size in pixels of the square crop around the face; the paper uses 512."
    )
    points: Annotated[int, Field(ge=16, le=5000)] = Field(
        600, description="Number of surface points that are compared."
    )
    renders: Literal["exact", "estimated", "network"] = Field(
        "exact",
        description="Flow of the renders: exact from the moving mesh; estimated as in the photos, the derivative still "
        "the mesh's; or by the flow network with its own derivative, as published.",
    )
    robust: Annotated[float, Field(gt=0.0)] = Field(
        1.0, description="Residual above which a point is downweighted (robust loss), % of eye distance."
    )
    stay: NonNegative = _omega("stay")
    iterations: Iterations = Field(8, description="Maximum iterations of each robust least-squares fit.")


class InfillConfig(Section):
    """Frames without a usable fit are filled from their neighbours (Deep Energies Sec. 6, 8.3, Appendix A)."""

    method: Literal["none", "flow", "linear", "spline"] = Field(
        "none", description="none leaves failed frames as they are."
    )
    passes: Literal["meet", "back-and-forth"] = Field(
        "meet",
        description="Flow: meet fills a gap from both ends, blends, and solves again between both neighbours; "
        "back-and-forth solves forward, then backward over the filled frames, as published.",
    )
    rounds: Annotated[int, Field(ge=1, le=10)] = Field(
        1, description="Flow: further passes through a gap, in alternating directions."
    )
    lids: Literal["network", "flow"] = Field(
        "network",
        description="Flow: network sets eyelids as far open as the landmark network sees them, where flow has put the "
        "face; flow leaves them as it has them, as published.",
    )
    longest: Annotated[int, Field(ge=1)] = Field(10_000, description="Longer gaps, in frames, are not filled.")
    largest_error: NonNegative = Field(
        10.0, description="Mean landmark error, % of eye distance, above which a fit counts as failed."
    )
    frames: tuple[tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]], ...] = Field(
        (), description="Frames to fill although they have a fit: first and last of each range."
    )

    @field_validator("frames")
    @classmethod
    def _in_order(cls, value):
        for first, last in value:
            if last < first:
                raise ValueError(f"a range of frames goes from first to last, got {first} to {last}")
        return tuple(sorted(value))

    def named(self, frame: int) -> bool:
        """Whether a frame is to be filled although it has a fit."""
        return any(first <= frame <= last for first, last in self.frames)


class RefinementConfig(Section):
    """Steadier tracks (Deep Energies Sec. 7, Appendix B)."""

    method: Literal["none", "averaging", "self", "plate", "hybrid"] = Field(
        "none", description="hybrid: averaging, then the flow of the pictures (plate)."
    )
    sweeps: Annotated[int, Field(ge=1, le=20)] = Field(1, description="Number of times each frame is solved.")
    order: Literal["jacobi", "gauss-seidel"] = Field(
        "jacobi", description="jacobi: neighbours from the previous sweep; gauss-seidel: the latest neighbours."
    )
    centre: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        0.5, description="Averaging: weight of the frame itself; its neighbours share the rest."
    )
    prior: NonNegative = Field(
        0.0, description="Flow: weight that holds each pose near its value before the pass; mm, 1 rad as 100 mm."
    )
    reestimate: Annotated[int, Field(ge=0, le=10)] = Field(
        0, description="Number of expression re-fits with the pose held (B.1), each after a refinement."
    )


class Provenance(Section):
    """Where an exported configuration comes from; runs ignore it."""

    # Metrics are not finite if no frame has a face.
    model_config = ConfigDict(allow_inf_nan=True)

    exported: str = Field("", description="Date and time, UTC.")
    versions: dict[str, str] = Field({}, description="Software versions that produced the numbers below.")
    model: str = Field("", description="Name and SHA-256 of the face model.")
    inputs: list[str] = Field([], description="Path and SHA-256 of each input.")
    landmarks: str = Field("", description="Path and SHA-256 of the landmark file, if one was used.")
    changed: list[str] = Field([], description="Differences from the preset that tuning started from.")
    before: dict[str, float] = Field({}, description="Metrics with that preset.")
    after: dict[str, float] = Field({}, description="Metrics with this configuration.")
    objective: str | None = Field(None, description="What a tuning minimised; before and after are its means by part.")
    learned: list[str] | None = Field(None, description="The settings that were free.")
    parts: dict[str, str] | None = Field(None, description="Frames by what they were used for, FIRST:END.")
    change_percent: dict[str, float] | None = Field(
        None, description="Change of the objective on the held-out frames, with the 95 % interval of a bootstrap."
    )
