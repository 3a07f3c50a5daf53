"""Every energy term as a small pure residual function; weights are applied last, in `total`."""

from workbench.energies.priors import beta_curve as beta_curve
from workbench.energies.priors import beta_residual as beta_residual
from workbench.energies.priors import beta_slope as beta_slope
from workbench.energies.priors import identity_residual as identity_residual
from workbench.energies.priors import range_residual as range_residual
from workbench.energies.priors import range_slope as range_slope
from workbench.energies.priors import sigma_residual as sigma_residual
from workbench.energies.priors import sigma_smooth_residual as sigma_smooth_residual
from workbench.energies.priors import sigma_smooth_slope as sigma_smooth_slope
from workbench.energies.reprojection import Observation as Observation
from workbench.energies.reprojection import points_head as points_head
from workbench.energies.reprojection import project_landmarks as project_landmarks
from workbench.energies.reprojection import reprojection_residual as reprojection_residual
from workbench.energies.reprojection import reprojection_with_jacobian as reprojection_with_jacobian
from workbench.energies.temporal import tau_residual as tau_residual
from workbench.energies.temporal import tau_scale as tau_scale
from workbench.energies.total import TERMS as TERMS
from workbench.energies.total import EnergyProblem as EnergyProblem
from workbench.energies.total import energy as energy
from workbench.energies.total import energy_by_term as energy_by_term
from workbench.energies.total import normal_system as normal_system
from workbench.energies.total import pack as pack
from workbench.energies.total import residuals as residuals
from workbench.energies.total import unpack as unpack
from workbench.energies.weights import EnergyConstants as EnergyConstants
from workbench.energies.weights import EnergyWeights as EnergyWeights
