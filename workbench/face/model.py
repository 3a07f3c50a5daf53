"""The face model as data: neutral, blendshapes, identity basis, jaw, and where its landmarks lie on it."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Integer, UInt8

from workbench.errors import ModelError
from workbench.face.jaw_unit import JAW_RANGE, JAW_SHAPES, USUAL_JAW, JawUnit, fitted_jaw_unit
from workbench.landmarks.scheme import POINT_COUNT, LandmarkScheme
from workbench.landmarks.schemes import SCHEMES, scheme_of_count

BLINKS = ("eyeBlinkLeft", "eyeBlinkRight")
BLINK_SCALE_RANGE = (0.3, 2.0)
EYES_MM = 88.8
"""Between the outer corners of the default head's eyes."""


@dataclass(frozen=True)
class Embedding:
    """Landmarks as barycentric points: landmark = Σ_j barycentric_j · vertex_j."""

    vertices: Integer[np.ndarray, "*n 3"]
    barycentric: Float[np.ndarray, "*n 3"]

    def of(self, vertices: Float[np.ndarray, "*b v 3"]) -> Float[np.ndarray, "... 3"]:
        """The landmarks of a mesh, or of a stack of vertex offsets, in its frame and unit."""
        return np.einsum("...jd,...j->...d", vertices[..., self.vertices, :], self.barycentric)


