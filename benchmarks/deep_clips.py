"""Deep Energies against FACE IT! on the same frames of real clips, where no truth is known.

Both systems get the same identity, camera, appearance and detections N(F*). For each fit: how far the points on the
mesh lie from N(F*), how far what the network sees in the render lies from it, and how well the re-rendered face matches
the photo. `--out` writes the film strip of each frame. Give clips; without any, the bundled one.
"""

import argparse
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np
from result import print_result

from workbench.config import preset
from workbench.errors import MissingDependencyError
from workbench.face import FaceParameters, load_default_head
from workbench.frames import FrameRange, open_frames
from workbench.landmarks.detectors import make_detector
from workbench.pictures.deep_strip import write_stage_strip
from workbench.pipeline.deep_sources import DeepSource
from workbench.pipeline.picture_source import PictureSource
from workbench.planning import plan_of
from workbench.rendering import face_vertices, render
from workbench.samples import samples_folder
from workbench.tracking import FaceItFitter, FrameContext, FrameFit, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_solver import predict


def main() -> None:
    """Print one line for each clip."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clips", nargs="*")
    parser.add_argument("--every", type=int, default=10, help="frames between two that are fitted")
    parser.add_argument("--frames", type=int, default=240, help="frames of the clip that count")
    parser.add_argument("--detector", default="auto")
    parser.add_argument("--fov", type=float, default=45.0)
    parser.add_argument("--out", type=Path, help="folder for film strips")
    options = parser.parse_args()
    for clip in options.clips or [str(samples_folder() / "performance.mp4")]:
        rows, details = compared(Path(clip), options)
        means = {
            f"{system}_{name}": round(float(np.mean([row[system][name] for row in rows])), 3)
            for system in ("face_it", "deep")
            for name in rows[0]["deep"]
        }
        value = means["deep_points_percent"] / means["face_it_points_percent"]
        against = "FACE IT!'s reprojection error on the same frames"
        print_result(f"deep_clip_{Path(clip).stem}", value, "ratio", None, against, details | means)


def compared(clip: Path, options: argparse.Namespace) -> tuple[list[dict], dict]:
    """Errors of both systems on every so many frames, and what was odd."""
    head = load_default_head()
    config = preset("deep").changed(camera={"fov_deg": options.fov}, landmarks={"detector": options.detector})
    frames = FrameRange(open_frames(clip), 0, options.frames - 1)
    try:
        source = DeepSource(PictureSource(frames, make_detector(options.detector), config, True), config)
    except MissingDependencyError as error:
        raise SystemExit(str(error)) from None
    fitter = DeepFitter(head, plan_of(config))
    points = FaceItFitter(head, plan_of(preset("joint").changed(camera={"fov_deg": options.fov})))
    observations = list(source.observations(0, {}, False))
    calibrated = fitter.calibrate(observations[: config.identity.window], config.identity.frames)
    chosen = [item for item in observations[:: options.every] if item.landmarks is not None]
    rows, failures = [], {}
    for observation in chosen:
        context = FrameContext(0, calibrated.identity, None, None, calibrated.appearance)
        solution = fitter.solve(fitter.problem(observation, context))
        deep = fitter.record(solution)
        face_it, _ = points.fit(observation, context._replace(appearance=None))
        judged = {
            name: measured(fitter, observation, context, fit) for name, fit in (("face_it", face_it), ("deep", deep))
        }
        rows.append(judged)
        if deep.failure:
            failures[observation.index] = deep.failure
        if options.out is not None:
            options.out.mkdir(parents=True, exist_ok=True)
            path = options.out / f"{clip.stem}-{observation.index:04d}.jpg"
            write_stage_strip(path, observation.picture, fitter, solution)
    without = sum(item.landmarks is None for item in observations)
    details = {"frames": len(chosen), "without_face": without, "failed": failures}
    details["seconds_per_frame"] = round(float(np.mean([row["deep"].pop("seconds") for row in rows])), 2)
    for row in rows:
        row["face_it"].pop("seconds")
    return rows, details


def measured(fitter: DeepFitter, observation: FrameObservation, context: FrameContext, fit: FrameFit) -> dict:
    """Errors in % of the eye distance over the inner 51, and PSNR inside of the face."""
    parameters = FaceParameters(
        *(jnp.asarray(part, float) for part in (fit.rotation, fit.translation, fit.expression, fit.identity, fit.jaw)),
        jnp.ones(1),
    )
    scene, views = fitter.scene(context.appearance), fitter.views(observation, context)
    prediction = predict(scene, views, parameters)
    unit, target = float(views[0].unit_px), observation.landmarks.points
    rendering = render(
        face_vertices(scene.model.render, parameters), scene.model.render.topology, fit.camera, scene.albedo,
        views[0].light, observation.picture / 255.0, size=observation.image_size, samples=2,
    )  # fmt: skip
    mask = np.zeros(observation.picture.shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.rint(target).astype(np.int32)), 1)
    inside = mask.astype(bool) & (np.asarray(rendering.triangle) >= 0)
    difference = np.clip(np.asarray(rendering.color), 0, 1)[inside] - observation.picture[inside] / 255.0
    return {
        "points_percent": inner(prediction.preselected[0] - target) / unit,
        "network_percent": inner(np.asarray(prediction.looks[0].points) - target) / unit,
        "psnr_db": float(-10.0 * np.log10((difference**2).mean())),
        "seconds": fit.milliseconds[2] / 1e3,
    }


def inner(error: np.ndarray) -> float:
    """Mean length over the inner 51 points."""
    return float(np.linalg.norm(error[17:], axis=1).mean())


if __name__ == "__main__":
    main()
