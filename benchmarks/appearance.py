"""Albedo and light of faces in pictures: each is fitted, its appearance estimated, the face drawn over it again.

Give pictures, or frames of videos as VIDEO:NUMBER; without any, the bundled portrait and two frames of the sample clip.
Each face is cut out and brought to one size first, so that the numbers of small and large faces can be compared (small
ones are enlarged, which flatters them). `--out` writes a picture with a row for each: photo, photo with the face drawn
over it, difference, and the albedo alone.
"""

import argparse
import itertools
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from result import print_result

from workbench.config import DEFAULT_PRESET, preset
from workbench.errors import InputError, MissingDependencyError
from workbench.face import FaceModel, FaceParameters, load_default_head
from workbench.frames import open_frames, write_picture
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.tracking import LandmarkTracker
from workbench.plots import as_picture, close_up
from workbench.rendering import (
    Rendering,
    RenderModel,
    ambient_light,
    estimate_appearance,
    face_vertices,
    render_face,
    render_model,
)
from workbench.samples import samples_folder
from workbench.tracker import FaceTracker
from workbench.tracking import FrameFit, FrameObservation

SIDE_PX = 384
"""Side of the square around the face."""
SAMPLES = ("astronaut.png", "performance.mp4:0", "performance.mp4:100")
DIFFERENCE_GAIN = 2.0
GREY = 0.25


def main() -> None:
    """Print the mean PSNR inside of the faces."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pictures", nargs="*", help="pictures, or VIDEO:NUMBER")
    parser.add_argument("--detector", default="auto")
    parser.add_argument("--out", type=Path, help="a picture to write")
    options = parser.parse_args()
    common = {"name": "appearance", "unit": "dB", "goal": None, "against": "PSNR to the photo, brows to chin"}
    try:
        finder = LandmarkTracker(make_detector(options.detector))
    except MissingDependencyError as error:
        print_result(**common, value=None, details={"skipped": str(error)})
        return
    head = load_default_head()
    model, tracker = render_model(head), FaceTracker(head, preset(DEFAULT_PRESET), stills=True)
    rows, details = [], {}
    for name in options.pictures or [str(samples_folder() / name) for name in SAMPLES]:
        picture, fit = fitted(name, finder, tracker)
        row, numbers = compared(head, model, *close_up(picture, fit, SIDE_PX))
        details[Path(name).name] = numbers | {"face_px": round(float(np.ptp(fit.observed[:, 0])))}
        rows.append(row)
    if options.out is not None:
        write_picture(options.out, np.concatenate(rows))
    value = float(np.mean([numbers["psnr_db"] for numbers in details.values()]))
    print_result(**common, value=value, details=details)


def fitted(name: str, finder: LandmarkTracker, tracker: FaceTracker) -> tuple[np.ndarray, FrameFit]:
    """The picture of this name, and the fit of its largest face. Raises `InputError` where there is none."""
    path, _, number = name.rpartition(":") if name.rpartition(":")[2].isdecimal() else (name, "", "0")
    frame = next(itertools.islice(open_frames(path).iterate(int(number)), 1), None)
    if frame is None:
        raise InputError(f"{path} has no frame {number}; give a smaller number.")
    finder.reset()
    landmarks = finder.step(frame.picture).landmarks
    if landmarks is None:
        raise InputError(f"There is no face in {name}; give another picture.")
    size = frame.picture.shape[1], frame.picture.shape[0]
    fits = tracker.push(FrameObservation(0, landmarks, size)) + tracker.finish()
    return frame.picture, replace(fits[-1], index=int(number))


def compared(head: FaceModel, model: RenderModel, picture: np.ndarray, fit: FrameFit) -> tuple[np.ndarray, dict]:
    """A row of pictures, and the numbers of one face."""
    photo = picture / 255.0
    face = FaceParameters(fit.rotation, fit.translation, fit.expression, fit.identity)
    vertices = np.asarray(face_vertices(model, face), float)
    found = estimate_appearance(picture, head, vertices, fit.camera)

    def drawn(albedo, light, background) -> Rendering:
        return render_face(model, face, fit.camera, albedo, light, background, size=(SIDE_PX, SIDE_PX), samples=2)

    over = drawn(found.albedo, found.light, photo)
    again = np.clip(np.asarray(over.color, float), 0.0, 1.0)
    flat = drawn(found.albedo, ambient_light(1.0), np.full((SIDE_PX, SIDE_PX, 3), GREY))
    inside = hull(fit.projected) & (np.asarray(over.triangle) >= 0)
    difference = 0.5 + 0.5 * DIFFERENCE_GAIN * (again - photo)
    row = np.concatenate([picture, *(as_picture(each) for each in (again, difference, flat.color))], axis=1)
    numbers = {
        "psnr_db": psnr(again - photo, inside),
        "psnr_of_mean_colour_db": psnr(photo[inside].mean(axis=0) - photo, inside),
    }
    return row, numbers


def hull(points: np.ndarray) -> np.ndarray:
    """The pixels within the convex hull of the landmarks."""
    mask = np.zeros((SIDE_PX, SIDE_PX), np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.rint(points).astype(np.int32)), 1)
    return mask.astype(bool)


def psnr(difference: np.ndarray, mask: np.ndarray) -> float:
    """Peak signal to noise ratio over masked pixels of colours of 0 to 1, dB."""
    return float(-10.0 * np.log10((difference[mask] ** 2).mean()))


if __name__ == "__main__":
    main()
