"""The numbers of a run at a glance."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from workbench.files import atomic_path
from workbench.geometry import Camera, horizontal_fov_deg
from workbench.landmarks.scheme import outer_eye_distance
from workbench.tracking import Track


def summary_of(track: Track, seconds: float | None = None) -> dict[str, Any]:
    """Frames, reprojection errors, times and the assumed camera of a track; `seconds` is the wall time of the run.

    Errors are means over the landmarks of a frame, then mean, median and 95th percentile over the frames with a face.
    """
    found = np.flatnonzero(track.found)
    residuals = np.linalg.norm(track.projected[found] - track.observed[found], axis=2)
    eye_distance = np.array([outer_eye_distance(points) for points in track.observed[found]])
    percent = 100.0 * residuals / eye_distance[:, None] if len(found) else residuals
    stages = ("detect", "landmarks", "solve")
    camera = Camera(track.focal_px[0], track.principal_point_px[0], track.distortion[0])
    size = (int(track.image_size[0, 0]), int(track.image_size[0, 1]))
    return {
        "frames": len(track),
        "frames_with_face": len(found),
        "shots": int(track.shot.max()) + 1,
        "reprojection_error": {
            "inner_51_px": _spread(residuals[:, 17:]),
            "all_68_px": _spread(residuals),
            "inner_51_percent_of_eye_distance": _spread(percent[:, 17:]),
            "all_68_percent_of_eye_distance": _spread(percent),
        },
        "milliseconds_per_frame": {
            name: _times(track.milliseconds[found, column]) for column, name in enumerate(stages)
        },
        "seconds": None if seconds is None else round(seconds, 3),
        "frames_per_second": None if not seconds else round(len(track) / seconds, 2),
        "camera": {
            "image_size": size,
            "focal_px": [round(float(value), 3) for value in camera.focal_px],
            "principal_point_px": [round(float(value), 3) for value in camera.principal_point_px],
            "distortion": [float(value) for value in camera.distortion],
            "horizontal_fov_deg": round(horizontal_fov_deg(camera, size), 2),
            "guessed": track.meta.get("camera_guessed", True),
        },
        "solver_iterations_mean": [round(float(value), 2) for value in track.iterations[found].mean(0)]
        if len(found)
        else [],
    }


def write_summary(summary: dict[str, Any], path: str | Path) -> None:
    """Write the summary as indented JSON, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _spread(values: np.ndarray) -> dict[str, float | None]:
    if not len(values):
        return {"mean": None, "median": None, "p95": None}
    by_frame = values.mean(axis=1)
    return {
        "mean": round(float(by_frame.mean()), 4),
        "median": round(float(np.median(by_frame)), 4),
        "p95": round(float(np.percentile(by_frame, 95)), 4),
    }


def _times(values: np.ndarray) -> dict[str, float | None]:
    if not len(values):
        return {"p50": None, "p95": None}
    return {"p50": round(float(np.median(values)), 3), "p95": round(float(np.percentile(values, 95)), 3)}
