"""Pictures for the notebooks: crops of faces, rows and film strips, with points, arrows and heat maps over them."""

import textwrap
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke

from workbench.arrays import AnyArray
from workbench.errors import InputError
from workbench.face import DressedHead, FaceModel
from workbench.face.jaw import posed_vertices
from workbench.geometry import Camera
from workbench.pictures import HeadPanel, OverlayParts, draw_overlay, head_painter
from workbench.plots.figures import DPI, GAP, PAGE_WIDTH, TITLE_HEIGHT, Picture, empty_figure
from workbench.plots.style import AMBER, LABEL_PT, styled
from workbench.tracking import FrameFit

CLOSE_UP_MARGIN = 1.5
"""Side of a close-up relative to the bounding box of the landmarks."""
HEAD_CUT = 1.35
"""Side of a rendered head relative to the part of it that is shown."""
STRIP_LABEL, STRIP_LARGEST = 0.24, 2.0
"""Film strips: space for the row names, and the largest side of a picture, inches."""
LETTER, LINE = 0.075, 0.16
"""Width of a letter of a row's name and height of its further lines, inches."""
STRIP_MARGIN, HEAD_SHARE = 1.2, 0.6
"""Film strips: margin like `CLOSE_UP_MARGIN`, and opacity of the head over the picture."""
LINES_ALONE = OverlayParts(observed=False, model_points=False, residuals=False, axes=False, text=False, legend=False)


def close_up(
    picture: Picture,
    fit: FrameFit,
    side: int,
    about: Float[np.ndarray, "n 2"] | None = None,
    margin: float = CLOSE_UP_MARGIN,
) -> tuple[Picture, FrameFit]:
    """A square crop around the face, `side` pixels wide, and the fit in its pixels, so that small faces are legible.

    The square is `margin` times as wide as the bounding box of the points `about`, by default the observed landmarks.
    It stays inside the picture if possible; outside, edge pixels are repeated.
    """
    points = fit.observed if about is None else about
    low, high = points.min(axis=0), points.max(axis=0)
    # Landmarks end at the brows, so the middle of the face is above the middle of their bounding box.
    half = 0.5 * margin * float(np.max(high - low))
    corner = (low + high) / 2 - half - np.array([0.0, 0.12 * half])
    room = np.array([picture.shape[1], picture.shape[0]]) - 2 * half
    corner = np.where(room > 0, np.clip(corner, -0.5, room - 0.5), corner)
    scale = side / (2 * half)
    matrix = np.array([[scale, 0.0, -0.5], [0.0, scale, -0.5]])
    matrix[:, 2] += scale * (0.5 - corner)
    size = (side, side)
    cut = cv2.warpAffine(picture, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)

    def moved(points):
        return points @ matrix[:, :2].T + matrix[:, 2]

    camera = Camera(
        np.asarray(fit.camera.focal_px) * scale, moved(np.asarray(fit.camera.principal_point_px)), fit.camera.distortion
    )
    points = {"observed": moved(fit.observed), "projected": moved(fit.projected)}
    return cut, replace(fit, image_size=size, camera=camera, covariance=fit.covariance * scale**2, **points)


