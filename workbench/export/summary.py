"""The numbers of a run at a glance."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from workbench.config import config_of_track
from workbench.files import atomic_path
from workbench.geometry import Camera, horizontal_fov_deg
from workbench.tracking import Track
from workbench.tracking.failures import failures_of
from workbench.tracking.records import FAILURES, SOURCES, frame_errors

TIMES = ("detect", "landmarks", "solve")


def summary_of(tracks: Iterable[Track], seconds: float | None = None) -> dict[str, Any]:
    """Frames, the detector, reprojection errors, times and the assumed camera of a run; `seconds` is its wall time.

    `tracks` are consecutive pieces of one run. The detector is None if the landmarks came from a file; focal length and
    field of view are None in parallel projection. Errors are means over the landmarks of a frame, then mean, median and
    95th percentile over the frames with a face.
    """
    errors, milliseconds, found, iterations, failure, shots, camera, detector = [], [], [], [], [], 0, {}, None
    filled = 0
    for track in tracks:
        errors.append(frame_errors(track))
        milliseconds.append(track.milliseconds)
        found.append(track.found)
        iterations.append(track.iterations)
        failure.append(failures_of(track))
        filled += int((track.source == SOURCES.index("filled")).sum())
        shots = int(track.shot.max()) + 1
        camera = camera or _camera(track)
        detector = track.meta.get("detector")
    found = np.concatenate(found)
    errors, milliseconds = np.concatenate(errors)[found], np.concatenate(milliseconds)[found]
    names = (
        "inner_51_px",
        "all_68_px",
        "inner_51_percent_of_eye_distance",
        "all_68_percent_of_eye_distance",
    )
    return {
        "frames": len(found),
        "frames_with_face": int(found.sum()),
        "frames_filled": filled,
        "frames_failed": _failures(np.concatenate(failure)),
        "shots": shots,
        "detector": detector,
        "reprojection_error": {name: _spread(errors[:, k]) for k, name in enumerate(names)},
        "milliseconds_per_frame": {name: _times(milliseconds[:, k]) for k, name in enumerate(TIMES)},
        "solver_iterations_mean": np.concatenate(iterations)[found].mean(0).round(2).tolist() if found.any() else [],
        "seconds": None if seconds is None else round(seconds, 3),
        "frames_per_second": None if not seconds else round(len(found) / seconds, 2),
        "camera": camera,
    }


def write_summary(summary: dict[str, Any], path: str | Path) -> None:
    """Write the summary as indented JSON, completely or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _failures(failure: Shaped[np.ndarray, "n"]) -> dict[str, int]:
    """Frames whose fit should not be used, by reason."""
    return {name: int((failure == name).sum()) for name in FAILURES if name and (failure == name).any()}


def _camera(track: Track) -> dict[str, Any]:
    camera = Camera(track.focal_px[0], track.principal_point_px[0], track.distortion[0])
    width, height = (int(length) for length in track.image_size[0])
    config = config_of_track(track.meta)
    parallel = config is not None and config.camera.projection == "orthographic"
    return {
        "image_size": [width, height],
        "projection": "orthographic" if parallel else "perspective",
        "focal_px": None if parallel else camera.focal_px.round(3).tolist(),
        "principal_point_px": camera.principal_point_px.round(3).tolist(),
        "distortion": camera.distortion.tolist(),
        "horizontal_fov_deg": None if parallel else round(horizontal_fov_deg(camera, (width, height)), 2),
        "guessed": not parallel and bool(track.meta.get("camera_guessed", True)),
    }


def _spread(values: np.ndarray) -> dict[str, float | None]:
    values = values[np.isfinite(values)]
    if not len(values):
        return {"mean": None, "median": None, "p95": None}
    return {
        "mean": round(float(values.mean()), 4),
        "median": round(float(np.median(values)), 4),
        "p95": round(float(np.percentile(values, 95)), 4),
    }


def _times(values: np.ndarray) -> dict[str, float | None]:
    if not len(values):
        return {"p50": None, "p95": None}
    return {"p50": round(float(np.median(values)), 3), "p95": round(float(np.percentile(values, 95)), 3)}
