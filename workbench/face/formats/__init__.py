"""Readers of other face models, each in its module, behind `load_face_model`."""

from workbench.face.formats.loading import load_face_model as load_face_model
from workbench.face.formats.shape_names import arkit_name as arkit_name
