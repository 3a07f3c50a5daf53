"""Fitted gaze against the true one, on rendered films of people whom no network has seen.

Each film is tracked from its pictures under `dense` and under `gaze`. The angle is between the directions of an eye in
the head, the true one and that of the fitted head, in frames with open eyes; beside it the angle to eyes that never
turn, and in frames with shut eyes how far the held gaze is from the true one.
"""

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np
from result import print_result

from workbench.config import Config, preset
from workbench.face import GAZE_NAMES, FaceModel, gaze_deg, in_scheme, load_default_head
from workbench.face.gaze import angle_between_deg
from workbench.face.model import BLINKS
from workbench.landmarks.schemes import detector_scheme
from workbench.pipeline import track
from workbench.training.gaze_films import FILM_VIEW, GazeFilm, gaze_films
from workbench.training.scenes import FaceStudio
from workbench.training.skin import skin_painter

SEED = 2417
GOAL = "<= 4"
PRESETS = ("dense", "gaze")


def main() -> None:
    """Render, track, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--films", type=int, default=6, help="films of either kind")
    parser.add_argument("--frames", type=int, default=48)
    asked = parser.parse_args()
    full = load_default_head(gaze=True)
    studio = FaceStudio(full, skin_painter(full), FILM_VIEW)
    rows = {name: {} for name in PRESETS}
    for kind, glasses in (("without glasses", False), ("with glasses", True)):
        films = list(gaze_films(studio, glasses, asked.films, asked.frames, SEED))
        for name in PRESETS:
            rows[name][kind] = mean_of([judged(film, preset(name)) for film in films])
    studio.close()
    details = {"mean": rows, "goal with glasses": "<= 6"}
    off = rows["dense"]["without glasses"]["open, degrees"]
    print_result("gaze", off, "degrees", GOAL, "the true direction", details)


def judged(film: GazeFilm, config: Config, head: FaceModel | None = None) -> dict[str, float]:
    """The errors of one film's fits."""
    head = in_scheme(head or load_default_head(), detector_scheme(config.landmarks.detector))
    with tempfile.TemporaryDirectory() as folder:
        pictures = Path(folder) / "film"
        pictures.mkdir()
        for number, frame in enumerate(film.frames):
            cv2.imwrite(str(pictures / f"{number:04d}.png"), frame.picture[..., ::-1])
        config = config.changed(camera={"fov_deg": film.fov_deg})
        found = track(pictures, Path(folder) / "out", head, config, pictures=False).track
    person = head.personal(found.identity[found.found][0])
    still = np.array([name not in GAZE_NAMES for name in found.expression_names])
    blinks = [found.expression_names.index(name) for name in BLINKS]
    rows = []
    for k in np.flatnonzero(found.found):
        frame, weights = film.frames[found.index[k]], found.expression[k]
        off, unturned = (
            angle_between_deg(gaze_deg(person, seen), frame.gaze_deg).mean() for seen in (weights, weights * still)
        )
        rows.append((frame.eyes_open, off, unturned, np.abs(weights - frame.expression)[blinks].mean()))
    is_open, off, unturned, blink = (np.array(part) for part in zip(*rows, strict=True))
    return {
        "open, degrees": off[is_open].mean(),
        "open, worst tenth": np.quantile(off[is_open], 0.9),
        "open, as if eyes never turned": unturned[is_open].mean(),
        "shut, degrees": off[~is_open].mean(),
        "blink weights, open": blink[is_open].mean(),
        "blink weights, shut": blink[~is_open].mean(),
        "frames with a face": float(found.found.mean()),
    }


def mean_of(rows: list[dict[str, float]]) -> dict[str, float]:
    """Each number's mean over the films, and the largest error of a film."""
    means = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    return means | {"worst film": float(max(row["open, degrees"] for row in rows))}


if __name__ == "__main__":
    main()
