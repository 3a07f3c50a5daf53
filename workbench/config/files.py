"""Configurations as commented TOML; every version of the format can be read."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import tomlkit
from pydantic import BaseModel

from workbench.config.configuration import DEFAULT_PRESET, VERSION, Config, quoted, validated
from workbench.config.presets import preset
from workbench.config.schedules import PARALLEL_STAGES, Stage
from workbench.config.sections import Detector
from workbench.errors import ConfigError
from workbench.face.characters import PLAIN, is_there
from workbench.files import atomic_path
from workbench.landmarks.detection import AUTO, RECOMMENDED
from workbench.reading import checked_file, place_now, reading, toml_tables

NAMED_FILES = (("camera", "rig"), ("deep", "network"), ("flow", "estimator"))
"""Sections and keys of what may be a file that fits depend on; the key `files` of a track's metadata is in this order.

What comes along is called by words without a suffix."""


def read_config(path: str | Path) -> Config:
    """The configuration in a TOML file; missing values come from its `preset` (default: `DEFAULT_PRESET`).

    Raises `ConfigError` for a missing file, invalid TOML, unknown keys (with the closest valid one) and invalid values.
    """
    absent = f"The configuration {path} does not exist; `workbench track` writes one as config.toml."
    path = checked_file(path, "a configuration", ConfigError, absent, may_be_empty=True)
    with reading(path, "a configuration", "start from what `workbench config show` prints", ConfigError):
        return parse_config(toml_tables(path, ConfigError), str(path))


def parse_config(stored: Mapping[str, Any], origin: str) -> Config:
    """The configuration in a plain dictionary of any version; missing values come from its `preset`.

    `origin` names it in messages. Raises `ConfigError` like `read_config`.
    """
    stored = _migrated(dict(stored), origin)
    try:
        base = preset(str(stored.get("preset", DEFAULT_PRESET))).model_dump()
    except ConfigError as error:
        raise ConfigError(f"{origin}: {error}") from None
    for key, value in stored.items():
        base[key] = {**base[key], **value} if isinstance(value, dict) and isinstance(base.get(key), dict) else value
    return validated(base, origin)


def absent_files(config: Config) -> dict[str, str]:
    """The files, by setting, that a configuration names and that are not there, seen from the current folder."""
    named = {f"{section}.{key}": getattr(getattr(config, section), key) for section, key in NAMED_FILES}
    files = {setting: name for setting, name in named.items() if Path(name).suffix}
    files["landmarks.face_landmarker"] = config.landmarks.face_landmarker
    absent = {setting: name for setting, name in files.items() if name and not Path(name).exists()}
    worn = config.head.character
    return absent if is_there(worn) else absent | {"head.character": worn}


def config_of_track(meta: Mapping[str, Any]) -> Config | None:
    """The configuration that a track was made with, by its metadata; None if it holds none.

    A character that is no longer there is the plain head, unless fits depend on it. Files are named where they are,
    from whatever folder the run named them, and the detector is the one that ran, even if "auto" then stood for another
    one. Raises `ConfigError` like `parse_config`.
    """
    stored, origin = meta.get("config"), "The track's configuration"
    if not stored:
        return None
    head = stored.get("head")
    if isinstance(head, dict) and isinstance(name := head.get("character"), str) and not is_there(name):
        plain = parse_config({**stored, "head": {**head, "character": PLAIN}}, origin)
        if not plain.renders_character:
            return _as_run(plain, meta)
    return _as_run(parse_config(stored, origin), meta)


def _as_run(config: Config, meta: Mapping[str, Any]) -> Config:
    config, ran = _with_its_files(config, meta), meta.get("detector")
    another = config.landmarks.detector == AUTO and ran != RECOMMENDED and ran in get_args(Detector)
    return config.changed(landmarks={"detector": ran}) if another else config


def _with_its_files(config: Config, meta: Mapping[str, Any]) -> Config:
    """A track's configuration with its files named as the metadata say, or where they were moved to."""
    left, places = list(meta.get("files", [])), {}
    for section, key in NAMED_FILES:
        name = Path(getattr(getattr(config, section), key)).name
        same = next((item for item in left if Path(item["path"]).name == name), None)
        if same is not None:
            left.remove(same)
            places[section] = {key: str(place_now(same["path"], same.get("sha256", "")).absolute())}
    return config.changed(**places) if places else config


