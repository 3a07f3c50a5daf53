"""The recipes of the bundled networks, each one call: renders, training, evaluation, calibration, weights, report."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.face import load_default_head
from workbench.files import atomic_path
from workbench.landmarks.dense_detector import bundled_dense_network
from workbench.landmarks.network_detector import bundled_landmark_network
from workbench.landmarks.schemes import DENSE_POINTS
from workbench.networks import read_landmark_network, read_weights
from workbench.networks.dense_gain import read_dense_gain
from workbench.networks.dense_network import SIDE, DenseNetwork, read_dense_network
from workbench.networks.eye_network import read_eye_network
from workbench.networks.frozen import FrozenDenseNetwork, FrozenEyeNetwork
from workbench.networks.frozen_floats import largest_passed
from workbench.networks.landmark_network import LandmarkNetwork
from workbench.training.augment import TRAINING, Hardness
from workbench.training.contact_sheet import eye_samples, face_samples, shown_early
from workbench.training.dense_gain import corrected_answers, fitted_gain, write_dense_gain
from workbench.training.dense_measuring import (
    DenseAnswers,
    dense_answers,
    deviation_factor,
    even_factor,
    measured_dense,
)
from workbench.training.dense_task import DenseTask
from workbench.training.evaluation import CLEAN, Answers, answers_of, calibration_of, unseen_pictures
from workbench.training.expressions import FITTED, counted_tracks, fitted_weights
from workbench.training.eye_measuring import eye_answers, measured_eyes
from workbench.training.eye_task import EyeTask
from workbench.training.finder_task import FinderTask
from workbench.training.landmark_task import LandmarkTask
from workbench.training.loop import Phase, Task, TrainingPlan, checked_plan, train
from workbench.training.measuring import looker, measured
from workbench.training.pool import Pool, halves, make_pool, open_pool
from workbench.training.report import DENSE_CURVES, EYE_CURVES, write_regression_report, write_report, write_tables
from workbench.training.shipping import write_shipped

LANDMARK_PLAN = TrainingPlan(phases=(Phase(128, 10000, 48, 3e-3), Phase(256, 4000, 24, 1e-3)))
FINDER_PLAN = TrainingPlan(
    phases=(Phase(128, 2500, 32, 3e-3), Phase(256, 2500, 24, 2e-3)), widths=(16, 32, 64, 96), blocks=2
)
FURTHER_FINDER_PLAN = TrainingPlan(phases=(Phase(256, 1400, 16, 1.5e-3),), widths=(16, 32, 64, 96), blocks=2)
"""For weights that are there already."""
BATCHED_PLAN = TrainingPlan(phases=(Phase(256, 4200, 256, 2e-3),), seed=7, batched=True)
"""For a GPU: a million pictures, in nine minutes of an H200 that had two other trainings beside it."""
DENSE_PLAN = TrainingPlan(phases=(Phase(256, 4500, 32, 1.5e-3),))
EYE_PLAN = TrainingPlan(phases=(Phase(64, 6000, 64, 2e-3),), widths=(24, 48, 64, 96))
FURTHER_EYE_PLAN = TrainingPlan(phases=(Phase(64, 8000, 64, 1.5e-3),), widths=(24, 48, 64, 96))
SEEDS = {"faces": (1, 1002), "eyes": (5, 1005)}
"""Of the pools that are learned from and measured on, by what they show."""
TEST_PICTURES, EVALUATED, CALIBRATED = 960, 800, 1500
LOOKED_AT_FOR_BYTES = 240
"""Augmented pictures on which a network's `largest` is measured."""

Report = Callable[[str], None]


@dataclass(frozen=True)
class Recipe:
    """Sizes of one training."""

    pictures: int = 5280
    test_pictures: int = TEST_PICTURES
    plan: TrainingPlan = LANDMARK_PLAN
    evaluated: int = EVALUATED
    calibrated: int = CALIBRATED
    start: Path | None = None
    """Weights to go on from."""


