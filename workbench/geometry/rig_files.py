"""Rigs in files: our `rig.toml`, and what OpenCV's `cv2.FileStorage` writes after a calibration.

`rig.toml`, the first view being the reference:

    unit = "mm"                        # of the translations: "mm", "cm" or "m"
    pose = "view_from_world"           # optional: OpenCV's x_view = R·x_world + t; or "world_from_view"

    [[views]]
    name = "left"
    image_size = [1280, 720]           # width, height
    matrix = [[1100.0, 0.0, 639.5], [0.0, 1100.0, 359.5], [0.0, 0.0, 1.0]]
    distortion = [-0.1, 0.02, 0.0, 0.0, 0.0]   # optional: OpenCV's 4, 5 or 8 coefficients
    rotation = [0.0, 0.0, 0.0]         # axis-angle in radians (OpenCV's rvec), or a 3 × 3 matrix
    translation = [0.0, 0.0, 0.0]

OpenCV files (.yml, .yaml, .json, .xml) come as a pair's stereo calibration, in one file or as intrinsics and
extrinsics: matrices `K1 K2` (or `M1`, `cameraMatrix1`, `camera_matrix1`), `D1 D2` (`distCoeffs1`, `dist_coeffs1`),
`R T`, the second camera seen from the first, as `cv2.stereoCalibrate` returns them; or as a file a camera with
`camera_matrix` (`K`, `M`, `cameraMatrix`), `distortion_coefficients` (`D`, `distCoeffs`, `dist_coeffs`), `rvec` or `R`,
`tvec` or `T`. They may say `image_width` and `image_height` (or `image_size`), `unit` and `pose` as above. What a file
does not say is OpenCV's: its pose convention, and `unit` and picture size must then be known by who reads it. The
rational model may have 12 or 14 coefficients, as OpenCV writes it, if those after the eighth are 0. A file a camera is
named by `name`, else by the file; files of one name by their folders.
"""

import difflib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.files import atomic_path
from workbench.geometry.camera import camera_from_matrix
from workbench.geometry.opencv_files import SUFFIXES as OPENCV_SUFFIXES
from workbench.geometry.opencv_files import read_opencv_file
from workbench.geometry.rig import Rig, View
from workbench.reading import checked_file, reading, shortened, toml_tables

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
POSES = ("view_from_world", "world_from_view")
TOP_KEYS = ("version", "unit", "pose", "views")
VIEW_KEYS = ("name", "image_size", "matrix", "distortion", "rotation", "translation")
VERSION = 1
LARGEST = 1e9
"""Of all numbers of a calibration; more is a damaged one."""
LONGEST_NAME = 100

MATRIX_NAMES = ("camera_matrix", "cameraMatrix", "K", "M")
DISTORTION_NAMES = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D")
ROTATION_NAMES = ("rvec", "R", "rotation")
TRANSLATION_NAMES = ("tvec", "T", "t", "translation")
SIZE_NAMES = ("image_size", "imageSize")
_WANTED = re.compile(
    "|".join(
        [
            *(f"{name}[12]?" for name in (*MATRIX_NAMES, *DISTORTION_NAMES, "name")),
            *(*ROTATION_NAMES, *TRANSLATION_NAMES, *SIZE_NAMES),
            *("image_width", "image_height", "unit", "pose", "fisheye_model"),
        ]
    )
)
"""Entries of OpenCV's files that are read."""


def read_rig(
    paths: str | Path | Sequence[str | Path], unit: str | None = None, image_size: tuple[int, int] | None = None
) -> Rig:
    """The rig of a `rig.toml`, or of one or several OpenCV files (see the module), the reference first.

    `unit` (mm, cm, m) and `image_size` (width, height) give what OpenCV files leave out; without a unit, millimetres
    are assumed. Raises `InputError` that names the file and what to correct, also for an impossible rig (see `Rig`).
    """
    paths = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    if not paths:
        raise InputError("A rig is read from at least one file, got none.")
    for path in paths:
        absent = f"The rig file {path.absolute()} does not exist; check the name and the folder."
        checked_file(path, "a rig", absent=absent, may_be_empty=True)
        if path.suffix.lower() not in (".toml", *OPENCV_SUFFIXES):
            raise InputError(f"Rig files are .toml, or OpenCV's {', '.join(OPENCV_SUFFIXES)}; got {path.name}.")
    toml = any(path.suffix.lower() == ".toml" for path in paths)
    if toml:
        if len(paths) > 1:
            raise InputError(f"A rig.toml holds all views, got {len(paths)} files; name it alone.")
        if unit is not None or image_size is not None:
            raise InputError(f"{paths[0]} gives its own unit and picture sizes; change them there.")
    with reading(" and ".join(map(str, paths)), "a rig", "calibrate again or compare with `workbench rig --help`"):
        return _read_toml(paths[0]) if toml else _read_opencv(paths, unit, image_size)


