"""Differentiable rendering in JAX: triangle meshes under spherical-harmonic light, contours with gradients."""

from workbench.rendering.appearance import Appearance as Appearance
from workbench.rendering.appearance import estimate_appearance as estimate_appearance
from workbench.rendering.appearance import load_appearance as load_appearance
from workbench.rendering.camera import CropCamera as CropCamera
from workbench.rendering.camera import OrthographicCamera as OrthographicCamera
from workbench.rendering.camera import orthographic_camera as orthographic_camera
from workbench.rendering.head import RenderModel as RenderModel
from workbench.rendering.head import face_vertices as face_vertices
from workbench.rendering.head import model_at as model_at
from workbench.rendering.head import render_face as render_face
from workbench.rendering.head import render_model as render_model
from workbench.rendering.lighting import ambient_light as ambient_light
from workbench.rendering.lighting import directional_light as directional_light
from workbench.rendering.lighting import shading as shading
from workbench.rendering.lighting import spherical_harmonics as spherical_harmonics
from workbench.rendering.lighting import turned_light as turned_light
from workbench.rendering.renderer import Rendering as Rendering
from workbench.rendering.renderer import render as render
from workbench.rendering.texture import Texture as Texture
from workbench.rendering.topology import MeshTopology as MeshTopology
from workbench.rendering.topology import mesh_topology as mesh_topology
