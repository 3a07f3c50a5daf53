"""Whether VTK can draw off screen here, found out in another process, because VTK without usable GL kills its own."""

import hashlib
import json
import os
import platform
import subprocess
import sys
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from workbench.errors import InputError
from workbench.files import atomic_path
from workbench.reading import checked_file, checked_json, reading
from workbench.runtime import cache_folder

NO_GL_VARIABLE = "WORKBENCH_NO_GL"
WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"
LINUX_WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow", "")
"""Tried in this order: EGL needs no display and prints no warning; the empty name leaves the choice to VTK."""
TIMEOUT_S = 60

PROBE = """
from vtkmodules.vtkFiltersSources import vtkConeSource
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkCommonCore import vtkUnsignedCharArray
from vtkmodules.util.numpy_support import vtk_to_numpy

cone, mapper, actor, renderer, window = (
    vtkConeSource(), vtkPolyDataMapper(), vtkActor(), vtkRenderer(), vtkRenderWindow()
)
mapper.SetInputConnection(cone.GetOutputPort())
actor.SetMapper(mapper)
renderer.AddActor(actor)
window.SetOffScreenRendering(1)
window.SetSize(64, 64)
window.AddRenderer(renderer)
window.Render()
pixels = vtkUnsignedCharArray()
window.GetRGBACharPixelData(0, 0, 63, 63, 0, pixels)
raise SystemExit(0 if vtk_to_numpy(pixels).std() > 5 else 1)
"""


def gl_available() -> bool:
    """Whether VTK draws off screen here; never raises and never crashes this process.

    The first call of a process looks for the answer of an earlier one (same Python, VTK and machine) in the cache
    folder, else draws a cone in a subprocess. As a side effect `VTK_DEFAULT_OPENGL_WINDOW` names the kind of window
    that worked, unless the user has set it. `WORKBENCH_NO_GL=1` always answers False.
    """
    if os.environ.get(NO_GL_VARIABLE, "0") not in ("", "0"):
        return False
    window = _working_window()
    if window:
        os.environ.setdefault(WINDOW_VARIABLE, window)
    return window is not None


@lru_cache(maxsize=1)
def _working_window() -> str | None:
    """Kind of render window that works ("" for VTK's own choice), None if none does."""
    try:
        key = f"{sys.version}|{version('vtk')}|{platform.node()}|{os.environ.get(WINDOW_VARIABLE, '')}"
    except PackageNotFoundError:
        return None
    remembered = cache_folder() / f"gl-{hashlib.sha256(key.encode()).hexdigest()[:16]}.json"
    if (window := _read_answer(remembered)) is not None:
        return window
    for window in _candidates():
        if _draws(window):
            _write_answer(remembered, window)
            return window
    # A "no" is not kept on disk: the user may install the libraries next.
    return None


def _candidates() -> tuple[str, ...]:
    chosen = os.environ.get(WINDOW_VARIABLE)
    if chosen:
        return (chosen,)
    return LINUX_WINDOWS if sys.platform.startswith("linux") else ("",)


def _draws(window: str) -> bool:
    environment = {**os.environ, WINDOW_VARIABLE: window} if window else dict(os.environ)
    try:
        done = subprocess.run(
            [sys.executable, "-c", PROBE], env=environment, capture_output=True, timeout=TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def _read_answer(path: Path) -> str | None:
    try:
        path = checked_file(path, "an answer")
        with reading(path, "an answer", "it is asked for again"):
            window = checked_json(path.read_bytes())["window"]
    except InputError:
        return None
    # Only what would have been tried: it goes into this process's environment.
    return window if window in _candidates() else None


def _write_answer(path: Path, window: str) -> None:
    try:
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps({"window": window}), encoding="utf-8")
    except OSError:
        # A read-only home costs one more probe next time, nothing else.
        return
