"""The figures, the table and the experiments of FACE IT! that can be remade."""

import time
from collections.abc import Iterable, Sequence
from functools import partial
from itertools import cycle, islice
from pathlib import Path

import numpy as np
from jaxtyping import Float

from workbench import plots
from workbench.config import Config, preset
from workbench.energies import EnergyConstants, beta_slope
from workbench.energies import beta_curve as range_curve
from workbench.errors import InputError
from workbench.face import FaceModel, load_default_head
from workbench.frames import open_frames
from workbench.landmarks.detectors import chosen_detector, make_detector
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.tracking import LandmarkTracker
from workbench.reproduction.boston import (
    NAMES,
    PRINTED_DEG,
    PRINTED_INCHES,
    BostonSequence,
    MeanErrors,
    mean_errors,
    pose_errors,
    read_set,
)
from workbench.reproduction.head_pose import (
    PNP,
    Poses,
    errors_of,
    landmarks_of_sequence,
    poses_by_pnp,
    poses_by_preset,
    read_poses,
)
from workbench.reproduction.rendered_clip import CLIP, FOV_DEG, SIZE, clip_landmarks, clip_pictures, clip_truth
from workbench.reproduction.simulated_boston import FRAMES, simulate_set
from workbench.reproduction.study import Result, Study, Table
from workbench.samples import sample
from workbench.tracker import FaceTracker
from workbench.tracking import FrameFit, FrameObservation

LIMITS = (1, 2, 3, 5, 8, 10, 15, 20, 30, 40, 50)
QUICK_LIMITS = (1, 5, 15)
SHOWN = (1, 3, 15, 50)
PAPER_ITERATIONS = 15
"""After these, both the pose and the expression of the paper are good enough."""
SETTLED = 1.01
"""Errors that differ by no more than this factor count as converged."""
BESIDE = 0.2
"""Times that differ by less than this part of other differences do not show beside those."""
FRAME = 192
"""An open mouth on a turned head, for the pictures."""
ON_THE_WAY = 144
"""Wide eyes and parted lips, for the overview."""
ABOUT_1000 = 960
"""The bundled clip four times."""
QUICK_NAMES = ("jam4", "jam5", "jim6", "jim8")
QUICK_FRAMES = 30


def overview(study: Study) -> Result:
    """Fig. 1: one frame on its way from the picture to pose and weights."""
    head, landmarks = load_default_head(), clip_landmarks()[ON_THE_WAY]
    picture = clip_pictures((ON_THE_WAY,))[ON_THE_WAY]
    fits = {
        label: _each_alone(head, _limited(rho=15, epsilon=epsilon), clip_landmarks(), [ON_THE_WAY])[0]
        for label, epsilon in (("3. pose: E_pose, E_τ, ρ = 15", 0), ("4. weights: E_fit, E_β, E_σ, ε = 15", 15))
    }
    seen = plots.with_points(picture, landmarks.points, "#00e0a0", radius=3)
    rows = tuple(
        (
            label,
            f"{fit.errors[2]:.2f}",
            ", ".join(f"{angle:.1f}" for angle in fit.angles_deg),
            str(fit.iterations.sum()),
        )
        for label, fit in fits.items()
    )
    return Result(
        data=f"Frame {ON_THE_WAY} of {CLIP}, preset face-it.",
        figures={
            "1. A frame of the video; 2. its 68 landmarks.": plots.pictures_in_a_row(
                [picture, seen], ["1. frame", "2. landmarks: predictor and optical flow"]
            ),
            "3. The pose with the face at rest; 4. the weights with the pose held.": plots.compared_fits(
                head, picture, fits, side=320
            ),
        },
        tables=(Table("After each stage", ("", "landmarks, %", "yaw, pitch, roll, °", "iterations"), rows),),
        notes=(
            "In a video each frame starts from the one before. The paper then moves a character by the weights: "
            "`workbench export --help`, notebook 11.",
        ),
    )


def beta_curve(study: Study) -> Result:
    """Fig. 2: E_β of one weight, with its values and slopes."""
    constants = EnergyConstants()
    places = np.array([-0.1, 1.0 - constants.a, 0.0, 0.5, 1.0, constants.a, 1.1])
    values = np.asarray(range_curve(places, constants))
    slopes = np.asarray(beta_slope(places, constants))
    rows = tuple((f"{w:g}", f"{v:.4f}", f"{s:.4g}") for w, v, s in zip(places, values, slopes, strict=True))
    return Result(
        data="Eq. 12 with the printed constants.",
        figures={"E_β against one weight, and its slope where it rises.": plots.beta_figure(constants)},
        tables=(Table("E_β at some weights", ("w", "E_β", "slope"), rows),),
        notes=(
            "A solver sees slopes only. Where the curve rises the slope is about 39,000, at 0 and 1 themselves 3.9, "
            "and at 0.1 outside them 0.0016.",
        ),
    )