def _migrated(stored: dict[str, Any], origin: str) -> dict[str, Any]:
    version = stored.get("version", VERSION)
    if not isinstance(version, int) or isinstance(version, bool) or not 1 <= version <= VERSION:
        raise ConfigError(f"{origin}: version is {quoted(version)}, this workbench reads 1 to {VERSION}; upgrade it.")
    for step in range(version, VERSION):
        stored = MIGRATIONS[step](stored)
    return {**stored, "version": VERSION}


def _from_1(stored: dict[str, Any]) -> dict[str, Any]:
    """1 → 2: `contour.sliding` became `contour.mode`; a file without a preset uses the default of that version."""
    stored = {"preset": "calibrated", **stored}
    contour = stored.get("contour")
    if not isinstance(contour, dict) or "sliding" not in contour:
        return stored
    renamed = {key: value for key, value in contour.items() if key != "sliding"}
    return {**stored, "contour": {**renamed, "mode": "sliding" if contour["sliding"] else "fixed"}}


def _from_2(stored: dict[str, Any]) -> dict[str, Any]:
    """2 → 3: the names of papers belong to what they print; what bore them before keeps its values."""
    name = stored.get("preset", DEFAULT_PRESET)
    if isinstance(name, str):
        stored = {**stored, "preset": RENAMED_IN_3.get(name, name)}
    if name == "deep-energies" and isinstance(stored.get("deep", {}), dict):
        stored = {**stored, "deep": {"network": "heat-maps", **stored.get("deep", {})}}
    if name == "orthographic":
        stored = {"stages": ORTHOGRAPHIC_BEFORE_3, **stored}
    if name != "face-it":
        return stored
    given = {key: stored.get(key, {}) for key in FACE_IT_BEFORE_3}
    if not all(isinstance(section, dict) for section in given.values()):
        return stored
    return {**stored, **{key: {**values, **given[key]} for key, values in FACE_IT_BEFORE_3.items()}}


RENAMED_IN_3 = {"deep-energies": "deep", "preselected-points": "deep-points", "orthographic": "deep-parallel"}
FACE_IT_BEFORE_3: dict[str, dict[str, Any]] = {
    "weights": {"beta": 0.01, "sigma": 0.01},
    "constants": {"rotation_mm": 100.0, "weighted_edges": True},
    "landmarks": {"confidence": True},
}
"""What the preset `face-it` had before version 3, where it has changed."""
ORTHOGRAPHIC_BEFORE_3 = [
    *(stage.model_dump() for stage in PARALLEL_STAGES[:-1]),
    PARALLEL_STAGES[-1].model_dump() | {"terms": ("regularisation",)},
]
MIGRATIONS = {1: _from_1, 2: _from_2}
"""By version: the function that turns a stored configuration into one of the next version."""


def write_config(config: Config, path: str | Path) -> None:
    """Write a configuration as TOML with a comment on each value. The file is written completely or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(config_toml(config), encoding="utf-8")


def config_toml(config: Config) -> str:
    """The configuration as TOML text with a comment on each value, in stable order."""
    document = tomlkit.document()
    document.add(tomlkit.comment("Face Energy Workbench configuration. Lengths in millimetres and pixels."))
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        if isinstance(value, BaseModel):
            document.add(name, _table(value))
        elif name == "subsets":
            document.add(name, _subsets_table(value, field.description))
        elif name == "stages":
            stages = tomlkit.aot()
            for stage in value:
                stages.append(_table(stage))
            document.add(name, stages)
        elif value is not None:
            document.add(name, _commented(value, field.description))
    return tomlkit.dumps(document)


def _table(section: BaseModel):
    table = tomlkit.table()
    if section.__doc__ and not isinstance(section, Stage):
        table.comment(section.__doc__.splitlines()[0])
    for name, field in type(section).model_fields.items():
        value = getattr(section, name)
        if value is None or (value == () and isinstance(section, Stage)):
            continue
        table.add(name, _commented(value, field.description))
    return table


def _subsets_table(subsets: Mapping[str, Sequence[int]], description: str | None):
    table = tomlkit.table().comment(description or "")
    for name, points in subsets.items():
        table.add(name, list(points))
    return table


def _commented(value: Any, description: str | None):
    if isinstance(value, dict):
        item = tomlkit.inline_table()
        item.update(value)
    else:
        item = tomlkit.item(list(value) if isinstance(value, tuple) else value)
    return item.comment(description) if description else item
