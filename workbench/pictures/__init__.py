"""Pictures: the 3D head off screen, and overlays on the input frames."""

from workbench.pictures.deep_strip import heat_map_pair as heat_map_pair
from workbench.pictures.deep_strip import stage_strip as stage_strip
from workbench.pictures.deep_strip import write_stage_strip as write_stage_strip
from workbench.pictures.gl_probe import gl_available as gl_available
from workbench.pictures.head_picture import HeadPainter as HeadPainter
from workbench.pictures.head_picture import HeadRenderer as HeadRenderer
from workbench.pictures.head_picture import PlainPainter as PlainPainter
from workbench.pictures.head_picture import head_painter as head_painter
from workbench.pictures.head_picture import picture_of_head as picture_of_head
from workbench.pictures.head_picture import portrait_view as portrait_view
from workbench.pictures.lighting import STUDIO as STUDIO
from workbench.pictures.lighting import Light as Light
from workbench.pictures.lighting import Lighting as Lighting
from workbench.pictures.model_check import model_check_picture as model_check_picture
from workbench.pictures.overlay import ALL_BUT_MESH as ALL_BUT_MESH
from workbench.pictures.overlay import OverlayParts as OverlayParts
from workbench.pictures.overlay import draw_overlay as draw_overlay
from workbench.pictures.overlay import side_by_side as side_by_side
from workbench.pictures.overlay_files import HeadPanel as HeadPanel
from workbench.pictures.overlay_files import write_overlay_picture as write_overlay_picture
from workbench.pictures.overlay_files import write_overlay_video as write_overlay_video
from workbench.pictures.wireframe import draw_wireframe as draw_wireframe
