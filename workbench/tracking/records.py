"""The results of fits: one frame (`FrameFit`) and a whole run (`Track`)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from workbench.files import atomic_path
from workbench.geometry import Camera, yaw_pitch_roll_deg
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import POINT_COUNT, LandmarkScheme, error_unit
from workbench.landmarks.schemes import scheme_of_count
from workbench.reading import checked_arrays, checked_file, reading
from workbench.tracking.track_layout import (
    FAILURES,
    LAYOUT,
    SOURCES,
    checked_columns,
    checked_meta,
    in_todays_layout,
    meta_array,
)

DAMAGED = "a track, it is damaged or not a workbench track", "run the tracking again"
"""The message for a file that cannot be read, and the advice."""


@dataclass(frozen=True)
class FrameFit:
    """One frame: its observations and its fit. Without a face all numbers except the index are NaN."""

    index: int
    found: bool
    shot: int
    source: str
    image_size: tuple[int, int]
    """(width, height), pixels."""
    camera: Camera
    rotation: Float[np.ndarray, "3"]
    """Axis-angle, head to camera, radians."""
    translation: Float[np.ndarray, "3"]
    """Millimetres."""
    expression: Float[np.ndarray, "k"]
    identity: Float[np.ndarray, "i"]
    observed: Float[np.ndarray, "points 2"]
    """Landmarks given to the fit, pixels; the model's own if only other views of a rig saw the face."""
    confidence: Float[np.ndarray, "points"]
    projected: Float[np.ndarray, "points 2"]
    """The model's landmarks in the picture, pixels."""
    energies: Float[np.ndarray, "s e"]
    """Weighted energy of each term (`Config.terms`) after each stage."""
    status: Int[np.ndarray, "s"]
    """`solvers.Status` of each stage, −1 for a stage that did not run."""
    iterations: Int[np.ndarray, "s"]
    milliseconds: Float[np.ndarray, "3"]
    """Time for detection, landmarks and solve."""
    jaw: Float[np.ndarray, "6"] = field(default_factory=lambda: np.zeros(6))
    """Motion of the jaw joint (`FaceParameters.jaw`); zero for models with blendshapes only."""
    scale: float = 1.0
    """Scale of the head, for orthographic views."""
    others: Float[np.ndarray, "o 68 3"] = field(default_factory=lambda: np.zeros((0, 68, 3)))
    """Landmarks in the other views of a rig: x and y in pixels, and confidence; 0 where a view saw no face."""
    failure: str = ""
    """One of `FAILURES`: why the fit should not be used; empty for a usable fit."""
    covariance: Float[np.ndarray, "c 2 2"] = field(default_factory=lambda: np.zeros((0, 2, 2)))
    """Of each observed place, squared pixels; empty in schemes without, NaN where the detector told none."""

    @property
    def errors(self) -> tuple[float, float, float]:
        """Mean error in px over all 68 landmarks, then in % of the outer-eye distance over the inner 51 and all.

        NaN unless landmarks were observed in this view (`seen`).
        """
        if not self.seen:
            return (np.nan, np.nan, np.nan)
        return tuple(_errors(self.projected[None], self.observed[None])[0, 1:].tolist())

    @property
    def seen(self) -> bool:
        """Whether landmarks were observed in this view: neither without a face nor filled."""
        return bool(np.nan_to_num(self.confidence).max(initial=0.0) > 0.0)

    @property
    def landmarks(self) -> Landmarks2D | None:
        """The detector's landmarks; None if it found no face in this view, and in frames made by infill."""
        if not self.seen or self.source == "filled":
            return None
        told = len(self.covariance) > 0 and bool(np.isfinite(self.covariance).all())
        return Landmarks2D(self.observed, self.confidence, self.image_size, self.covariance if told else None)

    @property
    def scheme(self) -> LandmarkScheme:
        """What the landmarks are called."""
        return scheme_of_count(len(self.observed))

    @property
    def residuals_px(self) -> Float[np.ndarray, "points"]:
        """Distance of each model landmark from the observed one, pixels."""
        return np.linalg.norm(self.projected - self.observed, axis=1)

    @property
    def residuals_percent(self) -> Float[np.ndarray, "points"]:
        """`residuals_px` in % of the observed outer-eye distance (`error_unit`), like every error in percent."""
        return 100.0 * self.residuals_px / error_unit(self.observed)

    @property
    def angles_deg(self) -> Float[np.ndarray, "3"]:
        """Yaw, pitch, roll (convention: `geometry.rotations`)."""
        return yaw_pitch_roll_deg(self.rotation)


