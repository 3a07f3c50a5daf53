"""Random faces of skin: albedo pictures painted in the head's UV layout from the bundled one."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Integer, UInt8

from workbench.face.model import Embedding, FaceModel
from workbench.frames import read_picture
from workbench.samples import sample

SIDE = 512
"""Pixels of the painted albedo; a face covers about 250 of them."""
WET_REGIONS = ("eyeL", "eyeR", "teethU", "teethL", "tongue", "mouth_cavity")
SKIN_TONES = np.array(
    [
        [246, 214, 196], [238, 200, 176], [226, 182, 152], [208, 160, 128], [190, 140, 106],
        [160, 110, 80], [128, 84, 60], [98, 64, 46], [72, 46, 36], [52, 35, 29],
    ],
    float,
)  # fmt: skip
"""From very light to very dark, sRGB; mixtures of neighbours are used."""
HAIR_COLORS = np.array(
    [[22, 18, 16], [42, 30, 24], [70, 48, 32], [104, 72, 46], [150, 112, 70], [196, 166, 120], [120, 60, 34],
     [132, 130, 128], [206, 204, 200], [30, 30, 38]],
    float,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class SkinPainter:
    """What the painter knows about the UV layout: masks in 0..1 and the landmarks' places in pixels."""

    base: Float[np.ndarray, "s s 3"]
    """The bundled albedo without hair and brows, 0..1."""
    wet: Float[np.ndarray, "s s"]
    hair: Float[np.ndarray, "s s"]
    lips: Float[np.ndarray, "s s"]
    iris: Float[np.ndarray, "s s"]
    landmarks: Float[np.ndarray, "68 2"]

    def paint(
        self, rng: np.random.Generator, brows: Float[np.ndarray, "10 2"] | None = None
    ) -> tuple[UInt8[np.ndarray, "s s 3"], Float[np.ndarray, "3"]]:
        """A random albedo (sRGB), and the colour of its hair. `brows`: their landmarks' places, if not the head's."""
        tone = _tone(rng)
        hair_color = (HAIR_COLORS[rng.integers(len(HAIR_COLORS))] / 255 * rng.uniform(0.7, 1.25)).astype(np.float32)
        skin = self._skin(rng, tone)
        skin = self._wrinkles(skin, rng)
        skin = self._lips(skin, rng)
        skin = self._makeup(skin, rng, tone)
        skin = self._hair(skin, rng, hair_color)
        if rng.random() < 0.45:
            skin = self._beard(skin, rng, hair_color)
        skin = self._brows(skin, rng, hair_color, brows)
        wet = self._wet(rng)
        picture = self.wet[..., None] * wet + (1 - self.wet[..., None]) * skin
        return np.clip(np.rint(255 * picture), 0, 255).astype(np.uint8), np.clip(hair_color, 0, 1)

    def over_photo(
        self, photo: UInt8[np.ndarray, "s s 3"], rng: np.random.Generator, brows: Float[np.ndarray, "10 2"]
    ) -> tuple[UInt8[np.ndarray, "s s 3"], Float[np.ndarray, "3"], bool]:
        """A photographed albedo with marks, make-up, a beard and roots of hair painted on; the hair's colour; and
        whether brows are painted too. `brows`: the places of their landmarks."""
        skin = photo.astype(np.float32) / 255
        tone = np.median(skin[200:330, 180:332].reshape(-1, 3), axis=0)
        hair_color = (HAIR_COLORS[rng.integers(len(HAIR_COLORS))] / 255 * rng.uniform(0.7, 1.25)).astype(np.float32)
        skin = self._marks(skin, rng, tone)
        if rng.random() < 0.4:
            skin = self._wrinkles(skin, rng)
        if rng.random() < 0.6:
            skin = self._lips(skin, rng)
        if rng.random() < 0.5:
            skin = self._makeup(skin, rng, tone)
        skin = self._hair(skin, rng, hair_color)
        if rng.random() < 0.35:
            skin = self._beard(skin, rng, hair_color)
        browed = rng.random() < 0.45
        if browed:
            skin = self._brows(skin, rng, hair_color, brows)
        picture = self.wet[..., None] * photo / 255 + (1 - self.wet[..., None]) * skin
        albedo = np.clip(np.rint(255 * picture), 0, 255).astype(np.uint8)
        return albedo, np.clip(hair_color, 0, 1), browed

    def _skin(self, rng, tone) -> np.ndarray:
        mean = np.array([0.815, 0.635, 0.525], np.float32)  # of the bundled albedo's skin
        # The bundled colours' own variation (redder ears, nose and cheeks) in ratios, more or less of it.
        ratio = np.clip(self.base / mean, 0.3, 1.5) ** rng.uniform(0.4, 1.8)
        blotches = sum(
            amount * _noise(rng, SIDE, cells)[..., None] * np.array([1.0, *rng.uniform(0.8, 1.3, 2)], np.float32)
            for amount, cells in ((rng.uniform(0, 0.06), 5), (rng.uniform(0, 0.035), 14), (rng.uniform(0, 0.03), 60))
        )
        pores = rng.uniform(0, 0.06) * rng.standard_normal((SIDE, SIDE), np.float32)[..., None]
        skin = tone * ratio * (1 + blotches + cv2.GaussianBlur(pores, (0, 0), 0.7)[..., None] * 2)
        return self._marks(skin, rng, tone)

    def _marks(self, skin, rng, tone) -> np.ndarray:
        """Freckles and moles."""
        if rng.random() < 0.25:  # freckles
            spots = (_noise(rng, SIDE, 110) > rng.uniform(1.6, 2.4)).astype(np.float32)
            skin = skin * (1 - rng.uniform(0.1, 0.35) * cv2.GaussianBlur(spots, (0, 0), 0.8)[..., None])
        for _ in range(rng.poisson(1.0)):  # moles
            centre = rng.uniform([230, 190], [790, 680]) * SIDE / 1024
            _blob(skin, centre, rng.uniform(0.8, 2.2), tone * 0.4, 0.8)
        return skin

    def _wrinkles(self, skin, rng) -> np.ndarray:
        """Lines of age and expression: forehead, between the brows, beside the eyes, from the nose to the mouth."""
        age = rng.beta(1.0, 1.6)
        shade = np.zeros((SIDE, SIDE), np.float32)
        at = self.landmarks
        for wing, corner, inner, outer in ((31, 48, 39, 36), (35, 54, 42, 45)):
            side = np.sign(at[corner, 0] - at[33, 0])
            fold = np.array([at[wing] + [side * 10, -12], at[wing] + [side * 22, 14], at[corner] + [side * 12, -8],
                             at[corner] + [side * 12, rng.uniform(-2, 20)]])  # fmt: skip
            _curve(shade, fold + rng.normal(0, 2, fold.shape), rng.uniform(1, 3), age * rng.uniform(0, 0.5))
            middle = (at[inner] + at[outer]) / 2
            reach = np.abs(at[outer, 0] - middle[0])
            bag = middle + np.array([[-reach, 8], [-reach / 2, 18], [reach / 2, 19], [reach, 6]])
            _curve(shade, bag + rng.normal(0, 2, bag.shape), rng.uniform(2, 5), rng.uniform(0, 0.45) * (0.3 + age))
            for _ in range(3):
                start = at[outer] + [side * rng.uniform(4, 9), rng.uniform(-8, 10)]
                end = start + np.array([side * rng.uniform(12, 26), rng.uniform(-12, 12)])
                _curve(shade, np.array([start, (start + end) / 2 + rng.normal(0, 2, 2), end]), 1.0, age * 0.3)
        middle = at[27]
        for height in np.sort(rng.uniform(-75, -38, 3)):
            width = rng.uniform(40, 110)
            line = middle + np.array(
                [[-width, height + 4], [-width / 3, height], [width / 3, height], [width, height + 4]]
            )
            _curve(shade, line + rng.normal(0, 2.5, line.shape), rng.uniform(1, 2.5), age * rng.uniform(0, 0.4))
        for side in (-1, 1):
            frown = middle + np.array([[side * 9, -8], [side * 10, -24], [side * 7, -36]])
            _curve(shade, frown + rng.normal(0, 2, frown.shape), 1.5, age * rng.uniform(0, 0.4))
        return skin * (1 - np.clip(shade, 0, 0.7))[..., None]

    def _lips(self, skin, rng) -> np.ndarray:
        # From none (the colour of skin) to lipstick.
        kind = rng.random()
        if kind < 0.75:
            color = np.array([rng.uniform(0.75, 1.05), rng.uniform(0.55, 1.0), rng.uniform(0.55, 1.0)], np.float32)
            return skin * (1 - self.lips[..., None] * (1 - color * rng.uniform(0.75, 1.05)))
        color = np.array([rng.uniform(0.35, 0.85), rng.uniform(0.02, 0.4), rng.uniform(0.05, 0.45)], np.float32)
        share = self.lips[..., None] * rng.uniform(0.5, 0.95)
        return skin * (1 - share) + share * color * (0.6 + 0.4 * self.base / self.base.max())

    def _makeup(self, skin, rng, tone) -> np.ndarray:
        at, shade = self.landmarks, np.zeros((SIDE, SIDE), np.float32)
        if rng.random() < 0.6:  # lashes and liner thicken the rim of the lids
            strength, width = rng.uniform(0.2, 0.9), rng.uniform(1, 3.5)
            for rim in ([36, 37, 38, 39], [42, 43, 44, 45]):
                inward = (
                    at[rim] * 0.7 + at[[i + 4 if i in (37, 43) else i + 2 if i in (38, 44) else i for i in rim]] * 0.3
                )
                _curve(shade, inward, width, strength)
            if rng.random() < 0.4:
                for rim in ([36, 41, 40, 39], [42, 47, 46, 45]):
                    _curve(
                        shade, at[rim] * 0.7 + at[[rim[0], rim[0] + 1, rim[0] + 2, rim[3]]] * 0.3, width, strength * 0.7
                    )
        skin = skin * (1 - np.clip(shade, 0, 0.9))[..., None]
        if rng.random() < 0.5:  # deep-set or painted sockets
            mask = np.zeros((SIDE, SIDE), np.float32)
            for eye in (slice(36, 42), slice(42, 48)):
                centre = at[eye].mean(0) - np.array([0, rng.uniform(0, 8)])
                cv2.ellipse(
                    mask, _whole(centre), (round(rng.uniform(18, 30)), round(rng.uniform(12, 26))), 0, 0, 360, 1.0, -1
                )
            share = cv2.GaussianBlur(mask, (0, 0), 7)[..., None] * rng.uniform(0.1, 0.5)
            color = tone * rng.uniform(0.3, 0.8) if rng.random() < 0.7 else rng.uniform(0.1, 0.8, 3).astype(np.float32)
            skin = skin * (1 - share) + share * color
        return skin

    def _hair(self, skin, rng, hair_color) -> np.ndarray:
        """Short hair where the bundled albedo has it, from shaved to dense, with strands."""
        if rng.random() < 0.12:
            return skin
        strands = (
            1 + 0.16 * _noise(rng, SIDE, 90, 12)[..., None] + 0.15 * rng.standard_normal((SIDE, SIDE, 1), np.float32)
        )
        share = self.hair[..., None] * rng.uniform(0.5, 1.0)
        return skin * (1 - share) + share * hair_color * np.clip(strands, 0.3, 1.6)

    def _beard(self, skin, rng, hair_color) -> np.ndarray:
        at, mask = self.landmarks, np.zeros((SIDE, SIDE), np.float32)
        kind = rng.choice(["stubble", "full", "moustache", "goatee", "short"])
        if kind in ("full", "stubble", "short"):
            jaw = at[[2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14]]
            below = jaw + np.array([0, 40])
            cheek = np.array([at[14] * 0.8 + at[54] * 0.2, at[54] + [18, -6], at[54] + [4, -22], at[35] + [4, 8],
                              at[33] + [0, 8], at[31] + [-4, 8], at[48] + [-4, -22], at[48] + [-18, -6],
                              at[2] * 0.8 + at[48] * 0.2])  # fmt: skip
            _fill(mask, np.concatenate([at[[2]], below, at[[14]], cheek]))
        if kind in ("moustache", "goatee"):
            _fill(mask, np.array([at[33] + [0, 8], at[35] + [2, 8], at[54] + [6, 0], at[53], at[51], at[49],
                                  at[48] + [-6, 0], at[31] + [-2, 8]]))  # fmt: skip
        if kind == "goatee":
            _fill(mask, np.array([at[48] + [-4, 0], at[59], at[57] + [0, 3], at[55], at[54] + [4, 0], at[54] + [2, 40],
                                  at[8] + [0, 20], at[48] + [-2, 40]]))  # fmt: skip
        mask = cv2.GaussianBlur(mask, (0, 0), rng.uniform(2, 6)) * (1 - 0.92 * self.lips) * (1 - self.hair)
        density = rng.uniform(0.1, 0.5) if kind == "stubble" else rng.uniform(0.5, 0.98)
        grain = np.clip(1 + 0.6 * rng.standard_normal((SIDE, SIDE), np.float32), 0.1, 2)
        grain = cv2.GaussianBlur(grain, (0, 0), sigmaX=0.6, sigmaY=rng.uniform(0.6, 2.0))
        share = np.clip(mask * density * grain, 0, 1)[..., None]
        color = hair_color * rng.uniform(0.6, 1.2) * (1 + 0.1 * _noise(rng, SIDE, 60)[..., None])
        return skin * (1 - share) + share * color

    def _brows(self, skin, rng, hair_color, line=None) -> np.ndarray:
        line = self.landmarks[17:27] if line is None else line
        layer = np.zeros((SIDE, SIDE), np.float32)
        thick, density = rng.uniform(3, 12), rng.uniform(0.35, 1.0)
        arch, drop = rng.normal(0, 1.5), rng.normal(1.0, 1.2)
        ends = rng.normal(0, 3, 2)
        for brow, sign in ((line[:5], 1), (line[:4:-1], -1)):
            points = brow + np.array([0.0, drop])
            points[2, 1] -= arch
            points[0, 0] += sign * ends[0]
            points[4, 0] += sign * ends[1]
            path = _smooth(points, 64)
            count = int(260 * density) + 40
            along = rng.uniform(0, 1, count)
            body = np.interp(along, [0, 0.25, 0.75, 1.0], [0.25, 0.8, 1.0, 0.75]) * thick
            start = path[(along * 63).astype(int)] + np.stack([np.zeros(count), body * rng.uniform(0.0, 1.0, count)], 1)
            angle = np.radians(np.interp(along, [0, 0.6, 1], [165, 205, 250]) + rng.normal(0, 14, count))
            length = rng.uniform(3, 9, count)
            step = np.stack([np.cos(angle) * sign, np.sin(angle)], 1) * length[:, None]
            for a, b in zip(np.rint(start * 16).astype(int), np.rint((start + step) * 16).astype(int), strict=True):
                cv2.line(layer, tuple(a.tolist()), tuple(b.tolist()), 1.0, 1, cv2.LINE_AA, 4)
        soft = cv2.GaussianBlur(layer, (0, 0), rng.uniform(0.6, 1.4))
        share = np.clip(soft * rng.uniform(0.5, 1.5), 0, 0.97)[..., None] * density**0.5
        color = np.minimum(hair_color * rng.uniform(0.15, 0.85), 0.6)
        return skin * (1 - share) + share * color

    def _wet(self, rng) -> np.ndarray:
        picture = self.base.copy()
        color = np.array(
            [[0.35, 0.22, 0.12], [0.16, 0.1, 0.07], [0.3, 0.42, 0.55], [0.3, 0.4, 0.25], [0.4, 0.42, 0.42]], np.float32
        )
        iris = color[rng.integers(len(color))] * rng.uniform(0.5, 1.3)
        grey = picture.mean(-1, keepdims=True)
        share = self.iris[..., None]
        picture = picture * (1 - share) + share * np.clip(grey / 0.28, 0, 1.6) * iris
        return picture * rng.uniform(0.6, 1.05) * (1 + rng.normal(0, 0.02, 3)).astype(np.float32)


