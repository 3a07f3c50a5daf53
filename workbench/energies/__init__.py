"""Every energy term as a small pure residual function; weights are applied last, in `total`."""

from workbench.energies.constants import EnergyConstants as EnergyConstants
from workbench.energies.reprojection import Observation as Observation
from workbench.energies.reprojection import landmark_errors as landmark_errors
from workbench.energies.reprojection import points_head as points_head
from workbench.energies.reprojection import project_landmarks as project_landmarks
from workbench.energies.reprojection import reprojection_with_jacobian as reprojection_with_jacobian
from workbench.energies.term import LandmarkErrors as LandmarkErrors
from workbench.energies.term import Term as Term
from workbench.energies.term import TermContext as TermContext
from workbench.energies.term import still as still
from workbench.energies.terms import NODES as NODES
from workbench.energies.terms import TABLE as TABLE
from workbench.energies.terms import factor as factor
from workbench.energies.terms import stage_factors as stage_factors
from workbench.energies.terms import terms_of as terms_of
from workbench.energies.total import FACE_IT_TERMS as FACE_IT_TERMS
from workbench.energies.total import EnergyProblem as EnergyProblem
from workbench.energies.total import energy as energy
from workbench.energies.total import energy_by_term as energy_by_term
from workbench.energies.total import normal_system as normal_system
from workbench.energies.total import pack as pack
from workbench.energies.total import residuals as residuals
from workbench.energies.total import unpack as unpack
from workbench.energies.total import weighed_residuals as weighed_residuals
