"""Pictures: the 3D head off screen, and overlays on the input frames."""

from workbench.rendering.gl_probe import gl_available as gl_available
from workbench.rendering.head_picture import HeadPainter as HeadPainter
from workbench.rendering.head_picture import HeadRenderer as HeadRenderer
from workbench.rendering.head_picture import PlainPainter as PlainPainter
from workbench.rendering.head_picture import head_painter as head_painter
from workbench.rendering.head_picture import picture_of_head as picture_of_head
from workbench.rendering.head_picture import portrait_view as portrait_view
from workbench.rendering.lighting import STUDIO as STUDIO
from workbench.rendering.lighting import Light as Light
from workbench.rendering.lighting import Lighting as Lighting
from workbench.rendering.overlay import ALL_BUT_MESH as ALL_BUT_MESH
from workbench.rendering.overlay import OverlayParts as OverlayParts
from workbench.rendering.overlay import draw_overlay as draw_overlay
from workbench.rendering.overlay import side_by_side as side_by_side
from workbench.rendering.overlay_files import HeadPanel as HeadPanel
from workbench.rendering.overlay_files import write_overlay_picture as write_overlay_picture
from workbench.rendering.overlay_files import write_overlay_video as write_overlay_video
from workbench.rendering.wireframe import draw_wireframe as draw_wireframe
