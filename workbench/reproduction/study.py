"""Remaking figures and tables of the papers: what an item is given, what it gives back, and how results are kept."""

import csv
import json
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import workbench
from workbench.config import preset
from workbench.errors import InputError
from workbench.files import atomic_path, make_folder
from workbench.frames import write_picture
from workbench.landmarks.detection import RECOMMENDED
from workbench.pipeline import Progress
from workbench.plots import LIGHT, Picture, on_page
from workbench.reading import checked_content, checked_json, reading
from workbench.reproduction.items import ITEMS, Item
from workbench.tracking.unwatched import silent

RESULT = "result.json"
FIGURE_DPI = 160
NETWORK = preset("deep-energies").deep.network
"""N of every study, where `deep` by itself has an ensemble: presets are to differ in what the paper prints."""


@dataclass(frozen=True)
class Study:
    """What an item may use."""

    folder: Path
    """For everything worth keeping between two runs on the same data; `overwrite` of its own item empties it."""
    quick: bool = False
    """On a small part of the data: shows that it works, not what it finds."""
    boston: Path | None = None
    """Boston University's set, if there is one."""
    poses: tuple[Path, ...] = ()
    """Head poses of other programs on that set (`head_pose.read_poses`)."""
    meshes: Path | None = None
    """Folder with meshes that other programs made (`mesh_files.read_mesh_folder`), if there is one."""
    progress: Progress = silent
    clip: Path | None = None
    """A clip of the user's, if there is one."""


@dataclass(frozen=True)
class Table:
    """A table of a result."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Result:
    """What an item found."""

    data: str
    """What it was found on, in a sentence."""
    figures: Mapping[str, Figure | Picture] = field(default_factory=dict)
    """By caption."""
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()
    """Sentences: what to see, and what is unlike the paper's."""
    pictures: Mapping[str, Picture] = field(default_factory=dict)
    """What other programs may work on, by file name without suffix."""


def check_data(
    items: Iterable[Item],
    *,
    boston: Path | None = None,
    poses: Sequence[Path] = (),
    meshes: Path | None = None,
    clip: Path | None = None,
) -> None:
    """Raise `InputError` if a given file or folder does not exist or none of these items reads it."""
    items = tuple(items)
    given = [("boston", boston, "reads_set"), *(("poses", path, "reads_set") for path in poses)]
    for name, path, reads in (*given, ("meshes", meshes, "reads_meshes"), ("clip", clip, "reads_clip")):
        if path is None:
            continue
        if not os.path.exists(path):
            raise InputError(f"{path} does not exist; check the name and the folder.")
        if not any(getattr(item, reads) for item in items):
            readers = ", ".join(item.name for item in ITEMS if getattr(item, reads))
            raise InputError(f"None of these items reads --{name}; choose {readers} as well.")


@on_page(LIGHT)
def run(
    items: Iterable[Item],
    folder: str | Path,
    *,
    quick: bool = False,
    boston: Path | None = None,
    poses: Sequence[Path] = (),
    meshes: Path | None = None,
    clip: Path | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> tuple[tuple[Item, bool], ...]:
    """Remake items in `folder`, each in its own subfolder: figures as PNG, tables as CSV, and `result.json`.

    An item that has been made from the same inputs is left as it is, with `quick` also one that was made on all of the
    data, and one that was interrupted continues from what it had kept; items that share a folder find there what the
    others kept. Returns the items, and whether each was made now. Raises `OutputError` if nothing can be written.
    """
    folder, made = make_folder(folder), []
    for item in items:
        own = make_folder(folder / item.name)
        basis = {"version": workbench.__version__, "quick": quick, "detector": RECOMMENDED}
        if item.reads_set:
            basis["boston"] = "" if boston is None else [str(boston.resolve()), _stamps(boston)]
        if item.reads_clip:
            basis["clip"] = "" if clip is None else [str(clip.resolve()), _stamps(clip)]
        kept = folder / (item.shares or item.name) / f"kept-{_digest(json.dumps(basis).encode())}"
        inputs = basis | ({"poses": _digests(poses)} if item.reads_set else {})
        if item.reads_meshes:
            inputs |= {"meshes": _stamps(meshes)}
        if overwrite and not item.shares:
            shutil.rmtree(kept, ignore_errors=True)
        before = _stored(own / RESULT)
        fresh = overwrite or before.get("inputs") not in (inputs, inputs | {"quick": False})
        if fresh:
            study = Study(kept, quick, boston, tuple(poses), meshes, progress, clip)
            module, function = item.make.split(":")
            _write(item, getattr(import_module(f"workbench.reproduction.{module}"), function)(study), own, inputs)
            for name in _files(before) - _files(_stored(own / RESULT)):
                (own / name).unlink(missing_ok=True)
        made.append((item, fresh))
    return tuple(made)


def results(folder: str | Path) -> tuple[tuple[Item, dict[str, Any]], ...]:
    """The items made in a folder, and what their `result.json` says."""
    stored = ((item, _stored(Path(folder) / item.name / RESULT)) for item in ITEMS)
    return tuple((item, content) for item, content in stored if content)


def _digests(files: Iterable[Path]) -> dict[str, str]:
    """What tells whether files are still the same. Raises `InputError` for one that cannot be read."""
    return {str(path): _digest(checked_content(path, "a table of head poses")) for path in files}


def _stamps(given: Path | None) -> dict[str, list[int]]:
    """Size and time of a file, or of every file below a folder: who reads them says what is missing or damaged."""
    found = [] if given is None else [given, *given.rglob("*")]
    files = sorted(path for path in found if path.is_file())
    return {str(path): [path.stat().st_size, path.stat().st_mtime_ns] for path in files}


def _digest(content: bytes) -> str:
    return sha256(content).hexdigest()[:12]


def _stored(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    with reading(path, "a result", "delete it and run again"):
        return dict(checked_json(checked_content(path, "a result")))


def _files(result: Mapping[str, Any]) -> set[str]:
    """Names of the figures and tables of a result."""
    return {Path(part["file"]).name for kind in ("figures", "tables") for part in result.get(kind, ())}


def _write(item: Item, result: Result, folder: Path, inputs: dict[str, Any]) -> None:
    for name, picture in result.pictures.items():
        write_picture(folder / f"{name}.png", picture)
    pictures = []
    for number, (caption, figure) in enumerate(result.figures.items(), 1):
        path = folder / f"{item.name}-{number}.png"
        if isinstance(figure, np.ndarray):
            write_picture(path, figure)
        else:
            with atomic_path(path) as temporary:
                figure.savefig(temporary, format="png", dpi=FIGURE_DPI)
        pictures.append({"caption": caption, "file": path.name})
    tables = []
    for number, table in enumerate(result.tables, 1):
        path = folder / f"{item.name}-{number}.csv"
        with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream).writerows([table.header, *table.rows])
        tables.append({"title": table.title, "header": table.header, "rows": table.rows, "file": path.name})
    content = {
        "inputs": inputs, "data": result.data, "figures": pictures, "tables": tables, "notes": result.notes,
    }  # fmt: skip
    with atomic_path(folder / RESULT) as temporary:
        temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False), encoding="utf-8")
