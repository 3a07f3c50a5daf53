"""Ready people for the default head: who they are, and what they wear on it."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from workbench.errors import ModelError
from workbench.reading import checked_file, shortened, toml_tables
from workbench.samples import sample

PLAIN = "plain"
"""The head without a character: painted skin, no parts."""
Color = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Character:
    """A person. Styles are names of files in the folder of the people."""

    name: str
    words: str
    """Who it is, for lists."""
    skin: str
    """One of the skins, or the path of a picture in the head's UVs."""
    eyes: str
    """Colour of the irises."""
    brows: str
    """Empty: none but what the skin shows."""
    lashes: str
    teeth: str
    identity: Float[np.ndarray, "i"]
    """Coefficients of the default head's identity basis."""
    hair: str = ""
    """Empty: none."""
    skin_shift: Color = (0.0, 0.0, 0.0)
    """Added to the skin in CIE Lab."""
    hair_color: Color | None = None
    """Mean colour of the hair, RGB of 0 to 255; None: as photographed."""
    brow_color: Color | None = None
    clothes: str = ""
    """Empty: none, and the neck ends open."""
    clothes_color: Color | None = None


TEXTS = ("words", "skin", "eyes", "brows", "lashes", "teeth", "hair", "clothes")
COLORS = {"skin_shift": (-100.0, 100.0)} | dict.fromkeys(("hair_color", "brow_color", "clothes_color"), (0.0, 255.0))
MUST = ("words", "skin", "eyes", "brows", "lashes", "teeth", "identity")
MOST_SIGMA = 6.0
CHARACTER_FILE = "character.toml"
"""In the folder of a character."""
SKIN_SUFFIXES = (".png", ".webp", ".jpg", ".jpeg")


def character_names() -> tuple[str, ...]:
    """Names of the ready characters."""
    return tuple(_bundled())


def is_character(name: str) -> bool:
    """Whether a name is that of a ready character, or of a file or folder with one."""
    return name.endswith(".toml") or name in _bundled() or (Path(name) / CHARACTER_FILE).is_file()


def is_there(name: str) -> bool:
    """Whether a character can be read: the plain head, a ready one, or the file or folder of one's own."""
    return name == PLAIN or name in _bundled() or (is_character(name) and Path(name).exists())


def lasting_name(name: str) -> str:
    """The name of a character that holds from every folder: a ready one's as it is, one's own as an absolute path."""
    ready = name == PLAIN or name in _bundled() or not Path(name).exists()
    return name if ready else str(Path(name).resolve())


def own_file(name: str | Path) -> Path | None:
    """The file of a character of one's own, named by it or its folder; None for a ready one."""
    if name in _bundled():
        return None
    inside = Path(name) / CHARACTER_FILE
    return inside if inside.is_file() else Path(name)


def find_character(name: str | Path) -> Character:
    """A ready character by name, or the first one of a TOML file, or of the one in a folder.

    Raises `ModelError` if there is none.
    """
    path = own_file(name)
    if path is None:
        return _bundled()[str(name)]
    if isinstance(name, Path) or path.suffix == ".toml":
        return next(iter(read_characters(path).values()))
    raise ModelError(
        f"There is no character {shortened(name)!r}; there are {', '.join(_bundled())}, and a path ending in .toml, "
        f"or a folder with a {CHARACTER_FILE}, is read as one of your own."
    )


def read_characters(path: Path) -> Mapping[str, Character]:
    """The characters of a TOML file, one table each. Raises `ModelError` that says what is wrong with the file."""
    tables = toml_tables(checked_file(path, "characters", ModelError), ModelError)
    if not tables:
        raise ModelError(
            f"{path} holds no character; give each a table, as in data_samples/head/people/characters.toml."
        )
    return {name: _character(path, name, table) for name, table in tables.items()}


@lru_cache(maxsize=1)
def _bundled() -> Mapping[str, Character]:
    return read_characters(sample("characters"))


def _character(path: Path, name: str, table: Any) -> Character:
    place = f"{path}, character {shortened(name)!r}"
    if not isinstance(table, dict):
        raise ModelError(f"{place}: expected a table of settings, got {shortened(table)}.")
    known = [field.name for field in fields(Character) if field.name != "name"]
    if unknown := [key for key in table if key not in known]:
        raise ModelError(f"{place}: there is no setting {shortened(unknown[0])!r}; there are {', '.join(known)}.")
    if missing := [key for key in MUST if key not in table]:
        raise ModelError(f"{place}: {missing[0]} is missing; a character needs {', '.join(MUST)}.")
    for key in TEXTS:
        if not isinstance(table.get(key, ""), str):
            raise ModelError(f"{place}: {key} needs text, got {shortened(table[key])}.")
    colors = {key: _numbers(place, key, table[key], 3, *within) for key, within in COLORS.items() if key in table}
    identity = _numbers(place, "identity", table["identity"], None, -MOST_SIGMA, MOST_SIGMA)
    texts = {key: table[key] for key in TEXTS if key in table}
    if texts["skin"].lower().endswith(SKIN_SUFFIXES):
        texts["skin"] = str(path.parent / texts["skin"])
    return Character(name=name, identity=np.array(identity, float), **texts, **colors)


def _numbers(place: str, key: str, value: Any, count: int | None, low: float, high: float) -> tuple[float, ...]:
    numbers = value if isinstance(value, list) else [value]
    right = all(isinstance(number, int | float) and low <= number <= high for number in numbers)
    if not isinstance(value, list) or not right or count not in (None, len(numbers)):
        wanted = f"{count} numbers" if count else "a list of numbers"
        raise ModelError(f"{place}: {key} needs {wanted} from {low:g} to {high:g}, got {shortened(value)}.")
    return tuple(float(number) for number in numbers)
