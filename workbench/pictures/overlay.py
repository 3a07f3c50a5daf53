"""The fit drawn into its frame: observed and model landmarks, residuals in colour, head axes, one line of numbers."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from workbench.face import FaceModel, posed_vertices
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import POINT_COUNT, POLYLINES, error_unit
from workbench.landmarks.uncertainty import ellipses
from workbench.pictures.lettering import SMALLEST_PX, fitting_size, text_width, write_text
from workbench.pictures.mesh import scaled_camera, to_camera, to_pixels
from workbench.tracking.failures import why_failed
from workbench.tracking.records import FrameFit

SMALLEST_SIDE, LARGEST_SIDE = 320, 1920
"""Bounds of the longer side of a drawn picture; others are enlarged or reduced to them for display."""
CROWDED = 0.6
"""Size of the marks of more than 68 points, as a share of those of 68."""
WORST_PERCENT = 10.0
"""Residual, % of the distance between the outer eye corners, at the bright end of the colour scale."""
SHIFT = 4
"""OpenCV draws with coordinates in sixteenths of a pixel."""
FURTHEST_PX = 30_000
"""Drawing further outside would overflow OpenCV's integers."""
WHITE, INK, PAPER = (255, 255, 255), (16, 18, 22), (244, 246, 248)
LINE_COLOR, MESH_COLOR = (150, 220, 235), (210, 240, 245)
AXIS_COLORS = ((230, 97, 70), (90, 200, 120), (80, 160, 255))
"""Head axes: x to the subject's left, y down, and out of the face (the nose's way)."""
AXIS_MM = 55.0
NOSE_TIP = 30


@dataclass(frozen=True)
class OverlayParts:
    """What `draw_overlay` draws."""

    observed: bool = True
    model_points: bool = True
    residuals: bool = True
    lines: bool = True
    mesh: bool = False
    ellipses: bool = False
    axes: bool = True
    text: bool = True
    legend: bool = True


ALL_BUT_MESH = OverlayParts()


def draw_overlay(
    picture: UInt8[np.ndarray, "h w 3"],
    fit: FrameFit,
    model: FaceModel | None = None,
    parts: OverlayParts = ALL_BUT_MESH,
    within: tuple[int, int] | None = None,
) -> UInt8[np.ndarray, "oh ow 3"]:
    """A copy of the RGB frame with the fit drawn into it; a frame without a face says so.

    White rings are the observed landmarks, dots the model's, and the line between them is their residual, coloured
    (viridis, readable with colour-blindness) by its length in % of the outer-eye distance. Line widths grow with the
    face. Pictures whose longer side is under 320 or over 1920 pixels are resized to that, or all to fit `within` a
    (width, height). `parts.mesh` needs the `model` of `fit`; `parts.ellipses` hold 80 % of where each point may be, if
    the detector said so.
    """
    scale, canvas = _for_display(picture, within)
    unit = _unit(canvas)
    if not fit.found:
        _label(canvas, f"frame {fit.index}   no face", unit)
        return canvas
    observed, projected = _resized(fit.observed, scale), _resized(fit.projected, scale)
    colors = residual_colors(fit.residuals_percent)
    fine = _fineness(observed, unit)
    if parts.mesh and model is not None:
        _draw_mesh(canvas, fit, model, scale)
    if parts.lines:
        _draw_polylines(canvas, projected, fine)
    detected = fit.landmarks if parts.ellipses else None
    if detected and detected.covariance is not None:
        _draw_ellipses(canvas, observed, detected.covariance * scale**2, confidence_colors(fit.confidence), fine)
    if parts.residuals:
        _draw_segments(canvas, observed, projected, colors, fine)
    if parts.observed:
        _draw_rings(canvas, observed, fit.confidence, fine)
    if parts.model_points:
        _draw_dots(canvas, projected, colors, fine)
    if parts.axes:
        _draw_axes(canvas, fit, projected[NOSE_TIP], scale, fine)
    if parts.legend and min(canvas.shape[:2]) >= 200:
        _draw_legend(canvas, _legend(unit, "residual, % of eye distance", ("0", "5", "10+")), unit)
    if parts.text:
        _label(canvas, _numbers(fit), unit)
    return canvas


