"""Why a fit is what it is: which blendshapes the landmarks can tell apart."""

from workbench.diagnosis.identifiability import Indistinguishable as Indistinguishable
from workbench.diagnosis.identifiability import group_columns as group_columns
from workbench.diagnosis.identifiability import indistinguishable_groups as indistinguishable_groups
from workbench.diagnosis.identifiability import landmark_motion as landmark_motion
