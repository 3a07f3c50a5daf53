"""Frames in which face detectors find nothing: the experiment of Deep Energies Sec. 6."""

from dataclasses import replace

import numpy as np

from workbench import plots
from workbench.errors import MissingDependencyError
from workbench.face import FaceModel, load_default_head
from workbench.geometry import axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.detectors import make_detector
from workbench.pictures.lighting import STUDIO
from workbench.reproduction.people import FilmStudio, Motion
from workbench.reproduction.study import Progress, Result, Study, Table

DETECTORS = {"dlib-hog": "dlib, HOG", "dlib-cnn": "dlib, CNN", "network": "the workbench's network"}
SIZE = (720, 540)
FOV_DEG, AWAY_MM = 40.0, 620.0
FRAMES, QUICK_FRAMES = 60, 5
FARTHEST_DEG = 75.0
"""The head turns from profile to profile, nodding."""
SEED = 19


def missed_frames(study: Study) -> Result:
    """How many frames of a head that turns from side to side each detector misses, each frame on its own."""
    head, count = load_default_head(), QUICK_FRAMES if study.quick else FRAMES
    yaws, pictures = _turning(head, count, study.progress)
    rows, missed = [], {}
    for name, title in DETECTORS.items():
        try:
            detector = make_detector(name)
        except MissingDependencyError as error:
            rows.append((title, "", "", str(error)))
            continue
        missed[title] = []
        for k, picture in enumerate(pictures):
            study.progress(title, k, count)
            if not detector.detect_faces(picture):
                missed[title].append(k)
        found = [abs(yaws[k]) for k in range(count) if k not in missed[title]]
        rows.append((title, str(count), str(len(missed[title])), f"{max(found, default=0.0):.0f}°"))
    shown = [k for k in range(count) if any(k in frames for frames in missed.values())][:: max(1, count // 20)][:6]
    labels = [f"{yaws[k]:+.0f}°: " + (", ".join(t for t, frames in missed.items() if k in frames)) for k in shown]
    figures = {}
    if shown:
        caption = "Frames that were missed, and by which detector."
        figures[caption] = plots.pictures_in_a_row([pictures[k] for k in shown], labels, columns=3)
    return Result(
        data=f"a rendered person who turns by ±{FARTHEST_DEG:g}° in {count} frames of 720 × 540.",
        figures=figures,
        tables=(Table("Frames without a face", ("detector", "frames", "missed", "farthest yaw found"), tuple(rows)),),
        notes=(
            "The paper's sequence is of a real performer before two cameras; this one turns to profiles on purpose.",
        ),
    )


def _turning(head: FaceModel, count: int, progress: Progress) -> tuple[np.ndarray, list[np.ndarray]]:
    """Yaws in degrees, and the pictures."""
    yaws = np.linspace(-FARTHEST_DEG, FARTHEST_DEG, count)
    angles = np.stack([yaws, 12.0 * np.sin(np.linspace(0.0, 12.0, count)), np.zeros(count)], axis=1)
    places = np.tile([0.0, 0.0, AWAY_MM], (count, 1))
    motion = Motion(axis_angle_from_yaw_pitch_roll(angles), places, np.zeros((count, len(head.expression_names))))
    pictures = []
    with FilmStudio(head, camera_from_fov(SIZE, FOV_DEG), SIZE) as studio:
        who = replace(studio.person(np.random.default_rng([SEED])), lighting=STUDIO)
        for k, picture in enumerate(studio.film(who, motion, np.random.default_rng(SEED))):
            progress("pictures", k, count)
            pictures.append(picture)
    return yaws, pictures
