"""A statistical basis of expressions: principal components of what a head's blendshapes make, sorted by size.

Deep Energies App. C.2 fits the first ten components of such a basis, Basel's. This gives any head with blendshapes
one of its own.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from workbench.errors import ModelError
from workbench.face.formats.raw import statistical_names
from workbench.face.model import FaceModel
from workbench.face.usual_expressions import ONE_SIDED

DEVIATIONS = 3.0
"""Weights of components run this many standard deviations either way, like those of published models."""
AT_WORK = 0.3
"""Share of the faces in which a blendshape is at work."""
SIDES_DIFFER = 0.2
"""Standard deviation, as a share, between the left and right of one movement."""


def principal_expressions(model: FaceModel, count: int = 10, faces: int = 2000, seed: int = 0) -> FaceModel:
    """The model with `count` principal components of random faces in place of its blendshapes, the largest first.

    The components are about the neutral face, which stays at weights of 0; their offsets are millimetres per standard
    deviation over the faces. `expression_000` and so on, with weights from −3 to 3. Raises `ModelError` for more
    components than blendshapes, fewer faces than blendshapes, and models whose weights do not run from 0 to 1.
    """
    shapes = len(model.expression_names)
    if not 1 <= count <= shapes:
        raise ModelError(f"{model.name} has {shapes} blendshapes, so {count} components cannot be made of them.")
    if faces < shapes:
        raise ModelError(f"{shapes} blendshapes need as many random faces or more, got {faces}.")
    if not model.weights_from_0_to_1:
        raise ModelError(f"The weights of {model.name} do not run from 0 to 1; it has a statistical basis already.")
    weights = random_expressions(model.expression_names, faces, np.random.default_rng(seed))
    root = np.linalg.qr(weights / np.sqrt(faces), mode="r")
    _, sizes, directions = np.linalg.svd(root @ model.expression_deltas.reshape(len(root), -1), full_matrices=False)
    components = (sizes[:, None] * directions)[:count].reshape(count, *model.neutral.shape)
    # A sign that the next decomposition keeps: the component's largest motion along y goes down (+y), as a jaw opens.
    along_y = components[..., 1]
    largest = np.take_along_axis(along_y, np.abs(along_y).argmax(axis=1)[:, None], axis=1)
    return replace(
        model,
        name=f"{model.name}-principal-{count}",
        expression_names=statistical_names(count),
        expression_deltas=components * np.where(largest < 0.0, -1.0, 1.0)[..., None],
        expression_range=np.tile([-DEVIATIONS, DEVIATIONS], (count, 1)),
        fixed_jaw_unit=model.jaw_unit,
    )


def random_expressions(names: tuple[str, ...], count: int, rng: np.random.Generator) -> Float[np.ndarray, "n k"]:
    """Faces as blendshape weights in [0, 1]: a few movements each, whose left and right sides nearly agree.

    Jaw and mouth move to one side at a time.
    """
    movements = [name.removesuffix("Left").removesuffix("Right") for name in names]
    strengths = {movement: rng.random(count) * (rng.random(count) < AT_WORK) for movement in dict.fromkeys(movements)}
    sides = 1.0 + SIDES_DIFFER * rng.standard_normal((count, len(names)))
    weights = np.clip(np.stack([strengths[movement] for movement in movements], axis=1) * sides, 0.0, 1.0)
    for left, right in zip(ONE_SIDED[::2], ONE_SIDED[1::2], strict=True):
        leftward = rng.random(count) < 0.5
        for name, at_rest in ((left, ~leftward), (right, leftward)):
            if name in names:
                weights[at_rest, names.index(name)] = 0.0
    return weights