FURTHER_LANDMARKS = Recipe(pictures=3840, plan=TrainingPlan(phases=(Phase(256, 2400, 16, 4e-4),), learned=0.7))
BATCHED = Recipe(pictures=12000, plan=BATCHED_PLAN)
QUICK = Recipe(
    pictures=240,
    test_pictures=240,
    plan=TrainingPlan(phases=(Phase(128, 30, 8, 2e-3), Phase(256, 5, 4, 1e-3)), widths=(8, 16, 16, 16), blocks=1),
    evaluated=20,
    calibrated=40,
)
"""Everything once, in a minute or two: to see that it works."""
QUICK_DENSE = replace(
    QUICK, plan=TrainingPlan(phases=(Phase(256, 20, 4, 1e-3),), widths=QUICK.plan.widths, blocks=QUICK.plan.blocks)
)
EYES = Recipe(pictures=3360, test_pictures=480, plan=EYE_PLAN)
FURTHER_EYES = replace(EYES, pictures=6720, plan=FURTHER_EYE_PLAN)
QUICK_EYES = replace(QUICK, plan=TrainingPlan(phases=(Phase(64, 20, 8, 1e-3),), widths=(8, 8, 16, 16), blocks=1))


def train_landmark_network(
    folder: Path, recipe: Recipe = Recipe(), workers: int = 1, device: str = "cpu", report: Report = print
) -> Path:
    """Make the landmark network from nothing: `folder/landmarks.safetensors`, and a report beside it.

    Called again after an interruption it goes on where it stopped. Raises `InputError` where the folder belongs to
    another plan.
    """
    raw, test = _trained(LandmarkTask(), folder, "landmarks", recipe, workers, device, report)
    side = recipe.plan.phases[-1].input_side
    network, held_out = read_landmark_network(raw), open_pool(test, recipe.test_pictures)
    report("calibrating the confidence")
    mass, confidence = calibration_of(answers_of(looker(network), held_out, recipe.calibrated, side, TRAINING, seed=1))
    known = {"calibration.mass": mass, "calibration.confidence": confidence}
    known["largest"] = _largest(network, held_out, recipe, side)
    path = folder / "landmarks.safetensors"
    write_shipped(path, read_weights(raw), recipe.plan.seed, **known)
    report("measuring on renders that it has not seen")
    numbers = measured(path, held_out, recipe.evaluated, side)
    with atomic_path(folder / "numbers.json") as temporary:
        temporary.write_text(json.dumps(numbers, indent=1), encoding="utf-8")
    write_report(folder, numbers, folder / "landmarks" / "curves.csv")
    return path


def train_face_finder(
    folder: Path,
    recipe: Recipe = Recipe(plan=FINDER_PLAN),
    workers: int = 1,
    device: str = "cpu",
    report: Report = print,
) -> Path:
    """Make the face finder from the same pool: `folder/finder.safetensors`; resumes like the landmark network."""
    raw, _ = _trained(FinderTask(), folder, "finder", recipe, workers, device, report)
    path = folder / "finder.safetensors"
    write_shipped(path, read_weights(raw), recipe.plan.seed)
    return path


