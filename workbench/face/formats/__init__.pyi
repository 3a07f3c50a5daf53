from .loading import load_face_model as load_face_model
from .shape_names import arkit_name as arkit_name