def iterations(study: Study) -> Result:
    """Fig. 4, left: the pose against ρ, and the expression against ε with the pose that ρ = 15 gives."""
    head, limits = load_default_head(), QUICK_LIMITS if study.quick else LIMITS
    landmarks, truth_deg = clip_landmarks(), clip_truth().angles_deg
    frames = range(0, len(landmarks), 60 if study.quick else 12)
    by_rho, by_epsilon, steps = [], [], 2 * len(limits)
    for done, limit in enumerate(limits):
        study.progress("ρ", done, steps)
        fits = _each_alone(head, _limited(rho=limit, epsilon=0), landmarks, frames)
        missed = np.abs(np.array([fit.angles_deg for fit in fits]) - truth_deg[list(frames)]).mean()
        by_rho.append((_error_percent(fits), float(missed)))
    for done, limit in enumerate(limits, len(limits)):
        study.progress("ε", done, steps)
        by_epsilon.append(_error_percent(_each_alone(head, _limited(rho=15, epsilon=limit), landmarks, frames)))
    errors = {
        "ρ, the expression at rest": np.array([error for error, _ in by_rho]),
        "ε, with the pose of ρ = 15": np.array(by_epsilon),
    }
    shown = [limit for limit in SHOWN if limit in limits]
    picture = clip_pictures((FRAME,))[FRAME]
    poses = {f"ρ = {k}": _each_alone(head, _limited(rho=k, epsilon=15), landmarks, [FRAME])[0] for k in shown}
    faces = {f"ε = {k}": _each_alone(head, _limited(rho=15, epsilon=k), landmarks, [FRAME])[0] for k in shown}
    jaw = head.expression_names.index("jawOpen")
    header = ("iterations", "ρ: landmarks, %", "ρ: angles, °", "ε: landmarks, %")
    rows = tuple(
        (str(limit), f"{error:.2f}", f"{angle:.2f}", f"{fitted:.2f}")
        for limit, (error, angle), fitted in zip(limits, by_rho, by_epsilon, strict=True)
    )
    return Result(
        data=f"{len(frames)} frames of {CLIP}, each fitted on its own with the preset face-it.",
        figures={
            "Mean landmark error against the number of iterations.": plots.curves(
                np.array(limits), errors, "iterations", "error, % of the eye distance"
            ),
            f"Frame {FRAME}: poses with ε = 15.": plots.compared_fits(head, picture, poses, side=220),
            f"Frame {FRAME}: expressions with ρ = 15.": plots.compared_fits(head, picture, faces, side=220),
        },
        tables=(Table("Mean errors", header, rows),),
        notes=(
            *pose_notes(limits, [error for error, _ in by_rho]),
            *expression_notes(limits, by_epsilon),
            f"In frame {FRAME}, chosen for its open mouth, jawOpen is "
            f"{', '.join(f'{fit.expression[jaw]:.2f} with {label}' for label, fit in faces.items())}. The upper row of "
            "pictures has ε = 15 throughout.",
        ),
    )


def pose_notes(limits: Sequence[int], errors: Sequence[float]) -> list[str]:
    """What the errors against ρ say of the pose's convergence; what they do not bear out is left out."""
    rest = (np.array(errors[k:]) for k in range(len(errors)))
    converged = (limit for limit, each in zip(limits, rest, strict=True) if each.max() <= SETTLED * each.min())
    settled = next(converged, limits[-1])
    after = f"{settled} iteration{'s' if settled > 1 else ''}"
    converges = (
        "The pose starts from eye corners and nose in closed form (SQPnP), already close, so its landmark error has "
        f"converged after {after} where the paper's pose needs about {PAPER_ITERATIONS}."
    )
    held = (
        "The angles are the head's true ones; the expression held at rest leaves an error in them that no number of "
        "iterations removes."
    )
    return [converges, held] if settled < PAPER_ITERATIONS else [held]


def expression_notes(limits: Sequence[int], errors: Sequence[float]) -> list[str]:
    """What the errors against ε say of the expression's convergence; what they do not bear out is left out."""
    by_limit, last = dict(zip(limits, errors, strict=True)), limits[-1]
    notes = []
    if errors[-2] > SETTLED * errors[-1]:
        expression = "As in the paper, the expression" if last == LIMITS[-1] else "The expression"
        notes += [f"{expression} has not converged after {last}."]
    if last > PAPER_ITERATIONS and by_limit[PAPER_ITERATIONS] > SETTLED * errors[-1]:
        notes += [f"Unlike in the paper, {PAPER_ITERATIONS} iterations of the expression are not enough."]
    return notes


