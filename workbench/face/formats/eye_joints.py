"""Eyeballs that hang on joints, as blendshapes turn them: a face model moves by its blendshapes alone."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.face.default_head import GAZE_NAMES, load_default_head
from workbench.face.dense_landmarks import in_scheme
from workbench.face.gaze import EYES, eye_turns
from workbench.face.model import FaceModel
from workbench.landmarks.schemes import DENSE

MOSTLY = 0.5
"""Share from which on a vertex that hangs on an eye's joint is one of its eyeball."""
AT_REST_MM = 0.5
"""A look that moves an eyeball by less leaves it to the joint."""


def with_turned_eyes(model: FaceModel, weights: Float[np.ndarray, "v 2"]) -> FaceModel:
    """The model whose looks turn the eyeballs too, by as much as the default head's, where they leave them at rest.

    `weights` are the shares of the vertices that turn with the joints `EYES`.
    """
    usual = in_scheme(load_default_head(), DENSE)
    turns = np.radians(eye_turns(usual)).reshape(2, 2, -1)
    looks = {
        k: usual.expression_names.index(name) for k, name in enumerate(model.expression_names) if name in GAZE_NAMES
    }
    deltas = model.expression_deltas.copy()
    for (across, up), eye, held in zip(turns, EYES, weights.T, strict=True):
        ball = held > MOSTLY
        if np.abs(deltas[list(looks)][:, ball]).max(initial=0.0) > AT_REST_MM:
            continue
        arms = model.neutral - model.joints[eye]
        for k, unit in looks.items():
            turned = Rotation.from_rotvec([-up[unit], -across[unit], 0.0]).apply(arms)
            deltas[k] += held[:, None] * (turned - arms)
    return replace(model, expression_deltas=deltas)
