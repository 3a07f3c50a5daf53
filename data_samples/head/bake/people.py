"""Bake what people wear on the default head: skins, eyes, teeth, tongue, brows, lashes and hair, and ready characters.

The art is MakeHuman's (CC0), a folder with `skins`, `eyes`, `teeth`, `tongue`, `eyebrows`, `eyelashes` and `hair`. The
head itself stays as it is: everything here is tied to its vertices.
"""

import io
import tomllib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from anchoring import Ties, lid_edges, lid_ties, nearest_ties, own_ties, rigid_ties, stacked
from asset import quantised, write_npz
from brows import raised_brows
from clothes import Clothes, read_clothes
from crop import Crop, head_islands, uv_islands
from identities import AVERAGE, DECIMETRES, Generator
from makehuman import MakeHuman
from PIL import Image
from scipy import ndimage
from scipy.spatial import cKDTree
from shirt import shirt, shirt_picture
from skins import Canvas, read_skin, skin_texture

KINDS = {
    "eyes": "eyes",
    "teeth": "teeth",
    "tongue": "tongue",
    "brows": "eyebrows",
    "lashes": "eyelashes",
    "hair": "hair",
}
"""Kinds of parts, and their folders in the art."""
TEXTURE_PX = {"eyes": 512, "teeth": 1024, "tongue": 256, "brows": 512, "lashes": 512, "hair": 1024}
TONES = {"teeth": (1.28, 1.2, 1.06), "eyes": (1.12, 1.1, 1.08), "tongue": (0.92, 0.8, 0.78)}
"""Factors of red, green and blue: the art is lit a little blue, and its tongue is pale."""
REDDISH_EYES = ("brown",)
SKIN_QUALITY, PART_QUALITY = 90, 86
OFFSET_STEP_MM = 0.02
UV_STEPS = 65535
SCALE_PAIRS = ((5399, 11998), (791, 881), (962, 5320))
"""Base vertices whose distances along x, y and z say how large a head is for its hair."""
IDENTITY_RIDGE = 0.02
"""Pull of the coefficients to 0, as variance of the residual (mm²) over that of the prior."""
MOST_SIGMA = 3.0
UPPER_TEETH_SHIFT_MM = np.array([0.0, 2.4, -1.2])
"""At rest the upper incisors end below the lips' line and bite over the lower ones; the base mesh's end at the line."""
LID_SHADOW_MM, LID_SHADE = 3.4, 0.5
"""Lids shade the eyeball over about this distance."""
EYES_OF_ALPHA = "brown"
"""The eyes whose texture tells eyeball from cornea, which is transparent: all are alike."""
MOUTH_SHADE = {"teeth": 0.7, "tongue": 0.8}
SHADE_FROM_MM, SHADE_OVER_MM = 9.0, 32.0
"""Behind the lips the mouth gets darker, over this depth."""


@dataclass(frozen=True)
class Wardrobe:
    """The head that everything is fitted to."""

    source: MakeHuman
    crop: Crop
    neutral: np.ndarray
    """Head vertices, millimetres, head frame."""
    shipped: np.ndarray
    """The same with an even border at the neck: what parts are tied to."""
    base: np.ndarray
    """All vertices of the base mesh in the same frame: the head's, and helpers carried along with them."""
    triangles: np.ndarray
    landmarks: np.ndarray
    """The 68 points on the head, millimetres."""

    @staticmethod
    def of(
        source: MakeHuman,
        crop: Crop,
        neutral: np.ndarray,
        shipped: np.ndarray,
        scale: float,
        triangles: np.ndarray,
        landmarks: np.ndarray,
    ) -> "Wardrobe":
        """Base vertices that the head lacks are MakeHuman's average, moved as the nearest skin has moved."""
        generator = Generator(source, crop)
        raw = source.base.vertices + source.macro(*AVERAGE)
        eyes = np.array([source.joint(raw, f"joint-{side}-eye") for side in "lr"])
        base = (raw - eyes.mean(axis=0)) * DECIMETRES * scale * [1.0, -1.0, -1.0]
        skin = np.flatnonzero(crop.outer)
        moved = neutral - generator.average[: len(neutral)] * scale
        distance, nearest = cKDTree(base[crop.base_ids[skin]]).query(base, k=6)
        weights = 1.0 / np.maximum(distance, 0.5)
        base = base + np.einsum("nk,nkd->nd", weights / weights.sum(axis=1, keepdims=True), moved[skin][nearest])
        base[crop.base_ids] = neutral
        return Wardrobe(source, crop, neutral, shipped, base, triangles, landmarks)


