"""The figures and experiments of Deep Energies that can be remade."""

from dataclasses import replace

import numpy as np

from workbench import plots
from workbench.config import preset
from workbench.face import FaceParameters, load_default_head
from workbench.files import make_folder
from workbench.geometry import write_rig, yaw_pitch_roll_deg
from workbench.pictures import stage_strip
from workbench.planning import plan_of
from workbench.reproduction.clip_solves import QUANTITIES, QUICK_NOTE, ClipSolver
from workbench.reproduction.people import Motion
from workbench.reproduction.rendered_clip import OPEN_MOUTH, SEVEN_FRAMES, clip_pictures
from workbench.reproduction.stereo_film import APART_DEG, AWAY_MM, FOV_DEG, film_stereo
from workbench.reproduction.study import Result, Study, Table
from workbench.tracking import FrameContext
from workbench.tracking.deep_fitter import DeepFitter

STEREO_FRAMES = 24
AXES = ("yaw, °", "pitch, °", "roll, °", "x, mm", "y, mm", "z, mm")
STRIPS = (60, 140, OPEN_MOUTH)
DATA = "frames of the bundled clip of a rendered head, 640 × 480, whose truth is exact; identity and camera given"
OTHER_PARTS = (
    "The network is the workbench's own, in place of 3D-FAN, and the renderer its own, in place of OpenDR. The paper's "
    "frames are of a real performer; here every error is measured against the truth that was rendered."
)


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


def stereo(study: Study) -> Result:
    """Fig. 10: errors of the rigid parameters by one camera, by two, and by two with preselected points."""
    head, frames = load_default_head(), 2 if study.quick else STEREO_FRAMES
    film = film_stereo(head, frames, study.progress)
    write_rig(film.rig, make_folder(study.folder) / "rig.toml")
    single = {"fov_deg": FOV_DEG}
    both = {"rig": str(study.folder / "rig.toml")}
    series = {
        "monocular": preset("deep").changed(camera=single),
        "stereo": preset("deep").changed(camera=both),
        "stereo, preselected": preset("deep-points").changed(camera=both),
    }
    errors = {}
    for label, config in series.items():
        config = config.changed(identity={"calibrate": False}, deep={"distance_mm": AWAY_MM})
        fitter = DeepFitter(head, plan_of(config))
        appearance = fitter.appearance(film.observations[:1], film.identity)
        context, rows = FrameContext(0, film.identity, None, None, appearance), []
        for k, observation in enumerate(film.observations):
            study.progress(label, k, frames)
            one = observation if config.camera.rig else replace(observation, others=())
            if one.faces:
                found = fitter.solve(fitter.problem(one, context)).parameters
                rows.append((k, *_rigid_errors(found, film.motion, k)))
        errors[label] = np.array(rows).reshape(-1, 1 + len(AXES))
    table = tuple(
        (label, *(f"{value:.2f}" for value in np.abs(rows[:, 1:]).mean(axis=0)), str(len(rows)))
        for label, rows in errors.items()
    )
    boxes = {axis: {label: np.abs(rows[:, k]) for label, rows in errors.items()} for k, axis in enumerate(AXES, 1)}
    return Result(
        data=f"a rendered film of {frames} frames, 720 × 540, by two cameras {APART_DEG:g}° apart, with the network's "
        "landmarks; presets deep and deep-points, the person's shape given.",
        figures={"Absolute errors of the rigid parameters over the frames.": plots.error_boxes(boxes)},
        tables=(Table("Mean absolute errors", ("", *AXES, "frames"), table),),
        notes=(OTHER_PARTS, "The paper's figure is against a manual alignment, ours against what was rendered."),
    )


def seen_or_preselected(study: Study) -> Result:
    """Fig. 19: landmarks that the network sees in the render against points on the mesh."""
    frames = (OPEN_MOUTH,) if study.quick else SEVEN_FRAMES
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


def _rigid_errors(found: FaceParameters, motion: Motion, frame: int) -> tuple[float, ...]:
    turned = yaw_pitch_roll_deg(np.array(found.rotation)) - yaw_pitch_roll_deg(motion.rotation[frame])
    return (*turned, *(np.asarray(found.translation) - motion.translation_mm[frame]))
