"""The default head dressed as a character: a skin for its texture, and parts that follow it."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Integer, UInt8

from workbench.errors import InputError, ModelError
from workbench.face.characters import PLAIN, SKIN_SUFFIXES, Character, find_character
from workbench.face.default_head import GAZE_NAMES, load_default_head
from workbench.face.jaw import posed_vertices
from workbench.face.model import FaceModel
from workbench.face.parameters import FaceParameters
from workbench.face.parts import Part, open_parts
from workbench.face.tinting import shifted, tinted, with_scalp
from workbench.frames import read_picture
from workbench.reading import checked_content, reading, shortened
from workbench.samples import sample

REPLACED_REGIONS = ("eyeL", "eyeR", "teethU", "teethL", "tongue")
"""What the plain head has of its own and a dressed one does not show."""
EYES, TONGUE, TEETH_PICTURE = "high-poly", "tongue01", "teeth"
SCALP_EDGE = 0.008
"""Softness of the hairline in widths and heights of the texture."""
CORNEA_ALPHA = 10
"""A cornea is all but invisible: its highlight is seen."""


@dataclass(frozen=True, eq=False)
class WornPart:
    """A part with its picture."""

    part: Part
    picture: UInt8[np.ndarray, "h w 4"]
    """RGBA; alpha cuts strands out of cards."""

    @property
    def translucent(self) -> bool:
        """Whether what is behind shows through anywhere."""
        return bool(self.picture[..., 3].min() < 255)


@dataclass(frozen=True, eq=False)
class DressedHead:
    """A character on the default head, whose mesh is untouched: fits, tracks and landmarks know only `model`."""

    character: Character
    model: FaceModel
    skin: UInt8[np.ndarray, "h w 3"]
    """Texture for the model's UVs, RGB."""
    worn: tuple[WornPart, ...]
    """From the inside out."""
    scale_vertices: Integer[np.ndarray, "3 2"]

    @property
    def person(self) -> FaceModel:
        """The model with the character's identity baked in."""
        return self.model.personal(self.character.identity)

    @property
    def shown(self) -> Bool[np.ndarray, "t"]:
        """Triangles of the model that no part replaces."""
        return ~self.model.in_regions(REPLACED_REGIONS)[self.model.triangles].all(axis=1)

    @property
    def clothed(self) -> bool:
        """Whether clothes cover the open end of the neck."""
        return any(worn.part.kind == "clothes" for worn in self.worn)

    def vertices(self, parameters: FaceParameters) -> Float[np.ndarray, "v 3"]:
        """Head vertices of these parameters without the pose; an empty identity is the character's.

        Weights may leave the eyes' units out, as those of fits to points that do not see them; others raise
        `InputError`.
        """
        weights = self._weights(parameters)
        return posed_vertices(self._person(parameters), weights, _jaw(parameters), _scale(parameters))

    def part_vertices(self, parameters: FaceParameters) -> tuple[Float[np.ndarray, "_ 3"], ...]:
        """Vertices of each worn part without the pose: head frame, millimetres."""
        rest = self._person(parameters).neutral
        return self.parts_on(rest, self.vertices(parameters))

    def parts_on(
        self, rest: Float[np.ndarray, "v 3"], posed: Float[np.ndarray, "v 3"]
    ) -> tuple[Float[np.ndarray, "_ 3"], ...]:
        """Vertices of each worn part, given the head's own: of the person at rest, and now; both in the head frame.

        A head scaled as a whole has hair scaled with it: the width of the skull says by how much.
        """
        (left, right), scale = self.scale_vertices[0], 1.0
        width = float(np.linalg.norm(rest[left] - rest[right]))
        if width > 0.0:
            scale = float(np.linalg.norm(posed[left] - posed[right])) / width
        growth = scale * self.growth(rest)
        return tuple(worn.part.on(scale * rest if worn.part.still else posed, growth) for worn in self.worn)

    def growth(self, rest: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "3"]:
        """Size of a resting head along x, y and z; 1 is the mean head's."""
        first, second = self.scale_vertices.T
        axes = np.arange(3)
        own = np.abs(rest[first, axes] - rest[second, axes])
        return own / np.abs(self.model.neutral[first, axes] - self.model.neutral[second, axes])

    def _weights(self, parameters: FaceParameters) -> Float[np.ndarray, "k"]:
        given, names = np.asarray(parameters.expression, float), self.model.expression_names
        without_eyes = [k for k, name in enumerate(names) if name not in GAZE_NAMES]
        if len(given) == len(names):
            return given
        if len(given) != len(without_eyes):
            raise InputError(
                f"The character has {len(names)} blendshapes, {len(without_eyes)} without the eyes' units, got "
                f"{len(given)} weights; give one for each."
            )
        weights = np.zeros(len(names))
        weights[without_eyes] = given
        return weights

    def _person(self, parameters: FaceParameters) -> FaceModel:
        identity = parameters.identity if len(parameters.identity) else self.character.identity
        return self.model.personal(np.asarray(identity, float))


def load_character(name: str | Path, gaze: bool = True) -> DressedHead:
    """The default head as a character: a ready one by name, or a TOML file of your own or the folder with it.

    With `gaze`, the eyes' units are there too. Raises `ModelError` for an unknown character, style or skin.
    """
    return dress(find_character(name), gaze)


