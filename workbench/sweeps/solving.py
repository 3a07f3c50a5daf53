"""Fits of parts of a clip under many configurations at once, with what cross-validation hides as more of the same."""

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from workbench.arrays import shapes_of
from workbench.config import Config
from workbench.errors import ConfigError
from workbench.face import FaceModel, FaceParameters, LandmarkModel, in_scheme, landmark_model
from workbench.geometry import Camera
from workbench.landmarks.scheme import IBUG68, POINT_COUNT, LandmarkScheme
from workbench.objectives import FOLDS, FittedClip, folds_of, inner_landmarks, surface_points, without_hidden
from workbench.planning import plan_of
from workbench.runtime import COMPUTING
from workbench.sweeps.clips import SweptClip, frames_of
from workbench.tracker import calibration_window, identity_key
from workbench.tracking import FaceItFitter, FrameObservation, Plan
from workbench.tracking.chain_solver import (
    CHAINS,
    FRAMES,
    Chain,
    ChainFrames,
    ChainState,
    SolvedFrames,
    solve_chains,
)
from workbench.tracking.face_it_solution import solve_settings, stage_program
from workbench.tracking.fitting import Calibrated, corrected
from workbench.tracking.frame_solver import Method, SolveSettings, StageProgram
from workbench.tracking.initial_pose import initial_pose
from workbench.tracking.walk import jumped

Key, Value = TypeVar("Key", bound=Hashable), TypeVar("Value")

KEPT_IDENTITIES = 256
KEPT_WINDOWS = 64
"""Of 240 frames they take 25 MB with 68 points, a third of a gigabyte with dense ones."""


@dataclass(frozen=True, eq=False)
class Setting:
    """One configuration as its solves need it, on the host."""

    config: Config
    plan: Plan
    numbers: SolveSettings
    first: StageProgram
    later: StageProgram

    @property
    def program(self) -> tuple[Method, tuple[str, ...], int]:
        """What is compiled: chains that agree in it are solved together."""
        method = "levenberg-marquardt" if self.plan.solver.method == "lm" else "trust-region"
        return method, self.plan.terms, len(self.first.limit)


def setting_of(config: Config, scheme: LandmarkScheme = IBUG68) -> Setting:
    """The setting of a configuration for a scheme's landmarks. Raises `ConfigError` for one that no batch can solve."""
    check_swept(config)
    plan = plan_of(config, scheme)
    return Setting(config, plan, solve_settings(plan), stage_program(plan, True), stage_program(plan, False))


@dataclass(frozen=True, eq=False)
class ChainJob:
    """A run of frames under one setting."""

    setting: Setting
    person: LandmarkModel
    frames: ChainFrames
    """On the host; (n, …)."""

    @property
    def chain(self) -> Chain:
        """All but the frames."""
        return Chain(self.person, self.setting.numbers, self.setting.first, self.setting.later)


class SeenFrames(NamedTuple):
    """What frames in a row show: the first fields of `ChainFrames`."""

    measured: Float[np.ndarray, "n points 3"]
    present: Bool[np.ndarray, "n"]
    afresh: Bool[np.ndarray, "n"]
    whitening: Float[np.ndarray, "n points 2 2"] | None = None


def seen_frames(
    plan: Plan,
    observations: Sequence[FrameObservation],
    moved: Sequence[Mapping[int, tuple[float, float]]],
    mask: Bool[np.ndarray, "n points"],
) -> SeenFrames:
    """What frames show whose detections are corrected by `moved`, without the landmarks that `mask` hides."""
    count, points = mask.shape
    seen = SeenFrames(np.zeros((count, points, 3)), np.zeros(count, bool), np.zeros(count, bool))
    whitenings: list[np.ndarray | None] = [None] * count
    before = None
    for k, (observation, places, hidden) in enumerate(zip(observations, moved, mask, strict=True)):
        observation = without_hidden(corrected(observation, places), hidden)
        if observation.landmarks is None:
            before = None
            continue
        points = observation.landmarks.points
        seen.measured[k, :, :2] = points
        seen.measured[k, :, 2], whitenings[k] = plan.measured(observation.landmarks)
        seen.present[k], seen.afresh[k] = True, before is None or jumped(before, points)
        before = points
    if all(whitening is None for whitening in whitenings):
        return seen
    absent = np.zeros((mask.shape[1], 2, 2))
    return seen._replace(whitening=np.stack([absent if each is None else each for each in whitenings]))


