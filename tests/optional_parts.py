"""Marks of tests that need what a user's machine may lack: dlib with its models, OpenGL."""

import importlib.util

import pytest

from workbench.pictures import gl_available

needs_dlib = pytest.mark.skipif(
    importlib.util.find_spec("dlib") is None or importlib.util.find_spec("face_recognition_models") is None,
    reason='dlib is not installed: pip install "face-energy-workbench[dlib]"',
)
needs_gl = pytest.mark.skipif(not gl_available(), reason="VTK has no usable OpenGL here")
