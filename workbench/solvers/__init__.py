"""Steppable nonlinear least squares with traced iteration limits. Nothing here knows of faces."""

from workbench.solvers.levenberg_marquardt import ArrowheadSystem as ArrowheadSystem
from workbench.solvers.levenberg_marquardt import DenseSystem as DenseSystem
from workbench.solvers.levenberg_marquardt import Solution as Solution
from workbench.solvers.levenberg_marquardt import SolverState as SolverState
from workbench.solvers.levenberg_marquardt import Status as Status
from workbench.solvers.levenberg_marquardt import init as init
from workbench.solvers.levenberg_marquardt import minimise as minimise
from workbench.solvers.levenberg_marquardt import normal_equations as normal_equations
from workbench.solvers.levenberg_marquardt import step as step
from workbench.solvers.optimistix_solvers import minimise_with_optimistix as minimise_with_optimistix
