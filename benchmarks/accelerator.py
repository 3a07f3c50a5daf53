"""Fits a second of a batch of 10,000 frames, and the parts of Deep Energies, on the accelerator that JAX finds.

Without one it skips: the same on a processor is what `sweep_rate.py` and `rendering.py` measure.
"""

import argparse
import time

import jax
import numpy as np
from result import print_result

from workbench.config import preset
from workbench.face import load_default_head
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.session import open_session
from workbench.sweeps import ClipSolver, SweptClip
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.fitting import FrameContext

FRAMES = 10_000
NONE = "JAX finds no accelerator here, only the processor"


def main() -> None:
    """Measure and print, or say that there is nothing to measure on."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--anyway", action="store_true", help="measure on the processor too")
    parser.add_argument("--frames", type=int, default=FRAMES)
    asked = parser.parse_args()
    device = jax.devices()[0]
    details = {"device": device.device_kind, "platform": device.platform}
    against = "the same program on this accelerator"
    if device.platform == "cpu" and not asked.anyway:
        print_result("accelerator", None, "fits/s", None, against, details | {"skipped": NONE})
        return
    details["deep_energies_s_per_frame"] = deep_seconds()
    rate = batch_rate(asked.frames)
    print_result("accelerator", rate, "fits/s", None, against, details | {"frames": asked.frames})


def batch_rate(frames: int) -> float:
    """Fits a second: the sample clip under as many settings as make so many frames."""
    base, head = preset("joint").changed(camera={"fov_deg": 33.0}), load_default_head()
    observations = open_session(sample("performance-landmarks"), base, head).material.observations
    clip, solver = SweptClip("clip", "accelerator", observations, False), ClipSolver(head)
    count = max(1, frames // len(observations))
    configs = [base.changed(weights={"tau": float(tau)}) for tau in np.geomspace(1e-3, 10.0, count)]
    solver.fits(configs[:1], clip, clip.shots)
    began = time.perf_counter()
    solver.fits(configs, clip, clip.shots)
    return count * len(observations) / (time.perf_counter() - began)


def deep_seconds() -> float:
    """Seconds of a frame of Deep Energies, renderer and network included, once everything is compiled."""
    config = preset("deep")
    session = open_session(sample("astronaut"), config)
    fitter = DeepFitter(session.model, plan_of(config))
    session.fit_frame(0)
    observation = session.observation(0)
    context = FrameContext(0, fitter.mean_identity(), None, None, session.context(0).appearance)
    fitter.fit(observation, context)
    began = time.perf_counter()
    fitter.fit(observation, context)
    return time.perf_counter() - began


if __name__ == "__main__":
    main()
