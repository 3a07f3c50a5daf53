"""How the sample clips look: the plain head's skin and sweater, the room, the light, and the camera's flaws."""

import cv2
import numpy as np

from workbench.face.model import FaceModel
from workbench.frames import read_picture
from workbench.geometry import Camera
from workbench.pictures import Light, Lighting
from workbench.pictures.mesh import to_pixels
from workbench.samples import sample

SEED = 7
NOISE_LEVELS = 1.6
"""Standard deviation of the camera's noise in grey levels."""
WET_REGIONS = ("eyeL", "eyeR", "teethU", "teethL", "tongue")
SKIN_GAIN = np.array([0.86, 0.75, 0.67])
SKIN_GAMMA = 1.12
SWEATER = np.array([58.0, 74.0, 92.0])

DAY = Lighting(
    lights=(
        Light((-0.8, -0.5, -0.9), 0.78, (1.0, 0.95, 0.86)),
        Light((0.9, 0.0, -0.7), 0.34, (0.80, 0.88, 1.0)),
        Light((0.6, -0.6, 0.8), 0.35, (1.0, 0.93, 0.85)),
    ),
    ambient=0.32,
)
EVENING = Lighting(
    lights=(
        Light((-0.8, -0.5, -0.9), 0.22, (1.0, 0.86, 0.70)),
        Light((0.8, -0.2, -0.9), 0.80, (0.74, 0.85, 1.0)),
        Light((-0.6, -0.6, 0.8), 0.28, (1.0, 0.80, 0.60)),
    ),
    ambient=0.25,
)


def albedo_of_person(model: FaceModel) -> np.ndarray:
    """The bundled texture with a darker skin; eyes, teeth and tongue keep their colours."""
    albedo = read_picture(sample("head-texture"))
    height, width = albedo.shape[:2]
    wet = np.zeros(len(model.neutral), bool)
    for name in WET_REGIONS:
        wet[model.regions[name]] = True
    keep = np.zeros((height, width), np.uint8)
    corners = model.uv[model.triangles_uv[wet[model.triangles].all(1)]]
    pixels = np.stack([corners[..., 0] * width - 0.5, (1 - corners[..., 1]) * height - 0.5], axis=-1)
    cv2.fillPoly(keep, list(np.round(pixels).astype(np.int32)), 255)
    keep = cv2.dilate(keep, np.ones((3, 3), np.uint8))[..., None] / 255.0
    skin = 255 * (albedo / 255.0) ** SKIN_GAMMA * SKIN_GAIN
    return np.clip(keep * albedo + (1 - keep) * skin, 0, 255).astype(np.uint8)


class Stage:
    """Room, clothes, light and camera around the rendered head."""

    def __init__(self, size: tuple[int, int], camera: Camera, sweater: bool) -> None:
        self.size, self.camera, self.sweater = size, camera, sweater
        self.rng = np.random.default_rng(SEED)
        self.room = _room(size, np.random.default_rng(SEED))
        self.knit = _knit(size)
        width, height = size
        x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
        self.vignette = (1 - 0.16 * (x * x + y * y))[..., None]

    def lighting(self, light: float) -> Lighting:
        """Between day (0) and evening (1)."""
        lights = [
            Light(_mix(a.direction, b.direction, light), _mix((a.intensity,), (b.intensity,), light)[0],
                  _mix(a.color, b.color, light))
            for a, b in zip(DAY.lights, EVENING.lights, strict=True)
        ]  # fmt: skip
        return Lighting(tuple(lights), _mix((DAY.ambient,), (EVENING.ambient,), light)[0])

    def compose(self, head: np.ndarray, mask: np.ndarray, light: float, translation: np.ndarray) -> np.ndarray:
        """The frame: room, sweater behind, head (on black, with its coverage), sweater in front, lens and noise."""
        tint = (1 - light) + light * np.array([0.66, 0.72, 0.88])
        neck = self._neck(translation)
        picture = self.room * tint
        if self.sweater:
            picture = self._over(picture, *self._sweater(neck, light, front=False))
        picture = head + picture * (1 - mask[..., None] / 255.0)
        if self.sweater:
            picture = self._over(picture, *self._sweater(neck, light, front=True))
        picture = cv2.GaussianBlur(picture * self.vignette, (0, 0), 0.7)
        grain = cv2.GaussianBlur(self.rng.normal(0, 1, (*picture.shape[:2], 3)), (0, 0), 0.6) * 2.0
        return np.clip(picture + NOISE_LEVELS * grain, 0, 255).astype(np.uint8)

    def _neck(self, translation: np.ndarray) -> np.ndarray:
        """Where the neck enters the sweater; the body follows the head only in part. Pixels x, y and pixels a mm."""
        base = np.array([0.6 * translation[0], 0.5 * translation[1] + 142.0, translation[2] + 60.0])
        x, y = to_pixels(self.camera, base[None])[0]
        return np.array([x, y, float(self.camera.focal_px[0]) / base[2]])

    def _sweater(self, neck: np.ndarray, light: float, front: bool) -> tuple[np.ndarray, np.ndarray]:
        """Colour and coverage of the part behind (collar's back, shoulders) or in front of the neck."""
        x, y, scale = neck
        width, height = self.size
        cover = np.zeros((height, width), np.uint8)
        angles = np.linspace(0, np.pi, 40)
        rim = np.stack([x - 66 * scale * np.cos(angles), y + (24 if front else -20) * scale * np.sin(angles)], axis=1)
        shoulders = np.array([[66, 0], [92, 6], [140, 22], [190, 48], [240, 110], [250, 400],
                              [-250, 400], [-240, 110], [-190, 48], [-140, 22], [-92, 6], [-66, 0]])  # fmt: skip
        outline = np.concatenate([rim, shoulders * scale + [x, y]])
        cv2.fillPoly(cover, [np.round(outline * 16).astype(np.int32)], 255, cv2.LINE_AA, 4)
        rows, columns = np.mgrid[0:height, 0:width]
        side = (columns - x) / (250 * scale)
        shade = (1 - light) * (0.92 - 0.34 * side) + light * (0.62 + 0.30 * side)
        # Darker where the cloth turns away: inside the collar and at its rim.
        distance = cv2.distanceTransform((cover > 127).astype(np.uint8), cv2.DIST_L2, 3)
        shade = shade * (0.55 + 0.45 * np.clip(distance / (14 * scale), 0, 1))
        band = np.exp(-(((distance - 13 * scale) / (1.2 * scale)) ** 2)) * (rows < y + 40 * scale)
        shade = shade * (1 - 0.25 * band) * (1.0 if front else 0.45) * self.knit
        tint = (1 - light) * np.array([1.0, 0.96, 0.90]) + light * np.array([0.85, 0.95, 1.1])
        return shade[..., None] * SWEATER * tint * 1.15, cv2.GaussianBlur(cover, (0, 0), 0.8)[..., None] / 255.0

    @staticmethod
    def _over(picture: np.ndarray, color: np.ndarray, cover: np.ndarray) -> np.ndarray:
        return picture * (1 - cover) + color * cover


