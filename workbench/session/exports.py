"""Exported configurations: their provenance, the command that runs them, and protection of existing files."""

import os
import shlex
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from workbench.config import Config, Hashed, differences, read_config, write_config
from workbench.errors import InputError, WorkbenchError
from workbench.export.suffixes import FORMATS, SAME
from workbench.face import FaceModel
from workbench.pipeline import software_versions
from workbench.reading import content_hash
from workbench.session.material import Material


class TakenError(InputError):
    """A configuration's file that exists and was not written by this session, or was changed since."""


class Exports:
    """Writes configurations tuned on a material. Only files that are as it wrote them are overwritten unasked."""

    def __init__(self, model: FaceModel, material: Material) -> None:
        self._model, self._material = model, material
        self._written: dict[Path, str] = {}
        """The content of each file as it was written here; another program may have changed it since."""

    def may_write(self, path: str | Path) -> bool:
        """Whether writing here overwrites nothing but this object's own exports, unchanged."""
        path = Path(path).absolute()
        try:
            return not os.path.exists(path) or (path in self._written and self._written[path] == content_hash(path))
        except InputError:  # it may no longer be read
            return False

    def check(self, path: Path, overwrite: bool) -> None:
        """Raises `TakenError` if the file exists, unless it is as written here or `overwrite` is set; `InputError` for
        the name of an animation."""
        if path.suffix.lower() in (*FORMATS, *SAME):
            raise InputError(
                f"The settings are TOML, so name them {path.with_suffix('.toml').name}; the animation is written by "
                f"workbench.export_track(session.track, session.model, {str(path)!r})."
            )
        if not overwrite and not self.may_write(path):
            raise TakenError(taken_text(path, self._material.name))

    def write(
        self, path: Path, config: Config, base: Config, before: dict[str, float], after: dict[str, float]
    ) -> None:
        """Write a configuration that was tuned from `base`, with the metrics under both."""
        provenance = {
            "exported": datetime.now(UTC).isoformat(timespec="seconds"),
            "versions": software_versions(),
            "model": str(Hashed(self._model.name, self._model.fingerprint())),
            "inputs": list(map(str, self._material.sources())),
            "landmarks": str(self._material.landmark_source() or ""),
            "changed": [str(item) for item in differences(base, config)],
            "before": before,
            "after": after,
        }
        write_config(config.changed(provenance=provenance), path)
        self._written[path.absolute()] = content_hash(path)


def track_command(material: Material, path: str | Path, config: Config, model: FaceModel | None = None) -> str:
    """The command line that runs the configuration `config`, exported to `path`, on a material; see `model_words`."""
    words = ["workbench", "track", *(material.inputs or ["INPUT"]), "--config", path]
    words += model_words(model)
    if config.traits.renders:  # other systems look at one camera
        words += [word for name, clip in material.views.items() for word in ("--view", f"{name}={clip}")]
    if material.landmark_file is not None:
        words += ["--landmarks", material.landmark_file]
    if material.part is not None:
        words += ["--frames", "{}-{}".format(*material.part)]
    if material.stills and len(material.observations) > 1:
        words.append("--stills")
    return shlex.join(str(word) for word in words)


def model_words(model: FaceModel | None) -> list[str]:
    """What a command line says of the model; a model does not know its file, for which MODEL stands.

    Nothing of the default head, which is also meant by None.
    """
    return [] if model is None or model.name == "default-head" else ["--model", "MODEL"]


def settings_for(material: Material, stored: Config, present: Config) -> Config:
    """Stored settings for a material whose points were found as `present` says, which stays as it is.

    Points moved by hand are the stored ones if they were exported for the same inputs with some.
    """
    kept = present.landmarks.kept_by_presets()
    moved = stored.landmarks.moved
    if moved and _contents(_inputs_of(stored)) == _contents(material.sources()):
        kept["moved"] = moved
    return stored.changed(landmarks=kept, provenance=present.provenance)


def _contents(inputs: Sequence[Hashed]) -> list[str]:
    """What inputs held, whatever their names are by now."""
    return [named.sha256 for named in inputs]


def _inputs_of(config: Config) -> list[Hashed]:
    return [] if config.provenance is None else list(map(Hashed.read, config.provenance.inputs))


def exported_for(path: Path) -> str:
    """Names of the inputs that an exported configuration was tuned on; empty if the file does not say."""
    try:
        inputs = _inputs_of(read_config(path))
    except (WorkbenchError, OSError):
        return ""
    return ", ".join(Path(named.name).name for named in inputs)


def free_file(folder: Path, name: str) -> Path:
    """The first of the paths NAME-tuned.toml, NAME-tuned-2.toml, … that does not exist."""
    number, found = 1, folder / f"{name}-tuned.toml"
    while found.exists():
        number += 1
        found = folder / f"{name}-tuned-{number}.toml"
    return found


def taken_text(path: Path, name: str) -> str:
    """Message that a file exists, and what to do. The proposed file name is made from `name`, the material's."""
    whose = exported_for(path)
    return (
        f"{path} exists already{f', exported for {whose}' if whose else ''}; export to "
        f"{free_file(path.parent, name).name} instead, or pass overwrite=True."
    )
