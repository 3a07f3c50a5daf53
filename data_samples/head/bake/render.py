"""Off-screen pictures of the baked head with an explicit pinhole camera, for contact sheets and landmark calibration.

Pixel (0, 0) is the centre of the top-left pixel. The camera frame is +x right, +y down, +z forward.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pyvista
import vtk
from jaxtyping import Float, Int, UInt8

vtk.vtkObject.GlobalWarningDisplayOff()


@dataclass(frozen=True)
class Asset:
    """The arrays of head.npz that pictures need, as floats in millimetres."""

    neutral: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "t 3"]
    uvs: Float[np.ndarray, "u 2"]
    triangles_uv: Int[np.ndarray, "t 3"]
    units: dict[str, Float[np.ndarray, "v 3"]]
    identities: Float[np.ndarray, "b v 3"]
    arrays: dict[str, np.ndarray]

    def shaped(
        self, identity: Float[np.ndarray, "b"] | None = None, expression: dict[str, float] | None = None
    ) -> Float[np.ndarray, "v 3"]:
        """Neutral + identity + expression, millimetres in the head frame."""
        vertices = self.neutral.copy()
        if identity is not None:
            vertices += np.tensordot(identity, self.identities, axes=1)
        for name, weight in (expression or {}).items():
            vertices += weight * self.units[name]
        return vertices


def load_asset(path: Path) -> Asset:
    """Read head.npz."""
    with np.load(path, allow_pickle=False) as archive:
        arrays = dict(archive)
    units = arrays["expression_deltas"] * float(arrays["expression_step_mm"])
    return Asset(
        neutral=arrays["neutral"].astype(float),
        triangles=arrays["triangles"].astype(int),
        uvs=arrays["uv"].astype(float),
        triangles_uv=arrays["triangles_uv"].astype(int),
        units=dict(zip(arrays["expression_names"].tolist(), units, strict=True)),
        identities=arrays["identity_deltas"] * float(arrays["identity_step_mm"]),
        arrays=arrays,
    )


@dataclass(frozen=True)
class View:
    """Pose and focal length; the principal point is the centre of the picture, (size - 1) / 2."""

    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]
    focal: float
    size: int

    def project(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Head-frame points (mm) to pixels."""
        camera = points @ self.rotation.T + self.translation
        return camera[..., :2] / camera[..., 2:] * self.focal + (self.size - 1) / 2


def view(yaw: float, pitch: float, roll: float, size: int, fill: float = 0.62, focal: float = 900.0) -> View:
    """A view of the whole head; degrees as in 300W-LP: yaw > 0 nose to image left, pitch > 0 nose up.

    R = Rx(-pitch) Ry(yaw) Rz(roll); the head (240 mm) covers the share `fill` of the picture height.
    """
    x, y, z = np.radians([-pitch, yaw, roll])
    turn_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    turn_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    turn_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    rotation = turn_x @ turn_y @ turn_z
    middle = np.array([0.0, 16.0, 44.0])
    return View(rotation, np.array([0, 0, focal * 240 / (size * fill)]) - rotation @ middle, focal, size)


class Renderer:
    """One hidden window of fixed size that draws the head with a texture or with vertex colours."""

    def __init__(self, asset: Asset, texture: UInt8[np.ndarray, "h w 3"] | None, size: int):
        self._asset, self._size = asset, size
        # One render vertex per (vertex, uv) pair; seams then keep both texture coordinates and smooth normals.
        corners = np.stack([asset.triangles, asset.triangles_uv], axis=-1).reshape(-1, 2)
        self._pairs, triangles = np.unique(corners, axis=0, return_inverse=True)
        faces = np.hstack([np.full((len(asset.triangles), 1), 3), triangles.reshape(-1, 3)])
        self._mesh = pyvista.PolyData(asset.neutral[self._pairs[:, 0]], faces.ravel())
        self._plotter = pyvista.Plotter(off_screen=True, window_size=(size, size), lighting="none")
        self._plotter.set_background([0.47, 0.49, 0.51])
        material = {"ambient": 0.25, "diffuse": 0.8, "specular": 0.07, "specular_power": 12, "smooth_shading": False}
        if texture is None:
            self._mesh["rgb"] = asset.arrays["colors"][self._pairs[:, 0]]
            actor = self._plotter.add_mesh(self._mesh, scalars="rgb", rgb=True, **material)
        else:
            self._mesh.active_texture_coordinates = asset.uvs[self._pairs[:, 1]]
            actor = self._plotter.add_mesh(self._mesh, texture=self._texture(texture), **material)
        actor.prop.interpolation = "Phong"
        self._actor = actor
        for position, strength in (((0.4, -0.7, -1.0), 0.75), ((-0.8, -0.2, -0.8), 0.35), ((0.0, 0.6, -0.5), 0.12)):
            light = pyvista.Light(position=np.array(position) * 1000, light_type="scene light", intensity=strength)
            light.positional = False
            self._plotter.add_light(light)
        self._plotter.enable_anti_aliasing("msaa", multi_samples=4)
        self._plotter.show(auto_close=False, interactive=False)

    @staticmethod
    def _texture(picture: UInt8[np.ndarray, "h w 3"]) -> pyvista.Texture:
        texture = pyvista.Texture(np.ascontiguousarray(picture))
        texture.interpolate, texture.mipmap = True, True
        return texture

    def set_texture(self, picture: UInt8[np.ndarray, "h w 3"]) -> None:
        """Draw with another texture from now on."""
        self._actor.texture = self._texture(picture)

    def draw(self, vertices: Float[np.ndarray, "v 3"], camera: View) -> UInt8[np.ndarray, "s s 3"]:
        """RGB picture of the head."""
        self._mesh.points = vertices[self._pairs[:, 0]].astype(np.float32)
        self._mesh.point_data["Normals"] = vertex_normals(vertices, self._asset.triangles)[self._pairs[:, 0]]
        self._mesh.point_data.active_normals_name = "Normals"
        position = -camera.rotation.T @ camera.translation
        window = self._plotter.camera
        window.position, window.up = position, -camera.rotation[1]
        window.focal_point = position + 100 * camera.rotation[2]
        window.view_angle = 2 * np.degrees(np.arctan(self._size / 2 / camera.focal))
        window.clipping_range = (10, 5000)
        self._plotter.render()
        return self._plotter.screenshot(None, return_img=True)[:, :, :3].copy()


def vertex_normals(vertices: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "t 3"]) -> Float[np.ndarray, "v 3"]:
    """Area-weighted outward unit normals."""
    corners = vertices[triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(face[:, i], 3), len(vertices)) for i in range(3)], axis=1
    )
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def load_texture(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """RGB picture from a PNG file."""
    return cv2.imread(str(path))[:, :, ::-1]
