"""The PyVista scene of one head. Every call comes from one thread (`render_thread`): a GL context belongs to its maker.

Meshes, materials, textures and lights are PyVista's. The window is VTK's own: a `pyvista.Plotter` brings layers and an
interactor that pictures without a viewer do not need, and no projection matrix of one's own.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import pyvista
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  (registers the GL classes behind the abstract ones)
from jaxtyping import Bool, Float, Int, UInt8
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkUnsignedCharArray
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow

from workbench.face.dressed_head import DressedHead, WornPart
from workbench.face.model import FaceModel
from workbench.geometry import Camera
from workbench.pictures.extras import (
    GHOST_COLOR,
    NOTHING,
    WET_REGIONS,
    Extras,
    marks_mesh,
    outer_triangles,
)
from workbench.pictures.lighting import SKIN_SHINE, WET_SHINE, Light, Lighting
from workbench.pictures.mesh import corner_sum, neck_opacity, split_seams, to_camera, to_pixels, vertex_normals
from workbench.pictures.worn_parts import WornActor

PEELS = 2
"""Passes over strands and cards; each blends the nearest and the farthest of the remaining layers."""
COLORS = "colors"
"""RGBA of the points."""
VTK_AXES = np.array([1.0, -1.0, -1.0])
"""VTK's camera looks along -z with y up, ours along +z with y down."""


