"""The readers of files from outside, each with a small valid file and a use of what was read (see `fuzzing`).

Everything here may be imported by the judge's process: functions of the module, nothing but the package behind them.
"""

from pathlib import Path

import numpy as np

from tests.fuzz_face_readers import FACE_READERS
from tests.fuzzing import Reader
from workbench import config as configuration
from workbench.export import retargeting
from workbench.landmarks import files as landmark_files
from workbench.landmarks.observations import Landmarks2D

NAMES = ("jawOpen", "mouthSmileLeft", "mouthSmileRight")
CHARACTER = ("Mouth_Open", "Smile")


def make_config(folder: Path) -> None:
    (folder / "config.toml").write_text(
        'version = 1\npreset = "joint"\n[camera]\nfov_deg = 40.0\n[weights]\ntau = 0.2\n[contour]\nsliding = true\n'
        '[landmarks]\nweights = { jaw = 0.5, "30" = 2.0 }\n[subsets]\nchin = [7, 8, 9]\n[infill]\nframes = [[3, 5]]\n'
        '[[stages]]\nname = "pose"\nfree = ["rotation", "translation"]\nlandmarks = { all = 1.0, chin = 0.0 }\n'
        '[provenance]\nmodel = "head"\ninputs = ["clip.mp4"]\nbefore = { error = 1.5 }\n'
    )


def read_config(folder: Path) -> None:
    config = configuration.read_config(folder / "config.toml")
    assert len(config.point_weights()) == 68
    assert all(len(stage.landmark_weights(config.subsets)) == 68 for stage in config.stages)
    assert configuration.parse_config(config.model_dump(), "again") == config
    configuration.config_toml(config)


def make_mapping(folder: Path) -> None:
    (folder / "mapping.toml").write_text(
        '[shapes]\nMouth_Open = "jawOpen"\nSmile = { mouthSmileLeft = 0.5, mouthSmileRight = 0.5 }\n'
    )


def read_mapping(folder: Path) -> None:
    mapping = retargeting.read_mapping(folder / "mapping.toml", NAMES, CHARACTER)
    assert mapping.matrix.shape == (3, 2)
    assert np.isfinite(mapping.matrix).all()


def _records() -> list[landmark_files.LandmarkRecord]:
    rng = np.random.default_rng(1)
    size = (640, 480)
    faces = [Landmarks2D(rng.uniform(0, 400, (68, 2)), rng.uniform(0, 1, 68), size) for _ in range(2)]
    return [
        landmark_files.LandmarkRecord(0, "first", faces[0], size),
        landmark_files.LandmarkRecord(2, "none", None, size),
        landmark_files.LandmarkRecord(5, "last", faces[1], size),
    ]


def make_landmarks_csv(folder: Path) -> None:
    landmark_files.write_landmark_file(folder / "points.csv", _records())


def make_landmarks_json(folder: Path) -> None:
    landmark_files.write_landmark_file(folder / "points.json", _records())


def make_landmarks_pts(folder: Path) -> None:
    landmark_files.write_landmark_file(folder / "points.pts", _records()[:1])


def read_landmarks(folder: Path) -> None:
    (path,) = folder.iterdir()
    for record in landmark_files.read_landmark_file(path):
        assert record.frame >= 0
        assert record.image_size is None or min(record.image_size) >= 1
        if record.landmarks is not None:
            assert np.isfinite(record.landmarks.points).all()


READERS = (
    Reader("configuration", make_config, read_config),
    Reader("retargeting", make_mapping, read_mapping),
    Reader("landmarks csv", make_landmarks_csv, read_landmarks),
    Reader("landmarks json", make_landmarks_json, read_landmarks),
    Reader("landmarks pts", make_landmarks_pts, read_landmarks),
    *FACE_READERS,
)
