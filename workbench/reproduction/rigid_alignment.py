"""Our rigid alignment beside one by tracked dots and beside the truth, as in Deep Energies Fig. 9."""

import numpy as np

from workbench import plots
from workbench.config import preset
from workbench.face import FaceModel, load_default_head
from workbench.planning import plan_of
from workbench.reproduction.head_pose import Poses
from workbench.reproduction.matchmove import DOTS, matchmove, rigid_vertices, with_dots
from workbench.reproduction.people import Motion, SimulatedPerson
from workbench.reproduction.stereo_film import APART_DEG, FOV_DEG, film_stereo, on_stage
from workbench.reproduction.stereo_solves import AXES, rigid_differences, solve_film
from workbench.reproduction.study import Result, Study, Table
from workbench.tracking import FrameFit
from workbench.tracking.flow_fitter import FlowFitter, parameters_of

FRAMES, QUICK_FRAMES = 24, 3
SHOWN = 5
PERSON = 20
"""Fair, with little hair in the forehead: dots are seen."""
DOTTED, MONOCULAR, STEREO = "tracked dots", "monocular", "stereo"


def compared(study: Study) -> Result:
    """Fig. 9: poses by tracked dots, by one camera and by two, over the film, and their differences by axis."""
    head, frames = load_default_head(), QUICK_FRAMES if study.quick else FRAMES
    vertices = rigid_vertices(head)

    def made_up(who: SimulatedPerson) -> SimulatedPerson:
        return with_dots(on_stage(who), vertices)

    film = film_stereo(head, frames, study.progress, PERSON, made_up)
    points = head.personal(film.identity).neutral[vertices]
    dots = matchmove(film.pictures, points, film.motion, film.rig.views[0].camera)
    solves = {MONOCULAR: solve_film(head, film, preset("deep"), study, MONOCULAR, both=False)}
    if not study.quick:
        solves[STEREO] = solve_film(head, film, preset("deep"), study, STEREO)
    solves = {DOTTED: _posed(head, solves[MONOCULAR], dots), **solves}
    common = sorted(set.intersection(*(set(fits) for fits in solves.values())))
    shown = common[:: -(-len(common) // SHOWN)]
    strip = plots.film_strip(
        head,
        [film.pictures[k] for k in shown],
        {label: [fits[k] for k in shown] for label, fits in solves.items()},
    )
    by_dots = Motion(*dots, film.motion.expression)
    rows = []
    for other, motion in (("rendered", film.motion), (DOTTED, by_dots)):
        for label, fits in solves.items():
            if label != other:
                apart = np.abs(rigid_differences({k: fits[k] for k in common}, motion)).mean(axis=0)
                rows.append((f"{label} − {other}", *(f"{value:.2f}" for value in apart)))
    return Result(
        data=f"a rendered film of {frames} frames, 720 × 540, by two cameras {APART_DEG:g}° apart, of a person with "
        f"{DOTS} painted dots; preset deep with one network's landmarks, the person's shape given.",
        figures={
            "The head in the poses of each row over the film. The expression in the row of the dots, which tell none, "
            "is that of one camera's solve.": strip
        },
        tables=(Table(f"Mean absolute differences, {len(common)} frames", ("", *AXES), tuple(rows)),),
        notes=(
            "The paper's other alignment is a matchmove artist's, from painted dots and other features. Here the dots "
            "are painted into the skin, tracked by optical flow and turned into poses by OpenCV's PnP on the person's "
            "own head, without network or energies. Like the artist's it has errors, which the film's truth shows.",
            *(("A quick run leaves out the second camera.",) if study.quick else ()),
        ),
    )


def _posed(head: FaceModel, fits: dict[int, FrameFit], poses: Poses) -> dict[int, FrameFit]:
    """The fits in other poses, where there is one."""
    fitter = FlowFitter(head, plan_of(preset("deep").changed(camera={"fov_deg": FOV_DEG})))
    return {
        k: fitter.placed(fit, parameters_of(fit)._replace(rotation=poses[0][k], translation=poses[1][k]))
        for k, fit in fits.items()
        if np.isfinite(poses[0][k]).all()
    }
