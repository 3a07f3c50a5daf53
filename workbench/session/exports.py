"""Files that an export would overwrite: what they were exported for, and a free name instead."""

from pathlib import Path

from workbench.config import read_config
from workbench.errors import WorkbenchError


def exported_for(path: Path) -> str:
    """Names of the inputs that an exported configuration was tuned on; empty where the file does not say."""
    try:
        provenance = read_config(path).provenance
    except (WorkbenchError, OSError):
        return ""
    inputs = [] if provenance is None else provenance.inputs
    return ", ".join(Path(entry.partition(" sha256:")[0]).name for entry in inputs)


def free_file(folder: Path, name: str) -> Path:
    """The first path of NAME-tuned.toml, NAME-tuned-2.toml, … that is not there yet."""
    number, found = 1, folder / f"{name}-tuned.toml"
    while found.exists():
        number += 1
        found = folder / f"{name}-tuned-{number}.toml"
    return found


def taken_text(path: Path, name: str) -> str:
    """That a file is there already, and what to do; `name` is that of the material, for the proposed name."""
    whose = exported_for(path)
    return (
        f"{path} is there already{f', exported for {whose}' if whose else ''}; export to "
        f"{free_file(path.parent, name).name} instead, or pass overwrite=True."
    )
