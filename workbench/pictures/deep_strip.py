"""A Deep Energies solve as pictures: photo, start and every stage (Figs. 3 to 6), and pairs of heat maps."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from workbench.energies.deep import DeepView, crop_of, in_view, view_vertices
from workbench.errors import InputError
from workbench.face import FaceParameters
from workbench.frames import write_picture
from workbench.landmarks.scheme import POINT_NAMES
from workbench.networks import BETA, CropBox, crop_and_resize, reduction_for, soft_argmax, to_picture
from workbench.pictures.lettering import fitting_size, text_width, write_text
from workbench.pictures.overlay import INK, PAPER, SHIFT
from workbench.rendering import CropCamera, cover_vertices, covered, render
from workbench.runtime import COMPUTING
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_programs import DeepScene
from workbench.tracking.deep_solution import DeepSolution
from workbench.tracking.deep_solver import StageResult
from workbench.tracking.failures import why_failed

PANEL, COLUMNS, GAP = 260, 5, 6
"""Side of a panel, panels in a row and space around them, pixels: five fill a screen 1366 pixels wide."""
CAPTION, FOOTER = 40, 26
SAMPLES = 2
"""Points per pixel side that a panel's render is shaded at."""
FACE_SHARE = 0.8
"""Of a render over the photo: enough of the photo stays to see the contours of both."""
FACES_ACROSS, MOST_FACES_ACROSS = 1.6, 2.4
"""Side of a panel in sides of the landmarks' box; more where a stage's head is further away, up to the second."""
SEEN_IN_RENDER, SEEN_IN_PHOTO, APART = (66, 224, 70), (0, 205, 215), (235, 60, 50)
"""The paper's colours of Fig. 3: green, teal, red."""
PALE, OUTSIDE = (150, 158, 168), (38, 42, 48)
HEAT = (255, 196, 0)
HEAT_POINTS = (36, 30, 48, 66, 8)
"""Eye corner, nose tip, mouth corner, lower lip, chin."""
HEAT_PANEL, HEAT_ACROSS = 220, 0.45
"""Side of a heat map's panel in pixels, and in sides of the landmarks' box."""


def stage_strip(
    picture: UInt8[np.ndarray, "h w 3"],
    fitter: DeepFitter,
    solution: DeepSolution,
    view: int = 0,
    columns: int = COLUMNS,
) -> UInt8[np.ndarray, "sh sw 3"]:
    """A film strip of a solve: the photo, the start, what each stage left, and the last one without marks.

    Each stage's face is rendered with the shot's albedo and light over the same square of the photo. Green dots are the
    model's landmarks, as the energy has them; teal rings those in the photo, red lines lead from one to the other (Deep
    Energies Fig. 3). Below are the stage's name, its steps, its energy before and after, and the mean distance. `view`
    counts the cameras of a rig; `picture` is that camera's. `columns` panels are in a row. Raises `InputError` for an
    unknown view.
    """
    _check(solution, view)
    scene, camera = solution.problem.scene, solution.views[view]
    seen = bool(np.any(np.asarray(camera.weights) > 0.0))
    target = np.asarray(camera.target) if seen else None
    places = [("start", solution.start, solution.results[0].path[0].points[view])]
    for number, (stage, result) in enumerate(zip(solution.stages, solution.results, strict=True), 1):
        places.append((f"{number}  {stage.name}", result.parameters, result.prediction.points[view]))
    box = _square([points for _, _, points in places], target)
    photo = _cut(picture, box, PANEL)
    number = solution.problem.observation.index
    panels = [_panel(photo, "photo", f"frame {number}" + ("" if seen else ", no face in this view"))]
    notes = ["", *(_note(result) for result in solution.results)]
    for (name, parameters, points), note in zip(places, notes, strict=True):
        with COMPUTING:
            over, share = _face_in_box(scene, camera, parameters, box, side=PANEL)
        drawn = _blended(photo, np.asarray(over), np.asarray(share), FACE_SHARE)
        _draw_pairs(drawn, _in_panel(points, box), None if target is None else _in_panel(target, box))
        if target is not None:
            note = f"{note}   {np.linalg.norm(points - target, axis=1).mean():.1f} px apart".strip()
        panels.append(_panel(drawn, name, note))
    failure = why_failed(fitter.record(solution))
    looks = sum(result.evaluations for result in solution.results)
    said = f"failed: {failure}" if failure else f"{looks} renders seen by the network" if _looks(solution) else ""
    panels.append(
        _panel(_blended(photo, np.asarray(over), np.asarray(share), 1.0), "result", said, APART if failure else PALE)
    )
    return _page(panels, columns, "seen in the render" if _looks(solution) else "points of the model")