@styled
def pictures_in_a_row(pictures: Sequence[Picture], titles: Sequence[str] = (), columns: int | None = None) -> Figure:
    """Pictures side by side, or in rows of `columns`, each with its title above; wide rows are scaled to the page.

    All pictures should have the same size.
    """
    columns = min(columns or len(pictures), len(pictures))
    rows = -(-len(pictures) // columns)
    height, width = np.max([picture.shape[:2] for picture in pictures], axis=0) / DPI
    scale = min(1.0, (PAGE_WIDTH - GAP * (columns - 1)) / (columns * width))
    width, height = scale * width, scale * height
    # A row whose titles are all empty needs no space for them.
    titled = [any(titles[row * columns : (row + 1) * columns]) for row in range(rows)]
    heads = [TITLE_HEIGHT if has_title else GAP for has_title in titled]
    total_width, total_height = columns * width + (columns - 1) * GAP, rows * height + sum(heads)
    figure = empty_figure(total_width, total_height)
    for k, picture in enumerate(pictures):
        row, column = divmod(k, columns)
        bottom = total_height - sum(heads[: row + 1]) - (row + 1) * height
        left = column * (width + GAP)
        axis = figure.add_axes((left / total_width, bottom / total_height, width / total_width, height / total_height))
        axis.imshow(picture)
        axis.axis("off")
        if titled[row]:
            axis.set_title(titles[k], pad=4)
    return figure


@styled
def film_strip(
    model: FaceModel,
    pictures: Sequence[Picture],
    rows: dict[str, Sequence[FrameFit]],
    notes: dict[str, Sequence[str]] | None = None,
) -> Figure:
    """Frames side by side: a row of pictures, and for each label a row of its fits as heads over the pictures.

    `rows[label][k]` is a fit to `pictures[k]`, and `notes[label][k]` is written into its corner. A column shows the
    same square in all rows. The head is translucent, so that mismatches appear as double contours; lines are the
    model's landmarks. A frame without a face is dark. Raises `InputError` if no row has a face in a frame.

    Deep Energies Figs. 8, 13, 14 and 18.
    """
    count = len(pictures)
    across = PAGE_WIDTH - STRIP_LABEL - GAP * count
    side = int(min(across / count, STRIP_LARGEST) * DPI)
    fine = 2 * side  # drawn at twice the size for thin, smooth lines
    panels: list[list[Picture]] = [[] for _ in range(len(rows) + 1)]
    with head_painter(model, (fine, fine), texture=False, fade_neck=True) as painter:
        for k, picture in enumerate(pictures):
            column = [fits[k] for fits in rows.values()]
            found = [fit.projected for fit in column if fit.found]
            if not found:
                raise InputError(f"Frame {column[0].index} of the film strip has no face in any row; leave it out.")
            square = {"about": np.median(found, axis=0), "margin": STRIP_MARGIN}
            photo, _ = close_up(picture, column[0], fine, **square)
            panels[0].append(_resized(photo, side))
            for row, fit in zip(panels[1:], column, strict=True):
                row.append(_resized(_head_over(model, painter, *close_up(picture, fit, fine, **square)), side))
    return _labelled_rows(
        panels,
        [f"frame {fit.index}" for fit in next(iter(rows.values()))],
        ["picture", *rows],
        [[""] * count, *(notes.get(label, [""] * count) if notes else [""] * count for label in rows)],
    )


@styled
def picture_rows(rows: dict[str, Sequence[Picture]], titles: Sequence[str]) -> Figure:
    """Square pictures as a table: a row for each label, a title above each column."""
    across = PAGE_WIDTH - STRIP_LABEL - GAP * len(titles)
    side = int(min(across / len(titles), STRIP_LARGEST) * DPI)
    panels = [[_resized(picture, side) for picture in pictures] for pictures in rows.values()]
    return _labelled_rows(panels, titles, list(rows), [[""] * len(titles)] * len(rows))


@styled
def compared_fits(
    model: FaceModel,
    picture: Picture | None,
    fits: dict[str, FrameFit],
    side: int = 300,
    view: str = "pose",
    columns: int | None = None,
    about: Float[np.ndarray, "n 2"] | None = None,
    dressed: DressedHead | None = None,
) -> Figure:
    """Fits of one frame side by side with labels: drawn over the picture, with heads below, `dressed` as a character.

    A single fit has its head next to it; without a picture only heads are shown, in rows of `columns`. With `view`
    "pose" the heads turn with the face, with "front" they stay frontal. All close-ups show the same square: around
    the points `about`, by default the observed landmarks. Raises `InputError` for a fit of another face model.
    """
    count = len(model.expression_names)
    for label, fit in fits.items():
        if len(fit.expression) != count:
            raise InputError(
                f"The fit {label!r} has {len(fit.expression)} blendshape weights, and the face model has {count}: give "
                "the model that it was fitted with (for the preset dense, face.in_scheme(model, DENSE)), and compare "
                "fits of different models in separate pictures."
            )
    wide = round(HEAD_CUT * side)
    with HeadPanel(model, (wide, wide), view, dressed=dressed) as panel:
        whole = [panel.submit(fit).result()[0] for fit in fits.values()]
    edge = round(len(whole[0]) * (1.0 - 1.0 / HEAD_CUT) / 2)
    heads = [_resized(head[edge : len(head) - edge, edge : len(head) - edge], side) for head in whole]
    if picture is None:
        return pictures_in_a_row(heads, list(fits), columns)
    parts = OverlayParts(text=False, legend=False)
    overlays = [draw_overlay(*close_up(picture, fit, side, about), parts=parts) for fit in fits.values()]
    overlays = [_resized(overlay, side) for overlay in overlays]  # small ones are enlarged already
    if len(fits) == 1:
        return pictures_in_a_row([*overlays, *heads], [*fits, ""])
    return pictures_in_a_row([*overlays, *heads], [*fits, *([""] * len(fits))], columns=len(fits))


def with_points(picture: Picture, points: Float[np.ndarray, "n 2"], color: str, radius: int = 2) -> Picture:
    """A copy of the picture with dots of `radius` pixels at these points."""
    drawn = picture.copy()
    for x, y in np.nan_to_num(points):
        cv2.circle(drawn, (round(float(x)), round(float(y))), radius, _rgb(color), -1, cv2.LINE_AA)
    return drawn


def with_arrows(
    picture: Picture, points: Float[np.ndarray, "n 2"], vectors: Float[np.ndarray, "n 2"], color: str
) -> Picture:
    """A copy of the picture with an arrow of `vectors` pixels at each of these points."""
    drawn = picture.copy()
    fraction_bits = 4
    ends = np.stack([points, points + vectors], axis=1)
    for tail, tip in np.rint(np.nan_to_num(ends) * 2**fraction_bits).astype(int):
        length = float(np.hypot(*(tip - tail))) / 2**fraction_bits
        head = min(0.4, 4.0 / max(length, 1e-6))
        cv2.arrowedLine(drawn, tuple(tail), tuple(tip), _rgb(color), 1, cv2.LINE_AA, fraction_bits, head)
    return drawn


def as_picture(values: Float[AnyArray, "h w 3"]) -> Picture:
    """The renderer's colours (0 to 1) as a picture; values out of range are clipped."""
    return np.rint(255.0 * np.clip(np.asarray(values), 0.0, 1.0)).astype(np.uint8)


def signed_picture(values: Float[AnyArray, "h w"], limit: float | None = None) -> Picture:
    """Signed numbers as colours: white is zero, red is `limit` and above, blue is −`limit` and below.

    `limit` defaults to the largest magnitude of the values.
    """
    values = np.asarray(values)
    limit = float(np.abs(values).max()) if limit is None else limit
    return as_picture(colormaps["RdBu_r"](0.5 + 0.5 * values / max(limit, 1e-30))[..., :3])


def heat_over(picture: Picture, heat: Float[AnyArray, "m n"], color: str = AMBER) -> Picture:
    """The picture in grey with a heat map in colour: transparent at 0, opaque at 1 and above.

    A map smaller than the picture is enlarged with pixel edges aligned.
    """
    size = picture.shape[1], picture.shape[0]
    share = np.clip(cv2.resize(np.asarray(heat, np.float32), size, interpolation=cv2.INTER_NEAREST), 0.0, 1.0)
    grey = np.repeat(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2) / 255.0
    return as_picture(grey + share[..., None] * (np.array(to_rgb(color)) - grey))


def ball_normals(side: int) -> Float[np.ndarray, "s s 3"]:
    """Camera-frame normals of a ball that fills a square orthographic picture of `side` pixels; NaN around it."""
    y, x = (np.mgrid[:side, :side] - (side - 1) / 2) / (side / 2)
    square = 1.0 - x * x - y * y
    return np.where(square[..., None] > 0.0, np.stack([x, y, -np.sqrt(np.maximum(square, 0.0))], axis=-1), np.nan)


def _head_over(model: FaceModel, painter, photo: Picture, fit: FrameFit) -> Picture:
    """The head of a fit over the picture, drawn by a `HeadPainter` of the picture's size."""
    if not fit.found:
        return photo // 3
    vertices = posed_vertices(model.personal(fit.identity), fit.expression, fit.jaw, fit.scale)
    head = painter.render(vertices, fit.camera, fit.rotation, fit.translation, background=photo)
    mixed = cv2.addWeighted(head, HEAD_SHARE, photo, 1.0 - HEAD_SHARE, 0.0)
    return draw_overlay(mixed, fit, parts=LINES_ALONE)


def _labelled_rows(
    panels: Sequence[Sequence[Picture]], tops: Sequence[str], labels: Sequence[str], notes: Sequence[Sequence[str]]
) -> Figure:
    """Square pictures in a table with column names above and row names on the left."""
    side = len(panels[0][0]) / DPI
    names = [textwrap.wrap(label, max(1, int(side / LETTER))) for label in labels]
    margin = STRIP_LABEL + LINE * (max(map(len, names)) - 1)
    width, height = margin + len(tops) * (side + GAP), TITLE_HEIGHT + len(panels) * (side + GAP)
    figure = empty_figure(width, height)
    for row, (pictures, name, said) in enumerate(zip(panels, names, notes, strict=True)):
        bottom = height - TITLE_HEIGHT - row * (side + GAP) - side
        figure.text(
            0.45 * margin / width, (bottom + side / 2) / height, "\n".join(name), rotation=90, ha="center",
            va="center", fontsize=LABEL_PT,
        )  # fmt: skip
        for column, (picture, note) in enumerate(zip(pictures, said, strict=True)):
            left = margin + column * (side + GAP)
            axis = figure.add_axes((left / width, bottom / height, side / width, side / height))
            axis.imshow(picture)
            axis.axis("off")
            axis.text(0.97, 0.03, note, transform=axis.transAxes, ha="right", va="bottom", fontsize=8, color="white",
                      path_effects=[Stroke(linewidth=2, foreground="0.1"), Normal()])  # fmt: skip
            if row == 0:
                axis.set_title(tops[column], pad=4)
    return figure


def _resized(picture: Picture, side: int) -> Picture:
    method = cv2.INTER_AREA if len(picture) > side else cv2.INTER_LINEAR
    return cv2.resize(picture, (side, side), interpolation=method)


def _rgb(color: str) -> tuple[int, int, int]:
    return tuple(round(255 * part) for part in to_rgb(color))
