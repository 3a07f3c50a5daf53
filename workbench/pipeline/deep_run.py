"""Frames of a Deep Energies run: where they are independent, over processes or a cluster, with the same numbers."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path

from workbench.energies.terms import TABLE
from workbench.errors import InputError, LostSchedulerError, WorkbenchWarning
from workbench.face import FaceModel
from workbench.pictures.deep_strip import write_stage_strip
from workbench.pipeline.deep_sources import DeepSource, RigSource
from workbench.pipeline.still_pictures import StillPictures
from workbench.tracker import FaceTracker
from workbench.tracking import FrameContext, FrameFit, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.plan import Plan
from workbench.tracking.track_writer import TrackWriter
from workbench.workers import Failed, ThisProcess, Workers, in_order

BATCH = 16
"""Frames between two parts on disk."""
BATCH_OF_A_WORKER = 4
"""Many workers get more frames at once, so that few of them wait for the last one of a batch."""
STRIPS = 12
"""At most this many frames have their stages drawn, evenly over the run, and as many that failed."""

Pair = tuple[FrameObservation, FrameContext]


class ShownFrames:
    """The frames whose stages are worth a picture, of those that are seen one after the other."""

    def __init__(self, count: int | None) -> None:
        """`count`: how many there are, if it is known."""
        self._every = max(1, -(-(count or 0) // STRIPS))
        self._chosen: list[Pair] = []
        self._failed: list[Pair] = []

    def add(self, pair: Pair, fit: FrameFit) -> None:
        """Consider the next frame."""
        if fit.failure:
            self._failed = [*self._failed, pair][:STRIPS]
        elif fit.found and fit.index % self._every == 0:
            self._chosen.append(pair)
        if len(self._chosen) > STRIPS:
            self._every *= 2
            self._chosen = [pair for pair in self._chosen if pair[0].index % self._every == 0]

    @property
    def pairs(self) -> list[Pair]:
        """Those chosen, then those that failed."""
        return [*self._chosen, *self._failed]


def track_deep_frames(
    source: DeepSource | RigSource,
    tracker: FaceTracker,
    writer: TrackWriter,
    stills: bool,
    workers: Workers,
    progress,
    drawn: StillPictures | None = None,
) -> list[Pair]:
    """Fit what the writer does not hold yet, in order; return the frames whose stages are worth a picture.

    On resume the landmarks of all frames are found again (a few milliseconds each): then nothing but the number of
    finished frames, and the last fit where a term links frames, has to be stored, and the numbers cannot depend on
    where a run was cut. An interrupted run, and one without its scheduler, keeps all frames up to the first that is
    missing. Raises `InputError` for other processes with a term that links frames, and for a frame that ends the
    process that works on it; `LostSchedulerError`.
    """
    linked = tracker.fitter.links_frames
    if linked and not isinstance(workers, ThisProcess):
        names = [name for name in TABLE if TABLE[name].links_frames and name in tracker.config.summed_terms]
        listed = " and ".join(map(repr, names))
        raise InputError(
            f"Several processes fit frames in any order, and the terms {listed} link each to the one before; use "
            f"--workers 1 without --scheduler, or take {listed} out of the stages' terms."
        )
    shown = ShownFrames(source.count)
    done = len(writer)
    work = FrameWork(tracker.model, _in_any_folder(tracker.fitter.plan))
    pairs = _pairs(source, tracker, stills)
    for position, pair in enumerate(islice(pairs, done)):
        if not linked:  # the frame before, which these began with, is not kept
            shown.add(pair, writer[position])
    if linked and done:
        tracker.continue_from(writer.state())

    def store() -> None:
        if drawn is not None:
            drawn.flush()  # the frames of a part have their pictures
        writer.write_part(tracker.state() or {} if linked else {})

    size = 1 if linked else max(BATCH, BATCH_OF_A_WORKER * workers.count)
    try:
        while batch := list(islice(pairs, size)):
            for (observation, context), result in zip(batch, _fits(batch, tracker, workers, work), strict=True):
                if drawn is not None:
                    drawn.add(observation, result)
                writer.add(result)
                done += 1
                progress("track", done, source.count)
                shown.add((observation, context), result)
            if not linked or done % BATCH == 0:
                store()
    except (KeyboardInterrupt, InputError, LostSchedulerError):
        if not linked:  # what links the next frame may be newer than the last one written
            store()
        raise
    store()
    return shown.pairs


def write_strips(pairs: list[Pair], fitter: DeepFitter, folder: Path, progress) -> tuple[Path, ...]:
    """Draw the stages of some frames: `stages/0012.jpg`."""
    made = []
    pictured = [pair for pair in pairs if pair[0].picture is not None]
    for observation, context in pictured:
        solution = fitter.solve(fitter.problem(observation, context))
        path = folder / "stages" / f"{observation.index:04d}.jpg"
        write_stage_strip(path, observation.picture, fitter, solution)
        made.append(path)
        progress("stages", len(made), len(pictured))
    return tuple(made)


def _pairs(source: DeepSource | RigSource, tracker: FaceTracker, stills: bool) -> Iterator[Pair]:
    for observation in source.observations(0, {}, stills):
        yield from tracker.prepare(observation)
    yield from tracker.prepare_rest()


@dataclass(frozen=True)
class FrameTask:
    """A frame in its context, without its picture."""

    clip: str
    """The frame's name in sentences."""
    observation: FrameObservation
    context: FrameContext


@dataclass(frozen=True, eq=False)
class FrameWork:
    """Fits frames for one model and plan, with a fitter that each process makes for itself."""

    model: FaceModel
    plan: Plan

    @cached_property
    def _fitter(self) -> DeepFitter:
        with warnings.catch_warnings():
            # The run's own fitter has said it.
            warnings.simplefilter("ignore", WorkbenchWarning)
            return DeepFitter(self.model, self.plan)

    def __call__(self, task: FrameTask) -> FrameFit:
        """The fit of a frame."""
        return self._fitter.fit(task.observation, task.context)[0]


def _in_any_folder(plan: Plan) -> Plan:
    """The plan with a weights file named as in any folder: workers may run in another one."""
    weights = Path(plan.deep.network)
    return replace(plan, deep=replace(plan.deep, network=str(weights.absolute()))) if weights.is_file() else plan


def _fits(batch: Sequence[Pair], tracker: FaceTracker, workers: Workers, work: FrameWork) -> Iterator[FrameFit]:
    """The fits of some frames in order, each as soon as those before it are there."""
    if isinstance(workers, ThisProcess):
        yield from (tracker.fit_prepared(*pair) for pair in batch)
        return
    tasks = [
        FrameTask(f"Frame {observation.index}", replace(observation, picture=None), context)
        for observation, context in batch
    ]
    for result in in_order(workers.results(tasks, work)):
        if isinstance(result, Failed):
            raise InputError(f"{result.reason} Finished frames are kept; --resume continues after them.")
        yield result