@dataclass(frozen=True)
class Track:
    """The frames of a run as stacked arrays, with metadata about the run (`meta`). `track[i]` is a `FrameFit`."""

    index: Int[np.ndarray, "n"]
    found: np.ndarray
    shot: Int[np.ndarray, "n"]
    source: np.ndarray
    image_size: Int[np.ndarray, "n 2"]
    focal_px: Float[np.ndarray, "n 2"]
    principal_point_px: Float[np.ndarray, "n 2"]
    distortion: Float[np.ndarray, "n 8"]
    rotation: Float[np.ndarray, "n 3"]
    translation: Float[np.ndarray, "n 3"]
    expression: Float[np.ndarray, "n k"]
    identity: Float[np.ndarray, "n i"]
    observed: Float[np.ndarray, "n points 2"]
    confidence: Float[np.ndarray, "n points"]
    projected: Float[np.ndarray, "n points 2"]
    energies: Float[np.ndarray, "n s e"]
    status: Int[np.ndarray, "n s"]
    iterations: Int[np.ndarray, "n s"]
    milliseconds: Float[np.ndarray, "n 3"]
    jaw: Float[np.ndarray, "n 6"]
    scale: Float[np.ndarray, "n"]
    failure: np.ndarray
    others: Float[np.ndarray, "n o 68 3"]
    covariance: Float[np.ndarray, "n c 2 2"]
    meta: dict[str, Any]
    """Expression names, configuration, inputs, names of the frames, software versions: plain JSON."""

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, position: int) -> FrameFit:
        row = {name: getattr(self, name)[position] for name in ARRAYS}
        camera = Camera(row.pop("focal_px"), row.pop("principal_point_px"), row.pop("distortion"))
        row["index"], row["shot"], row["found"] = int(row["index"]), int(row["shot"]), bool(row["found"])
        row["source"], row["failure"] = SOURCES[int(row["source"])], FAILURES[int(row["failure"])]
        row["scale"] = float(row["scale"])
        row["image_size"] = (int(row["image_size"][0]), int(row["image_size"][1]))
        return FrameFit(camera=camera, **row)

    @property
    def scheme(self) -> LandmarkScheme:
        """What the landmarks are called."""
        return scheme_of_count(self.observed.shape[1])

    @property
    def expression_names(self) -> tuple[str, ...]:
        """Blendshape names, in the order of the columns of `expression`."""
        return tuple(self.meta["expression_names"])

    @property
    def seen(self) -> Bool[np.ndarray, "n"]:
        """`FrameFit.seen` of each frame."""
        return np.nan_to_num(self.confidence).max(axis=1, initial=0.0) > 0.0

    @property
    def residuals_percent(self) -> Float[np.ndarray, "n points"]:
        """`FrameFit.residuals_percent` of each frame; NaN without a face."""
        residuals = np.linalg.norm(self.projected - self.observed, axis=2)
        return 100.0 * residuals / error_unit(self.observed)[:, None]

    @property
    def angles_deg(self) -> Float[np.ndarray, "n 3"]:
        """Yaw, pitch, roll of each frame."""
        return yaw_pitch_roll_deg(self.rotation)

    def save(self, path: str | Path) -> None:
        """Write the track as one .npz file. The file is written completely or not at all."""
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            # Row by row, because `TrackReader` reads them that way.
            arrays = {name: np.ascontiguousarray(getattr(self, name)) for name in ARRAYS}
            np.savez_compressed(stream, meta=meta_array(self.meta), **arrays)

    @classmethod
    def load(cls, path: str | Path) -> "Track":
        """Read a track of any version. Raises `InputError` for a missing, damaged or foreign file."""
        path = checked_track_file(path)
        with reading(path, *DAMAGED), path.open("rb") as stream, checked_arrays(stream) as stored:
            meta = checked_meta(stored, path)
            columns = in_todays_layout(stored, len(stored["index"]))
            return cls(meta=meta, **checked_columns(columns, meta))