def write_stage_strip(
    path: str | Path,
    picture: UInt8[np.ndarray, "h w 3"],
    fitter: DeepFitter,
    solution: DeepSolution,
    view: int = 0,
) -> None:
    """Write `stage_strip` as PNG or JPEG (by suffix), completely or not at all."""
    write_picture(path, stage_strip(picture, fitter, solution, view))


def heat_map_pair(
    picture: UInt8[np.ndarray, "h w 3"],
    solution: DeepSolution,
    points: Sequence[int] = HEAT_POINTS,
    stage: int = -1,
    view: int = 0,
) -> UInt8[np.ndarray, "ph pw 3"]:
    """Heat maps of these landmarks in the photo (above) and in the render that a stage left (below).

    A column shows one square of the picture in both, so that the maps can be compared by eye. The heat is the square
    root of the probability that softmax(50·H) gives; ring and dot are N(F*) and N(F). Raises `InputError` for a view
    without a face or without the network.
    """
    _check(solution, view)
    network, camera = solution.problem.scene.network, solution.views[view]
    look = solution.results[stage].prediction.looks[view]
    if look is None or look.heat_maps is None or not np.any(np.asarray(camera.weights) > 0.0):
        raise InputError(
            f'View {view} has no heat maps: it has them only if the network found a face, deep.energy is "deep" or '
            '"mixed", and deep.network is not dense.'
        )
    target, box = np.asarray(camera.target), crop_of(network, jnp.asarray(camera.target))
    with COMPUTING:
        crop = crop_and_resize(
            jnp.asarray(picture, jnp.float32) / 255.0, box, look.picture.shape[0], reduction_for(box)
        )
        maps = np.asarray(network(crop))
        found = np.asarray(to_picture(soft_argmax(maps), box, maps.shape[-1]))
    rows = {
        "photo": (np.moveaxis(np.asarray(crop), 0, -1), maps, box, found, SEEN_IN_PHOTO),
        "render": (np.asarray(look.picture), np.asarray(look.heat_maps), look.box, np.asarray(look.points),
                   SEEN_IN_RENDER),
    }  # fmt: skip
    side = HEAT_ACROSS * float(np.max(np.ptp(target, axis=0)))
    panels = []
    for name, (colors, heat, crop, seen, mark) in rows.items():
        confidence = np.asarray(network.confidence_of(jnp.asarray(heat)))
        for k in points:
            window = CropBox(target[k], np.float64(side), np.float64(0.0))
            drawn = _heat_panel(colors, heat[k], crop, window)
            if name == "render":
                _draw_pairs(drawn, _in_panel(seen[[k]], window, HEAT_PANEL), _in_panel(found[[k]], window, HEAT_PANEL))
            else:
                _ring(drawn, _in_panel(seen[k], window, HEAT_PANEL), mark)
            panels.append(_panel(drawn, f"{name}, confidence {confidence[k]:.2f}", f"{k}: {POINT_NAMES[k]}"))
    return _page(panels, len(points), "seen in the render")


