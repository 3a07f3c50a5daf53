"""How the front door is used, for the type checker (`make types`) alone: nothing here runs."""

from collections.abc import Iterator
from typing import assert_type

import workbench
from workbench.frames import Frames
from workbench.landmarks.detection import LandmarkDetector
from workbench.landmarks.files import LandmarkRecord
from workbench.widgets import TuningPanel


def one_picture() -> None:
    fit = workbench.fit("portrait.jpg", model=workbench.load_default_head(), config="joint")
    assert_type(fit, workbench.PictureFit)
    assert_type(fit.weights, dict[str, float])
    assert_type(fit.yaw_pitch_roll, tuple[float, float, float])


def a_clip() -> None:
    head, config = workbench.load_face_model("hero.glb"), workbench.preset("joint")
    assert_type(head, workbench.FaceModel)
    assert_type(config, workbench.Config)
    track = workbench.track("talk.mp4", "out/talk", head, config, pictures=False).track
    assert_type(track, workbench.Track)
    assert_type(track[0], workbench.FrameFit)


def parts() -> None:
    assert_type(workbench.open_frames(["a.png", "b.png"]), Frames)
    assert_type(workbench.make_detector("network"), LandmarkDetector)
    assert_type(workbench.read_landmark_file("points.csv"), Iterator[LandmarkRecord])
    assert_type(workbench.face.load_default_head(), workbench.face.FaceModel)


def panel() -> None:
    session = workbench.open_session("talk.mp4")
    assert_type(session, workbench.TuningSession)
    TuningPanel(session)
