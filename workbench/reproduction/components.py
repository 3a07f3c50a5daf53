"""Appendix C.2 of Deep Energies on the default head: parallel projection, ten components of shape and expression."""

import numpy as np
from jaxtyping import Float

from workbench import plots
from workbench.face import FaceModel, load_default_head
from workbench.landmarks.scheme import lip_distance, outer_eye_distance
from workbench.reproduction.clip_solves import parallel_fit, parallel_head
from workbench.reproduction.rendered_clip import OPEN_MOUTH, SEVEN_FRAMES, clip_truth
from workbench.reproduction.study import Result, Study, Table

FRAMES, QUICK_FRAMES = tuple(sorted((*SEVEN_FRAMES, 4, 44, 84, 124, 164))), (SEVEN_FRAMES[0], OPEN_MOUTH)
"""Open mouths and closed ones, those of other items among them."""


def opening(study: Study) -> Result:
    """Whether ten components open the mouth: distance of the lips, as found and as rendered."""
    head, frames = load_default_head(), QUICK_FRAMES if study.quick else FRAMES
    truth = clip_truth()
    true_person = head.personal(truth.identity)
    names = ("deep-parallel",) if study.quick else ("deep-parallel", "orthographic")
    found: dict[str, list[float]] = {name: [] for name in names}
    rendered = [_lips_apart(true_person, true_person.vertices(truth.expression[k])) for k in frames]
    for name in names:
        for done, frame in enumerate(frames):
            study.progress(name, done, len(frames))
            fit = parallel_fit(name, frame)
            person = parallel_head().personal(np.asarray(fit.identity))
            found[name].append(_lips_apart(person, person.vertices(fit.expression)))
    rows = tuple(
        (str(frame), *(f"{100.0 * value:.1f}" for value in (rendered[k], *(found[name][k] for name in names))))
        for k, frame in enumerate(frames)
    )
    curves = {"rendered": rendered, **found}
    return Result(
        data=f"{len(frames)} frames of the bundled clip; the default head with ten principal components of its own "
        "expressions and its first ten of identity, from the mean face, no lens known.",
        figures={
            f"Distance of the lips in frames {', '.join(map(str, frames))}, % of the distance of the outer eye "
            "corners; between these frames lines lead the eye alone.": plots.curves(
                np.array(frames),
                {label: 100.0 * np.array(values) for label, values in curves.items()},
                "frame",
                "lips, %",
            )
        },
        tables=(Table("Distance of the lips, % of the eye distance", ("frame", "rendered", *names), rows),),
        notes=(
            "The paper fits Basel's model to photos and shows the results beside other methods'. Basel's files are "
            "read, but not bundled. The clip has perspective, which a parallel projection cannot explain.",
            "In the published form (`orthographic`) only the landmarks constrain shape and expression, and several "
            "mixtures of the two explain them equally well: the mouth it finds need not be the rendered one.",
        ),
    )


def _lips_apart(model: FaceModel, vertices: Float[np.ndarray, "v 3"]) -> float:
    points = model.landmarks.of(vertices)
    return float(lip_distance(points) / outer_eye_distance(points))