def time_notes(by_rho: Float[np.ndarray, "limits"], by_epsilon: Float[np.ndarray, "limits"]) -> list[str]:
    """What milliseconds at rising limits say of the cost of an iteration; what they do not bear out is left out."""
    if (np.diff(by_epsilon) <= 0).any():
        return []
    if np.ptp(by_rho) > BESIDE * np.ptp(by_epsilon):
        return ["Time grows with ε."]
    return ["Time grows with ε; iterations of the pose's six unknowns cost too little to show beside that."]


def iteration_times(study: Study) -> Result:
    """Fig. 4, right: milliseconds of a frame's energy minimisation against ρ and ε."""
    head, limits = load_default_head(), QUICK_LIMITS if study.quick else LIMITS
    observations = list(islice(cycle(_observations(clip_landmarks())), 60 if study.quick else ABOUT_1000))
    configs = {
        "ρ, with ε = 15": [_limited(rho=limit, epsilon=15, tolerance=0.0) for limit in limits],
        "ε, with ρ = 15": [_limited(rho=15, epsilon=limit, tolerance=0.0) for limit in limits],
    }
    times, done = {}, 0
    for label, series in configs.items():
        times[label] = np.zeros(len(limits))
        for k, config in enumerate(series):
            study.progress("times", done, 2 * len(limits))
            times[label][k], done = _milliseconds(head, config, observations), done + 1
    rows = tuple((str(limit), f"{a:.2f}", f"{b:.2f}") for limit, a, b in zip(limits, *times.values(), strict=True))
    return Result(
        data=f"{len(observations)} frames of {CLIP}; the tolerance is 0.",
        figures={
            "Mean time of the energy minimisation per frame.": plots.curves(
                np.array(limits), times, "iterations", "ms per frame"
            )
        },
        tables=(Table("Milliseconds per frame", ("iterations", *times), rows),),
        notes=(
            "Times are those of the computer that made this page, and other work on it makes them uneven.",
            *time_notes(*times.values()),
        ),
    )


def runtime(study: Study) -> Result:
    """Sec. 5: time for the landmarks and for the energy on a video of about 1,000 frames."""
    head = load_default_head()
    pictures = [frame.picture for frame in open_frames(sample("performance")).iterate()]
    count = 60 if study.quick else ABOUT_1000
    detector = LandmarkTracker(make_detector("auto"))
    tracker = FaceTracker(head, preset("face-it").changed(camera={"fov_deg": FOV_DEG}))
    tracker.warm_up(SIZE)
    seconds, fits = [], []
    for k, picture in enumerate(islice(cycle(pictures), count)):
        if k % 20 == 0:
            study.progress("frames", k, count)
        began = time.perf_counter()
        found = detector.step(picture)
        seconds.append(time.perf_counter() - began)
        fits += tracker.push(FrameObservation(k, found.landmarks, SIZE, cut=found.cut))
    landmarks_ms = 1e3 * float(np.mean(seconds))
    energy_ms = float(np.mean([fit.milliseconds[2] for fit in fits]))
    rows = (
        ("paper, Intel Xeon W3520", "23.7", "31.6", "18"),
        ("here", f"{landmarks_ms:.1f}", f"{energy_ms:.1f}", f"{1e3 / (landmarks_ms + energy_ms):.0f}"),
    )
    return Result(
        data=f"{count} frames of the bundled clip (640 × 480), landmarks by {chosen_detector()}, preset face-it.",
        tables=(Table("Mean time per frame", ("", "landmarks, ms", "energy, ms", "frames per second"), rows),),
        notes=("The computers differ, and so do the solvers (Ceres there); the landmarks here combine detector and "
               "optical flow.",),
    )  # fmt: skip


