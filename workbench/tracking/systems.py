"""The two systems behind one set of calls: FACE IT! from landmarks, Deep Energies from renders as well."""

from workbench.config import Config
from workbench.face import FaceModel
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.face_it_fitter import FaceItFitter
from workbench.tracking.fitting import Fitter

SYSTEMS: dict[str, type[Fitter]] = {"face-it": FaceItFitter, "deep-energies": DeepFitter}


def make_fitter(model: FaceModel, config: Config) -> Fitter:
    """The fitter of the configuration's system."""
    return SYSTEMS[config.system](model, config)


def configured(fitter: Fitter, config: Config) -> Fitter:
    """The fitter under another configuration; a new one only where the system changes."""
    if type(fitter) is not SYSTEMS[config.system]:
        return make_fitter(fitter.model, config)
    fitter.configure(config)
    return fitter