class SolvedModel:
    """A face model with the points of one scheme, and what its solves share."""

    def __init__(self, model: FaceModel) -> None:
        self.model = model
        self.landmarks = landmark_model(model)
        self.fitter: FaceItFitter | None = None


class ClipSolver:
    """Solves parts of clips for one face model, in this process; the latest identities are kept.

    Fits take all points of a clip's scheme; what is measured of them are the 68 that every scheme begins with.
    """

    def __init__(self, model: FaceModel):
        self.model = in_scheme(model, IBUG68)
        self._whole = model
        self._by_scheme: dict[str, SolvedModel] = {}
        self._identities: OrderedDict[tuple, Calibrated] = OrderedDict()
        self._windows: OrderedDict[tuple, SeenFrames] = OrderedDict()

    def fits(
        self,
        configs: Sequence[Config],
        clip: SweptClip,
        windows: Sequence[range],
        kinds: tuple[str, ...] = (),
        surface: bool = False,
    ) -> list[FittedClip]:
        """The fits of some windows of a clip under each configuration, frames in a row as `frames_of` gives them.

        `kinds` names the folds of cross-validation that are fitted too, `surface` asks for the points of the mesh.
        Raises `ConfigError` for a configuration that no batch can solve.
        """
        jobs, identities = zip(
            *(pair for config in configs for pair in self.jobs(config, clip, windows, kinds)), strict=True
        )
        solved = iter(zip(solve_jobs(jobs), identities, strict=True))
        model = self._solved(clip.scheme).model
        return [_fitted(model, solved, windows, kinds, surface) for _ in configs]

    def jobs(
        self, config: Config, clip: SweptClip, windows: Sequence[range], kinds: tuple[str, ...] = ()
    ) -> Iterator[tuple[ChainJob, Float[np.ndarray, "i"]]]:
        """What is solved for some windows of a clip, with the identity of each: first with everything seen, then what
        the folds see; one job per window. Raises `ConfigError` for a configuration that no batch can solve.
        """
        setting = setting_of(config, clip.scheme)
        ends, starts = np.cumsum([*map(len, windows)]), [shot.start for shot in clip.shots]
        for fold in folds_of(kinds, int(ends[-1]), clip.scheme):
            for window, mask in zip(windows, np.split(fold, ends[:-1]), strict=True):
                shot = clip.shots[bisect_right(starts, window.start) - 1]
                calibrated = self._calibrated(setting, clip, shot, mask)
                yield self._job(setting, clip, window, calibrated, mask), calibrated.identity

    def _solved(self, scheme: LandmarkScheme) -> SolvedModel:
        if scheme.name not in self._by_scheme:
            self._by_scheme[scheme.name] = SolvedModel(in_scheme(self._whole, scheme))
        return self._by_scheme[scheme.name]

    def _calibrated(
        self, setting: Setting, clip: SweptClip, shot: range, mask: Bool[np.ndarray, "n points"]
    ) -> Calibrated:
        """The identity of a shot, from landmarks that are not hidden in all frames."""
        config, plan, solved = setting.config, setting.plan, self._solved(clip.scheme)
        nothing = Calibrated(np.zeros(len(solved.model.identity_deltas)), {})
        if not (plan.identity.calibrate and solved.model.has_identities):
            return nothing
        hidden = mask.all(0) & ~mask.all()
        window = calibration_window(
            clip.observations[shot.start : shot.stop], 1 if clip.stills else config.identity.window
        )
        window = [without_hidden(corrected(each, config.moved_points(each.index)), hidden) for each in window]
        if not any(each.landmarks is not None for each in window):
            return nothing

        def calibrate() -> Calibrated:
            if solved.fitter is None:
                solved.fitter = FaceItFitter(solved.model, plan)
            # Hidden landmarks are muted too, or the poses that the calibration starts from would know them.
            solved.fitter.configure(replace(plan, point_weights=np.where(hidden, 0.0, plan.point_weights)))
            return solved.fitter.calibrate(window, 1 if clip.stills else config.identity.frames)

        key = (clip.digest, shot.start, identity_key(config, plan.camera, window), hidden.tobytes())
        return kept(self._identities, key, KEPT_IDENTITIES, calibrate)

    def _job(
        self,
        setting: Setting,
        clip: SweptClip,
        window: range,
        calibrated: Calibrated,
        mask: Bool[np.ndarray, "n points"],
    ) -> ChainJob:
        plan, solved = setting.plan, self._solved(clip.scheme)
        shapes = len(solved.model.expression_names)
        person = solved.landmarks.personal(np.asarray(calibrated.identity, float))
        sizes = [clip.observations[k].image_size for k in window]
        by_size = {size: plan.camera.of(size) for size in set(sizes)}
        cameras = [by_size[size] for size in sizes]
        seen = self._seen(setting, clip, window, mask)
        starts = (np.zeros((len(window), size)) for size in (3, 3, shapes))
        stacked = Camera(*(np.stack(part) for part in zip(*cameras, strict=True)))
        frames = ChainFrames(*seen[:3], *starts, stacked, seen.whitening)
        for k in np.flatnonzero(seen.afresh):
            start = calibrated.starts.get(clip.observations[window[k]].index)
            if start is None:
                used = (plan.point_weights > 0.0) & ~mask[k]
                pose = initial_pose(cameras[k], person.frontal_neutral(), seen.measured[k, :, :2], used)
                start = FaceParameters(*pose, np.zeros(shapes), np.zeros(0))
            frames.rotation[k], frames.translation[k], frames.expression[k] = start[:3]
        return ChainJob(setting, person, frames)

    def _seen(self, setting: Setting, clip: SweptClip, window: range, mask: Bool[np.ndarray, "n points"]) -> SeenFrames:
        """What the frames of a window show; the same for most settings, so the latest are kept."""
        moved = {index: setting.config.moved_points(index) for index in map(int, setting.config.landmarks.moved)}

        def see() -> SeenFrames:
            frames = frames_of(clip, [window])
            return seen_frames(setting.plan, frames, [moved.get(each.index, {}) for each in frames], mask)

        key = (clip.digest, window, mask.tobytes(), setting.plan.confident, repr(moved))
        return kept(self._windows, key, KEPT_WINDOWS, see)


