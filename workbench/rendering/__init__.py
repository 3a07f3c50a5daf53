"""Pictures: the 3D head off screen, and overlays on the input frames."""

from workbench.rendering.gl_probe import gl_available as gl_available
from workbench.rendering.head_picture import head_painter as head_painter
from workbench.rendering.head_picture import HeadPainter as HeadPainter
from workbench.rendering.head_picture import HeadRenderer as HeadRenderer
from workbench.rendering.head_picture import picture_of_head as picture_of_head
from workbench.rendering.head_picture import PlainPainter as PlainPainter
from workbench.rendering.head_picture import portrait_view as portrait_view
from workbench.rendering.lighting import Light as Light
from workbench.rendering.lighting import Lighting as Lighting
from workbench.rendering.lighting import STUDIO as STUDIO
from workbench.rendering.wireframe import draw_wireframe as draw_wireframe
