"""The tuning session without a screen: material, configuration with undo, fits, diagnosis, export."""

from workbench.session.fitted_head import FittedHead as FittedHead
from workbench.session.material import Material as Material
from workbench.session.material import load_material as load_material
from workbench.session.material import material_of_photo as material_of_photo
from workbench.session.material import material_of_track as material_of_track
from workbench.session.temporal import TemporalWork as TemporalWork
from workbench.session.temporal import Worked as Worked
from workbench.session.tuning import TuningSession as TuningSession
from workbench.session.tuning import open_session as open_session
