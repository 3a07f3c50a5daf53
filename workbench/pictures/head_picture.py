"""Pictures of a head: off-screen VTK where GL works, else the plain painter, which says so."""

from concurrent.futures import Future
from dataclasses import replace
from functools import lru_cache
from types import TracebackType
from typing import Protocol

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import InputError, MissingDependencyError, WorkbenchError
from workbench.face.dressed_head import DressedHead
from workbench.face.model import FaceModel
from workbench.frames import read_picture
from workbench.geometry import Camera
from workbench.pictures.background import background_picture, composite
from workbench.pictures.extras import GHOST_COLOR, NOTHING, SEGMENT_MM, Extras, outer_triangles
from workbench.pictures.gl_probe import gl_available
from workbench.pictures.lighting import STUDIO, Lighting
from workbench.pictures.mesh import check_scene, to_camera, to_pixels
from workbench.pictures.neck import bent, neck_of
from workbench.pictures.outline import paint_outline
from workbench.pictures.render_thread import RenderThread
from workbench.pictures.wireframe import draw_wireframe
from workbench.samples import sample

LARGEST_PX = 8192
PORTRAIT_MARGIN = 1.2
"""Height of a portrait in heights of the head from chin to crown."""
NO_GL_NOTE = (
    "3D pictures are drawn without GL (flat shading, no texture): install libegl1 and libgl1-mesa-dri, "
    "or libosmesa6, and restart."
)

Background = UInt8[np.ndarray, "h w 3"] | tuple[int, int, int] | None


class HeadPainter(Protocol):
    """Something that draws one model at one size; calls may come from any thread."""

    size: tuple[int, int]
    note: str | None
    """What the user should know about the quality of the pictures."""

    def render(
        self, vertices: np.ndarray, camera: Camera, rotation: np.ndarray, translation: np.ndarray,
        background: Background = None, lighting: Lighting = STUDIO, extras: Extras = NOTHING,
    ) -> np.ndarray: ...  # fmt: skip

    def submit(
        self, vertices: np.ndarray, camera: Camera, rotation: np.ndarray, translation: np.ndarray,
        background: Background = None, lighting: Lighting = STUDIO, extras: Extras = NOTHING,
    ) -> Future: ...  # fmt: skip

    def close(self) -> None: ...

    def __enter__(self) -> "HeadPainter": ...

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None: ...


