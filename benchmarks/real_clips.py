"""The dense points against 68 on real clips, where no truth is known: how well the re-rendered head matches the photo.

Each clip is tracked under `joint` with the network detector and under `dense`. Of frames spread over a shot some give
albedo and light, the others are drawn with them, so that no frame is judged by its own colours. Both heads are judged
on the same pixels: within the 68 detected points, where both are drawn. `--out` writes a sheet for each clip: 24
frames, each as photo, head by 68 points and head by dense points. Give clips; without any, the bundled ones.
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from appearance import psnr
from result import print_result

from workbench.config import Config, preset
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters, in_scheme, load_default_head
from workbench.frames import open_frames, write_picture
from workbench.landmarks.schemes import DENSE
from workbench.pipeline import track
from workbench.plots import as_picture, close_up
from workbench.rendering import Appearance, estimate_appearance, face_vertices, render_face, render_model
from workbench.samples import sample
from workbench.tracking import FrameFit, Track

CLIPS = ("performance", "laugh", "glasses")
SIDE_PX = 192
"""Side of the square around the face."""
JUDGED, GIVING = 24, 6
"""Frames of a clip that are judged, and frames of a shot that give albedo and light."""
COLUMNS = 4
FACE_POINTS = 68
LEAST_SHARE = 0.1
"""Of a square's pixels: frames in which both heads are drawn on less of the face are left out."""


class Scheme:
    """A preset with the head that it fits, and what draws that head."""

    def __init__(self, config: Config, head: FaceModel):
        self.config, self.head, self.render_model = config, head, render_model(head)

    def tracked(self, clip: Path) -> Track:
        """The fits of a clip."""
        with tempfile.TemporaryDirectory() as folder:
            return track(clip, folder, load_default_head(), self.config, pictures=False).track

    def appearance(self, picture: np.ndarray, fit: FrameFit) -> Appearance | None:
        """Albedo and light of a frame; None where too little of the face is seen."""
        vertices = np.asarray(face_vertices(self.render_model, parameters(fit)), float)
        try:
            return estimate_appearance(picture, self.head, vertices, fit.camera)
        except InputError:
            return None

    def drawn(self, picture: np.ndarray, fit: FrameFit, albedo: np.ndarray, light: np.ndarray):
        """The head over the photo, and where it is drawn."""
        size = (SIDE_PX, SIDE_PX)
        found = render_face(
            self.render_model, parameters(fit), fit.camera, albedo, light, picture / 255.0, size=size, samples=2
        )
        return np.clip(np.asarray(found.color, float), 0.0, 1.0), np.asarray(found.triangle) >= 0


def main() -> None:
    """Track, draw, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clips", nargs="*", type=Path)
    parser.add_argument("--out", type=Path, help="folder for the sheets")
    options = parser.parse_args()
    head = load_default_head()
    schemes = {
        "68": Scheme(preset("joint").changed(landmarks={"detector": "network"}), head),
        "dense": Scheme(preset("dense"), in_scheme(head, DENSE)),
    }
    details = {}
    for clip in options.clips or [sample(name) for name in CLIPS]:
        details[clip.stem], sheet = judged(clip, schemes)
        if options.out is not None:
            options.out.mkdir(parents=True, exist_ok=True)
            write_picture(options.out / f"{clip.stem}.png", sheet)
    value = min(numbers["dense"] - numbers["68"] for numbers in details.values())
    against = "PSNR to the photo inside the face, 68 points on the same frames; the worst clip"
    print_result("real_clips", value, "dB", ">= 0", against, details)


def judged(clip: Path, schemes: dict[str, Scheme]) -> tuple[dict[str, float], np.ndarray]:
    """PSNR of both schemes on the frames of a clip, and its sheet."""
    tracks = {name: scheme.tracked(clip) for name, scheme in schemes.items()}
    both = np.logical_and(*(found.found for found in tracks.values()))
    shots = tracks["68"].shot
    chosen = np.flatnonzero(both)[np.linspace(0, both.sum() - 1, JUDGED).round().astype(int)]
    pictures = {frame.index: frame.picture for frame in open_frames(clip).iterate()}
    colours = {}
    for shot in np.unique(shots[chosen]):
        free = np.setdiff1d(np.flatnonzero(both & (shots == shot)), chosen)
        giving = free[np.linspace(0, len(free) - 1, min(GIVING, len(free))).round().astype(int)]
        for name, scheme in schemes.items():
            cuts = (cut(pictures, tracks, name, position) for position in giving)
            found = [scheme.appearance(*each) for each in cuts]
            colours[shot, name] = mean_appearance([each for each in found if each is not None])
    rows, tiles = {name: [] for name in schemes}, []
    for position in chosen:
        made = {}
        for name, scheme in schemes.items():
            if colours[shots[position], name] is not None:
                picture, fit = cut(pictures, tracks, name, position)
                made[name] = scheme.drawn(picture, fit, *colours[shots[position], name])
        if len(made) < len(schemes):
            continue
        inside = hull(cut(pictures, tracks, "68", position)[1].observed[:FACE_POINTS])
        inside &= np.logical_and(*(where for _, where in made.values()))
        if inside.mean() < LEAST_SHARE:
            continue
        for name, (again, _) in made.items():
            rows[name].append(psnr(again - picture / 255.0, inside))
        tiles.append(np.concatenate([picture, *(as_picture(again) for again, _ in made.values())], axis=1))
    if not tiles:
        raise InputError(f"No shot of {clip.name} shows a face in enough frames; give another clip.")
    means = {name: float(np.mean(values)) for name, values in rows.items()}
    better = float(np.mean(np.array(rows["dense"]) > np.array(rows["68"])))
    return means | {"share of frames where dense is better": better, "frames": len(tiles)}, sheet_of(tiles)


def cut(pictures, tracks: dict[str, Track], name: str, position: int) -> tuple[np.ndarray, FrameFit]:
    """The square around a frame's face, the same for both schemes, and the fit in its pixels."""
    about = tracks["68"][position].observed[:FACE_POINTS]
    return close_up(pictures[int(tracks[name].index[position])], tracks[name][position], SIDE_PX, about)


def parameters(fit: FrameFit) -> FaceParameters:
    """The unknowns of a fit."""
    return FaceParameters(fit.rotation, fit.translation, fit.expression, fit.identity)


def mean_appearance(found: Sequence[Appearance]) -> tuple[np.ndarray, np.ndarray] | None:
    """One albedo, each vertex as the frames have it that saw it, and the mean light; None without any."""
    if not found:
        return None
    seen = np.stack([each.seen for each in found])[..., None]
    weights = np.where(seen.sum(axis=0) > 0.0, seen, 1.0)
    albedo = (weights * np.stack([each.albedo for each in found])).sum(axis=0) / weights.sum(axis=0)
    return albedo, np.mean([each.light for each in found], axis=0)


def hull(points: np.ndarray) -> np.ndarray:
    """The pixels within the convex hull of points."""
    mask = np.zeros((SIDE_PX, SIDE_PX), np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.rint(points).astype(np.int32)), 1)
    return mask.astype(bool)


def sheet_of(tiles: Sequence[np.ndarray]) -> np.ndarray:
    """Frames in rows of `COLUMNS`."""
    blank = np.full_like(tiles[0], 255)
    padded = [*tiles, *[blank] * (-len(tiles) % COLUMNS)]
    return np.concatenate(
        [np.concatenate(padded[start : start + COLUMNS], axis=1) for start in range(0, len(padded), COLUMNS)]
    )


if __name__ == "__main__":
    main()
