"""Image derivatives of the renderer against central differences of supersampled pictures, over random scenes.

A picture is differenced over ±STEP_PX: twice without any smoothing, the mean of 16 × 16 points per pixel. Such a
difference quotient is the mean of the true derivative over the step, and as a contour passes from pixel to pixel that
derivative jumps; so it is compared with the mean of the renderer's derivative over the same step (`NODES` points).
The details also give the renderer's derivative at the middle alone, which no exact derivative could match better.
"""

import argparse

import numpy as np
from rendering_scenes import CLASSES, Differentiator, RenderScene, agreement, moved, random_scene
from result import print_result

SIZE_PX = 256
SUPERSAMPLING = 16
STEP_PX = 0.5
NODES = 24
LEAST_COSINE, LARGEST_ERROR = 0.98, 0.10


def main() -> None:
    """Print one line for each class of parameters, then the summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--samples", type=int, default=2, help="shaded points per pixel and side")
    arguments = parser.parse_args()
    tool = Differentiator(SIZE_PX, SUPERSAMPLING)
    smooth = tool.derivative(samples=arguments.samples)
    rough = tool.derivative(samples=arguments.samples, antialias=False)
    rows = {name: [] for name in CLASSES}
    for seed in range(arguments.scenes):
        scene = random_scene(tool.head, seed)
        for name in CLASSES:
            rows[name].append(compare(tool, scene, name, smooth, rough))
    details = {"scenes": arguments.scenes, "samples": arguments.samples, "size_px": SIZE_PX, "step_px": STEP_PX}
    cosines = []
    for name, measured in rows.items():
        columns = {key: np.array([row[key] for row in measured]) for key in measured[0]}
        cosines.append(float(np.median(columns["cosine"])))
        line = summary(columns)
        details[name] = line
        print_result(f"rendering_gradient_{name}", cosines[-1], "cosine", ">= 0.98", "central differences", line)
    print_result("rendering_gradient", min(cosines), "cosine", ">= 0.98", "central differences", details)


def compare(tool: Differentiator, scene: RenderScene, name: str, smooth, rough) -> dict[str, float]:
    """Cosine and relative error of one scene's derivative along one direction."""
    direction = scene.directions[name]
    step = tool.step(scene, direction, STEP_PX)
    reference = tool.central_difference(scene, direction, step)
    places = step * ((np.arange(NODES) + 0.5) / NODES * 2.0 - 1.0)
    mean = np.mean([smooth(moved(scene.parameters, direction, place), direction, scene) for place in places], axis=0)
    cosine, error = agreement(mean, reference)
    at_once = agreement(smooth(scene.parameters, direction, scene), reference)
    without = agreement(rough(scene.parameters, direction, scene), reference)
    return {
        "cosine": cosine,
        "error": error,
        "cosine_at_middle": at_once[0],
        "error_at_middle": at_once[1],
        "cosine_without_edges": without[0],
        "error_without_edges": without[1],
    }


def summary(columns: dict[str, np.ndarray]) -> dict[str, float]:
    """Median and worst of each number, and how many scenes keep both bounds."""
    line = {f"{key}_median": float(np.median(values)) for key, values in columns.items()}
    line |= {"cosine_worst": float(columns["cosine"].min()), "error_worst": float(columns["error"].max())}
    kept = (columns["cosine"] >= LEAST_COSINE) & (columns["error"] <= LARGEST_ERROR)
    line |= {"scenes_within_0.98_and_10_percent": int(kept.sum())}
    return line | {"cosines": [round(float(c), 3) for c in columns["cosine"]],
                   "errors": [round(float(e), 3) for e in columns["error"]]}  # fmt: skip


if __name__ == "__main__":
    main()
