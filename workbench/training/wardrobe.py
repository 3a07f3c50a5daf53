"""Random people in the art of the default head: what they wear, at the size of training pictures."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.face.dressed_head import CORNEA_ALPHA, EYES, TEETH_PICTURE, TONGUE, WornPart
from workbench.face.model import Embedding, FaceModel
from workbench.face.parts import Part, PartStore, open_parts
from workbench.face.tinting import shifted, tinted
from workbench.frames import read_picture
from workbench.samples import sample
from workbench.training.brows import BrowPlace, brows_at, denser, line_of_brows

PICTURE_SIDE = 256
"""Pixels of the longer side of a part's picture: a head is drawn about as large."""
AS_PHOTOGRAPHED = 0.2
"""Share of hair that keeps the colour of its picture."""
MOST_LAYERS = 4.0
"""Of brows: the bundled ones, as they are, let a quarter or more of the skin through."""


@dataclass(frozen=True, eq=False)
class Wardrobe:
    """Parts, pictures and skins of the default head, each read once."""

    model: FaceModel
    store: PartStore
    skin_side: int
    _parts: dict[tuple[str, str], Part] = field(default_factory=dict)
    _pictures: dict[tuple[str, str], UInt8[np.ndarray, "h w 4"]] = field(default_factory=dict)
    _brow_lines: dict[str, Embedding] = field(default_factory=dict)
    _skins: dict[str, UInt8[np.ndarray, "s s 3"]] = field(default_factory=dict)

    def skin(self, rng: np.random.Generator) -> UInt8[np.ndarray, "s s 3"]:
        """A photographed skin in the head's UV layout, or a mixture of two, lighter or darker and of another hue."""
        names = sorted(path.stem for path in _folder("skins").glob("*.webp"))
        first, second = (self._skin(str(name)) for name in rng.choice(names, 2))
        share = rng.uniform(0.2, 0.8) if rng.random() < 0.4 else 0.0
        mixed = cv2.addWeighted(first, 1 - share, second, share, 0)
        contrast = cv2.GaussianBlur(mixed, (0, 0), self.skin_side / 64)
        mixed = cv2.addWeighted(mixed, amount := float(rng.uniform(0.7, 1.7)), contrast, 1 - amount, 0)
        return shifted(mixed, tuple((rng.normal(0, 1, 3) * [8.0, 2.0, 3.0] + [3.0, 0.0, -1.0]).tolist()))

    def dress(
        self, rng: np.random.Generator, hair_color: Float[np.ndarray, "3"], brows: BrowPlace
    ) -> tuple[WornPart, ...]:
        """Eyes, mouth, brows, lashes, and most often hair and a shirt; `hair_color` is RGB of 0 to 1."""
        shade = 255.0 * hair_color
        hair = None if rng.random() < AS_PHOTOGRAPHED else _color(shade)
        eyes = self._picture("eyes", _one(rng, self._files("eyes"))).copy()
        eyes[..., :3] = np.clip(eyes[..., :3] * rng.uniform(0.6, 1.05) * rng.normal(1, 0.03, 3), 0, 255)
        eyes[..., 3] = 255
        mouth = self._picture("teeth", TEETH_PICTURE).copy()
        mouth[..., :3] = np.clip(mouth[..., :3] * rng.uniform(0.6, 1.5) * [1.0, 1.0, rng.uniform(0.8, 1.0)], 0, 255)
        worn = [
            ("tongue", TONGUE, self._picture("tongue", TONGUE)),
            ("teeth", _one(rng, self.store.styles["teeth"]), mouth),
            ("eyes", EYES, eyes),
            ("corneas", EYES, np.full((2, 2, 4), (255, 255, 255, CORNEA_ALPHA), np.uint8)),
        ]
        if rng.random() < 0.8:
            style = _one(rng, self.store.styles["brows"])
            hairs = denser(self._picture("brows", style), float(np.exp(rng.uniform(0.0, np.log(MOST_LAYERS)))))
            worn.append(("brows", style, tinted(hairs, _color(shade * rng.uniform(0.15, 0.85)))))
        if rng.random() < 0.8:
            style = _one(rng, self.store.styles["lashes"])
            worn.append(("lashes", style, self._picture("lashes", style)))
        if rng.random() < 0.85:
            style = _one(rng, self.store.styles["clothes"])
            color = _color(rng.uniform(5, 245, 3) if rng.random() < 0.6 else np.full(3, rng.uniform(5, 245)))
            worn.append(("clothes", style, tinted(self._picture("clothes", style), color)))
        if rng.random() < 0.75:
            style = _one(rng, self.store.styles["hair"])
            worn.append(("hair", style, tinted(self._picture("hair", style), hair)))
        parts = [WornPart(self._part(kind, style), picture) for kind, style, picture in worn]
        return tuple(
            replace(own, part=brows_at(own.part, self.model, brows)) if own.part.kind == "brows" else own
            for own in parts
        )

    def brow_line(self, style: str) -> Embedding:
        """The ten landmarks of both brows on a style's own vertices: annotators follow the hair that they see."""
        if style not in self._brow_lines:
            self._brow_lines[style] = line_of_brows(
                self._part("brows", style), self._picture("brows", style), self.model.neutral
            )
        return self._brow_lines[style]

    def _part(self, kind: str, style: str) -> Part:
        if (kind, style) not in self._parts:
            self._parts[kind, style] = self.store.read(kind, style, len(self.model.neutral))
        return self._parts[kind, style]

    def _picture(self, kind: str, style: str) -> UInt8[np.ndarray, "h w 4"]:
        if (kind, style) not in self._pictures:
            stored = cv2.imread(str(_folder(kind) / f"{style}.webp"), cv2.IMREAD_UNCHANGED)
            code = cv2.COLOR_BGRA2RGBA if stored.shape[2] == 4 else cv2.COLOR_BGR2RGBA
            self._pictures[kind, style] = _reduced(cv2.cvtColor(stored, code), PICTURE_SIDE)
        return self._pictures[kind, style]

    def _skin(self, name: str) -> UInt8[np.ndarray, "s s 3"]:
        if name not in self._skins:
            size = (self.skin_side, self.skin_side)
            whole = read_picture(_folder("skins") / f"{name}.webp")
            self._skins[name] = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
        return self._skins[name]

    def _files(self, kind: str) -> tuple[str, ...]:
        return tuple(sorted(path.stem for path in _folder(kind).glob("*.webp")))