ARRAYS = tuple(LAYOUT)


def checked_track_file(path: str | Path) -> Path:
    """The path of a possible track. Raises `InputError` if it is not a file."""
    absent = f"The track {path} does not exist; `workbench track INPUT` writes track.npz."
    return checked_file(path, "a track", absent=absent)


def recorded_covariance(
    covariance: Float[np.ndarray, "points 2 2"] | None, scheme: LandmarkScheme
) -> Float[np.ndarray, "c 2 2"]:
    """A detection's covariance, or None, as the fits of a scheme hold it."""
    if covariance is not None and scheme.has_covariances:
        return covariance
    return np.full((len(scheme) if scheme.has_covariances else 0, 2, 2), np.nan)


def stack_fits(fits: list[FrameFit]) -> dict[str, np.ndarray]:
    """Arrays of `Track` for consecutive frames."""
    columns = {
        "index": np.array([fit.index for fit in fits], np.int64),
        "found": np.array([fit.found for fit in fits], bool),
        "shot": np.array([fit.shot for fit in fits], np.int64),
        "source": np.array([SOURCES.index(fit.source) for fit in fits], np.int8),
        "image_size": np.array([fit.image_size for fit in fits], np.int64),
        "failure": np.array([FAILURES.index(fit.failure) for fit in fits], np.int8),
        "focal_px": np.stack([np.asarray(fit.camera.focal_px, float) for fit in fits]),
        "principal_point_px": np.stack([np.asarray(fit.camera.principal_point_px, float) for fit in fits]),
        "distortion": np.stack([np.asarray(fit.camera.distortion, float) for fit in fits]),
    }
    for name in ARRAYS:
        if name not in columns:
            columns[name] = np.stack([getattr(fit, name) for fit in fits])
    return {name: columns[name] for name in ARRAYS}


@dataclass(frozen=True, eq=False)
class Fits(Sequence):
    """The frames of a track as a sequence of fits, each created on access; a slice is a tuple."""

    track: Track

    def __len__(self) -> int:
        return len(self.track)

    def __getitem__(self, place: int | slice) -> FrameFit | tuple[FrameFit, ...]:
        if isinstance(place, slice):
            return tuple(self.track[k] for k in range(*place.indices(len(self))))
        return self.track[range(len(self))[place]]


def frame_errors(track: Track) -> Float[np.ndarray, "n 4"]:
    """Mean errors per frame: in px over the inner 51 and over all 68, then both in % of the outer-eye distance.

    NaN unless landmarks were observed in this view (`seen`). The last three columns are `FrameFit.errors`.
    """
    return np.where(track.seen[:, None], _errors(track.projected, track.observed), np.nan)


def _errors(
    projected: Float[np.ndarray, "n points 2"], observed: Float[np.ndarray, "n points 2"]
) -> Float[np.ndarray, "n 4"]:
    residuals = np.linalg.norm(projected - observed, axis=2)[:, :POINT_COUNT]
    pixels = np.stack([residuals[:, 17:].mean(1), residuals.mean(1)], axis=1)
    return np.concatenate([pixels, 100.0 * pixels / error_unit(observed)[:, None]], axis=1)
