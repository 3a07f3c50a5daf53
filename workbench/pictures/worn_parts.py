"""Actors of what a dressed head wears: textured meshes, some of them translucent."""

import numpy as np
import pyvista
from jaxtyping import Float, UInt8

from workbench.face.dressed_head import WornPart
from workbench.pictures.finish import FINISHES
from workbench.pictures.mesh import corner_sum, split_seams, vertex_normals

# A highlight is light that comes back whatever lies below: it makes an otherwise invisible cornea opaque.
HIGHLIGHT_IS_OPAQUE = """//VTK::Light::Impl
  float glint = clamp(2.0 * specular.r, 0.0, 1.0);
  fragOutput0 = mix(fragOutput0, vec4(1.0), glint);
"""
CORNEA_OPACITY = 0.03
DENSE = 0.95
"""Opacity above which a strand is drawn as opaque; what would show through is too faint to see."""
DENSE_ALONE = f"""//VTK::TCoord::Impl
  if (fragOutput0.a < {DENSE}) discard;
"""


class WornActor:
    """One part in the scene: its actor and, if it is translucent, a second one for its dense strands.

    The second one is drawn with the opaque meshes and hides what is behind it. That leaves few layers to blend, each of
    which is expensive in a software GL.
    """

    def __init__(self, worn: WornPart, mesh_of, actor_of, texture_of, colors: str) -> None:
        self.part = part = worn.part
        self.finish = FINISHES[part.kind]
        self.triangles = part.triangles
        self.sums = corner_sum(part.triangles, len(part.offsets))
        self.order, uv_of_point, triangles = split_seams(part.triangles, part.triangles_uv)
        self.mesh: pyvista.PolyData = mesh_of(np.zeros((len(self.order), 3)), triangles)
        self.mesh.point_data[colors] = self.lit(None)
        self.mesh.active_texture_coordinates = part.uv[uv_of_point].astype(np.float32)
        actor: pyvista.Actor = actor_of(self.mesh, self.finish.shine)
        self.actors = [actor]
        if part.kind == "corneas":
            actor.prop.opacity = CORNEA_OPACITY
            actor.GetShaderProperty().AddFragmentShaderReplacement(
                "//VTK::Light::Impl", True, HIGHLIGHT_IS_OPAQUE, False
            )
        else:
            actor.texture = texture_of(worn.picture if worn.translucent else worn.picture[..., :3])
        if not worn.translucent:
            actor.ForceOpaqueOn()
            return
        actor.ForceOpaqueOff()
        actor.ForceTranslucentOn()
        if actor.texture is not None:
            dense: pyvista.Actor = actor_of(self.mesh, self.finish.shine)
            dense.texture = actor.texture
            dense.GetShaderProperty().AddFragmentShaderReplacement("//VTK::TCoord::Impl", True, DENSE_ALONE, False)
            dense.ForceOpaqueOn()
            self.actors.append(dense)

    def lit(self, light: UInt8[np.ndarray, "v 3"] | None) -> UInt8[np.ndarray, "s 4"]:
        """RGBA of its points where this share of the light, of 255, reaches the head's vertices; None: all of it."""
        colors = shaded(self.part.shade)
        if light is not None and not self.part.still:
            share = np.einsum("nj,njc->nc", self.part.weights, light[self.part.anchors] / 255.0)
            colors[:, :3] = np.rint(colors[:, :3] * np.clip(share, 0.0, 1.0))
        return colors[self.order]

    def place(self, points: Float[np.ndarray, "n 3"], middle: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray]:
        """Points and normals (s 3) along the seams, in the frame of the given points; `middle` is the head's."""
        normals = vertex_normals(points, self.triangles, self.sums)
        if self.finish.roundness:
            outward = points - middle
            outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
            facing = np.where(np.einsum("nd,nd->n", normals, outward) < 0.0, -1.0, 1.0)[:, None]
            normals = self.finish.roundness * outward + (1.0 - self.finish.roundness) * facing * normals
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        return points[self.order], normals[self.order]


def shaded(shade: UInt8[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 4"]:
    """RGBA of points whose texture is darkened."""
    return np.column_stack([shade, shade, shade, np.full_like(shade, 255)])