@dataclass(frozen=True, eq=False)
class FaceModel:
    """A linear face model. Head frame, millimetres; sides are the subject's.

    Blendshapes that mean what ARKit's do have ARKit's names; components of a statistical basis have others.
    """

    name: str
    neutral: Float[np.ndarray, "v 3"]
    """b_0: the face with neutral expression and mean identity."""
    triangles: Integer[np.ndarray, "t 3"]
    """Counter-clockwise seen from outside."""
    expression_names: tuple[str, ...]
    expression_deltas: Float[np.ndarray, "k v 3"]
    """B: offsets b_k − b_0 (FACE IT! Eq. 3)."""
    identity_deltas: Float[np.ndarray, "i v 3"]
    """Identity components scaled to unit variance."""
    landmarks: Embedding
    """The points of a landmark scheme, jaw contour at its frontal place."""
    contour_yaw_deg: Float[np.ndarray, "b"]
    """Head yaws, ascending, for which the sliding jaw contour is tabulated; empty if there is none."""
    contour: Embedding
    """The 17 contour points for each of those yaws."""
    colors: UInt8[np.ndarray, "v 3"]
    regions: dict[str, Int[np.ndarray, "_"]]
    """Vertex indices by anatomical region."""
    joints: dict[str, Float[np.ndarray, "3"]]
    jaw_weights: Float[np.ndarray, "v"]
    """Linear blend skinning weight of the jaw joint."""
    uv: Float[np.ndarray, "u 2"]
    triangles_uv: Integer[np.ndarray, "t 3"]
    mirror: Integer[np.ndarray, "v"]
    """Index of each vertex's mirror image."""
    identity_joint_deltas: dict[str, Float[np.ndarray, "i 3"]]
    blink_scale: Float[np.ndarray, "2"]
    """Scale of (eyeBlinkLeft, eyeBlinkRight) that just closes the lids of the mean identity."""
    blink_scale_identity: Float[np.ndarray, "i 2"]
    """How that scale changes with each identity coefficient."""
    expression_range: Float[np.ndarray, "k 2"] | None = None
    """Least and largest weight of each blendshape; None: [0, 1] for all. Statistical components have −3 to 3."""
    fixed_jaw_unit: JawUnit | None = None
    """`jaw_unit` where it is given; None: as the model's own blendshapes have it."""
    notes: tuple[str, ...] = ()
    """What a user should know about how the model was read."""

    def __post_init__(self):
        vertex_count = len(self.neutral)
        for label, deltas in (("expression", self.expression_deltas), ("identity", self.identity_deltas)):
            if deltas.ndim != 3 or deltas.shape[1:] != (vertex_count, 3):
                raise ModelError(f"The {label} offsets need shape (n, {vertex_count}, 3), got {deltas.shape}.")
        if len(self.expression_names) != len(self.expression_deltas):
            raise ModelError(
                f"{len(self.expression_deltas)} blendshapes need one name each, got {len(self.expression_names)}."
            )
        if self.expression_range is not None and len(self.expression_range) != len(self.expression_names):
            raise ModelError(
                f"{len(self.expression_names)} blendshapes need one range each, got {len(self.expression_range)}."
            )
        counts = [len(scheme) for scheme in SCHEMES.values()]
        if len(self.landmarks.vertices) not in counts or self.landmarks.vertices.shape[1:] != (3,):
            known = " or ".join(map(str, counts))
            raise ModelError(f"The landmark embedding has {known} points, got {len(self.landmarks.vertices)}.")
        if max(self.triangles.max(initial=0), self.landmarks.vertices.max()) >= vertex_count:
            raise ModelError(f"A triangle or landmark names a vertex beyond the model's {vertex_count}.")

    @property
    def scheme(self) -> LandmarkScheme:
        """What the landmarks are called."""
        return scheme_of_count(len(self.landmarks.vertices))

    @property
    def has_identities(self) -> bool:
        """Whether the model has an identity basis: whether there is an identity to calibrate."""
        return len(self.identity_deltas) > 0

    def in_regions(self, names: Iterable[str]) -> Bool[np.ndarray, "v"]:
        """Which vertices are in one of these regions, as far as the model has them."""
        inside = np.zeros(len(self.neutral), bool)
        for name in names:
            inside[self.regions.get(name, np.zeros(0, int))] = True
        return inside

    def fingerprint(self) -> str:
        """SHA-256 of the shape, blendshapes and landmarks: two models with one fingerprint fit alike.

        Of the landmarks the 68 that every scheme begins with count: a model is the same in any scheme.
        """
        digest = hashlib.sha256("\n".join(self.expression_names).encode())
        embeddings = (
            self.landmarks.vertices[:POINT_COUNT],
            self.landmarks.barycentric[:POINT_COUNT],
            self.contour.vertices,
            self.contour.barycentric,
        )
        for array in (self.neutral, self.expression_deltas, self.identity_deltas, *embeddings):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    @cached_property
    def jaw_unit(self) -> JawUnit:
        """What the jaw blendshapes at weight 1 move the jaw joint by, fitted to their motion of the landmarks.

        What they do not determine, and everything for a model without a jaw joint, is the default head's, scaled to
        size.
        """
        if self.fixed_jaw_unit is not None:
            return self.fixed_jaw_unit
        points = self.landmarks.of(self.neutral)
        usual = USUAL_JAW.scaled(float(np.linalg.norm(points[45] - points[36])) / EYES_MM or 1.0)
        if "jaw" not in self.joints:
            return usual
        moved = {
            name: self.landmarks.of(self.expression_deltas[k])
            for k, name in enumerate(self.expression_names)
            if name in JAW_SHAPES
        }
        weights = np.einsum("nj,nj->n", self.jaw_weights[self.landmarks.vertices], self.landmarks.barycentric)
        arms = self.landmarks.of(self.jaw_weights[:, None] * (self.neutral - self.joints["jaw"]))
        return fitted_jaw_unit(arms, weights, moved, usual)

    @property
    def jaw_range(self) -> Float[np.ndarray, "2 6"]:
        """Minimum and maximum motion of the jaw joint: radians about x, y and z, then millimetres."""
        return JAW_RANGE * self.jaw_unit.relative

    def with_expressions(self, names: tuple[str, ...]) -> "FaceModel":
        """The model with these blendshapes only, in this order; the jaw joint keeps its unit.

        Raises `ModelError` for names it does not have.
        """
        missing = [name for name in names if name not in self.expression_names]
        if missing:
            raise ModelError(f"The model has no blendshape {missing[0]!r}; it has {', '.join(self.expression_names)}.")
        index = [self.expression_names.index(name) for name in names]
        kept = None if self.expression_range is None else self.expression_range[index]
        return replace(
            self,
            expression_names=tuple(names),
            expression_deltas=self.expression_deltas[index],
            expression_range=kept,
            fixed_jaw_unit=self.jaw_unit,
        )

    def weight_range(self) -> Float[np.ndarray, "k 2"]:
        """Smallest and largest weight of each blendshape."""
        if self.expression_range is not None:
            return self.expression_range
        return np.tile([0.0, 1.0], (len(self.expression_names), 1))

    @property
    def weights_from_0_to_1(self) -> bool:
        """Whether all weights run from 0 to 1; those of statistical components go both ways."""
        return bool((self.weight_range() == [0.0, 1.0]).all())

    def personal(self, identity: Float[np.ndarray, "i"]) -> "FaceModel":
        """The model of one person: identity baked into neutral, joints and blink travel; no identity basis left.

        The blinks are scaled because the same lid offset overshoots on narrow eyes and stays open on wide ones.
        """
        identity = np.asarray(identity, float)
        deltas = self.expression_deltas.copy()
        for side, scale in zip(BLINKS, self.blink_scale_for(identity), strict=True):
            if side in self.expression_names:
                deltas[self.expression_names.index(side)] *= scale
        return replace(
            self,
            neutral=self.neutral + np.tensordot(identity, self.identity_deltas, axes=1),
            expression_deltas=deltas,
            identity_deltas=np.zeros((0, len(self.neutral), 3)),
            joints={
                name: joint + identity @ self.identity_joint_deltas[name] if len(identity) else joint
                for name, joint in self.joints.items()
            },
            identity_joint_deltas={name: np.zeros((0, 3)) for name in self.joints},
            blink_scale=np.ones(2),
            blink_scale_identity=np.zeros((0, 2)),
            fixed_jaw_unit=self.jaw_unit,
        )

    def shape_scales(self) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "i k"]]:
        """Travel of each blendshape for the mean identity, and how identity changes it: 1 and 0 but for blinks."""
        scale = np.ones(len(self.expression_names))
        by_identity = np.zeros((len(self.identity_deltas), len(self.expression_names)))
        for side, name in enumerate(BLINKS):
            if name in self.expression_names:
                column = self.expression_names.index(name)
                scale[column], by_identity[:, column] = self.blink_scale[side], self.blink_scale_identity[:, side]
        return scale, by_identity

    def blink_scale_for(self, identity: Float[np.ndarray, "i"]) -> Float[np.ndarray, "2"]:
        """Scale of (eyeBlinkLeft, eyeBlinkRight) with which weight 1 just closes this identity's lids."""
        return np.clip(self.blink_scale + identity @ self.blink_scale_identity, *BLINK_SCALE_RANGE)

    def vertices(self, expression: Float[np.ndarray, "k"]) -> Float[np.ndarray, "v 3"]:
        """x(w): head-frame vertices of the mean identity with these weights (FACE IT! Eq. 3), millimetres.

        For a person, call it on `personal(identity)`.
        """
        return self.neutral + np.tensordot(np.asarray(expression, float), self.expression_deltas, axes=1)
