"""Steppable nonlinear least squares with traced iteration limits. Nothing here knows of faces."""

from workbench.solvers.levenberg_marquardt import LevenbergMarquardt as LevenbergMarquardt
from workbench.solvers.loop import Method as Method
from workbench.solvers.loop import Solution as Solution
from workbench.solvers.loop import SolverState as SolverState
from workbench.solvers.loop import Status as Status
from workbench.solvers.loop import init as init
from workbench.solvers.loop import judge as judge
from workbench.solvers.loop import minimise as minimise
from workbench.solvers.loop import propose as propose
from workbench.solvers.loop import step as step
from workbench.solvers.normal_equations import ArrowheadSystem as ArrowheadSystem
from workbench.solvers.normal_equations import DenseSystem as DenseSystem
from workbench.solvers.normal_equations import System as System
from workbench.solvers.normal_equations import normal_equations as normal_equations
from workbench.solvers.trust_region import TrustRegion as TrustRegion
