"""The two systems behind one set of calls: FACE IT! from landmarks, Deep Energies from renders as well."""

from workbench.config import Config
from workbench.face import FaceModel
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.fitter import FrameFitter

Fitter = FrameFitter | DeepFitter


def make_fitter(model: FaceModel, config: Config) -> Fitter:
    """The fitter of the configuration's system."""
    return DeepFitter(model, config) if config.system == "deep-energies" else FrameFitter(model, config)


def configured(fitter: Fitter, config: Config) -> Fitter:
    """The fitter under another configuration; a new one only where the system changes."""
    if isinstance(fitter, DeepFitter) != (config.system == "deep-energies"):
        return make_fitter(fitter.model, config)
    fitter.configure(config)
    return fitter