def draw_landmarks(
    picture: UInt8[np.ndarray, "h w 3"], landmarks: Landmarks2D | None, name: str = ""
) -> UInt8[np.ndarray, "oh ow 3"]:
    """A copy of the RGB picture with landmarks coloured by confidence (viridis: violet guessed, yellow sure).

    Around points with a covariance are the ellipses that hold 80 % of where they may be.
    Without landmarks it says that there is no face. Pictures are resized as by `draw_overlay`.
    """
    scale, canvas = _for_display(picture)
    unit = _unit(canvas)
    title = f"{name}   " if name else ""
    if landmarks is None:
        _label(canvas, f"{title}no face", unit)
        return canvas
    points = _resized(landmarks.points, scale)
    fine = _fineness(points, unit)
    _draw_polylines(canvas, points, fine)
    colors = confidence_colors(landmarks.confidence)
    if landmarks.covariance is not None:
        _draw_ellipses(canvas, points, landmarks.covariance * scale**2, colors, fine)
    _draw_dots(canvas, points, colors, fine)
    if min(canvas.shape[:2]) >= 200:
        _draw_legend(canvas, _legend(unit, "confidence", ("0", "0.5", "1")), unit)
    _label(canvas, f"{title}confidence {np.median(landmarks.confidence):.2f}", unit)
    return canvas


def displayed_size(image_size: tuple[int, int]) -> tuple[int, int]:
    """(width, height) of the overlay of a frame of this (width, height)."""
    longest = max(image_size)
    scale = min(max(longest, SMALLEST_SIDE), LARGEST_SIDE) / longest
    return max(1, round(image_size[0] * scale)), max(1, round(image_size[1] * scale))


