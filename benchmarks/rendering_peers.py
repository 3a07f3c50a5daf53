"""Speed and error of the derivative at silhouettes beside Mitsuba 3 (`direct_projective`, LLVM), on the same scenes.

Both render the coverage of the default head and differentiate it along a motion; the judge is a central difference of
coverage with 16 × 16 points per pixel. Mitsuba needs not be in this environment: `--python` names an interpreter that
has it.
"""

import argparse
import functools
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from rendering_scenes import FOV_DEG, Differentiator, agreement, moved, random_scene
from result import print_result

from workbench.rendering import face_vertices, render

SIZE_PX = 256
STEP_PX = 0.5
NODES = 8
SCENES = 3
PEER_SAMPLES = (16, 64, 256)
ROUNDS = 8
PEER = Path(__file__).parent / "peers" / "mitsuba_coverage.py"
AGAINST = "Mitsuba 3 direct_projective, llvm_ad_rgb"


def main() -> None:
    """Print the cosine of both derivatives with the judge, and both times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", default=sys.executable, help="an interpreter that can import mitsuba")
    interpreter = parser.parse_args().python
    probe = subprocess.run([interpreter, "-c", "import mitsuba"], capture_output=True, text=True)
    if probe.returncode:
        reason = "Mitsuba is not installed; pip install mitsuba elsewhere and pass --python"
        return print_result("rendering_peers", None, "ratio", None, AGAINST, {"skipped": reason})
    tool = Differentiator(SIZE_PX, 16)
    rows = [compare(tool, seed, interpreter) for seed in range(SCENES)]
    details = {key: float(np.median([row[key] for row in rows])) for key in rows[0]}
    ratio = details[f"mitsuba_{PEER_SAMPLES[-1]}_spp_ms"] / details["ours_2_ms"]
    print_result("rendering_peers", ratio, "times faster", None, AGAINST, details | {"scenes": SCENES})


def compare(tool: Differentiator, seed: int, interpreter: str) -> dict[str, float]:
    """One scene's head moved along a random translation."""
    scene = random_scene(tool.head, seed)
    direction = scene.directions["translation"]
    step = tool.step(scene, direction, STEP_PX)
    white, black, light = jnp.ones_like(tool.model.colors), jnp.zeros(3), scene.light

    def coverage(parameters, offset, **options):
        camera = tool.camera._replace(principal_point_px=tool.camera.principal_point_px - offset)
        vertices = face_vertices(tool.model, parameters)
        mesh = tool.model.topology
        return render(vertices, mesh, camera, white, light, black, size=tool.size, **options).coverage

    grid = jnp.asarray(np.stack(np.meshgrid(*[(np.arange(16) + 0.5) / 16 - 0.5] * 2), -1).reshape(-1, 2), jnp.float32)
    fine = jax.jit(
        lambda p: jax.lax.map(lambda offset: coverage(p, offset, antialias=False), grid).mean(axis=0)
    )  # fmt: skip
    ends = [np.asarray(fine(moved(scene.parameters, direction, sign * step)), float) for sign in (1.0, -1.0)]
    reference = (ends[0] - ends[1]) / (2.0 * step)
    places = step * ((np.arange(NODES) + 0.5) / NODES * 2.0 - 1.0)
    row = {}
    still = jnp.zeros(2, jnp.float32)
    faces = [moved(scene.parameters, direction, place) for place in places]
    for samples in (1, 2):
        sampled = functools.partial(coverage, offset=still, samples=samples)
        both = jax.jit(lambda p, picture=sampled: jax.jvp(picture, (p,), (direction,)))
        mean = np.mean([np.asarray(both(face)[1], float) for face in faces], axis=0)
        row[f"ours_{samples}_cosine"], row[f"ours_{samples}_error"] = agreement(mean, reference)
        seconds = []
        for _ in range(ROUNDS):
            began = time.perf_counter()
            jax.block_until_ready(both(scene.parameters))
            seconds.append(time.perf_counter() - began)
        row[f"ours_{samples}_ms"] = 1e3 * min(seconds)
    vertices = np.stack([np.asarray(face_vertices(tool.model, face)) for face in faces])
    motion = np.broadcast_to(np.asarray(direction.translation), vertices.shape[1:])
    return row | peer_row(interpreter, vertices, motion, tool, reference)


def peer_row(interpreter: str, vertices: np.ndarray, motion: np.ndarray, tool: Differentiator, reference):
    """The same in Mitsuba: its derivative averaged over the same step."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "scene.npz", Path(folder) / "result.npz"
        np.savez(
            source, vertices=vertices, motion=motion, triangles=tool.head.triangles,
            size_px=SIZE_PX, fov_deg=FOV_DEG, samples=PEER_SAMPLES,
        )  # fmt: skip
        subprocess.run([interpreter, PEER, source, target], check=True)
        with np.load(target, allow_pickle=False) as result:
            derivatives = {samples: result[f"derivative_{samples}"] for samples in PEER_SAMPLES}
            row = {f"mitsuba_{samples}_spp_ms": 1e3 * float(result[f"seconds_{samples}"]) for samples in PEER_SAMPLES}
    for samples in PEER_SAMPLES:
        name = f"mitsuba_{samples}_spp"
        row[f"{name}_cosine"], row[f"{name}_error"] = agreement(derivatives[samples], reference)
    return row


if __name__ == "__main__":
    main()