def open_wardrobe(model: FaceModel, skin_side: int) -> Wardrobe:
    """The bundled art, for skins of `skin_side` pixels."""
    return Wardrobe(model, open_parts(sample("parts")), skin_side)


def _folder(kind: str) -> Path:
    return sample("characters").parent / kind


def _one(rng: np.random.Generator, names: tuple[str, ...]) -> str:
    return names[int(rng.integers(len(names)))]


def _color(values: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    red, green, blue = np.clip(values, 0.0, 255.0).tolist()
    return red, green, blue


def _reduced(picture: UInt8[np.ndarray, "h w 4"], longest: int) -> UInt8[np.ndarray, "h2 w2 4"]:
    """The picture with a longer side of at most `longest`; what is hidden does not bleed into what is seen."""
    height, width = picture.shape[:2]
    scale = longest / max(height, width)
    if scale >= 1.0:
        return picture
    alpha = picture[..., 3:] / np.float32(255)
    spread = cv2.resize(
        np.dstack([picture[..., :3] * alpha, alpha, picture[..., :3] * np.float32(1)]),
        (round(width * scale), round(height * scale)),
        interpolation=cv2.INTER_AREA,
    )
    cover = spread[..., 3:4]
    colors = np.where(cover > 0.02, spread[..., :3] / np.maximum(cover, 0.02), spread[..., 4:])
    return np.rint(np.clip(np.dstack([colors, 255 * cover]), 0, 255)).astype(np.uint8)
