"""Frames of a Deep Energies run: where they are independent, over several processes, with the same numbers."""

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from itertools import islice
from pathlib import Path

from workbench.energies.terms import TABLE
from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.pictures.deep_strip import write_stage_strip
from workbench.pipeline.sources import DeepSource, RigSource
from workbench.pipeline.still_pictures import StillPictures
from workbench.tracker import FaceTracker
from workbench.tracking import FrameContext, FrameFit, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.plan import Plan
from workbench.tracking.track_writer import TrackWriter

BATCH = 16
"""Frames between two parts on disk: an interrupted run loses less than these."""
STRIPS = 12
"""Frames whose stages are drawn, evenly over the run, and at most as many that failed."""

Pair = tuple[FrameObservation, FrameContext]


def track_deep_frames(
    source: DeepSource | RigSource,
    tracker: FaceTracker,
    writer: TrackWriter,
    stills: bool,
    workers: int,
    progress,
    drawn: StillPictures | None = None,
) -> list[Pair]:
    """Fit what the writer does not hold yet, in order; return the frames whose stages are worth a picture.

    On resume the landmarks of all frames are found again (a few milliseconds each): then nothing but the number of
    finished frames, and the last fit where a term links frames, has to be stored, and the numbers cannot depend on
    where a run was cut. Raises `InputError` for several processes with a term that links frames.
    """
    linked = tracker.fitter.links_frames
    if linked and workers > 1:
        names = [name for name in TABLE if TABLE[name].links_frames and name in tracker.config.summed_terms]
        listed = " and ".join(map(repr, names))
        raise InputError(
            f"Several processes fit frames in any order, and the terms {listed} link each to the one before; use "
            f"--workers 1, or take {listed} out of the stages' terms."
        )
    every = max(1, (source.count or STRIPS) // STRIPS)
    chosen: list[Pair] = []
    failed: list[Pair] = []
    done = len(writer)
    with ExitStack() as stack:
        fit = _mapper(tracker, workers, stack)
        pairs = _pairs(source, tracker, stills)
        for _ in islice(pairs, done):
            pass
        if linked and done:
            tracker.continue_from(writer.state())
        while batch := list(islice(pairs, 1 if linked else BATCH)):
            for (observation, context), result in zip(batch, fit(batch), strict=True):
                if drawn is not None:
                    drawn.add(observation, result)
                writer.add(result)
                done += 1
                progress("track", done, source.count)
                if result.found and observation.index % every == 0 and len(chosen) < STRIPS:
                    chosen.append((observation, context))
                elif result.failure and len(failed) < STRIPS:
                    failed.append((observation, context))
            if drawn is not None:
                drawn.flush()  # the frames of a part have their pictures
            if not linked or done % BATCH == 0:
                writer.write_part(tracker.state() or {} if linked else {})
        writer.write_part(tracker.state() or {} if linked else {})
    return [*chosen, *failed]


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


def _mapper(tracker: FaceTracker, workers: int, stack: ExitStack):
    """What fits a batch: here, or in processes that each hold model and plan."""
    if workers <= 1:
        return lambda batch: (tracker.fit_prepared(*pair) for pair in batch)
    # Spawned: a forked child of a process that runs JAX's threads hangs.
    pool = stack.enter_context(
        ProcessPoolExecutor(
            workers,
            multiprocessing.get_context("spawn"),
            initializer=_start,
            initargs=(tracker.model, tracker.fitter.plan),
        )
    )
    return lambda batch: pool.map(
        _fit, [(replace(observation, picture=None), context) for observation, context in batch]
    )


_FITTER: list[DeepFitter] = []
"""The worker's own fitter, made once when the process starts."""


def _start(model: FaceModel, plan: Plan) -> None:
    _FITTER.append(DeepFitter(model, plan))


def _fit(pair: Pair) -> FrameFit:
    return _FITTER[0].fit(*pair)[0]