def write_rig(rig: Rig, path: str | Path) -> None:
    """Write a rig as `rig.toml` (see the module), completely or not at all; reading it gives the same numbers.

    Raises `InputError` for another suffix.
    """
    path = Path(path)
    if path.suffix.lower() != ".toml":
        raise InputError(f"Rigs are written as .toml, got {path.name}; name another file.")
    with atomic_path(path) as temporary:
        temporary.write_text(rig_toml(rig), encoding="utf-8")


def rig_toml(rig: Rig) -> str:
    """The rig as the text of a `rig.toml`."""
    document = tomlkit.document()
    document.add(tomlkit.comment("Face Energy Workbench rig. The first view is the reference."))
    document.add("version", tomlkit.item(VERSION))
    document.add("unit", tomlkit.item("mm").comment("of the translations: mm, cm or m"))
    document.add("pose", tomlkit.item(POSES[0]).comment("x_view = rotation · x_world + translation"))
    views = tomlkit.aot()
    for view in rig.views:
        (fx, fy), (cx, cy) = view.camera.focal_px.tolist(), view.camera.principal_point_px.tolist()
        table = tomlkit.table()
        table.add("name", view.name)
        table.add("image_size", tomlkit.item(list(view.image_size)).comment("width, height"))
        table.add("matrix", _rows([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]))
        table.add(
            "distortion", tomlkit.item(view.camera.distortion.tolist()).comment("OpenCV: k1 k2 p1 p2 k3 k4 k5 k6")
        )
        table.add("rotation", _rows(view.rotation_view_world.tolist()))
        table.add("translation", tomlkit.item(view.translation_view_world_mm.tolist()))
        views.append(table)
    document.add("views", views)
    return tomlkit.dumps(document)


def _rows(matrix: list[list[float]]) -> tomlkit.items.Array:
    array = tomlkit.item(matrix)
    return array.multiline(True)


# --- rig.toml ---


def _read_toml(path: Path) -> Rig:
    stored = toml_tables(path)
    _check_keys(str(path), stored, TOP_KEYS, ("unit", "views"))
    if stored.get("version", VERSION) != VERSION:
        version = _shortened(stored["version"])
        raise InputError(f"{path}: version is {version}, this workbench reads {VERSION}; upgrade it.")
    views = stored["views"]
    if not isinstance(views, list) or not all(isinstance(view, dict) for view in views):
        raise InputError(f"{path}: views must be tables; begin each with a line [[views]].")
    mm, pose = _scale(path, stored["unit"]), _pose(path, stored.get("pose", POSES[0]))
    return _built(str(path), [_toml_view(f"{path}, view {i + 1}", view, mm, pose) for i, view in enumerate(views)])


def _toml_view(where: str, view: Mapping[str, Any], mm: float, pose: str) -> View:
    _check_keys(where, view, VIEW_KEYS, tuple(key for key in VIEW_KEYS if key != "distortion"))
    if not isinstance(view["name"], str):
        raise InputError(f"{where}: name is {_shortened(view['name'])}, expected text in quotes.")
    return _view(where, view["name"], _image_size(where, view["image_size"]), view, mm, pose)


def _check_keys(where: str, table: Mapping[str, Any], known: Sequence[str], needed: Sequence[str]) -> None:
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            hint = near[0] if near else ", ".join(known)
            raise InputError(f"{where}: unknown key {_shortened(key)}; did you mean {hint}?")
    missing = [key for key in needed if key not in table]
    if missing:
        raise InputError(f"{where}: {', '.join(missing)} is missing; a rig.toml needs {', '.join(needed)} there.")