class HeadScene:
    """Head, lights and off-screen window of one size."""

    def __init__(
        self,
        model: FaceModel,
        size: tuple[int, int],
        texture: UInt8[np.ndarray, "th tw 3"] | None,
        supersampling: float,
        fade_neck: bool,
        dressed: DressedHead | None = None,
    ) -> None:
        self.triangles = model.triangles
        self.corner_sum = corner_sum(model.triangles, len(model.neutral))
        self.lighting: Lighting | None = None
        if texture is None:
            self.vertex_of_point = np.arange(len(model.neutral))
            points_of_triangle = model.triangles.astype(np.int64)
        else:
            self.vertex_of_point, uv_of_point, points_of_triangle = split_seams(model.triangles, model.triangles_uv)
        fade_neck = fade_neck and not (dressed and dressed.clothed)
        opacity = np.rint(255 * neck_opacity(model)) if fade_neck else np.full(len(model.neutral), 255)
        tint = model.colors if texture is None else np.full_like(model.colors, 255)
        self.opacity = opacity.astype(np.uint8)
        self.own_colors = np.column_stack([tint, self.opacity]).astype(np.uint8)
        self.colored = False
        """Whether the actors have these colours, with the texture and the parts of now."""
        self.shown_colors: UInt8[np.ndarray, "v 3"] | None = None
        self.shown_light: UInt8[np.ndarray, "v 3"] | None = None
        self.texture = None if texture is None else _texture(texture)
        # VTK keeps on drawing a texture that is taken away; a white one takes its place.
        self.blank = None if texture is None else _texture(np.full((2, 2, 3), 255, np.uint8))
        self.outer_triangles = outer_triangles(model).astype(np.int64)
        self.marks, self.ghost = _Part(translucent=False), _Part(translucent=True)
        self.renderer = vtkRenderer()
        self.renderer.SetBackgroundAlpha(0.0)
        self.renderer.AutomaticLightCreationOff()
        self.renderer.SetLightFollowCamera(False)
        self.meshes, self.actors = [], []
        shown = np.ones(len(model.triangles), bool) if dressed is None else dressed.shown
        groups = _by_shine(model, points_of_triangle, shown)
        for triangles, shine in zip(groups, (SKIN_SHINE, WET_SHINE), strict=True):
            mesh = _mesh(model.neutral[self.vertex_of_point], triangles)
            # The texture is multiplied by the colours of the points.
            mesh.point_data[COLORS] = self.own_colors[self.vertex_of_point]
            if texture is not None:
                mesh.active_texture_coordinates = model.uv[uv_of_point].astype(np.float32)
            self.meshes.append(mesh)
            actor = _actor(mesh, shine, fade_neck)
            actor.texture = self.texture
            self.actors.append(actor)
            self.renderer.AddActor(actor)
        for part in (self.marks, self.ghost):
            self.renderer.AddActor(part.actor)
        self.worn: list[WornActor] = []
        if dressed:
            self.wear(dressed.worn)
        self.camera = self.renderer.GetActiveCamera()
        self.camera.SetPosition(0.0, 0.0, 0.0)
        self.camera.SetFocalPoint(0.0, 0.0, -1.0)
        self.camera.SetViewUp(0.0, 1.0, 0.0)
        self.camera.UseExplicitProjectionTransformMatrixOn()
        self.window = vtkRenderWindow()
        self.window.SetOffScreenRendering(1)
        # Rendered larger and reduced: as fast as multisampling in a software GL, and textures are smoothed too.
        self.window.SetMultiSamples(0)
        self.window.SetAlphaBitPlanes(1)
        self.resize(size, supersampling)
        self.window.AddRenderer(self.renderer)
        self.pixels = vtkUnsignedCharArray()

    def render(
        self,
        points_camera: Float[np.ndarray, "v 3"],
        camera: Camera,
        lighting: Lighting,
        extras: Extras = NOTHING,
        pose: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]] | None = None,
        worn_camera: Sequence[Float[np.ndarray, "_ 3"]] = (),
    ) -> UInt8[np.ndarray, "h w 4"]:
        """RGBA of the head and the extras alone, colours already multiplied by alpha.

        Camera-frame vertices in millimetres, those of the worn parts too; `pose` (rotation, translation) takes the
        head-frame extras there.
        """
        width, height = self.size
        depth = points_camera[:, 2]
        if depth.max() <= 0.0:
            return np.zeros((height, width, 4), np.uint8)
        self._set_points(_distorted(camera, points_camera))
        self._set_colors(extras.colors, extras.light)
        self._set_worn(worn_camera, points_camera.mean(axis=0), camera)
        worn_depth = [points[:, 2] for points in worn_camera]
        depth = np.concatenate([depth, *worn_depth, *self._set_extras(extras, camera, pose)])
        self._set_lighting(lighting)
        # Depth resolution is near/far: the range hugs the head.
        self._set_projection(camera, near=max(0.95 * depth.min(), 0.05 * depth.max()), far=1.05 * depth.max())
        self.window.Render()
        drawn_width, drawn_height = self.drawn_size
        self.window.GetRGBACharPixelData(0, 0, drawn_width - 1, drawn_height - 1, 0, self.pixels)
        rgba = vtk_to_numpy(self.pixels).reshape(drawn_height, drawn_width, 4)[::-1]
        return (
            rgba.copy() if self.drawn_size == self.size else cv2.resize(rgba, self.size, interpolation=cv2.INTER_AREA)
        )

    def resize(self, size: tuple[int, int], supersampling: float) -> None:
        """Draw pictures of another size from now on: much cheaper than another window."""
        self.size = size
        self.drawn_size = (math.ceil(size[0] * supersampling), math.ceil(size[1] * supersampling))
        self.window.SetSize(*self.drawn_size)

    def wear(self, parts: Sequence[WornPart]) -> None:
        """Other parts on a head that was made for a dressed one."""
        for actor in (actor for worn in self.worn for actor in worn.actors):
            self.renderer.RemoveActor(actor)
        self.worn = [_worn_actor(part) for part in parts]
        for actor in (actor for worn in self.worn for actor in worn.actors):
            self.renderer.AddActor(actor)
            if self.lighting is not None:
                actor.prop.ambient = self.lighting.ambient
        self.colored = False
        self.renderer.SetUseDepthPeeling(bool(self.worn))
        self.renderer.SetMaximumNumberOfPeels(PEELS)
        self.renderer.SetOcclusionRatio(0.0)

    def set_texture(self, texture: UInt8[np.ndarray, "th tw 3"]) -> None:
        """Another albedo for a head that was made with one."""
        self.texture, self.colored = _texture(texture), False

    def set_shine(self, strength: float, exponent: float) -> None:
        """Highlights of the skin: their strength (0 to 1), and how small they are."""
        self.actors[0].prop.specular = strength
        self.actors[0].prop.specular_power = exponent

    def close(self) -> None:
        """Give the GL context back."""
        self.window.Finalize()

    def _set_points(self, points_camera) -> None:
        points = _vectors(points_camera, self.vertex_of_point)
        normals = vertex_normals(points_camera, self.triangles, self.corner_sum)
        normals = _vectors(normals, self.vertex_of_point)
        for mesh in self.meshes:
            mesh.points = points
            mesh.point_data.active_normals = normals

    def _set_worn(self, worn_camera, middle: Float[np.ndarray, "3"], camera: Camera) -> None:
        for worn, points_camera in zip(self.worn, worn_camera, strict=True):
            points, normals = worn.place(_distorted(camera, points_camera), middle)
            worn.mesh.points = np.ascontiguousarray(points * VTK_AXES, np.float32)
            worn.mesh.point_data.active_normals = np.ascontiguousarray(normals * VTK_AXES, np.float32)

    def _set_colors(self, colors: UInt8[np.ndarray, "v 3"] | None, light: UInt8[np.ndarray, "v 3"] | None) -> None:
        if self.colored and colors is self.shown_colors and light is self.shown_light:
            return
        rgba = self.own_colors if colors is None else np.column_stack([colors, self.opacity])
        if light is not None:
            rgba = np.column_stack([np.rint(rgba[:, :3] * (light / 255.0)), self.opacity]).astype(np.uint8)
        for worn in self.worn:
            worn.mesh.point_data[COLORS] = worn.lit(light)
        for mesh, actor in zip(self.meshes, self.actors, strict=True):
            mesh.point_data[COLORS] = rgba[self.vertex_of_point]
            actor.texture = self.texture if colors is None else self.blank
        self.shown_colors, self.shown_light, self.colored = colors, light, True

    def _set_extras(self, extras: Extras, camera: Camera, pose) -> list[Float[np.ndarray, "_"]]:
        """Show marks and ghost; the depths of their points."""
        parts = []
        vertices, triangles, colors = marks_mesh(extras)
        if self.marks.show(len(vertices) > 0 and pose is not None):
            self.marks.set(_distorted(camera, points := to_camera(vertices, *pose)), triangles, colors)
            parts.append(points[:, 2])
        surface = extras.ghost is not None and not extras.ghost_outline and extras.ghost_opacity > 0.0
        if self.ghost.show(surface and pose is not None):
            points = to_camera(extras.ghost, *pose)
            opacity = np.rint(extras.ghost_opacity * self.opacity.astype(float))
            rgba = np.column_stack([np.tile(GHOST_COLOR, (len(points), 1)), opacity]).astype(np.uint8)
            self.ghost.set(_distorted(camera, points), self.outer_triangles, rgba)
            parts.append(points[:, 2])
        return parts

    def _set_lighting(self, lighting: Lighting) -> None:
        if lighting == self.lighting:
            return
        self.renderer.RemoveAllLights()
        # Without any light VTK would show surfaces at full brightness.
        for light in lighting.lights or (Light((0.0, 0.0, -1.0), 0.0),):
            distant = pyvista.Light(
                position=tuple((VTK_AXES * light.direction).tolist()),
                focal_point=(0.0, 0.0, 0.0),
                light_type="scene light",
                intensity=light.intensity,
                positional=False,
            )
            distant.SetColor(*light.color)  # PyVista's colours have eight bits
            self.renderer.AddLight(distant)
        for actor in self.renderer.GetActors():
            actor.prop.ambient = lighting.ambient
        self.lighting = lighting

    def _set_projection(self, camera: Camera, near: float, far: float) -> None:
        (fx, fy), (cx, cy) = camera.focal_px, camera.principal_point_px
        width, height = self.size
        # GL counts pixel edges: our pixel (0, 0), a centre, is its (0.5, 0.5).
        matrix = np.array(
            [
                (2 * fx / width, 0.0, 1 - 2 * (cx + 0.5) / width, 0.0),
                (0.0, 2 * fy / height, 2 * (cy + 0.5) / height - 1, 0.0),
                (0.0, 0.0, (near + far) / (near - far), 2 * near * far / (near - far)),
                (0.0, 0.0, -1.0, 0.0),
            ]
        )
        self.camera.SetClippingRange(near, far)
        self.camera.SetExplicitProjectionTransformMatrix(pyvista.vtkmatrix_from_array(matrix))


