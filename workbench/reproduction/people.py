"""Simulated people before a camera: films whose every parameter is known.

They are painted by another renderer (VTK, with a skin texture, hair and shine) than the energies' own, on a still
background, with a camera's noise and the losses of JPEG.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.geometry import Camera
from workbench.pictures.extras import ColoredMesh, Extras
from workbench.pictures.gl_probe import gl_available
from workbench.pictures.head_scene import HeadScene
from workbench.pictures.lighting import Lighting
from workbench.pictures.mesh import to_camera
from workbench.training.accessories import hair
from workbench.training.scenes import random_lighting
from workbench.training.skin import skin_painter

IDENTITY_SPREAD = 0.8
"""Standard deviation of the identity coefficients, in those of the model."""
JPEG_QUALITY = 88
NOISE = 0.012
"""Standard deviation of the camera's noise; 1 is white."""
BLUR_PX = 0.6


@dataclass(frozen=True, eq=False)
class SimulatedPerson:
    """One person in a place of their own."""

    identity: Float[np.ndarray, "i"]
    model: FaceModel
    """The head model in this person's shape."""
    albedo: UInt8[np.ndarray, "a a 3"]
    hair: ColoredMesh
    shine: tuple[float, float]
    """Strength and exponent of the skin's highlight."""
    lighting: Lighting
    background: Float[np.ndarray, "h w 3"]


@dataclass(frozen=True, eq=False)
class Motion:
    """What a person does, a row per frame."""

    rotation: Float[np.ndarray, "n 3"]
    """Head to camera, axis-angle."""
    translation_mm: Float[np.ndarray, "n 3"]
    expression: Float[np.ndarray, "n k"]

    def __len__(self) -> int:
        return len(self.rotation)


class FilmStudio:
    """Films people. Owns a GL context, so it is made and used in one thread; use it in a `with` block."""

    def __init__(self, head: FaceModel, camera: Camera, size: tuple[int, int]):
        """`size`: width and height of the pictures. Raises `InputError` where VTK cannot draw."""
        if not gl_available():
            raise InputError(
                "Simulated people are drawn by OpenGL, which does not work here; install Mesa's drivers (on Debian: "
                "libegl1 and libgl1-mesa-dri) and run again."
            )
        self.head, self.size = head, size
        self.camera = Camera(*(np.asarray(part, float) for part in camera))
        self._painter = skin_painter(head)
        self._scene = HeadScene(head, size, np.full((8, 8, 3), 255, np.uint8), supersampling=1.6, fade_neck=False)

    def __enter__(self) -> "FilmStudio":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Give the GL context back."""
        self._scene.close()

    def person(self, rng: np.random.Generator) -> SimulatedPerson:
        """A random person, light and background."""
        identity = rng.normal(0.0, IDENTITY_SPREAD, len(self.head.identity_deltas))
        person = self.head.personal(identity)
        albedo, hair_color = self._painter.paint(rng)
        mesh = hair(person.neutral, self.head, hair_color, rng)
        shine = (rng.uniform(0.0, 0.2), rng.uniform(6, 40))
        lighting = random_lighting(rng)
        coarse = rng.uniform(0.1, 0.9, (5, 7, 3)).astype(np.float32)
        background = cv2.resize(coarse, self.size, interpolation=cv2.INTER_CUBIC).clip(0.0, 1.0)
        return SimulatedPerson(identity, person, albedo, mesh, shine, lighting, background)

    def film(
        self, who: SimulatedPerson, motion: Motion, rng: np.random.Generator
    ) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
        """The pictures of a motion, one after the other; `rng` makes the noise."""
        self._scene.set_texture(who.albedo)
        self._scene.set_shine(*who.shine)
        extras = Extras(meshes=(who.hair,))
        for rotation, place, expression in zip(motion.rotation, motion.translation_mm, motion.expression, strict=True):
            points = to_camera(who.model.vertices(expression), rotation, place)
            rgba = self._scene.render(points, self.camera, who.lighting, extras, (rotation, place))
            yield _photo(rgba, who.background, rng)


def _photo(
    rgba: UInt8[np.ndarray, "h w 4"], background: Float[np.ndarray, "h w 3"], rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """A render before a background as a camera would store it."""
    seen = rgba[..., :3] / 255.0 + (1.0 - rgba[..., 3:] / 255.0) * background
    seen = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), BLUR_PX) + rng.normal(0.0, NOISE, seen.shape)
    pixels = np.round(255.0 * np.clip(seen, 0.0, 1.0)).astype(np.uint8)
    _, stored = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return cv2.imdecode(stored, cv2.IMREAD_COLOR_RGB)
