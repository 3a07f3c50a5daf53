"""Rotations, cameras and rigs of several cameras.

Millimetres, radians, pixels; OpenCV's camera frame (+x right, +y down, +z forward).
"""

from workbench.geometry.camera import Camera as Camera
from workbench.geometry.camera import camera_from_fov as camera_from_fov
from workbench.geometry.camera import camera_from_matrix as camera_from_matrix
from workbench.geometry.camera import horizontal_fov_deg as horizontal_fov_deg
from workbench.geometry.camera import project as project
from workbench.geometry.camera import project_with_derivative as project_with_derivative
from workbench.geometry.rig import PlacedCamera as PlacedCamera
from workbench.geometry.rig import Rig as Rig
from workbench.geometry.rig import View as View
from workbench.geometry.rig import pose_in_view as pose_in_view
from workbench.geometry.rig import project_to_view as project_to_view
from workbench.geometry.rig import relative_pose as relative_pose
from workbench.geometry.rig import resized_view as resized_view
from workbench.geometry.rig import to_reference as to_reference
from workbench.geometry.rig import to_view as to_view
from workbench.geometry.rig_files import read_rig as read_rig
from workbench.geometry.rig_files import rig_toml as rig_toml
from workbench.geometry.rig_files import write_rig as write_rig
from workbench.geometry.rig_report import RigReport as RigReport
from workbench.geometry.rig_report import ViewReport as ViewReport
from workbench.geometry.rig_report import axes_meeting_point as axes_meeting_point
from workbench.geometry.rig_report import rig_report as rig_report
from workbench.geometry.rotations import axis_angle_from_yaw_pitch_roll as axis_angle_from_yaw_pitch_roll
from workbench.geometry.rotations import head_yaw as head_yaw
from workbench.geometry.rotations import rotation_matrix as rotation_matrix
from workbench.geometry.rotations import yaw_of as yaw_of
from workbench.geometry.rotations import yaw_pitch_roll_deg as yaw_pitch_roll_deg
from workbench.geometry.triangulation import epipolar_distance as epipolar_distance
from workbench.geometry.triangulation import fundamental_matrix as fundamental_matrix
from workbench.geometry.triangulation import reprojection_error as reprojection_error
from workbench.geometry.triangulation import triangulate as triangulate
from workbench.geometry.triangulation import undistorted_pixels as undistorted_pixels
from workbench.geometry.triangulation import undistorted_rays as undistorted_rays