def part_arrays(
    wardrobe: Wardrobe, kind: str, clothes: Clothes, points: np.ndarray | None = None, alpha: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """One part as it is stored: ties to the head's vertices, what they leave over, triangles and UVs.

    `points` are its vertices on the head, where they are not MakeHuman's; `alpha` is the opacity of brows.
    """
    crop = wardrobe.crop
    points = clothes.worn(wardrobe.base) if points is None else points
    if kind == "teeth":
        points = points + UPPER_TEETH_SHIFT_MM * _upper(crop, clothes)[:, None]
    if kind == "lashes":
        ties, points = _lash_ties(wardrobe, clothes, points)
    elif kind == "brows":
        skin = wardrobe.triangles[crop.outer[wardrobe.triangles].all(axis=1)]
        ties, points = raised_brows(clothes, points, alpha, wardrobe.landmarks, wardrobe.neutral, skin)
    else:
        ties = _ties(wardrobe, kind, clothes, points)
    weights = ties.weights.astype(np.float16)
    offsets = Ties(ties.anchors, weights.astype(float)).offsets(points, wardrobe.shipped)
    shade = _shade(wardrobe, kind, points)
    uvs = np.clip(clothes.uvs, 0, 1)
    return {
        "anchors": ties.anchors.astype(np.uint16),
        "weights": weights,
        "offsets": quantised(offsets, OFFSET_STEP_MM),
        "shade": np.rint(255 * shade).astype(np.uint8),
        "triangles": clothes.triangles.astype(np.uint16),
        "uv": np.rint(uvs * UV_STEPS).astype(np.uint16),
        "triangles_uv": clothes.triangles_uv.astype(np.uint16),
    }


def _upper(crop: Crop, clothes: Clothes) -> np.ndarray:
    return np.isin(clothes.anchors[:, 0], crop.base_ids[crop.is_part("teethU")])


def _shade(wardrobe: Wardrobe, kind: str, points: np.ndarray) -> np.ndarray:
    """Share of the light that reaches a part at rest: less deep in the mouth, less under the lids."""
    crop, head = wardrobe.crop, wardrobe.neutral
    if kind in MOUTH_SHADE:
        depth = points[:, 2] - head[crop.lip_seam, 2].min()
        return 1 - MOUTH_SHADE[kind] * np.clip((depth - SHADE_FROM_MM) / SHADE_OVER_MM, 0, 1)
    if kind == "eyes":
        rims = [crop.lid_seam_left, crop.lid_seam_right]
        upper = [rim[head[rim, 1] < np.median(head[rim, 1])] for rim in rims]
        away = cKDTree(head[np.concatenate(rims)]).query(points)[0]
        below = cKDTree(head[np.concatenate(upper)]).query(points)[0]
        lids = np.exp(-((below / LID_SHADOW_MM) ** 2)) + 0.5 * np.exp(-((away / LID_SHADOW_MM * 2) ** 2))
        return 1 - LID_SHADE * np.clip(lids, 0, 1)
    return np.ones(len(points))


def _ties(wardrobe: Wardrobe, kind: str, clothes: Clothes, points: np.ndarray) -> Ties:
    crop, head = wardrobe.crop, wardrobe.neutral
    left = points[:, 0] > 0

    def members(*names: str) -> np.ndarray:
        return np.flatnonzero(crop.is_part(*names))

    if kind == "eyes":
        sides = ((left, members("eyeL")), (~left, members("eyeR")))
        return stacked([(rows, rigid_ties(points[rows], head, eye)) for rows, eye in sides], len(points))
    if kind == "teeth":
        upper = _upper(crop, clothes)
        rows = ((upper, members("teethU")), (~upper, members("teethL")))
        return stacked([(jaw, rigid_ties(points[jaw], head, teeth)) for jaw, teeth in rows], len(points))
    if kind != "clothes" and np.isin(clothes.anchors, crop.base_ids).all():
        return own_ties(clothes, crop)
    return nearest_ties(points, head, crop.outer & (crop.lip_mask < 0.1))


def _lash_ties(wardrobe: Wardrobe, clothes: Clothes, points: np.ndarray) -> tuple[Ties, np.ndarray]:
    crop, head = wardrobe.crop, wardrobe.neutral
    left = points[:, 0] > 0
    pieces, moved = [], points.copy()
    for rows, seam, eye in ((left, crop.lid_seam_left, "eyeL"), (~left, crop.lid_seam_right, "eyeR")):
        triangles = np.searchsorted(np.flatnonzero(rows), clothes.triangles[rows[clothes.triangles].all(axis=1)])
        eyeball = np.flatnonzero(crop.is_part(eye))
        ties, moved[rows] = lid_ties(points[rows], triangles, head, lid_edges(crop, head, seam), eyeball)
        pieces.append((rows, ties))
    return stacked(pieces, len(points)), moved


def part_picture(kind: str, path: Path) -> Image.Image:
    """A part's texture, reduced and toned, with the strands' colour continued where nothing is opaque.

    Filtering mixes neighbouring texels, so what lies behind transparent ones is seen at the edges of strands.
    """
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if picture.shape[2] == 4:
        solid = picture[..., 3] > 96
        rows, columns = ndimage.distance_transform_edt(~solid, return_distances=False, return_indices=True)
        filled = np.where(solid[..., None], picture[..., :3], picture[rows, columns, :3])
        smooth = cv2.GaussianBlur(filled, (0, 0), 3.0)
        colour = np.where(solid[..., None], filled, smooth)
        picture = np.dstack([colour, picture[..., 3]])
    size = TEXTURE_PX[kind]
    if max(picture.shape[:2]) > size:
        picture = cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA)
    if kind in TONES:
        toned = np.rint(np.clip(picture[..., :3] * TONES[kind][::-1], 0, 255)).astype(np.uint8)
        picture = np.dstack([toned, picture[..., 3:]])
    if path.stem in REDDISH_EYES and kind == "eyes":
        picture = np.dstack([_less_red(picture[..., :3]), picture[..., 3:]])
    code = cv2.COLOR_BGRA2RGBA if picture.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return Image.fromarray(cv2.cvtColor(picture, code))


