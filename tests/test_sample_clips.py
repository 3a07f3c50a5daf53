"""The bundled clips: pictures, truth and landmarks of each belong together."""

import numpy as np
import pytest

from workbench.energies import project_landmarks
from workbench.face import (
    FaceParameters,
    contour_blend,
    find_character,
    landmark_model,
    load_default_head,
    model_landmarks,
)
from workbench.frames import open_frames
from workbench.geometry import Camera
from workbench.landmarks.files import read_landmark_file
from workbench.samples import sample
from workbench.tracking.frame_solver import head_yaw

PEOPLE = {"laugh": "ravi", "glasses": "edda"}
LARGEST = 1_500_000
INNER = slice(17, 68)


def truth_of(clip):
    with np.load(sample(f"{clip}-truth"), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def projected(truth, k):
    model = load_default_head()
    points_of = landmark_model(model)
    camera = Camera(truth["focal_px"], truth["principal_point_px"], truth["distortion"])
    names = ("rotation", "translation", "expression")
    parameters = FaceParameters(*(truth[name][k] for name in names), truth["identity"])
    blend = contour_blend(points_of.contour_yaw, head_yaw(truth["rotation"][k]), 1.0)
    return np.asarray(project_landmarks(camera, model_landmarks(points_of, blend, truth["identity"]), parameters))


@pytest.mark.parametrize("clip", PEOPLE)
def test_truth_is_of_this_person_and_its_points_follow_from_it(clip):
    truth = truth_of(clip)
    np.testing.assert_array_equal(truth["identity"], find_character(PEOPLE[clip]).identity)
    assert truth["expression_names"].tolist() == list(load_default_head().expression_names)
    for k in (0, 61, 149):
        np.testing.assert_allclose(projected(truth, k), truth["landmarks"][k], atol=1e-3)


@pytest.mark.parametrize("clip", PEOPLE)
def test_the_detectors_points_lie_on_the_person(clip):
    truth, frames = truth_of(clip), open_frames(sample(clip))
    records = list(read_landmark_file(sample(f"{clip}-landmarks")))
    assert len(records) == len(truth["landmarks"]) == frames.announced_count == 150
    assert frames.image_size == tuple(truth["image_size"])
    points = np.stack([record.landmarks.points for record in records])
    eyes = np.linalg.norm(truth["landmarks"][:, 45] - truth["landmarks"][:, 36], axis=1)
    apart = np.linalg.norm(points - truth["landmarks"], axis=2)[:, INNER].mean(axis=1) / eyes
    assert np.median(apart) < 0.05


def test_one_laughs_with_an_open_mouth():
    truth = truth_of("laugh")
    names = truth["expression_names"].tolist()
    jaw, smile = (truth["expression"][:, names.index(name)] for name in ("jawOpen", "mouthSmileLeft"))
    assert np.minimum(jaw, smile).max() > 0.45


def test_clips_are_small():
    for clip in PEOPLE:
        assert sample(clip).stat().st_size < LARGEST