def _fitted(
    model: FaceModel, solved: Iterator, windows: Sequence[range], kinds: tuple[str, ...], surface: bool
) -> FittedClip:
    """Takes one configuration's chains, the folds' in their order."""

    def next_fold():
        pieces = [next(solved) for _ in windows]
        fits = SolvedFrames(*(np.concatenate(part) for part in zip(*(fits for fits, _ in pieces), strict=True)))
        identity = np.concatenate([np.tile(found, (len(fits.iterations), 1)) for fits, found in pieces])
        return fits._replace(projected=fits.projected[:, :POINT_COUNT]), identity

    fits, identity = next_fold()
    folds = {kind: np.stack([next_fold()[0].projected for _ in range(len(FOLDS[kind](1)))]) for kind in kinds}
    numbers = (fits.rotation, fits.translation, fits.expression, identity)
    return FittedClip(
        *numbers[:3],
        fits.projected,
        inner_landmarks(model, *numbers),
        fits.iterations,
        surface_points(model, *numbers) if surface else None,
        folds,
    )


def kept(store: OrderedDict[Key, Value], key: Key, most: int, make: Callable[[], Value]) -> Value:
    """The value of a key, made where it is not kept; the `most` that were asked for last are."""
    if key not in store:
        store[key] = make()
        while len(store) > most:
            store.popitem(last=False)
    store.move_to_end(key)
    return store[key]


