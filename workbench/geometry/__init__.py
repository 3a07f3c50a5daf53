"""Rotations and cameras. Millimetres, radians, pixels; OpenCV's camera frame (+x right, +y down, +z forward)."""

from workbench.geometry.camera import Camera as Camera
from workbench.geometry.camera import camera_from_fov as camera_from_fov
from workbench.geometry.camera import camera_from_matrix as camera_from_matrix
from workbench.geometry.camera import horizontal_fov_deg as horizontal_fov_deg
from workbench.geometry.camera import project as project
from workbench.geometry.camera import project_with_derivative as project_with_derivative
from workbench.geometry.rotations import axis_angle_from_yaw_pitch_roll as axis_angle_from_yaw_pitch_roll
from workbench.geometry.rotations import rotation_matrix as rotation_matrix
from workbench.geometry.rotations import yaw_pitch_roll_deg as yaw_pitch_roll_deg