def head_pose(study: Study) -> Result:
    """Table 1: mean absolute error of the head's angles, on the real set if there is one, else on a simulated one."""
    head = load_default_head()
    if study.boston is None:
        names, frames = (QUICK_NAMES, QUICK_FRAMES) if study.quick else (NAMES, FRAMES)
        simulate_set(study.folder / "set", head, names, frames, study.progress)
        sequences, problems = read_set(study.folder / "set")[0], ()
        given = _poses_of_others(study.poses, sequences, sequences)
        data = (
            f"a simulated set in the layout of Boston University's: {len(sequences)} sequences of {frames} frames, "
            "320 × 240, rendered people with exact poses (`reproduction/simulated_boston.py`)."
        )
    else:
        whole, problems = read_set(study.boston)
        sequences = whole[:1] if study.quick else whole
        data = f"Boston University's set, {len(sequences)} of its 45 sequences of uniform light."
        given = _poses_of_others(study.poses, whole, sequences)
    landmarks: dict[str, tuple[Landmarks2D | None, ...]] = {}
    for done, sequence in enumerate(sequences):
        study.progress("landmarks", done, len(sequences))
        landmarks[sequence.name] = landmarks_of_sequence(sequence, study.folder / "landmarks" / f"{sequence.name}.csv")
    ways = {f"ours, {name}": partial(poses_by_preset, name, head) for name in ("joint", "calibrated", "face-it")}
    rows = []
    for label, way in {**ways, PNP: partial(poses_by_pnp, head)}.items():
        study.progress(label, 0, None)
        store = study.folder / "poses" / label.replace("ours, ", "").replace(" ", "-")
        errors = errors_of(sequences, lambda one, way=way: way(landmarks[one.name]), store)
        rows.append(_table_row(label, mean_errors(errors)))
    for path, poses in given.items():
        errors = [pose_errors(one, *poses[one.name]) for one in sequences if one.name in poses]
        rows.append(_table_row(path.name, mean_errors(errors)))
    printed = [
        (f"printed: {name}", *(f"{value:.2f}" for value in degrees), *_inches(name), "", "")
        for name, degrees in PRINTED_DEG.items()
    ]
    header = ("", "roll, °", "pitch, °", "yaw, °", "average, °", "X, in", "Y, in", "Z, in", "frames", "missed")
    notes = () if study.boston else (
        "Rows marked *printed* are the paper's, on the real set: they stand beside ours, not against them. The "
        "simulated people are samples of the default head's own shapes, with exact poses: expect larger errors on real "
        "faces and a magnetic sensor. The mean face by PnP comes about as close as ours here: the simulated people "
        "hardly change their faces. `--boston FOLDER` fills the table from the real set.",
    )  # fmt: skip
    sensor = (
        "Positions are those of a sensor on the head, calibrated by the first frame alone: when the head turns, the "
        "sensor's way about the head's origin counts as an error."
    )
    return Result(
        data=data,
        tables=(Table("Mean absolute errors", header, (*rows, *printed)),),
        notes=(*notes, sensor, *problems),
    )


def _poses_of_others(
    paths: Iterable[Path], known: Sequence[BostonSequence], used: Sequence[BostonSequence]
) -> dict[Path, dict[str, Poses]]:
    """By table: the poses of the sequences in use; rows of other known ones are checked and left out.

    Raises `InputError` for a table without any, besides what `read_poses` raises.
    """
    names, found = [one.name for one in used], {}
    for path in paths:
        found[path] = {name: poses for name, poses in read_poses(path, known).items() if name in names}
        if not found[path]:
            raise InputError(f"{path} has no pose in the sequences that are used ({', '.join(names)}).")
    return found


def _limited(rho: int, epsilon: int, tolerance: float = 1e-6) -> Config:
    """The preset with these limits, one pose stage and the clip's lens."""
    config = preset("face-it")
    limits = {"pose": rho, "expression": epsilon}
    stages = [
        stage.model_copy(update={"limit": limits[stage.name]}).model_dump()
        for stage in config.stages
        if stage.name in limits
    ]
    return config.changed(camera={"fov_deg": FOV_DEG}, solver={"tolerance": tolerance}, stages=stages)


def _observations(landmarks: Sequence[Landmarks2D | None]) -> list[FrameObservation]:
    return [FrameObservation(k, each, SIZE) for k, each in enumerate(landmarks)]


def _each_alone(head: FaceModel, config: Config, landmarks, frames: Sequence[int]) -> list[FrameFit]:
    tracker = FaceTracker(head, config, stills=True)
    return list(tracker.fit_all(FrameObservation(k, landmarks[k], SIZE) for k in frames))


def _error_percent(fits: Sequence[FrameFit]) -> float:
    return float(np.mean([fit.errors[2] for fit in fits]))


def _milliseconds(head: FaceModel, config: Config, observations: Sequence[FrameObservation]) -> float:
    tracker = FaceTracker(head, config)
    tracker.warm_up(SIZE)
    return float(np.mean([fit.milliseconds[2] for fit in tracker.fit_all(observations)]))


def _table_row(label: str, errors: MeanErrors) -> tuple[str, ...]:
    degrees = (errors.roll_deg, errors.pitch_deg, errors.yaw_deg, errors.average_deg)
    return (label, *(f"{value:.2f}" for value in (*degrees, *errors.places_in)), str(errors.frames), str(errors.missed))


def _inches(name: str) -> tuple[str, ...]:
    return tuple(f"{value:.2f}" for value in PRINTED_INCHES) if name == "FACE IT!" else ("", "", "")