class _Part:
    """An actor with a mesh of its own, replaced as a whole."""

    def __init__(self, translucent: bool) -> None:
        self.mesh = pyvista.PolyData()
        # Only outer sides of a translucent head are drawn: blending them then needs no sorting.
        self.actor = _actor(self.mesh, SKIN_SHINE, fade_neck=translucent)
        if translucent:
            self.actor.ForceOpaqueOff()
            self.actor.ForceTranslucentOn()
        self.actor.SetVisibility(False)

    def show(self, shown: bool) -> bool:
        self.actor.SetVisibility(shown)
        return shown

    def set(self, points_camera, triangles: Int[np.ndarray, "t 3"], colors: UInt8[np.ndarray, "v _"]) -> None:
        order = np.arange(len(points_camera))
        made = _mesh(_vectors(points_camera, order), triangles)
        normals = vertex_normals(points_camera, triangles, corner_sum(triangles, len(points_camera)))
        made.point_data.active_normals = _vectors(normals, order)
        made.point_data[COLORS] = np.ascontiguousarray(colors)
        self.mesh.shallow_copy(made)


def _by_shine(
    model: FaceModel, points_of_triangle, shown: Bool[np.ndarray, "t"]
) -> tuple[Int[np.ndarray, "a 3"], Int[np.ndarray, "b 3"]]:
    inside = model.in_regions(WET_REGIONS)[model.triangles].all(1)
    return points_of_triangle[~inside & shown], points_of_triangle[inside & shown]


