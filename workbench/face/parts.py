"""What is worn on the default head: eyes, teeth, tongue, brows, lashes and hair, tied to its vertices.

Parts are for drawing alone: no landmark lies on them and no fit knows of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Integer, UInt8

from workbench.errors import ModelError
from workbench.face.checking import check_indices, check_numbers
from workbench.reading import checked_arrays, checked_file, reading

STILL = ("hair", "clothes")
"""Kinds that follow the skull and not the face: they keep their shape as the brows and the jaw move."""
UV_STEPS = 65535


@dataclass(frozen=True)
class Part:
    """A mesh tied to the head: vertex = Σ_j weight_j · head[anchor_j] + growth · offset; head frame, millimetres."""

    kind: str
    style: str
    anchors: Integer[np.ndarray, "n k"]
    """Vertices of the head."""
    weights: Float[np.ndarray, "n k"]
    offsets: Float[np.ndarray, "n 3"]
    shade: UInt8[np.ndarray, "n"]
    """Share of the light, of 255, that the rest of the head leaves to a vertex: less and less into the mouth."""
    triangles: Integer[np.ndarray, "t 3"]
    uv: Float[np.ndarray, "u 2"]
    triangles_uv: Integer[np.ndarray, "t 3"]

    @property
    def still(self) -> bool:
        """Whether it follows the resting head."""
        return self.kind in STILL

    def on(
        self, head: Float[np.ndarray, "v 3"], growth: Float[np.ndarray, "3"] | float = 1.0
    ) -> Float[np.ndarray, "n 3"]:
        """Its vertices on those of a head; `growth` is the head's size along x, y and z, the mean head's being 1."""
        tied = np.zeros_like(self.offsets)
        for corner in range(self.anchors.shape[1]):
            tied += self.weights[:, corner, None] * head[self.anchors[:, corner]]
        return tied + growth * self.offsets

    def carried(self, deltas: Float[np.ndarray, "b v 3"]) -> Float[np.ndarray, "b n 3"]:
        """Offsets of its vertices that follow from offsets of the head's, for blendshapes of its own."""
        return np.einsum("nj,bnjd->bnd", self.weights, deltas[:, self.anchors])


@dataclass(frozen=True)
class PartStore:
    """The file of all parts; each is read when it is asked for."""

    path: Path
    scale_vertices: Integer[np.ndarray, "3 2"]
    """Pairs of head vertices whose distances along x, y and z say how large a head is."""
    styles: Mapping[str, tuple[str, ...]]
    """Styles of each kind."""

    def read(self, kind: str, style: str, vertex_count: int) -> Part:
        """One part for a head with this many vertices. Raises `ModelError` if there is none, and for damage."""
        if style not in self.styles.get(kind, ()):
            known = ", ".join(self.styles.get(kind, ())) or "none"
            raise ModelError(f"There is no style {style!r} for {kind}; the styles are {known}.")
        with (
            reading(self.path, "parts of a head", REMEDY, ModelError),
            self.path.open("rb") as stream,
            checked_arrays(stream) as stored,
        ):
            fields = {name: stored[f"{kind}.{style}.{name}"] for name in FIELDS}
            step = float(stored["offset_step_mm"])
        fields["weights"] = fields["weights"].astype(float)
        _check(self.path, f"{kind} {style}", fields, vertex_count)
        return Part(
            kind=kind,
            style=style,
            anchors=fields["anchors"].astype(np.int32),
            weights=fields["weights"],
            offsets=fields["offsets"] * step,
            shade=fields["shade"],
            triangles=fields["triangles"].astype(np.int32),
            uv=fields["uv"] / UV_STEPS,
            triangles_uv=fields["triangles_uv"].astype(np.int32),
        )


FIELDS = ("anchors", "weights", "offsets", "shade", "triangles", "uv", "triangles_uv")
REMEDY = "bake it again or reinstall"


def open_parts(path: Path) -> PartStore:
    """The parts that a file holds. Raises `ModelError` if it is missing or damaged."""
    path = checked_file(path, "parts of a head", ModelError)
    with (
        reading(path, "parts of a head", REMEDY, ModelError),
        path.open("rb") as stream,
        checked_arrays(stream) as stored,
    ):
        pairs = stored["scale_vertices"].astype(np.int32)
        names = [name.split(".") for name in stored.files if name.endswith(".anchors")]
    check_numbers(path, "scale_vertices", pairs, (3, 2))
    kinds = dict.fromkeys(kind for kind, _, _ in names)
    return PartStore(path, pairs, {kind: tuple(style for k, style, _ in names if k == kind) for kind in kinds})


def _check(path: Path, label: str, fields: Mapping[str, np.ndarray], vertex_count: int) -> None:
    count = len(fields["shade"])
    check_numbers(path, f"{label} (shade)", fields["shade"], (count,))
    check_indices(path, f"{label} (anchors)", fields["anchors"], (count, None), vertex_count)
    check_numbers(path, f"{label} (weights)", fields["weights"], fields["anchors"].shape)
    check_numbers(path, f"{label} (offsets)", fields["offsets"], (count, 3))
    check_indices(path, f"{label} (triangles)", fields["triangles"], (None, 3), count)
    check_numbers(path, f"{label} (uv)", fields["uv"], (None, 2))
    check_indices(path, f"{label} (triangles_uv)", fields["triangles_uv"], fields["triangles"].shape, len(fields["uv"]))