class HeadRenderer:
    """Off-screen renderer of one model at one picture size (width, height).

    All VTK work happens in a private thread, so calls may come from any thread. `texture` True takes the bundled
    albedo for the default head and the vertex colours for other models, False the vertex colours, and an RGB picture
    is used through the model's UVs. `supersampling` (1 to 4) renders larger and reduces, against jagged edges.
    `fade_neck` lets the open end of the neck fade out, for portraits. `dressed` draws a character: its skin is the
    texture, and what it wears follows the vertices; `model` is then the default head, or a person of it.
    Raises `MissingDependencyError` without usable GL, `InputError` for a size outside 1..8192 and for a character on
    another model.
    """

    note = None

    def __init__(
        self,
        model: FaceModel,
        size: tuple[int, int],
        texture: bool | UInt8[np.ndarray, "th tw 3"] = True,
        supersampling: float = 2.0,
        fade_neck: bool = False,
        dressed: DressedHead | None = None,
    ) -> None:
        _check_size(size)
        if dressed is not None and len(model.neutral) != len(dressed.model.neutral):
            raise InputError(
                f"Characters are for the default head with {len(dressed.model.neutral)} vertices, "
                f"got a model with {len(model.neutral)}; draw that one without a character."
            )
        self._supersampling = supersampling
        drawn = self._drawn_larger(size)
        if not gl_available():
            raise MissingDependencyError(
                "The 3D renderer needs OpenGL without a screen, and VTK cannot use it here; "
                "install libegl1 and libgl1-mesa-dri, or use draw_wireframe."
            )
        self.size = size
        self._rest, self._dressed = model.neutral, dressed
        albedo = _albedo(model, texture if dressed is None else dressed.skin)
        self._thread = RenderThread(
            lambda: _make_scene(model, size, albedo, drawn, fade_neck, dressed), lambda scene: scene.close()
        )

    def render(
        self,
        vertices: Float[np.ndarray, "v 3"],
        camera: Camera,
        rotation: Float[np.ndarray, "3"],
        translation: Float[np.ndarray, "3"],
        background: Background = None,
        lighting: Lighting = STUDIO,
        extras: Extras = NOTHING,
    ) -> UInt8[np.ndarray, "h w 3"]:
        """RGB picture of head-frame `vertices` (millimetres) in this pose, seen by `camera` (of a picture of `size`).

        `rotation` is axis-angle, head to camera; `background` an RGB colour, a picture of the same size, or None for
        a plain dark one. Raises `InputError` for a wrong number of vertices and for numbers that are not finite.
        """
        return self.submit(vertices, camera, rotation, translation, background, lighting, extras).result()[0]

    def render_with_mask(
        self,
        vertices: Float[np.ndarray, "v 3"],
        camera: Camera,
        rotation: Float[np.ndarray, "3"],
        translation: Float[np.ndarray, "3"],
        background: Background = None,
        lighting: Lighting = STUDIO,
        extras: Extras = NOTHING,
    ) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w"]]:
        """As `render`, with the head's coverage of each pixel, 0 to 255."""
        return self.submit(vertices, camera, rotation, translation, background, lighting, extras).result()

    def submit(
        self,
        vertices: Float[np.ndarray, "v 3"],
        camera: Camera,
        rotation: Float[np.ndarray, "3"],
        translation: Float[np.ndarray, "3"],
        background: Background = None,
        lighting: Lighting = STUDIO,
        extras: Extras = NOTHING,
    ) -> Future:
        """As `render_with_mask`, without waiting: a future of (picture, mask)."""
        if not self._thread.running:
            raise WorkbenchError("This head renderer has been closed; make a new one.")
        check_scene(vertices, len(self._rest), rotation, translation, camera)
        behind = background_picture(background, self.size)
        shown, worn = self._dressed_points(vertices, rotation, extras)
        points_camera = to_camera(shown, rotation, translation)
        worn_camera = [to_camera(points, rotation, translation) for points in worn]
        pose = (rotation, translation)
        return self._thread.submit(_draw, points_camera, camera, lighting, behind, extras, pose, worn_camera)

    def _dressed_points(
        self, vertices: np.ndarray, rotation: np.ndarray, extras: Extras
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """The head's vertices and those of each worn part, the neck bent to the body; head frame."""
        if self._dressed is None:
            return vertices, ()
        rest = self._rest if extras.rest is None else extras.rest
        worn = self._dressed.parts_on(rest, vertices)
        if extras.body is None:
            return vertices, worn
        turns = (neck_of(self._dressed.model, rest), rotation, extras.body)
        parts = zip(self._dressed.worn, worn, strict=True)
        turned = tuple(bent(points, points[:, 1], *turns) if part.part.still else points for part, points in parts)
        return bent(vertices, rest[:, 1], *turns), turned

    def resize(self, size: tuple[int, int]) -> None:
        """Draw pictures of another size (width, height) from now on."""
        _check_size(size)
        self._thread.submit(_resize, size, self._drawn_larger(size))
        self.size = size

    def _drawn_larger(self, size: tuple[int, int]) -> float:
        return min(max(self._supersampling, 1.0), 4.0, max(1.0, LARGEST_PX / max(size)))

    def close(self) -> None:
        """End the render thread and free the GL context; closing twice is fine."""
        self._thread.stop()

    def __enter__(self) -> "HeadRenderer":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()


class PlainPainter:
    """`draw_wireframe` with the interface of `HeadRenderer`, for machines without GL."""

    def __init__(self, model: FaceModel, size: tuple[int, int], dressed: DressedHead | None = None) -> None:
        _check_size(size)
        self.model, self.size = model, size
        plain = "" if dressed is None else f" The head is plain: {dressed.character.name} needs GL, too."
        self.note = NO_GL_NOTE + plain

    def render(
        self,
        vertices: Float[np.ndarray, "v 3"],
        camera: Camera,
        rotation: Float[np.ndarray, "3"],
        translation: Float[np.ndarray, "3"],
        background: Background = None,
        lighting: Lighting = STUDIO,
        extras: Extras = NOTHING,
    ) -> UInt8[np.ndarray, "h w 3"]:
        """As `HeadRenderer.render`."""
        return self._draw(vertices, camera, rotation, translation, background, lighting, extras)[0]

    def submit(
        self,
        vertices: Float[np.ndarray, "v 3"],
        camera: Camera,
        rotation: Float[np.ndarray, "3"],
        translation: Float[np.ndarray, "3"],
        background: Background = None,
        lighting: Lighting = STUDIO,
        extras: Extras = NOTHING,
    ) -> Future:
        """As `HeadRenderer.submit`; the future is already done."""
        future: Future = Future()
        future.set_result(self._draw(vertices, camera, rotation, translation, background, lighting, extras))
        return future

    def resize(self, size: tuple[int, int]) -> None:
        """Draw pictures of another size (width, height) from now on."""
        _check_size(size)
        self.size = size

    def close(self) -> None:
        """Nothing to free."""

    def _draw(self, vertices, camera, rotation, translation, background, lighting, extras: Extras):
        model = self.model if extras.colors is None else replace(self.model, colors=extras.colors)
        picture, mask = draw_wireframe(model, self.size, vertices, camera, rotation, translation, background, lighting)
        view = (camera, rotation, translation)
        if extras.ghost is not None and not extras.ghost_outline:
            ghost = draw_wireframe(_ghost_model(self.model), self.size, extras.ghost, *view, picture, lighting)[0]
            picture = cv2.addWeighted(ghost, extras.ghost_opacity, picture, 1.0 - extras.ghost_opacity, 0.0)
        _paint_marks(picture, extras, camera, rotation, translation)
        _paint_outline(picture, extras, outer_triangles(self.model), *view)
        return picture, mask

    def __enter__(self) -> "PlainPainter":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()


def head_painter(
    model: FaceModel,
    size: tuple[int, int],
    texture: bool | UInt8[np.ndarray, "th tw 3"] = True,
    supersampling: float = 2.0,
    fade_neck: bool = False,
    dressed: DressedHead | None = None,
) -> HeadRenderer | PlainPainter:
    """The best way to draw this model here; `.note` says what is missing, None if nothing is."""
    if not gl_available():
        return PlainPainter(model, size, dressed)
    return HeadRenderer(model, size, texture, supersampling, fade_neck, dressed)


def picture_of_head(
    model: FaceModel,
    size: tuple[int, int],
    vertices: Float[np.ndarray, "v 3"],
    camera: Camera,
    rotation: Float[np.ndarray, "3"],
    translation: Float[np.ndarray, "3"],
    background: Background = None,
    texture: bool | UInt8[np.ndarray, "th tw 3"] = True,
    lighting: Lighting = STUDIO,
    fade_neck: bool = False,
    dressed: DressedHead | None = None,
) -> tuple[UInt8[np.ndarray, "h w 3"], str | None]:
    """One picture as `HeadRenderer.render`, with a note where it had to be drawn without GL (else None)."""
    with head_painter(model, size, texture, fade_neck=fade_neck, dressed=dressed) as painter:
        return painter.render(vertices, camera, rotation, translation, background, lighting), painter.note


def portrait_view(
    model: FaceModel, size: tuple[int, int], distance_mm: float = 900.0
) -> tuple[Camera, Float[np.ndarray, "3"]]:
    """Camera and translation that show the head in a picture (width, height), cut at the neck as in a portrait."""
    top = float(model.neutral[:, 1].min())
    chin = float(model.landmarks.of(model.neutral)[8, 1])
    radius = PORTRAIT_MARGIN * (chin - top) / 2
    translation = np.array([0.0, -(top + chin) / 2 - 0.03 * radius, distance_mm])
    focal = 0.5 * min(size) * distance_mm / radius
    return Camera(np.full(2, focal), np.array([(size[0] - 1) / 2, (size[1] - 1) / 2]), np.zeros(8)), translation


def bundled_texture(model: FaceModel) -> UInt8[np.ndarray, "h w 3"] | None:
    """The albedo picture of the default head, None for other models."""
    return _bundled_albedo() if model.name == "default-head" and len(model.uv) else None


def _make_scene(
    model: FaceModel,
    size: tuple[int, int],
    albedo: np.ndarray | None,
    supersampling: float,
    fade_neck: bool,
    dressed: DressedHead | None,
):
    # VTK is imported in the thread that uses it, and only where GL has been found to work.
    from workbench.pictures.head_scene import HeadScene

    return HeadScene(model, size, albedo, supersampling, fade_neck, dressed)


def _draw(scene, points_camera, camera: Camera, lighting: Lighting, behind: np.ndarray, extras: Extras, pose, worn):
    rgba = scene.render(points_camera, camera, lighting, extras, pose, worn)
    picture = composite(rgba, behind)
    _paint_outline(picture, extras, scene.outer_triangles, camera, *pose)
    return picture, rgba[..., 3].copy()


def _resize(scene, size: tuple[int, int], supersampling: float) -> None:
    scene.resize(size, supersampling)


def _check_size(size: tuple[int, int]) -> None:
    if not all(1 <= side <= LARGEST_PX for side in size):
        raise InputError(f"A picture of a head has sides of 1 to {LARGEST_PX} pixels, got {size[0]} × {size[1]}.")


def _ghost_model(model: FaceModel) -> FaceModel:
    colors = np.tile(np.array(GHOST_COLOR, np.uint8), (len(model.neutral), 1))
    triangles = outer_triangles(model)
    return replace(model, triangles=triangles, triangles_uv=triangles, colors=colors)


def _paint_marks(picture: UInt8[np.ndarray, "h w 3"], extras: Extras, camera: Camera, rotation, translation) -> None:
    """Points and segments over the head, also those that it hides: painting knows no depth."""
    marks = []
    if extras.segments is not None:
        marks += list(zip(extras.segments, extras.segment_colors, [SEGMENT_MM] * len(extras.segments), strict=True))
    if extras.points is not None:
        points = np.repeat(extras.points[:, None], 2, axis=1)
        marks += list(zip(points, extras.point_colors, [extras.point_mm] * len(points), strict=True))
    for ends_head, color, thickness_mm in marks:
        ends = to_camera(ends_head, rotation, translation)
        pixels = np.rint(to_pixels(camera, ends)) if ends[:, 2].min() > 1.0 else np.full((2, 2), np.inf)
        if np.abs(pixels).max() < 30_000:
            width = max(1, round(thickness_mm * float(camera.focal_px[0]) / ends[0, 2]))
            (x0, y0), (x1, y1) = pixels.astype(int).tolist()
            cv2.line(picture, (x0, y0), (x1, y1), color.tolist(), width, cv2.LINE_AA)


def _paint_outline(
    picture: np.ndarray, extras: Extras, triangles: np.ndarray, camera: Camera, *pose: np.ndarray
) -> None:
    if extras.ghost is not None and extras.ghost_outline:
        paint_outline(picture, to_camera(extras.ghost, *pose), triangles, camera)


def _albedo(model: FaceModel, texture: bool | np.ndarray) -> np.ndarray | None:
    if texture is False or len(model.uv) == 0:
        return None
    return bundled_texture(model) if texture is True else texture


@lru_cache(maxsize=1)
def _bundled_albedo() -> np.ndarray | None:
    path = sample("head-texture")
    return read_picture(path) if path.is_file() else None