def dress(character: Character, gaze: bool = True) -> DressedHead:
    """The default head as this character. Raises `ModelError` for an unknown style or skin."""
    model = load_default_head(gaze=gaze)
    if len(character.identity) != len(model.identity_deltas):
        raise ModelError(
            f"The character {character.name!r} has {len(character.identity)} identity coefficients, "
            f"the default head {len(model.identity_deltas)}; give one for each."
        )
    skin = shifted(_skin(character.skin), character.skin_shift)
    if character.hair and character.hair_color is not None:
        skin = with_scalp(skin, _scalp(*skin.shape[:2]), character.hair_color)
    store = open_parts(sample("parts"))
    worn = [
        ("tongue", TONGUE, _rgba("tongue", TONGUE)),
        ("teeth", character.teeth, _rgba("teeth", TEETH_PICTURE)),
        ("eyes", EYES, _opaque(_rgba("eyes", character.eyes))),
        ("corneas", EYES, np.full((2, 2, 4), (255, 255, 255, CORNEA_ALPHA), np.uint8)),
    ]
    if character.brows:
        worn.append(("brows", character.brows, tinted(_rgba("brows", character.brows), character.brow_color)))
    worn.append(("lashes", character.lashes, _rgba("lashes", character.lashes)))
    if character.clothes:
        picture = tinted(_rgba("clothes", character.clothes), character.clothes_color)
        worn.append(("clothes", character.clothes, picture))
    if character.hair:
        worn.append(("hair", character.hair, tinted(_rgba("hair", character.hair), character.hair_color)))
    return DressedHead(
        character=character,
        model=model,
        skin=skin,
        worn=tuple(WornPart(store.read(kind, style, len(model.neutral)), picture) for kind, style, picture in worn),
        scale_vertices=store.scale_vertices,
    )


def dressed_as(character: str, model: FaceModel) -> DressedHead | None:
    """The default head as a character, None for `plain`; raises `ModelError` if the model is another one."""
    if character == PLAIN:
        return None
    check_wears_characters(model)
    return load_character(character)


def check_wears_characters(model: FaceModel) -> None:
    """Raise `ModelError` for a model other than the default head."""
    if model.name != load_default_head().name:
        raise ModelError(
            f"Characters are for the default head, this is the model {model.name}; leave the character at {PLAIN!r}."
        )


def skin_names() -> tuple[str, ...]:
    """Names of the skins; each is a picture in the head's UVs."""
    return tuple(sorted(path.stem for path in (sample("characters").parent / "skins").glob("*.webp")))


def read_skin(name: str) -> UInt8[np.ndarray, "h w 3"]:
    """A skin by name, RGB. Raises `ModelError` if there is none."""
    return read_picture(_picture_path("skins", name))


def _skin(name: str) -> UInt8[np.ndarray, "h w 3"]:
    if not name.lower().endswith(SKIN_SUFFIXES):
        return read_skin(name)
    try:
        return read_picture(name)
    except InputError as error:
        raise ModelError(f"The character's skin cannot be read: {error}") from error


def _picture_path(kind: str, style: str) -> Path:
    folder = sample("characters").parent / kind
    known = sorted(path.stem for path in folder.glob("*.webp"))
    if style not in known:
        named = repr(shortened(style))
        told = f"skin {named}; the skins" if kind == "skins" else f"style {named} for {kind}; the styles"
        raise ModelError(f"There is no {told} are {', '.join(known)}.")
    return folder / f"{style}.webp"


@lru_cache(maxsize=2)
def _scalp(height: int, width: int) -> Float[np.ndarray, "h w"]:
    """Where the scalp is in a texture of the head, 0 to 1 with a soft edge."""
    model = load_default_head(gaze=True)
    inside = model.in_regions(("scalp",))
    corners = model.uv[model.triangles_uv[inside[model.triangles].all(axis=1)]] * [1.0, -1.0] + [0.0, 1.0]
    mask = np.zeros((height, width), np.uint8)
    for corner in np.rint(corners * [width, height]).astype(np.int32):
        cv2.fillConvexPoly(mask, corner, 255)
    return cv2.GaussianBlur(mask, (0, 0), sigmaX=SCALP_EDGE * width, sigmaY=SCALP_EDGE * height) / 255.0


@lru_cache(maxsize=16)
def _rgba(kind: str, style: str) -> UInt8[np.ndarray, "h w 4"]:
    path = _picture_path(kind, style)
    with reading(path, "a picture with transparency", "reinstall the workbench", ModelError):
        content = checked_content(path, "a picture with transparency", ModelError)
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        if picture is None:
            raise ValueError("it does not decode")
        return cv2.cvtColor(picture, cv2.COLOR_BGRA2RGBA if picture.shape[2] == 4 else cv2.COLOR_BGR2RGBA)


def _opaque(picture: UInt8[np.ndarray, "h w 4"]) -> UInt8[np.ndarray, "h w 4"]:
    solid = picture.copy()
    solid[..., 3] = 255
    return solid


def _jaw(parameters: FaceParameters) -> Float[np.ndarray, "6"]:
    return np.asarray(parameters.jaw, float) if len(parameters.jaw) else np.zeros(6)


def _scale(parameters: FaceParameters) -> float:
    return float(parameters.scale[0]) if len(parameters.scale) else 1.0