# --- OpenCV ---


def _read_opencv(paths: Sequence[Path], unit: str | None, image_size: tuple[int, int] | None) -> Rig:
    files = [read_opencv_file(path, _WANTED) for path in paths]
    for path, file in zip(paths, files, strict=True):
        if file.get("fisheye_model"):
            raise InputError(f"{path} uses OpenCV's fisheye model; calibrate with the ordinary or the rational one.")
    merged: dict[str, Any] = {}
    for file in files:
        merged |= file
    where = " and ".join(map(str, paths))
    if _named(merged, MATRIX_NAMES, "1") is not None:
        _check_one_pair(where, files)
        return _stereo(where, merged, unit, image_size)
    views = []
    for path, name, file in zip(paths, _file_names(paths), files, strict=True):
        fields = {"matrix": _named(file, MATRIX_NAMES), "distortion": _named(file, DISTORTION_NAMES)}
        if fields["matrix"] is None:
            raise InputError(f"{path} holds no camera matrix (camera_matrix, or K1 and K2); its keys: {_keys(file)}.")
        fields |= {"rotation": _named(file, ROTATION_NAMES), "translation": _named(file, TRANSLATION_NAMES)}
        for key, names in (("rotation", "rvec or R"), ("translation", "tvec or T")):
            if fields[key] is None:
                raise InputError(f"{path} does not say where its camera is: no {key} ({names}) is in it.")
        size = _opencv_size(path, file, image_size)
        mm, pose = _opencv_unit(path, file, unit), _pose(path, file.get("pose", POSES[0]))
        views.append(_view(str(path), str(file.get("name", name)), size, fields, mm, pose))
    return _built(where, views)


def _file_names(paths: Sequence[Path]) -> list[str]:
    """What cameras are called after their files: the stems, or where stems are alike the folders."""
    stems = [path.stem for path in paths]
    return [path.absolute().parent.name if stems.count(path.stem) > 1 else path.stem for path in paths]


def _check_one_pair(where: str, files: Sequence[Mapping[str, Any]]) -> None:
    """Raise `InputError` for the files of several pairs, which have no place for one another."""
    matrices = sum(_named(file, MATRIX_NAMES, "1") is not None for file in files)
    if matrices > 1 or sum(file.get("R") is not None for file in files) > 1:
        raise InputError(
            f"{where} belong to several pairs of cameras; name those of one pair, or for three or more cameras one "
            "file each, with its matrix and pose."
        )


def _stereo(where: str, file: Mapping[str, Any], unit: str | None, image_size: tuple[int, int] | None) -> Rig:
    """A pair as `cv2.stereoCalibrate` has it: x_2 = R·x_1 + T."""
    rotation, translation = file.get("R"), file.get("T")
    if rotation is None or translation is None:
        raise InputError(
            f"{where} has two cameras but no R and T between them; name the file with the extrinsic parameters too."
        )
    mm, pose = _opencv_unit(where, file, unit), _pose(where, file.get("pose", POSES[0]))
    places = [(np.zeros(3), np.zeros(3)), (rotation, translation)]
    views = []
    for number, (turned, moved) in zip("12", places, strict=True):
        matrix = _named(file, MATRIX_NAMES, number)
        if matrix is None:
            raise InputError(
                f"{where} holds no matrix for camera {number} (K{number} or M{number}); write both cameras."
            )
        fields = {"matrix": matrix, "distortion": _named(file, DISTORTION_NAMES, number)}
        fields |= {"rotation": turned, "translation": moved}
        name, size = str(file.get(f"name{number}", f"camera{number}")), _opencv_size(where, file, image_size)
        views.append(_view(f"{where}, camera {number}", name, size, fields, mm, pose))
    return _built(where, views)


def _named(file: Mapping[str, Any], names: Sequence[str], number: str = "") -> Any:
    """The first entry by any of its names, None if there is none."""
    return next((file[name + number] for name in names if file.get(name + number) is not None), None)


