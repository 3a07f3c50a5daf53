"""Face Energy Workbench: facial performance capture by optimisation.

The names below are the front door; everything else is imported from its folder, as `workbench.energies`.
"""

__version__ = "0.2.0"

from workbench.runtime import configure_jax

# Before any array is made: precision cannot be changed for arrays that exist.
configure_jax()

from workbench.config import Config as Config  # noqa: E402
from workbench.config import Stage as Stage  # noqa: E402
from workbench.config import preset as preset  # noqa: E402
from workbench.config import read_config as read_config  # noqa: E402
from workbench.config import write_config as write_config  # noqa: E402
from workbench.export import export_track as export_track  # noqa: E402
from workbench.face import FaceModel as FaceModel  # noqa: E402
from workbench.face import load_default_head as load_default_head  # noqa: E402
from workbench.face import load_face_model as load_face_model  # noqa: E402
from workbench.face import read_obj_folder as read_obj_folder  # noqa: E402
from workbench.frames import open_frames as open_frames  # noqa: E402
from workbench.frames import read_picture as read_picture  # noqa: E402
from workbench.geometry import read_rig as read_rig  # noqa: E402
from workbench.landmarks.detectors import make_detector as make_detector  # noqa: E402
from workbench.landmarks.files import read_landmark_file as read_landmark_file  # noqa: E402
from workbench.landmarks.observations import Landmarks2D as Landmarks2D  # noqa: E402
from workbench.landmarks.tracking import LandmarkTracker as LandmarkTracker  # noqa: E402
from workbench.pipeline import track as track  # noqa: E402
from workbench.pipeline import work_over as work_over  # noqa: E402
from workbench.samples import sample as sample  # noqa: E402
from workbench.session import TuningSession as TuningSession  # noqa: E402
from workbench.session import open_session as open_session  # noqa: E402
from workbench.tracking import FaceTracker as FaceTracker  # noqa: E402
from workbench.tracking import FrameFit as FrameFit  # noqa: E402
from workbench.tracking import FrameObservation as FrameObservation  # noqa: E402
from workbench.tracking import Track as Track  # noqa: E402
