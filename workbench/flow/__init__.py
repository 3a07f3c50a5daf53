"""Optical flow: estimators behind one protocol, the exact flow of a moving mesh, colours, consistency and errors."""

from workbench.flow.coloring import color_wheel as color_wheel
from workbench.flow.coloring import flow_picture as flow_picture
from workbench.flow.coloring import wheel_picture as wheel_picture
from workbench.flow.estimators import DisFlow as DisFlow
from workbench.flow.estimators import FarnebackFlow as FarnebackFlow
from workbench.flow.estimators import FlowEstimator as FlowEstimator
from workbench.flow.geometric import GeometricFlow as GeometricFlow
from workbench.flow.geometric import SeenSurface as SeenSurface
from workbench.flow.geometric import SurfacePoints as SurfacePoints
from workbench.flow.geometric import choose_points as choose_points
from workbench.flow.geometric import geometric_flow as geometric_flow
from workbench.flow.geometric import point_flow as point_flow
from workbench.flow.geometric import points_in_camera as points_in_camera
from workbench.flow.geometric import seen_surface as seen_surface
from workbench.flow.geometric import surface_points as surface_points
from workbench.flow.measures import EndPointError as EndPointError
from workbench.flow.measures import end_point_error as end_point_error
from workbench.flow.measures import end_point_errors as end_point_errors
from workbench.flow.measures import occluded as occluded
from workbench.flow.measures import round_trip as round_trip
from workbench.flow.sampling import sample as sample
from workbench.flow.sampling import warp as warp