def _less_red(picture: np.ndarray) -> np.ndarray:
    """Irises (BGR) turned from red to brown."""
    lab = cv2.cvtColor(picture.astype(np.float32) / 255, cv2.COLOR_BGR2LAB)
    iris = np.clip((lab[..., 1] - 8) / 12, 0, 1)
    lab[..., 1] *= 1 - 0.55 * iris
    lab[..., 2] *= 1 - 0.15 * iris
    return np.rint(np.clip(cv2.cvtColor(lab, cv2.COLOR_LAB2BGR), 0, 1) * 255).astype(np.uint8)


def _alpha(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., 3] / 255.0


def webp(picture: Image.Image, quality: int) -> bytes:
    """WebP bytes that keep the colours behind transparent texels."""
    stream = io.BytesIO()
    picture.save(stream, "WEBP", quality=quality, method=6, exact=True)
    return stream.getvalue()


def identity_of(
    generator: Generator, sitter: dict, neutral: np.ndarray, identities: np.ndarray, scale: float
) -> np.ndarray:
    """Coefficients of the identity basis that come nearest to a sitter's head; the skin counts."""
    source, crop = generator.source, generator.crop
    macro = (sitter["races"], sitter["gender"], sitter["age"], sitter["weight"], sitter["muscle"])
    vertices = source.base.vertices + source.macro(*macro)
    for name, weight in sitter.get("shapes", {}).items():
        vertices = vertices + weight * source.shape(name)
    head = generator.aligned(vertices)
    # The basis is centred between the eyes of its mean, before it is scaled.
    rows = np.flatnonzero(crop.outer)
    wanted = (head[rows] * scale - neutral[rows]).ravel()
    basis = np.hstack([identities[:, rows].reshape(len(identities), -1).T, np.tile(np.eye(3), (len(rows), 1))])
    prior = np.diag([IDENTITY_RIDGE * len(rows)] * len(identities) + [0.0] * 3)
    solution = np.linalg.solve(basis.T @ basis + prior, basis.T @ wanted)[: len(identities)]
    return np.clip(solution, -MOST_SIGMA, MOST_SIGMA)


