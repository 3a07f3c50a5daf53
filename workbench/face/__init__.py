"""The parametric face: blendshapes, identity, jaw, landmark embedding, and the default head."""

from workbench.face.alignment import align_targets as align_targets
from workbench.face.alignment import rigid_alignment as rigid_alignment
from workbench.face.blendshapes import absolute_form as absolute_form
from workbench.face.blendshapes import delta_form as delta_form
from workbench.face.blendshapes import targets_to_deltas as targets_to_deltas
from workbench.face.default_head import GAZE_NAMES as GAZE_NAMES
from workbench.face.default_head import load_default_head as load_default_head
from workbench.face.formats import arkit_name as arkit_name
from workbench.face.formats import load_face_model as load_face_model
from workbench.face.jaw import JAW_SHAPES as JAW_SHAPES
from workbench.face.jaw import JawJoint as JawJoint
from workbench.face.jaw import jaw_joint as jaw_joint
from workbench.face.jaw import jaw_of_weights as jaw_of_weights
from workbench.face.jaw import move_jaw as move_jaw
from workbench.face.jaw import posed_vertices as posed_vertices
from workbench.face.jaw import weights_with_jaw as weights_with_jaw
from workbench.face.landmark_model import LandmarkModel as LandmarkModel
from workbench.face.landmark_model import PointModel as PointModel
from workbench.face.landmark_model import contour_blend as contour_blend
from workbench.face.landmark_model import landmark_model as landmark_model
from workbench.face.landmark_model import model_landmarks as model_landmarks
from workbench.face.landmark_model import seen_shapes as seen_shapes
from workbench.face.model import Embedding as Embedding
from workbench.face.model import FaceModel as FaceModel
from workbench.face.obj_folder import read_obj_folder as read_obj_folder
from workbench.face.parameters import FaceParameters as FaceParameters