@partial(jax.jit, static_argnames=("side",))
def _face_in_box(
    scene: DeepScene,
    view: DeepView,
    parameters: FaceParameters,
    box: CropBox,
    side: int,
) -> tuple[Float[jax.Array, "s s 3"], Float[jax.Array, "s s"]]:
    """The face inside of a square of a view's picture, its colours times its coverage, and the coverage.

    What hides the face is left out: there the photo stays.
    """
    camera = CropCamera(view.camera, box, jnp.float32(side))
    seen = render(
        view_vertices(scene.model, view, parameters), scene.model.render.topology, camera, scene.albedo, view.light,
        jnp.zeros(3), size=(side, side), samples=SAMPLES,
    )  # fmt: skip
    if scene.cover is None:
        return seen.color, seen.coverage
    worn = in_view(cover_vertices(scene.cover, scene.model.render, parameters), view)
    _, hidden = covered(seen, scene.cover, worn, camera, view.light, size=(side, side))
    return seen.color * ~hidden[..., None], seen.coverage * ~hidden


def _check(solution: DeepSolution, view: int) -> None:
    if not 0 <= view < len(solution.views):
        raise InputError(f"This solve has {len(solution.views)} views, counted from 0; got view {view}.")


def _looks(solution: DeepSolution) -> bool:
    """Whether the network saw any render."""
    return any(look is not None for result in solution.results for look in result.prediction.looks)


def _note(result: StageResult) -> str:
    steps = f"{result.iterations} step" + ("s" if result.iterations != 1 else "")
    return f"{steps}   E {_short(result.path[0].energies.sum())} \u2192 {_short(result.energies.sum())}"


def _short(value: float) -> str:
    """Three digits, large numbers in full."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def _square(stages: Sequence[Float[np.ndarray, "68 2"]], target: Float[np.ndarray, "68 2"] | None) -> CropBox:
    """The square of the picture that holds the photo's face and, as far as that is sensible, every stage's."""
    face = stages[-1] if target is None else target
    everything = np.concatenate([face, *(points for points in stages if np.isfinite(points).all())])
    size = float(max(np.max(np.ptp(face, axis=0)), 1.0))
    wanted = 1.15 * float(np.max(np.ptp(everything, axis=0)))
    side = float(np.clip(wanted, FACES_ACROSS * size, MOST_FACES_ACROSS * size))
    whole = (everything.min(axis=0) + everything.max(axis=0)) / 2.0
    # Landmarks end at the brows, so the middle of the face lies above the middle of their box.
    own = (face.min(axis=0) + face.max(axis=0)) / 2.0 - np.array([0.0, 0.12 * size])
    room = np.maximum(0.0, (side - FACES_ACROSS * size) / 2.0)
    return CropBox(own + np.clip(whole - own, -room, room), np.float64(side), np.float64(0.0))


def _in_panel(points: Float[np.ndarray, "*n 2"], box: CropBox, side: int = PANEL) -> Float[np.ndarray, "*n 2"]:
    """The picture's pixels as those of a panel that shows an upright box."""
    return ((points - np.asarray(box.centre)) / float(box.side) + 0.5) * side - 0.5


def _cut(picture: UInt8[np.ndarray, "h w 3"], box: CropBox, side: int) -> UInt8[np.ndarray, "s s 3"]:
    """The picture inside of an upright box; large ones are averaged, so that they do not flicker."""
    finer = int(np.clip(np.ceil(float(box.side) / side), 1, 16))
    scale = finer * side / float(box.side)
    offset = _in_panel(np.zeros(2), box, finer * side)
    matrix = np.array([[scale, 0.0, offset[0]], [0.0, scale, offset[1]]])
    method = cv2.INTER_CUBIC if finer == 1 else cv2.INTER_LINEAR
    shown = cv2.warpAffine(picture, matrix, (finer * side,) * 2, flags=method, borderValue=OUTSIDE)
    return cv2.resize(shown, (side, side), interpolation=cv2.INTER_AREA)


def _blended(photo, over, coverage, share: float) -> UInt8[np.ndarray, "s s 3"]:
    """The render over the photo; `over` is already times its coverage."""
    rest = 1.0 - share * np.clip(coverage, 0.0, 1.0)[..., None]
    return np.rint(np.clip(rest * photo + 255.0 * share * over, 0.0, 255.0)).astype(np.uint8)


def _fixed(point: Float[np.ndarray, "2"]) -> tuple[int, int]:
    """OpenCV's coordinates in sixteenths of a pixel; those far outside would overflow them."""
    x, y = np.rint(np.clip(np.nan_to_num(point, nan=-1e4), -1e4, 1e4) * (1 << SHIFT)).astype(int).tolist()
    return x, y