def _mix(first: tuple[float, ...], second: tuple[float, ...], share: float) -> tuple[float, ...]:
    return tuple(float((1 - share) * a + share * b) for a, b in zip(first, second, strict=True))


def _room(size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """A living room out of focus: wall, window with daylight, shelf with books, plant, lamp."""
    width, height = size
    x, y = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
    room = np.array([168.0, 152, 134]) * (1.05 - 0.35 * x - 0.15 * y)[..., None]
    window = np.array([[0.02, 0.05], [0.25, 0.05], [0.25, 0.62], [0.02, 0.62]])
    _fill(room, window, (226, 234, 240))
    _fill(room, window * [1, 0.5] + [0, 0.31], (190, 206, 180))
    for bar in (0.125, 0.145), (0.245, 0.26):
        _fill(room, np.array([[bar[0], 0.03], [bar[1], 0.03], [bar[1], 0.64], [bar[0], 0.64]]), (150, 138, 124))
    _fill(room, np.array([[0.0, 0.62], [0.28, 0.62], [0.28, 0.66], [0.0, 0.66]]), (196, 184, 168))
    for shelf in (0.30, 0.56, 0.82):
        _books(room, shelf, rng)
        _fill(room, np.array([[0.68, shelf], [1.0, shelf], [1.0, shelf + 0.025], [0.68, shelf + 0.025]]), (92, 66, 48))
    _fill(room, np.array([[0.67, 0.03], [0.685, 0.03], [0.685, 1.0], [0.67, 1.0]]), (84, 60, 44))
    for _ in range(70):
        leaf = np.array([0.33, 0.62]) + rng.normal(0, [0.045, 0.1])
        color = np.array([62, 96, 58]) + rng.normal(0, 14, 3)
        centre = (round(leaf[0] * width), round(leaf[1] * height))
        cv2.ellipse(room, centre, (20, 6), rng.uniform(0, 180), 0, 360, color.tolist(), -1, cv2.LINE_AA)
    room = cv2.GaussianBlur(room, (0, 0), 9)
    lamp = np.exp(-(((x - 0.60) / 0.07) ** 2 + ((y - 0.16) / 0.09) ** 2))[..., None]
    return np.clip(room + lamp * np.array([70.0, 56, 34]), 0, 255)


def _fill(room: np.ndarray, polygon: np.ndarray, color: tuple[int, int, int]) -> None:
    height, width = room.shape[:2]
    cv2.fillPoly(room, [np.round(polygon * [width, height]).astype(np.int32)], color)


def _books(room: np.ndarray, shelf: float, rng: np.random.Generator) -> None:
    left = 0.69
    while left < 0.99:
        thick, tall = rng.uniform(0.012, 0.032), rng.uniform(0.12, 0.2)
        color = tuple((rng.uniform(0.35, 1.0) * rng.uniform(40, 190, 3)).tolist())
        top = shelf - tall
        _fill(room, np.array([[left, top], [left + thick, top], [left + thick, shelf], [left, shelf]]), color)
        left += thick + 0.002


def _knit(size: tuple[int, int]) -> np.ndarray:
    """Fine ribs of the cloth."""
    width, height = size
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    return 1 + 0.05 * np.sin(columns * 1.15) + 0.03 * np.sin(rows * 0.9 + columns * 0.1)
