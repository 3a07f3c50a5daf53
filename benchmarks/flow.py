"""The bundled flow network on pairs that it has not seen, against OpenCV's DIS and Farnebäck on the same pairs.

The pairs come from a seed that the training does not use: heads that turn and speak before a moving ground, exact flow
from the mesh. "Clean" is without noise, blur, compression and occluders. The value is the network's mean error over the
better of the other two: below 1 it beats both, on clean and on damaged pairs.
"""

import argparse
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from result import print_result
from timing import least_ms

from workbench.flow import DisFlow, FarnebackFlow, bundled_flow
from workbench.pictures.gl_probe import gl_available

SEED = 2311
TANGENTS = 4


def main() -> None:
    """Print the ratio of end-point errors inside the face."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--pairs", type=int, default=240)
    arguments.add_argument("--side", type=int, default=256, help="pixels of the pictures and of the network's input")
    arguments.add_argument("--pool", type=Path, help="a pool of pairs made before, instead of new ones")
    options = arguments.parse_args()
    common = {"name": "flow", "unit": "of the better one's error", "goal": "<= 1.0"}
    if not gl_available():
        print_result(**common, value=None, against="pairs", details={"skipped": "VTK finds no OpenGL here"})
        return
    # PyTorch is not needed, but the rest of the training code is.
    from workbench.training.flow_measuring import measured_flow
    from workbench.training.flow_pool import make_pair_pool, open_pair_pool

    network = bundled_flow(options.side)
    estimators = {"network": network, "dis": DisFlow(), "farneback": FarnebackFlow()}
    with tempfile.TemporaryDirectory() as folder:
        pool = options.pool or Path(folder)
        if options.pool is None:
            make_pair_pool(pool, options.pairs, SEED, workers=2)
        tables = measured_flow(estimators, open_pair_pool(pool), options.pairs, options.side)
    ratios = {
        kind: rows["network"]["face"] / min(rows["dis"]["face"], rows["farneback"]["face"])
        for kind, rows in tables.items()
    }
    print_result(
        **common,
        value=max(ratios.values()),
        against="DIS and Farnebäck of OpenCV, the same pairs, visible pixels of the face",
        details={**{f"ratio, {kind}": ratio for kind, ratio in ratios.items()}, **tables, **_speed(network)},
    )


def _speed(network) -> dict[str, float]:
    """Milliseconds of one call, and of a tangent in calls."""
    rng = np.random.default_rng(0)
    first, second = jnp.asarray(rng.random((2, network.side, network.side, 3)), jnp.float32)
    changes = jnp.asarray(rng.random((TANGENTS, *second.shape)), jnp.float32)
    flow = jax.jit(network.traced)

    def tangent(second, way):
        return jax.jvp(lambda picture: network.traced(first, picture), (second,), (way,))[1]

    tangents = jax.jit(jax.vmap(tangent, in_axes=(None, 0)))
    one, many = least_ms(lambda: flow(first, second), 10), least_ms(lambda: tangents(second, changes), 10)
    return {"call_ms": one, "tangent_in_calls": (many - one) / TANGENTS / one}


if __name__ == "__main__":
    main()