def _worn_actor(worn: WornPart) -> WornActor:
    return WornActor(worn, _mesh, lambda mesh, shine: _actor(mesh, shine, fade_neck=False), _texture, COLORS)


def _mesh(points: Float[np.ndarray, "p 3"], triangles: Int[np.ndarray, "t 3"]) -> pyvista.PolyData:
    return pyvista.PolyData.from_regular_faces(np.asarray(points, np.float32), np.asarray(triangles, np.int64))


def _actor(mesh: pyvista.PolyData, shine: Sequence[float], fade_neck: bool) -> pyvista.Actor:
    mapper = pyvista.DataSetMapper(mesh)
    mapper.SetScalarModeToUsePointFieldData()
    mapper.SelectColorArray(COLORS)
    mapper.color_mode = "direct"
    mapper.interpolate_before_map = False
    material = pyvista.Property(
        color="white",
        interpolation="Phong",
        diffuse=1.0,
        specular=shine[0],
        specular_power=shine[1],
        culling="back" if fade_neck else "none",
    )
    actor = pyvista.Actor(mapper, material)
    # A faded neck blends with the empty ground in the plain depth-tested pass. That needs no sorting as long as the
    # inner side of the neck, which would show through here and there, is not drawn.
    actor.ForceOpaqueOn()
    return actor


def _texture(picture: UInt8[np.ndarray, "h w _"]) -> pyvista.Texture:
    texture = pyvista.Texture(np.ascontiguousarray(picture))
    texture.interpolate = True
    texture.mipmap = True
    # Anisotropic filtering, VTK's default, costs a software GL three times the rest of the frame.
    texture.SetMaximumAnisotropicFiltering(1)
    return texture


def _distorted(camera: Camera, points_camera):
    """Points moved sideways, so that a plain pinhole shows them where the lens does."""
    if not np.any(camera.distortion):
        return points_camera
    rays = (to_pixels(camera, points_camera) - camera.principal_point_px) / camera.focal_px
    return np.concatenate([rays * points_camera[:, 2:], points_camera[:, 2:]], axis=1)


def _vectors(vectors: Float[np.ndarray, "v 3"], order: Int[np.ndarray, "s"]) -> Float[np.ndarray, "s 3"]:
    return np.ascontiguousarray((vectors * VTK_AXES)[order], np.float32)
