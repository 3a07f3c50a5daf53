"""Why a fit is what it is: reasons for bad frames, pulls of landmark groups, uncertainty, indistinguishable shapes."""

from workbench.diagnosis.diagnose import diagnose_frame as diagnose_frame
from workbench.diagnosis.diagnose import leave_one_group_out as leave_one_group_out
from workbench.diagnosis.flags import flag_frames as flag_frames
from workbench.diagnosis.identifiability import Indistinguishable as Indistinguishable
from workbench.diagnosis.identifiability import group_columns as group_columns
from workbench.diagnosis.identifiability import indistinguishable_groups as indistinguishable_groups
from workbench.diagnosis.identifiability import landmark_motion as landmark_motion
from workbench.diagnosis.records import Change as Change
from workbench.diagnosis.records import Diagnosis as Diagnosis
from workbench.diagnosis.records import FrameCase as FrameCase
from workbench.diagnosis.records import FrameFlags as FrameFlags
from workbench.diagnosis.records import GroupPull as GroupPull
from workbench.diagnosis.records import Reason as Reason
from workbench.diagnosis.records import Uncertainty as Uncertainty
from workbench.diagnosis.reference import ShotReference as ShotReference
from workbench.diagnosis.reference import reference_of as reference_of
from workbench.diagnosis.uncertainty import estimate_uncertainty as estimate_uncertainty
from workbench.diagnosis.uncertainty import vertex_uncertainty as vertex_uncertainty