def _opencv_unit(where: str | Path, file: Mapping[str, Any], unit: str | None) -> float:
    stored = file.get("unit")
    if unit is not None and stored is not None and unit != stored:
        told = _shortened(stored)
        raise InputError(f"{where} says that its unit is {told}, and {unit!r} was asked for; leave one out.")
    return _scale(where, unit or stored or "mm")


def _opencv_size(where: str | Path, file: Mapping[str, Any], image_size: tuple[int, int] | None) -> tuple[int, int]:
    stored = _named(file, SIZE_NAMES)
    if stored is None and "image_width" in file and "image_height" in file:
        stored = [file["image_width"], file["image_height"]]
    if stored is None and image_size is None:
        raise InputError(
            f"{where} names no picture size (image_width, image_height); give it with --size, for example 1280x720."
        )
    size = _image_size(str(where), stored if stored is not None else image_size)
    if image_size is not None and size != image_size:
        told, asked = (f"{width} × {height}" for width, height in (size, image_size))
        raise InputError(f"{where} says that its pictures are {told}, and {asked} was asked for; leave out --size.")
    return size


# --- both ---


def _view(where: str, name: str, image_size: tuple[int, int], fields: Mapping[str, Any], mm: float, pose: str) -> View:
    if not name.isprintable() or len(name) > LONGEST_NAME:
        raise InputError(f"{where}: name is {_shortened(name)}, expected at most {LONGEST_NAME} letters on one line.")
    matrix = _numbers(where, "matrix", fields["matrix"], (9,)).reshape(3, 3)
    distortion = fields.get("distortion")
    coefficients = np.zeros(0) if distortion is None else _numbers(where, "distortion", distortion, None)
    rotation = _numbers(where, "rotation", fields["rotation"], (3, 9))
    matrix_view_world = Rotation.from_rotvec(rotation).as_matrix() if rotation.size == 3 else rotation.reshape(3, 3)
    translation = mm * _numbers(where, "translation", fields["translation"], (3,))
    try:
        if pose == POSES[1]:
            # Checked as it stands in the file: the inverse below would hide a scale.
            View(name, image_size, camera_from_matrix(matrix, coefficients), matrix_view_world, translation)
            matrix_view_world, translation = matrix_view_world.T, -matrix_view_world.T @ translation
        return View(name, image_size, camera_from_matrix(matrix, coefficients), matrix_view_world, translation)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _built(where: str, views: Sequence[View]) -> Rig:
    try:
        return Rig(tuple(views))
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _numbers(where: str, key: str, value: Any, counts: tuple[int, ...] | None) -> Float[np.ndarray, "n"]:
    expected = f"expected {' or '.join(map(str, counts))} numbers" if counts else "expected numbers"
    try:
        numbers = np.asarray(value, float).ravel()
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: {key} is {_shortened(value)}, {expected}.") from None
    if counts is not None and numbers.size not in counts:
        raise InputError(f"{where}: {key} has {numbers.size} entries, {expected}.")
    if not np.isfinite(numbers).all():
        raise InputError(f"{where}: {key} holds a number that is not finite; calibrate again.")
    if (np.abs(numbers) > LARGEST).any():
        raise InputError(f"{where}: {key} holds a number beyond {LARGEST:g}; calibrate again.")
    return numbers


def _image_size(where: str, value: Any) -> tuple[int, int]:
    numbers = _numbers(where, "image_size", value, (2,))
    if not (numbers >= 1).all() or (numbers % 1).any():
        raise InputError(f"{where}: image_size is {_shortened(value)}, expected width and height in whole pixels.")
    return int(numbers[0]), int(numbers[1])


def _scale(where: str | Path, unit: Any) -> float:
    if not isinstance(unit, str) or unit not in MM_PER_UNIT:
        raise InputError(
            f"{where}: unit is {_shortened(unit)}; say what lengths are measured in: {', '.join(MM_PER_UNIT)}."
        )
    return MM_PER_UNIT[unit]


def _pose(where: str | Path, pose: Any) -> str:
    if pose not in POSES:
        raise InputError(
            f"{where}: pose is {_shortened(pose)}; it is {POSES[0]} (OpenCV's x_view = R·x_world + t) or {POSES[1]}."
        )
    return pose


def _keys(file: Mapping[str, Any]) -> str:
    return shortened(", ".join(file)) or "none"


def _shortened(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
