"""The two systems behind one interface: FACE IT! from landmarks, Deep Energies from renders as well."""

from workbench.face import FaceModel
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.face_it_fitter import FaceItFitter
from workbench.tracking.fitting import Fitter
from workbench.tracking.plan import Plan

FITTERS: dict[str, type[Fitter]] = {"face-it": FaceItFitter, "deep-energies": DeepFitter}


def make_fitter(model: FaceModel, plan: Plan) -> Fitter:
    """The fitter of the plan's system."""
    return FITTERS[plan.system](model, plan)


def configured(fitter: Fitter, plan: Plan) -> Fitter:
    """The fitter with another plan; a new fitter only if the system changes."""
    if type(fitter) is not FITTERS[plan.system]:
        return make_fitter(fitter.model, plan)
    fitter.configure(plan)
    return fitter