def train_dense_network(
    folder: Path,
    recipe: Recipe = Recipe(plan=DENSE_PLAN),
    workers: int = 1,
    device: str = "cpu",
    report: Report = print,
) -> Path:
    """Make the dense network from the same pool: `folder/dense.safetensors`; resumes like the landmark network.

    Its deviations are calibrated on half of the held-out renders; the tables are of the other half.
    """
    raw, test = _trained(DenseTask(), folder, "dense", recipe, workers, device, report)
    network, (known, unseen) = read_dense_network(raw), halves(open_pool(test, recipe.test_pictures))
    report("calibrating the deviations")
    largest = _largest(network, known, recipe, SIDE)
    look = FrozenDenseNetwork(replace(network, largest=jnp.asarray(largest)))
    kinds = (CLEAN, TRAINING)
    answers = (dense_answers(look, known, DENSE_POINTS, recipe.calibrated // 2, kind, seed=1) for kind in kinds)
    factor = even_factor([each.deviations for each in answers])
    path = folder / "dense.safetensors"
    write_shipped(path, read_weights(raw), recipe.plan.seed, deviation_factor=factor, largest=largest)
    report("measuring on renders that it has not seen")
    look = FrozenDenseNetwork(read_dense_network(path))
    clean, damaged = (dense_answers(look, unseen, DENSE_POINTS, recipe.evaluated, kind) for kind in kinds)
    write_regression_report(folder, "dense", measured_dense(clean, damaged, DENSE_POINTS), DENSE_CURVES)
    return path


def learn_dense_gain(
    folder: Path, recipe: Recipe = Recipe(), workers: int = 1, device: str = "cpu", report: Report = print
) -> Path:
    """Learn what the bundled heat maps tell of the bundled dense network's points: `folder/dense_gain.safetensors`.

    On half of the held-out renders; the tables are of the other half. It takes minutes on a CPU, whatever the `device`.
    """
    test = folder / "pool_test"
    make_pool(test, recipe.test_pictures, SEEDS["faces"][1], workers, _rendered(report))
    known, unseen = halves(open_pool(test, recipe.test_pictures))
    dense, landmarks = FrozenDenseNetwork(bundled_dense_network()), looker(bundled_landmark_network())

    def answers(pool: Pool, count: int, hardness: Hardness, seed: int = 0) -> tuple[DenseAnswers, Answers]:
        return (
            dense_answers(dense, pool, DENSE_POINTS, count, hardness, seed),
            answers_of(landmarks, pool, count, SIDE, hardness, seed),
        )

    report("looking at renders with both networks")
    kinds = (CLEAN, TRAINING)
    sets = [[answers(people, recipe.calibrated // 2, kind, seed=1) for kind in kinds] for people in halves(known)]
    gain = fitted_gain(sets, DENSE_POINTS)
    path = folder / "dense_gain.safetensors"
    write_dense_gain(path, gain)
    report("measuring on renders of other people")
    gain = read_dense_gain(path)
    clean, damaged = (corrected_answers(gain, *answers(unseen, recipe.evaluated, kind)) for kind in kinds)
    write_tables(folder, "dense_gain", measured_dense(clean, damaged, DENSE_POINTS))
    return path


def train_eye_network(
    folder: Path,
    recipe: Recipe = EYES,
    workers: int = 1,
    device: str = "cpu",
    report: Report = print,
) -> Path:
    """Make the eye network from a pool of eyes: `folder/eyes.safetensors`; resumes like the landmark network.

    Its deviations are calibrated on half of the held-out renders; the tables are of the other half.
    """
    raw, test = _trained(EyeTask(), folder, "eyes", recipe, workers, device, report, "eyes")
    look, (known, unseen) = FrozenEyeNetwork(read_eye_network(raw)), halves(open_pool(test, recipe.test_pictures))
    report("calibrating the deviations")
    factor = deviation_factor(eye_answers(look, known, recipe.calibrated, TRAINING, seed=1).deviations)
    path = folder / "eyes.safetensors"
    write_shipped(path, read_weights(raw), recipe.plan.seed, deviation_factor=factor)
    report("measuring on renders that it has not seen")
    look = FrozenEyeNetwork(read_eye_network(path))
    clean, damaged = (eye_answers(look, unseen, recipe.evaluated, hardness) for hardness in (CLEAN, TRAINING))
    write_regression_report(folder, "eyes", measured_eyes(clean, damaged), EYE_CURVES)
    return path


def _largest(
    network: LandmarkNetwork | DenseNetwork, pool: Pool, recipe: Recipe, side: int
) -> Float[np.ndarray, "layers"]:
    """A network's `largest`, measured on pictures like those of the training."""
    count = min(recipe.calibrated, LOOKED_AT_FOR_BYTES)
    return largest_passed(network, (made.picture for made, _ in unseen_pictures(pool, count, side, TRAINING, seed=1)))


def _trained(
    task: Task,
    folder: Path,
    name: str,
    recipe: Recipe,
    workers: int,
    device: str,
    report: Report,
    kind: str = "faces",
) -> tuple[Path, Path]:
    """The trained weights, and the pool to measure them on; what cannot be followed is refused before any render."""
    plan, start = replace(recipe.plan, pictures=recipe.pictures), recipe.start
    checked_plan(task, folder / name, plan, device, start)
    pool, test = _pools(folder, recipe, workers, report, kind)
    return train(task, pool, folder / name, plan, workers, device, report=report, start=start), test


def _pools(folder: Path, recipe: Recipe, workers: int, report: Report, kind: str = "faces") -> tuple[Path, Path]:
    name = "pool" if kind == "faces" else f"pool_{kind}"
    pools = folder / name, folder / f"{name}_test"
    samples = {"faces": face_samples, "eyes": eye_samples}[kind]
    seeds, fits = SEEDS[kind], fitted_weights(folder, load_default_head(gaze=True).expression_names)
    if fits:
        report(f"{100 * FITTED:.0f} % of the new pictures to learn from show expressions of {counted_tracks(fits)}")
    make_pool(pools[0], recipe.pictures, seeds[0], workers, shown_early(report, pools[0], samples), kind, fits)
    make_pool(pools[1], recipe.test_pictures, seeds[1], workers, _rendered(report), kind)
    return pools


def _rendered(report: Report) -> Callable[[int, int], None]:
    return lambda done, total: report(f"rendered {done} of {total}")