def bake_parts(wardrobe: Wardrobe, art: Path, out: Path) -> None:
    """Write `parts.npz` and the pictures of all parts."""
    arrays: dict[str, np.ndarray] = {
        "offset_step_mm": np.float32(OFFSET_STEP_MM),
        "scale_vertices": np.searchsorted(wardrobe.crop.base_ids, np.array(SCALE_PAIRS)).astype(np.uint16),
    }

    def add(
        kind: str, style: str, clothes: Clothes, points: np.ndarray | None = None, alpha: np.ndarray | None = None
    ) -> None:
        stored = part_arrays(wardrobe, kind, clothes, points, alpha)
        arrays.update({f"{kind}.{style}.{name}": array for name, array in stored.items()})

    for kind, folder in KINDS.items():
        for fit in sorted((art / folder).glob("*.mhclo")):
            clothes = read_clothes(fit, fit.with_suffix(".obj"))
            if kind == "eyes":
                eyeball = clothes.seen(_alpha(art / folder / f"{EYES_OF_ALPHA}.png"))
                add("eyes", fit.stem, clothes.of_triangles(eyeball))
                add("corneas", fit.stem, clothes.of_triangles(~eyeball))
            elif kind == "brows":
                add(kind, fit.stem, clothes, alpha=_alpha(fit.with_suffix(".png")))
            else:
                add(kind, fit.stem, clothes)
        _write_pictures(out / kind, {path.stem: part_picture(kind, path) for path in (art / folder).glob("*.png")})
    base = wardrobe.source.base
    islands = uv_islands(base)
    face, cavities = head_islands(base, islands)
    points, mesh = shirt(base, wardrobe.base, np.array([face, *cavities]), islands)
    add("clothes", "shirt", mesh, points)
    _write_pictures(out / "clothes", {"shirt": Image.fromarray(shirt_picture())})
    write_npz(out / "parts.npz", arrays)


def bake_skins(canvas: Canvas, art: Path, out: Path) -> None:
    """Write the skins as textures of the head."""
    (out / "skins").mkdir(parents=True, exist_ok=True)
    for path in sorted((art / "skins").glob("*.jpg")):
        texture = Image.fromarray(skin_texture(canvas, read_skin(art / "skins", path.stem)))
        (out / "skins" / f"{path.stem}.webp").write_bytes(webp(texture, SKIN_QUALITY))


def bake_characters(wardrobe: Wardrobe, identities: np.ndarray, scale: float, sitters: Path, out: Path) -> None:
    """Write `characters.toml`."""
    generator = Generator(wardrobe.source, wardrobe.crop)
    chapters = [
        _chapter(name, sitter, identity_of(generator, sitter, wardrobe.neutral, identities, scale))
        for name, sitter in tomllib.loads(sitters.read_text(encoding="utf-8")).items()
    ]
    (out / "characters.toml").write_text("\n".join(chapters), encoding="utf-8")


def _write_pictures(folder: Path, pictures: dict[str, Image.Image]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in pictures.items():
        (folder / f"{name}.webp").write_bytes(webp(picture, PART_QUALITY))


WORN = (
    "words",
    "skin",
    "skin_shift",
    "eyes",
    "brows",
    "brow_color",
    "lashes",
    "teeth",
    "hair",
    "hair_color",
    "clothes",
    "clothes_color",
)


def _chapter(name: str, sitter: dict, identity: np.ndarray) -> str:
    worn = [f"{key} = {_toml(sitter[key])}" for key in WORN if key in sitter]
    numbers = ", ".join(f"{value:.3f}" for value in identity)
    return "\n".join([f"[{name}]", *worn, f"identity = [{numbers}]", ""])


def _toml(value: str | list) -> str:
    return f'"{value}"' if isinstance(value, str) else f"[{', '.join(str(number) for number in value)}]"
