"""Charts of a report as SVG text: they take their colours from the page, so that one chart suits light and dark."""

import base64
import html
from collections.abc import Mapping
from types import MappingProxyType

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from workbench.pictures.overlay import WORST_PERCENT, residual_colors
from workbench.tracking import Track

WIDTH, HEIGHT = 860.0, 190.0
LEFT, RIGHT, TOP, BOTTOM = 86.0, 0.0, 10.0, 24.0
"""Margins; the left one is a tenth of the width, as that of the strip of residuals in report.css."""
MOST_POINTS = 1500
"""Points of a curve: more than a screen has columns; of longer clips every second, third … frame is drawn."""
STEPS = (1.0, 2.0, 5.0)
NO_FACE = (128, 128, 128)
JPEG_QUALITY = 85


def line_chart(
    frames: Float[np.ndarray, "n"],
    series: Mapping[str, Float[np.ndarray, "n"]],
    unit: str,
    marked: Mapping[int, str] = MappingProxyType({}),
) -> str:
    """Curves over frames with a legend; gaps where there is no number, ticks at the `marked` frames that say why.

    Empty without a curve, and for a single frame, over which nothing changes.
    """
    if not series or len(frames) == 1:
        return ""
    step = -(-len(frames) // MOST_POINTS)
    values = np.stack([np.asarray(curve, float) for curve in series.values()])
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    ticks = nice_ticks(low, high)
    low, high = min(low, ticks[0]), max(high, ticks[-1])
    first, last = float(frames[0]), max(float(frames[-1]), float(frames[0]) + 1.0)

    def x_of(frame):
        return LEFT + (frame - first) / (last - first) * (WIDTH - LEFT - RIGHT)

    def y_of(value):
        return TOP + (high - value) / max(high - low, 1e-12) * (HEIGHT - TOP - BOTTOM)

    parts = [f'<svg viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="{html.escape(unit)} over frames">']
    for tick in ticks:
        y = y_of(tick)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    for tick in nice_ticks(first, last, 8):
        if first <= tick <= last and tick.is_integer():
            parts.append(f'<text x="{x_of(tick):.1f}" y="{HEIGHT - 6}" text-anchor="middle">{tick:g}</text>')
    for frame, why in marked.items():
        x, title = x_of(float(frame)), html.escape(f"frame {frame}: {why}")
        parts.append(f'<path class="mark" d="M{x:.1f} {TOP - 2} l-4 -7 h8 z"><title>{title}</title></path>')
    for number, curve in enumerate(values):
        path = _path(x_of(frames[::step]), y_of(curve[::step]))
        parts.append(f'<path class="curve c{number % 8}" d="{path}"/>')
    parts.append("</svg>")
    keys = "".join(f'<span class="key c{k % 8}">{html.escape(name)}</span>' for k, name in enumerate(series))
    return (
        f'<figure>{"".join(parts)}<figcaption>{keys}<span class="unit">{html.escape(unit)}</span></figcaption></figure>'
    )


def residual_picture(track: Track) -> UInt8[np.ndarray, "h n 3"]:
    """One row per landmark, by parts of the face, one column per frame: errors in colour, grey without landmarks."""
    order = [point for points in track.scheme.parts.values() for point in points]
    percent = np.where(track.seen[:, None], track.residuals_percent, np.nan)
    percent = percent[:: -(-len(track) // MOST_POINTS)]
    picture = np.array(residual_colors(percent.ravel()), np.uint8).reshape(*percent.shape, 3)
    picture[np.isnan(percent).any(1)] = NO_FACE
    return picture[:, order].transpose(1, 0, 2)


def strip_rows(track: Track) -> list[tuple[str, int]]:
    """The parts of the face in the rows of `residual_picture`, with the number of their landmarks."""
    return [(part, len(points)) for part, points in track.scheme.parts.items()]


def scale_gradient() -> str:
    """The colours of residuals as a CSS gradient, from 0 to `WORST_PERCENT`."""
    colors = residual_colors(np.linspace(0.0, WORST_PERCENT, 9))
    return "linear-gradient(to right, {})".format(", ".join("#{:02x}{:02x}{:02x}".format(*color) for color in colors))


def data_address(picture: UInt8[np.ndarray, "h w 3"], suffix: str = ".jpg") -> str:
    """An RGB picture as an address that holds the picture itself."""
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if suffix == ".jpg" else []
    encoded = cv2.imencode(suffix, np.ascontiguousarray(picture[..., ::-1]), options)[1].tobytes()
    kind = "jpeg" if suffix == ".jpg" else "png"
    return f"data:image/{kind};base64,{base64.b64encode(encoded).decode()}"


def nice_ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Round numbers across a range: steps of 1, 2 or 5 times a power of ten, `most` of them or fewer."""
    span = max(high - low, 1e-9)
    power = 10.0 ** np.floor(np.log10(span / most))
    step = next(factor * power for factor in (*STEPS, 10.0, 20.0) if span / (factor * power) <= most)
    first, last = np.floor(low / step), np.ceil(high / step)
    return [float(round(k * step, 10)) for k in np.arange(first, last + 1)]


def _path(x: Float[np.ndarray, "n"], y: Float[np.ndarray, "n"]) -> str:
    here: Bool[np.ndarray, n] = np.isfinite(y)
    begins = here & ~np.concatenate([[False], here[:-1]])
    commands = np.where(begins, "M", "L")
    # A line of no length shows a number between two gaps as a dot.
    ends = np.where(begins & ~np.concatenate([here[1:], [False]]), "h0", "")
    points = zip(commands, x, y, ends, here, strict=True)
    return "".join(f"{command}{a:.1f} {b:.1f}{end}" for command, a, b, end, shown in points if shown)