def check_swept(config: Config) -> None:
    """Raise `ConfigError` for a configuration whose frames need more than their landmarks."""
    if config.traits.renders:
        raise ConfigError(
            "A sweep fits landmarks, and Deep Energies renders; start from joint, calibrated, face-it, gaze or dense "
            "(--preset)."
        )
    if config.compares_pictures:
        raise ConfigError("A sweep fits landmarks without pictures; take the term 'flow' out of the stages.")


def solve_jobs(jobs: Sequence[ChainJob]) -> list[SolvedFrames]:
    """The fits of every job on the host, in the order of the jobs."""
    found: dict[int, SolvedFrames] = {}
    by_program: dict[tuple, list[int]] = {}
    for number, job in enumerate(jobs):
        by_program.setdefault((*job.setting.program, job.frames.whitening is None), []).append(number)
    for (method, terms, *_), numbers in by_program.items():
        # Long chains together: a block runs until its longest chain ends.
        numbers = sorted(numbers, key=lambda number: -len(jobs[number].frames.present))
        for first in range(0, len(numbers), CHAINS):
            block = numbers[first : first + CHAINS]
            found |= dict(zip(block, _solve_block([jobs[k] for k in block], method, terms), strict=True))
    return [found[number] for number in range(len(jobs))]


def _solve_block(jobs: Sequence[ChainJob], method: Method, terms: tuple[str, ...]) -> list[SolvedFrames]:
    padded = [*jobs, *[jobs[0]] * (CHAINS - len(jobs))]
    chains = _stacked([job.chain for job in padded])
    counts = [len(job.frames.present) for job in jobs]
    shapes = padded[0].frames.expression.shape[1]
    states = _at_rest(shapes)
    pieces: list[SolvedFrames] = []
    for start in range(0, max(counts), FRAMES):
        frames = _stacked([_block_of(job.frames, start, k < len(jobs)) for k, job in enumerate(padded)])
        program = _program_for((chains, states, frames), method, terms)
        with COMPUTING:
            states, solved = program(chains, states, frames)
        pieces.append(jax.tree.map(np.asarray, solved))
    whole = SolvedFrames(*(np.concatenate(part, axis=1) for part in zip(*pieces, strict=True)))
    return [SolvedFrames(*(part[k, :count] for part in whole)) for k, count in enumerate(counts)]


def _program_for(arguments: tuple[Chain, ChainState, ChainFrames], method: Method, terms: tuple[str, ...]):
    """The compiled program for arguments of these shapes. It is compiled while other programs may run, so that a panel
    beside it goes on."""
    return _compiled(*shapes_of(arguments), method, terms)


@lru_cache(maxsize=4)
def _compiled(tree, shapes: tuple[jax.ShapeDtypeStruct, ...], method: Method, terms: tuple[str, ...]):
    return solve_chains.lower(*jax.tree.unflatten(tree, shapes), method, terms).compile()


def _block_of(frames: ChainFrames, start: int, used: bool) -> ChainFrames:
    """`FRAMES` frames from `start` on; those beyond the end, and all of a chain that only fills a block, are absent."""
    piece = jax.tree.map(lambda part: part[start : start + FRAMES], frames)
    missing = FRAMES - len(piece.present)
    piece = jax.tree.map(lambda part: np.pad(part, [(0, missing)] + [(0, 0)] * (part.ndim - 1)), piece)
    return piece if used else piece._replace(present=np.zeros(FRAMES, bool))


def _at_rest(shapes: int) -> ChainState:
    """The state before the first frame, which starts from scratch whatever it is."""
    parameters = FaceParameters(*(jnp.zeros((CHAINS, size)) for size in (3, 3, shapes, 0, 0, 0)))
    pose = jnp.zeros((CHAINS, 6))
    return ChainState(parameters, pose, pose, jnp.zeros(CHAINS, int))


def _stacked(trees: Sequence):
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack([np.asarray(leaf) for leaf in leaves])), *trees)
