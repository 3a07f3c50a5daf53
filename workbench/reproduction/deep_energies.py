"""The figures and experiments of Deep Energies that can be remade."""

import numpy as np

from workbench import plots
from workbench.config import preset
from workbench.face import load_default_head
from workbench.pictures import stage_strip
from workbench.reproduction.clip_solves import QUANTITIES, ClipSolver
from workbench.reproduction.rendered_clip import clip_pictures
from workbench.reproduction.study import Result, Study, Table

OPEN_MOUTH = 200
"""A frame with the mouth as wide open as the clip has it."""
FRAMES = (24, 60, 100, 140, 180, OPEN_MOUTH, 220)
STRIPS = (60, 140, OPEN_MOUTH)
DATA = "frames of the bundled clip of a rendered head, 640 × 480, whose truth is exact; identity and camera given"
OTHER_PARTS = (
    "The network is the workbench's own, in place of 3D-FAN, and the renderer its own, in place of OpenDR. The paper's "
    "frames are of a real performer; here every error is measured against the truth that was rendered."
)
QUICK_NOTE = "A quick run leaves out the presets with the paper's names: their derivative takes minutes to compile."


def stages(study: Study) -> Result:
    """Figs. 3 to 6: what each stage leaves, as strips and as errors."""
    frames = (OPEN_MOUTH,) if study.quick else STRIPS
    solver = ClipSolver(load_default_head())
    solves = {
        name: solver.solve(preset(name), frames, study, name)
        for name in (("deep",) if study.quick else ("deep-energies", "deep"))
    }
    pictures = clip_pictures(frames)
    strips = {
        f"Frame {frame} by the preset {name}: the photo, the frontal start, each stage, the result.": stage_strip(
            pictures[frame], found.fitter, found.solutions[frame], columns=5
        )
        for name, found in solves.items()
        for frame in frames
    }
    names = ("start", *(stage.name for stage in preset("deep").running(start=True)))
    means = {name: np.mean([found.by_stage(k) for k in frames], axis=0) for name, found in solves.items()}
    errors = {
        quantity: {name: mean[:, column] for name, mean in means.items()} for column, quantity in enumerate(QUANTITIES)
    }
    header = ("after", *(f"{name}: {quantity}" for name in solves for quantity in QUANTITIES))
    rows = tuple(
        (stage, *(f"{errors[quantity][name][row]:.2f}" for name in solves for quantity in QUANTITIES))
        for row, stage in enumerate(names)
    )
    return Result(
        data=f"{len(frames)} {DATA}.",
        figures={**strips, "Mean errors after each stage.": plots.errors_per_stage(names, errors)},
        tables=(Table("Mean errors after each stage", header, rows),),
        notes=(OTHER_PARTS, *((QUICK_NOTE,) if study.quick else ())),
    )


def seen_or_preselected(study: Study) -> Result:
    """Fig. 19: landmarks that the network sees in the render against points on the mesh."""
    frames = (OPEN_MOUTH,) if study.quick else FRAMES
    ours, printed = ("deep", "deep-points"), ("deep-energies", "preselected-points")
    solver = ClipSolver(load_default_head())
    solves = {
        name: solver.solve(preset(name), frames, study, name) for name in (ours if study.quick else printed + ours)
    }
    errors = {
        quantity: {name: found.errors()[:, column] for name, found in solves.items()}
        for column, quantity in enumerate(QUANTITIES)
    }
    shown, picture = OPEN_MOUTH, clip_pictures((OPEN_MOUTH,))[OPEN_MOUTH]
    strips = {
        f"Frame {shown} by the preset {name}.": stage_strip(picture, found.fitter, found.solutions[shown], columns=5)
        for name, found in solves.items()
        if name in (ours if study.quick else printed)
    }
    rows = tuple((name, *(f"{value:.2f}" for value in found.errors().mean(axis=0))) for name, found in solves.items())
    return Result(
        data=f"{len(frames)} {DATA}.",
        figures={"Errors over the frames.": plots.error_boxes(errors), **strips},
        tables=(Table("Mean errors", ("", *QUANTITIES), rows),),
        notes=(OTHER_PARTS, *((QUICK_NOTE,) if study.quick else ())),
    )
