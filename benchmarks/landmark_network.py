"""The bundled landmark network on renders of people that it has not seen: error, confidence, eyes, mouth, speed.

The renders come from a seed that the training does not use. "Clean" is the framing of a detector in a good picture;
"damaged" is all that the training does to pictures (occluders, blur, noise, compression, odd colours).
"""

import argparse
import tempfile
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from result import print_result
from timing import least_ms

from workbench.landmarks.network_detector import BUNDLED, CROP_SIDE, bundled_landmark_network
from workbench.networks import crop_box, landmarks_of
from workbench.networks.frozen import FrozenNetwork
from workbench.pictures.gl_probe import gl_available

GOAL_PERCENT = "<= 2.5"
SEED = 4711
TANGENTS = 10


def main() -> None:
    """Print the mean error of the inner 51 points below 45° of yaw."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--pictures", type=int, default=480)
    arguments.add_argument("--pool", type=Path, help="a pool of renders made before, instead of new ones")
    options = arguments.parse_args()
    common = {"name": "landmark_network", "unit": "% of the outer-eye distance", "goal": GOAL_PERCENT}
    if not gl_available():
        print_result(**common, value=None, against="renders", details={"skipped": "VTK finds no OpenGL here"})
        return
    # PyTorch is not needed, but the rest of the training code is.
    from workbench.training.measuring import measured
    from workbench.training.pool import make_pool, open_pool

    with tempfile.TemporaryDirectory() as folder:
        pool = options.pool or Path(folder)
        if options.pool is None:
            make_pool(pool, options.pictures, SEED, workers=2)
        numbers = measured(BUNDLED / "landmarks.safetensors", open_pool(pool), options.pictures, CROP_SIDE)
    closed, opened = numbers["eye_aspect_closed"], numbers["eye_aspect_open"]
    print_result(
        **common,
        value=numbers["clean"]["inner 51, yaw below 45°"]["mean"],
        against="exact landmarks of clean renders, yaw below 45°",
        details={
            "clean": numbers["clean"],
            "damaged": numbers["damaged"],
            "eye_aspect_falls_by": 1 - closed / opened,
            "eye_aspect_falls_by_truth": 1 - numbers["eye_aspect_closed_true"] / numbers["eye_aspect_open_true"],
            "mouth_opening_error": numbers["mouth_opening_error"],
            "rank_correlation": numbers["rank_correlation"],
            "reliability": numbers["reliability"],
            **_speed(),
        },
    )


def _speed() -> dict[str, float]:
    """Milliseconds of a forward pass, frozen and in JAX, of the whole chain, and of a tangent of it in chains."""
    network = bundled_landmark_network()
    rng = np.random.default_rng(0)
    crop = jnp.asarray(rng.random((3, CROP_SIDE, CROP_SIDE)), jnp.float32)
    picture = jnp.asarray(rng.random((540, 720, 3)), jnp.float32)
    changes = jnp.asarray(rng.random((TANGENTS, 540, 720, 3)), jnp.float32)
    box = crop_box((200.0, 120.0, 480.0, 400.0))
    seen, frozen = np.asarray(255 * crop.transpose(1, 2, 0), np.uint8), FrozenNetwork(network)
    forward = eqx.filter_jit(network)
    chain = jax.jit(lambda picture: landmarks_of(network, picture, box).points)
    tangents = jax.jit(lambda: jax.vmap(lambda change: jax.jvp(chain, (picture,), (change,))[1])(changes))
    runs = (lambda: frozen(seen), lambda: forward(crop), lambda: chain(picture), tangents)
    quick, one, whole, many = (least_ms(run, 15) for run in runs)
    return {
        "frozen_ms": quick,
        "forward_ms": one,
        "chain_720x540_ms": whole,
        "tangent_in_chains": (many - whole) / TANGENTS / whole,
    }


if __name__ == "__main__":
    main()
