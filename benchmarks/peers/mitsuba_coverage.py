"""Coverage of a mesh and its derivative along a motion in Mitsuba 3, for `rendering_peers.py`.

Runs under an interpreter that has Mitsuba: `python mitsuba_coverage.py IN.npz OUT.npz`. The mesh glows with radiance 1
before black, so the picture is its coverage; `direct_projective` samples silhouettes.
"""

import sys
import tempfile
import time
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

# Mitsuba has no classes before a variant is chosen.
mi.set_variant("llvm_ad_rgb")


def main() -> None:
    """Read the scene, write the mean derivative over several places of the mesh and the best time of one of them."""
    with np.load(sys.argv[1], allow_pickle=False) as stored:
        scene_arrays = {name: stored[name] for name in stored.files}
    with tempfile.TemporaryDirectory() as folder:
        scene = load_scene(scene_arrays, Path(folder) / "head.ply")
    results = {}
    for samples in scene_arrays["samples"].tolist():
        seconds, derivatives = [], []
        for seed, vertices in enumerate(scene_arrays["vertices"]):
            began = time.perf_counter()
            derivatives.append(differentiate(scene, vertices, scene_arrays["motion"], samples, seed))
            seconds.append(time.perf_counter() - began)
        results[f"derivative_{samples}"] = np.mean(derivatives, axis=0)
        # The first round compiles.
        results[f"seconds_{samples}"] = np.float64(min(seconds[1:]))
    np.savez(sys.argv[2], **results)


def load_scene(arrays: dict[str, np.ndarray], file: Path) -> mi.Scene:
    """The mesh in front of a pinhole camera that looks along +z with y down."""
    mesh = mi.Mesh("head", arrays["vertices"].shape[1], len(arrays["triangles"]))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = arrays["vertices"][0].astype(np.float32).ravel()
    parameters["faces"] = arrays["triangles"].astype(np.uint32).ravel()
    parameters.update()
    mesh.write_ply(str(file))
    size = int(arrays["size_px"])
    view = mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0])
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "fov": float(arrays["fov_deg"]), "to_world": view, "film": film},
            "head": {
                "type": "ply",
                "filename": str(file),
                "face_normals": True,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
        }
    )


def differentiate(scene: mi.Scene, vertices, motion, samples: int, seed: int) -> np.ndarray:
    """The forward derivative of coverage along the vertices' motion."""
    integrator = mi.load_dict({"type": "direct_projective", "sppc": samples, "sppp": samples, "sppi": 0})
    parameters = mi.traverse(scene)
    start, way = (mi.Float(array.astype(np.float32).ravel()) for array in (vertices, motion))
    step = mi.Float(0.0)
    dr.enable_grad(step)
    parameters["head.vertex_positions"] = start + step * way
    parameters.update()
    picture = mi.render(scene, parameters, integrator=integrator, spp=samples, seed=seed)
    dr.forward(step)
    return np.array(dr.grad(picture)).mean(axis=-1)


if __name__ == "__main__":
    main()
