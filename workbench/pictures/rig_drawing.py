"""A rig on paper: its cameras and what they see, from above and from the side."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from scipy.spatial import ConvexHull

from workbench.geometry import Rig, axes_meeting_point, undistorted_rays

COLORS = ("#2a6f97", "#c0392b", "#2d936c", "#e09f3e", "#5e548e")
HEAD_RADIUS_MM = 90.0
BEYOND = 1.2
"""How far the pyramids are drawn, in distances to where the axes meet."""
PARALLEL_BASELINES = 8.0
"""The same in baselines, for axes that do not meet; a rig of one camera is drawn a metre deep."""
SIZE_INCHES, DPI = (9.6, 4.9), 100


def rig_figure(rig: Rig) -> Figure:
    """Plan and side view in the reference camera's frame, millimetres: cameras, pyramids, axes, and a head's size where
    the axes meet."""
    meeting = axes_meeting_point(rig)
    figure = Figure(figsize=SIZE_INCHES, dpi=DPI, layout="constrained")
    above, side = figure.subplots(1, 2)
    # Seen from above, forward is up the page; seen from the reference's right, forward is to the right.
    _draw(above, rig, meeting, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    _draw(side, rig, meeting, np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]))
    above.set(title="from above", xlabel="right, mm", ylabel="forward, mm")
    side.set(title=f"from the right of {rig.names[0]}", xlabel="forward, mm", ylabel="up, mm")
    figure.legend(*above.get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    return figure


def _draw(axes: Axes, rig: Rig, meeting: Float[np.ndarray, "3"] | None, paper: Float[np.ndarray, "2 3"]) -> None:
    if meeting is not None:
        axes.add_patch(
            Circle(paper @ meeting, HEAD_RADIUS_MM, color="#8d99a6", alpha=0.35, lw=0, label="a head's size")
        )
    for index, name in enumerate(rig.names):
        color, dashes = COLORS[index % len(COLORS)], (0, (6, 2 + 2 * index))
        apex, corners, tip = _pyramid(rig, index, meeting)
        outline = np.vstack([apex, corners]) @ paper.T
        outline = outline[ConvexHull(outline).vertices]
        axes.add_patch(Polygon(outline, facecolor=color, alpha=0.12, lw=0))
        axes.add_patch(Polygon(outline, fill=False, edgecolor=color, alpha=0.5, lw=0.8))
        axes.plot(*(np.stack([apex, tip]) @ paper.T).T, color=color, lw=1.2, ls=dashes)
        label = f"{name} (reference)" if index == 0 and len(rig) > 1 else name
        axes.plot(*(paper @ apex), "o", color=color, ms=8, label=label)
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.autoscale_view()


def _pyramid(rig: Rig, index: int, meeting: Float[np.ndarray, "3"] | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """In the reference frame: the camera's position, the corners of its view at some depth, its axis there."""
    view, rotation = rig.views[index], rig.rotation_view_reference[index]
    apex, (width, height) = rig.position_reference_mm[index], view.image_size
    if meeting is not None:
        depth = BEYOND * float(np.linalg.norm(meeting - apex))
    elif len(rig) > 1:
        depth = PARALLEL_BASELINES * float(np.linalg.norm(rig.position_reference_mm, axis=1).max())
    else:
        depth = 1000.0
    pixels = np.array([[0.0, 0.0], [width - 1.0, 0.0], [width - 1.0, height - 1.0], [0.0, height - 1.0]])
    straight = (pixels - view.camera.principal_point_px) / view.camera.focal_px
    rays = undistorted_rays(view.camera, pixels)
    # A lens that folds over has no ray at its corners: draw it as if it were straight.
    rays = np.where(np.isfinite(rays), rays, straight)
    corners = depth * np.column_stack([rays, np.ones(4)]) @ rotation + apex
    return apex, corners, apex + depth * rotation[2]
