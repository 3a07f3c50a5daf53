"""Deep Energies on the rendered film of two cameras, and rigid parameters compared axis by axis."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from workbench.config import Config
from workbench.face import FaceModel
from workbench.files import make_folder
from workbench.geometry import write_rig, yaw_pitch_roll_deg
from workbench.planning import plan_of
from workbench.reproduction.people import Motion
from workbench.reproduction.stereo_film import AWAY_MM, AXES, FOV_DEG, StereoFilm
from workbench.reproduction.study import NETWORK, Study
from workbench.tracking import FrameContext, FrameFit
from workbench.tracking.deep_fitter import DeepFitter


def solve_film(
    head: FaceModel, film: StereoFilm, config: Config, study: Study, label: str, both: bool = True
) -> dict[int, FrameFit]:
    """The frames of the film with a face, each on its own, seen by both cameras or the first; the person is known."""
    if both:
        rig = make_folder(study.folder) / "rig.toml"
        write_rig(film.rig, rig)
        config = config.changed(camera={"rig": str(rig)})
    else:
        config = config.changed(camera={"fov_deg": FOV_DEG})
    deep = {"distance_mm": AWAY_MM, "network": NETWORK}
    fitter = DeepFitter(head, plan_of(config.changed(identity={"calibrate": False}, deep=deep)))
    appearance = fitter.appearance(film.observations[:1], film.identity)
    context, fits = FrameContext(0, film.identity, None, None, appearance), {}
    for k, observation in enumerate(film.observations):
        study.progress(label, k, len(film.observations))
        seen = observation if both else replace(observation, others=())
        if seen.faces:
            fits[k] = fitter.record(fitter.solve(fitter.problem(seen, context)))
    return fits


def rigid_differences(fits: Mapping[int, FrameFit], motion: Motion) -> Float[np.ndarray, "n 6"]:
    """Fits minus a motion, a row per frame that was fitted: `AXES`."""
    rows = [
        (*(fit.angles_deg - yaw_pitch_roll_deg(motion.rotation[k])), *(fit.translation - motion.translation_mm[k]))
        for k, fit in fits.items()
    ]
    return np.array(rows).reshape(-1, len(AXES))