def side_by_side(left: UInt8[np.ndarray, "lh lw 3"], right: UInt8[np.ndarray, "rh rw 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Two pictures in one row; the right one is resized to the height of the left one."""
    height = left.shape[0]
    if right.shape[0] != height:
        width = max(1, round(right.shape[1] * height / right.shape[0]))
        method = cv2.INTER_AREA if height < right.shape[0] else cv2.INTER_LINEAR
        right = cv2.resize(right, (width, height), interpolation=method)
    return np.concatenate([left, right], axis=1)


def residual_colors(percent: Float[np.ndarray, "n"]) -> list[tuple[int, int, int]]:
    """RGB colours of residuals in % of the outer-eye distance: from violet (0) to yellow (10 and more)."""
    places = np.clip(np.nan_to_num(percent, nan=WORST_PERCENT) / WORST_PERCENT, 0.0, 1.0)
    return [tuple(color) for color in _scale_colors()[np.rint(places * 255).astype(int)].tolist()]


def confidence_colors(confidence: Float[np.ndarray, "n"]) -> list[tuple[int, int, int]]:
    """RGB colours of confidences: from violet (0) to yellow (1)."""
    return residual_colors(WORST_PERCENT * confidence)


@lru_cache(maxsize=1)
def _scale_colors() -> UInt8[np.ndarray, "256 3"]:
    # Viridis without its darkest sixth, which is lost in hair and shadow.
    steps = np.linspace(42, 255, 256).astype(np.uint8)[:, None]
    return cv2.applyColorMap(steps, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1].copy()


def _for_display(
    picture: UInt8[np.ndarray, "h w 3"], within: tuple[int, int] | None = None
) -> tuple[float, UInt8[np.ndarray, "oh ow 3"]]:
    """Scale, and a copy to draw on."""
    height, width = picture.shape[:2]
    size = displayed_size((width, height))
    if within not in (None, size):
        scale = min(within[0] / width, within[1] / height)
        size = max(1, round(width * scale)), max(1, round(height * scale))
    if size == (width, height):
        return 1.0, np.ascontiguousarray(picture).copy()
    scale = max(size) / max(width, height)
    return scale, cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR)


def _resized(points: Float[np.ndarray, "n 2"], scale: float) -> Float[np.ndarray, "n 2"]:
    return (points + 0.5) * scale - 0.5


def _unit(canvas: np.ndarray) -> float:
    """Drawing unit in pixels: 1 for a picture of 640 × 360."""
    return float(np.clip(np.sqrt(canvas.shape[0] * canvas.shape[1]) / 480.0, 0.4, 3.5))


def _fixed(points: np.ndarray) -> Int[np.ndarray, "..."]:
    finite = np.nan_to_num(points, nan=-FURTHEST_PX, posinf=FURTHEST_PX, neginf=-FURTHEST_PX)
    return np.rint(np.clip(finite, -FURTHEST_PX, FURTHEST_PX) * (1 << SHIFT)).astype(np.int32)


def _width(unit: float, factor: float) -> int:
    return max(1, round(unit * factor))


def _fineness(points: Float[np.ndarray, "points 2"], unit: float) -> float:
    """Size of marks: by that of the face, and smaller where there are many."""
    fine = float(np.clip(error_unit(points) / 90.0, 0.35, unit))
    return fine if len(points) == POINT_COUNT else CROWDED * fine


def _draw_polylines(canvas, points, unit) -> None:
    lines = [_fixed(points[list(line)]) for line in POLYLINES]
    drawn = canvas.copy()
    cv2.polylines(drawn, lines, False, LINE_COLOR, _width(unit, 1.2), cv2.LINE_AA, SHIFT)
    cv2.addWeighted(drawn, 0.6, canvas, 0.4, 0, dst=canvas)


def _draw_ellipses(canvas, points, covariance, colors, unit) -> None:
    outlines = list(_fixed(ellipses(points, covariance)))
    drawn = canvas.copy()
    for outline, color in zip(outlines, colors, strict=True):
        cv2.polylines(drawn, [outline], True, color, _width(unit, 0.9), cv2.LINE_AA, SHIFT)
    cv2.addWeighted(drawn, 0.7, canvas, 0.3, 0, dst=canvas)


def _draw_segments(canvas, observed, projected, colors, unit) -> None:
    ends = _fixed(np.stack([observed, projected], axis=1))
    cv2.polylines(canvas, list(ends), False, INK, _width(unit, 1.6) + 1, cv2.LINE_AA, SHIFT)
    for end, color in zip(ends, colors, strict=True):
        cv2.line(canvas, end[0].tolist(), end[1].tolist(), color, _width(unit, 1.6), cv2.LINE_AA, SHIFT)


def _draw_rings(canvas, points, confidence, unit) -> None:
    """Observed landmarks; guessed ones (low confidence) are drawn smaller."""
    for centre, certainty in zip(_fixed(points).tolist(), confidence.tolist(), strict=True):
        radius = int((2.8 if certainty > 0.5 else 1.6) * unit * (1 << SHIFT))
        cv2.circle(canvas, centre, radius, WHITE, _width(unit, 0.7), cv2.LINE_AA, SHIFT)


def _draw_dots(canvas, points, colors, unit) -> None:
    for centre, color in zip(_fixed(points).tolist(), colors, strict=True):
        cv2.circle(canvas, centre, int(1.7 * unit * (1 << SHIFT)), INK, -1, cv2.LINE_AA, SHIFT)
        cv2.circle(canvas, centre, int(1.3 * unit * (1 << SHIFT)), color, -1, cv2.LINE_AA, SHIFT)


def _draw_axes(canvas, fit: FrameFit, nose, scale, unit) -> None:
    """Head axes, moved in the picture so that they start at the nose tip."""
    camera = scaled_camera(fit.camera, scale)
    axes_head = AXIS_MM * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1]])
    points_camera = to_camera(axes_head, fit.rotation, fit.translation)
    if points_camera[:, 2].min() <= 1.0:
        return
    pixels = to_pixels(camera, points_camera)
    start, ends = _fixed(nose).tolist(), _fixed(pixels[1:] - pixels[0] + nose)
    # The axis that points away from the camera is drawn first.
    for k in np.argsort(-points_camera[1:, 2]):
        end = ends[k].tolist()
        cv2.line(canvas, start, end, INK, _width(unit, 2.0) + 1, cv2.LINE_AA, SHIFT)
        cv2.line(canvas, start, end, AXIS_COLORS[k], _width(unit, 2.0), cv2.LINE_AA, SHIFT)