def _ring(canvas, point, color) -> None:
    cv2.circle(canvas, _fixed(point), 3 << SHIFT, color, 1, cv2.LINE_AA, SHIFT)


def _draw_pairs(canvas, rendered: Float[np.ndarray, "n 2"], photo: Float[np.ndarray, "n 2"] | None) -> None:
    if photo is not None:
        for start, end in zip(rendered, photo, strict=True):
            cv2.line(canvas, _fixed(start), _fixed(end), APART, 1, cv2.LINE_AA, SHIFT)
        for point in photo:
            _ring(canvas, point, SEEN_IN_PHOTO)
    for point in rendered:
        cv2.circle(canvas, _fixed(point), 2 << SHIFT, SEEN_IN_RENDER, -1, cv2.LINE_AA, SHIFT)


def _heat_panel(colors, heat, crop: CropBox, window: CropBox) -> UInt8[np.ndarray, "s s 3"]:
    """One landmark's map over the grey picture that it was found in, both taken from the crop to the window."""
    shown = []
    high = np.exp(BETA * (heat - heat.max()))
    for values in (np.asarray(colors, np.float32), np.sqrt(high).astype(np.float32)):
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) * (len(values) - 1)
        places = _in_panel(np.asarray(to_picture(corners, crop, len(values))), window, HEAT_PANEL)
        matrix = cv2.getAffineTransform(corners.astype(np.float32), places.astype(np.float32))
        shown.append(cv2.warpAffine(values, matrix, (HEAT_PANEL,) * 2, flags=cv2.INTER_LINEAR))
    grey = np.repeat(cv2.cvtColor(shown[0], cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2)
    share = 0.85 * np.clip(shown[1], 0.0, 1.0)[..., None]
    mixed = (1.0 - share) * grey + share * np.array(HEAT) / 255.0
    return np.rint(255.0 * np.clip(mixed, 0.0, 1.0)).astype(np.uint8)


def _panel(drawn: UInt8[np.ndarray, "s s 3"], title: str, note: str, color=PALE) -> UInt8[np.ndarray, "ps s 3"]:
    """A picture with two lines of text below."""
    caption = np.full((CAPTION, drawn.shape[1], 3), INK, np.uint8)
    for line, (text, shade, size) in enumerate(((title, PAPER, 14), (note, color, 12))):
        write_text(caption, text, (4, 16 + 17 * line), shade, fitting_size(text, size, drawn.shape[1] - 8))
    return np.concatenate([drawn, caption])


def _page(panels: Sequence[UInt8[np.ndarray, "ph pw 3"]], columns: int, green: str) -> UInt8[np.ndarray, "h w 3"]:
    """The panels in rows, and the meaning of the marks below."""
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    height, width = panels[0].shape[:2]
    page = np.full((rows * (height + GAP) + GAP + FOOTER, columns * (width + GAP) + GAP, 3), INK, np.uint8)
    for k, panel in enumerate(panels):
        row, column = divmod(k, columns)
        top, left = GAP + row * (height + GAP), GAP + column * (width + GAP)
        page[top : top + height, left : left + width] = panel
    x, y = 2 * GAP, len(page) - FOOTER // 2 - GAP // 2
    for text, color in ((green, SEEN_IN_RENDER), ("seen in the photo", SEEN_IN_PHOTO), ("difference", APART)):
        place, shift = np.array([x + 4.0, y]), np.array([5.0, 0.0])
        if color == APART:
            cv2.line(page, _fixed(place - shift), _fixed(place + shift), APART, 2, cv2.LINE_AA, SHIFT)
        elif color == SEEN_IN_PHOTO:
            _ring(page, place, color)
        else:
            cv2.circle(page, _fixed(place), 2 << SHIFT, color, -1, cv2.LINE_AA, SHIFT)
        write_text(page, text, (x + 14, y + 4), PAPER, 13)
        x += 14 + text_width(text, 13) + 24
    return page
