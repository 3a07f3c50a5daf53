"""Milliseconds to render the default head at 256 × 256, and the cost of a Jacobian in renders."""

import time

import jax
import jax.numpy as jnp
import numpy as np
from rendering_scenes import Differentiator, RenderScene, random_scene
from result import print_result

from workbench.face import FaceParameters

SIZE_PX = 256
ROUNDS = 20
FREE = 16
"""Free parameters of the Jacobian: six of the pose and ten blendshapes."""
GOAL_MS = "<= 15"
GOAL_RATIO = "<= 1.5"


def main() -> None:
    """The fastest of several rounds: other programs only ever slow a round down."""
    tool = Differentiator(SIZE_PX, 1)
    scene = random_scene(tool.head, 0)
    details = {"size_px": SIZE_PX, "free_parameters": FREE, "goal_forward_ms": GOAL_MS}
    for samples in (1, 2):
        forward, jacobian = programs(tool, scene, samples)
        free = jnp.zeros(FREE, jnp.float32)
        render_ms, jacobian_ms = interleaved_ms(forward, jacobian, free)
        details[f"samples_{samples}_forward_ms"] = render_ms
        details[f"samples_{samples}_jacobian_ms"] = jacobian_ms
        details[f"samples_{samples}_ratio"] = jacobian_ms / ((FREE + 1) * render_ms)
    against = "(free parameters + 1) forward renders"
    print_result("rendering", details["samples_1_ratio"], "ratio", GOAL_RATIO, against, details)


def programs(tool: Differentiator, scene: RenderScene, samples: int):
    """The picture as a function of the free parameters, and its Jacobian, one tangent per parameter."""

    def picture(free, base, light, background, model, camera):
        expression = base.expression.at[: FREE - 6].add(free[6:])
        face = FaceParameters(base.rotation + free[:3], base.translation + free[3:6], expression, base.identity)
        return tool.picture(face, RenderScene(base, light, background, {}), model, camera, samples=samples)

    rest = (scene.parameters, scene.light, scene.background, tool.model, tool.camera)
    forward, jacobian = jax.jit(picture), jax.jit(jax.jacfwd(picture))
    return (lambda free: forward(free, *rest)), (lambda free: jacobian(free, *rest))


def interleaved_ms(*functions_and_argument) -> list[float]:
    """The least milliseconds of each function, run in turn."""
    *functions, argument = functions_and_argument
    times = np.full((ROUNDS, len(functions)), np.inf)
    for round_ in range(ROUNDS):
        for k, function in enumerate(functions):
            began = time.perf_counter()
            jax.block_until_ready(function(argument))
            times[round_, k] = 1e3 * (time.perf_counter() - began)
    return times.min(axis=0).tolist()


if __name__ == "__main__":
    main()