def _draw_mesh(canvas, fit: FrameFit, model: FaceModel, scale: float) -> None:
    """The edges of the triangles that face the camera, half transparent."""
    vertices = posed_vertices(model.personal(fit.identity), fit.expression, fit.jaw, fit.scale)
    points_camera = to_camera(vertices, fit.rotation, fit.translation)
    if points_camera[:, 2].min() <= 1.0:
        return
    pixels = to_pixels(scaled_camera(fit.camera, scale), points_camera)
    corners = pixels[model.triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    facing = corners[first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] < 0]
    drawn = canvas.copy()
    cv2.polylines(drawn, list(_fixed(facing)), True, MESH_COLOR, 1, cv2.LINE_AA, SHIFT)
    cv2.addWeighted(drawn, 0.25, canvas, 0.75, 0, dst=canvas)


def _numbers(fit: FrameFit) -> str:
    yaw, pitch, roll = np.rint(fit.angles_deg) + 0.0  # adding zero turns −0 into 0
    pixels, _, percent = fit.errors
    error = f"error {pixels:.1f} px ({percent:.1f} %)" if fit.seen else "not seen"
    error = "filled" if fit.source == "filled" else error
    why = why_failed(fit)
    text = f"frame {fit.index}   {error}   " + (f"failed: {why}   " if why else "")
    return (text + f"yaw {yaw:+.0f}°  pitch {pitch:+.0f}°  roll {roll:+.0f}°").replace("-", "\u2212")


def _label(canvas, text: str, unit: float) -> None:
    """One line of text on a dark band at the upper edge, as small as it must be to fit."""
    height, width = canvas.shape[:2]
    size = fitting_size(text, max(SMALLEST_PX, round(13 * unit)), round(width - 26 * unit))
    band = min(height, round(1.9 * size))
    canvas[:band] = (canvas[:band] * 0.35 + np.array(INK) * 0.65).astype(np.uint8)
    write_text(canvas, text, (round(0.7 * size), round(1.3 * size)), PAPER, size)


def _draw_legend(canvas, bar: UInt8[np.ndarray, "bh bw 3"], unit: float) -> None:
    """The colour scale in the lower left corner."""
    height, width = bar.shape[:2]
    margin = round(8 * unit)
    if height + 2 * margin > canvas.shape[0] or width + 2 * margin > canvas.shape[1]:
        return
    place = canvas[canvas.shape[0] - margin - height : canvas.shape[0] - margin, margin : margin + width]
    cv2.addWeighted(bar, 0.85, place, 0.15, 0, dst=place)


@lru_cache(maxsize=8)
def _legend(unit: float, title: str, marks: tuple[str, str, str]) -> UInt8[np.ndarray, "h w 3"]:
    """The colour scale with its marks at the dark end, the middle and the bright end."""
    size, pad = max(SMALLEST_PX, round(10 * unit)), round(6 * unit)
    length, thick = round(150 * unit), max(3, round(7 * unit))
    bar = np.full((3 * pad + thick + 3 * size, length + 2 * pad, 3), INK, np.uint8)
    top = pad + round(1.4 * size)
    bar[top : top + thick, pad : pad + length] = _scale_colors()[np.linspace(0, 255, length).astype(int)]
    write_text(bar, title, (pad, pad + size), PAPER, size)
    for place, text in zip((0.0, 0.5, 1.0), marks, strict=True):
        x = pad + round((length - text_width(text, size)) * place)
        write_text(bar, text, (x, top + thick + round(1.3 * size)), PAPER, size)
    return bar