def skin_painter(model: FaceModel) -> SkinPainter:
    """The painter for a model with the default head's UV layout."""
    albedo = cv2.resize(read_picture(sample("head-texture")), (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    wet = np.maximum.reduce([_region(model, name) for name in WET_REGIONS])
    landmarks = landmark_places(model)
    skin = 1 - wet
    # Hair is painted dark; eye rims too, but they lie in the middle of the face.
    dark = (albedo.max(-1) < 120) & (skin > 0.5)
    rows, columns = np.mgrid[0:SIDE, 0:SIDE]
    top, bottom = landmarks[17:27, 1].min() - 12, landmarks[8, 1]
    face = (rows > top) & (rows < bottom) & (columns > landmarks[0, 0] - 6) & (columns < landmarks[16, 0] + 6)
    brows = (dark & face & (rows < landmarks[27, 1] - 4)).astype(np.uint8)
    hair = (dark & ~face).astype(np.uint8)
    holes = cv2.dilate(brows | cv2.dilate(hair, np.ones((5, 5), np.uint8)), np.ones((5, 5), np.uint8))
    base = albedo.copy()
    base[hair > 0] = (208, 162, 134)
    base = cv2.inpaint(base, holes, 5, cv2.INPAINT_TELEA)
    inside_lips = _region(model, "lips", every=False) * (albedo[..., 1].astype(float) < 0.66 * albedo[..., 0])
    eyes = np.maximum(_region(model, "eyeL"), _region(model, "eyeR"))
    return SkinPainter(
        base=(base / 255.0).astype(np.float32),
        wet=cv2.GaussianBlur(wet.astype(np.float32), (0, 0), 0.6),
        hair=cv2.GaussianBlur(hair.astype(np.float32), (0, 0), 2.0),
        lips=np.clip(cv2.GaussianBlur(inside_lips.astype(np.float32), (0, 0), 1.2), 0, 1),
        iris=cv2.GaussianBlur(((albedo.max(-1) < 150) & (eyes > 0.5)).astype(np.float32), (0, 0), 0.7),
        landmarks=landmarks,
    )


def landmark_places(model: FaceModel) -> Float[np.ndarray, "68 2"]:
    """Where the 68 landmarks lie in the albedo, pixels of a SIDE×SIDE picture."""
    return places_of(model.landmarks, model)


def places_of(points: Embedding, model: FaceModel) -> Float[np.ndarray, "n 2"]:
    """Where points of the skin lie in the albedo, pixels of a SIDE×SIDE picture."""
    return np.einsum("lkc,lk->lc", vertex_places(model)[points.vertices], points.barycentric)


def vertex_places(model: FaceModel) -> Float[np.ndarray, "v 2"]:
    """Where each vertex lies in the albedo, pixels of a SIDE×SIDE picture; on a seam, one of its places."""
    uv = np.zeros((len(model.neutral), 2))
    uv[model.triangles.ravel()] = model.uv[model.triangles_uv.ravel()]
    return _to_pixels(uv)


def _to_pixels(uv):
    return np.stack([uv[..., 0] * SIDE - 0.5, (1 - uv[..., 1]) * SIDE - 0.5], axis=-1)


def _region(model: FaceModel, name: str, every: bool = True) -> Float[np.ndarray, "s s"]:
    """1 in the triangles whose corners (every one, or any) belong to the region."""
    member = np.zeros(len(model.neutral), bool)
    member[model.regions[name]] = True
    corners = member[model.triangles]
    chosen: Integer[np.ndarray, "t 3"] = model.triangles_uv[corners.all(1) if every else corners.any(1)]
    mask = np.zeros((SIDE, SIDE), np.uint8)
    for triangle in np.rint(_to_pixels(model.uv[chosen])).astype(np.int32):
        cv2.fillConvexPoly(mask, triangle, 1)
    return mask.astype(float)


def _tone(rng) -> Float[np.ndarray, "3"]:
    place = rng.uniform(0, len(SKIN_TONES) - 1)
    lower = int(place)
    tone = SKIN_TONES[lower] + (place - lower) * (SKIN_TONES[min(lower + 1, len(SKIN_TONES) - 1)] - SKIN_TONES[lower])
    return (tone / 255 * rng.uniform(0.9, 1.1) * (1 + rng.normal(0, 0.025, 3))).astype(np.float32)


def _noise(rng, side: int, cells: int, stretch: int = 1) -> Float[np.ndarray, "side side"]:
    """Smooth noise of unit variance with about `cells` bumps across, `stretch` times longer than wide."""
    small = rng.standard_normal((max(2, cells // stretch) + 3, cells + 3)).astype(np.float32)
    smooth = cv2.resize(small, (side, side), interpolation=cv2.INTER_CUBIC)
    return smooth / max(float(smooth.std()), 1e-6)


def _smooth(points, count: int) -> Float[np.ndarray, "count 2"]:
    """Points along the quadratic or cubic through the given ones."""
    at = np.linspace(0, 1, len(points))
    order = min(3, len(points) - 1)
    dense = np.linspace(0, 1, count)
    return np.stack([np.polyval(np.polyfit(at, points[:, axis], order), dense) for axis in (0, 1)], axis=1)


def _curve(shade: np.ndarray, points: np.ndarray, width: float, strength: float) -> None:
    """Darken along a soft curve."""
    if strength < 0.02:
        return
    layer = np.zeros_like(shade)
    path = np.rint(_smooth(points, 24) * 16).astype(np.int32)
    cv2.polylines(layer, [path], False, 1.0, max(1, round(width)), cv2.LINE_AA, 4)
    x, y = np.clip(np.rint(points.min(0)).astype(int) - 20, 0, SIDE - 1)
    right, bottom = np.clip(np.rint(points.max(0)).astype(int) + 20, 1, SIDE)
    window = (slice(y, bottom), slice(x, right))
    shade[window] += strength * cv2.GaussianBlur(layer[window], (0, 0), 0.5 + 0.4 * width)


def _blob(picture: np.ndarray, centre, radius: float, color, strength: float) -> None:
    layer = np.zeros(picture.shape[:2], np.float32)
    cv2.circle(layer, _whole(centre), max(1, round(radius)), 1.0, -1, cv2.LINE_AA)
    share = strength * cv2.GaussianBlur(layer, (0, 0), 0.8)[..., None]
    picture[:] = picture * (1 - share) + share * color


def _fill(mask: np.ndarray, polygon: np.ndarray) -> None:
    cv2.fillPoly(mask, [np.rint(polygon).astype(np.int32)], 1.0)


def _whole(point) -> tuple[int, int]:
    x, y = np.rint(point).astype(int).tolist()
    return x, y
