"""Infill and refinement of a session's clip: running and comparing methods, with results before and after."""

import threading
import time
from collections import OrderedDict
from collections.abc import Iterable, Sequence

from workbench.config import Config
from workbench.errors import InputError
from workbench.frames import FrameRange, Frames
from workbench.pipeline.temporal_run import STEPS, Step, needs_pictures, over_time, wanted_steps
from workbench.planning import infill_plan, refinement_plan
from workbench.session.clip_run import Run
from workbench.session.dependence import TIME_SECTIONS, fits_key, time_key
from workbench.session.failed_frames import FailedFrames
from workbench.session.material import Cancelled, Material, Progress
from workbench.session.part_fits import PartFits
from workbench.session.parts import Part, parts_of
from workbench.session.worked import Worked, name_of
from workbench.tracking import FrameFit
from workbench.tracking.infill import usable
from workbench.tracking.refinement import passes
from workbench.tracking.unwatched import never, silent

INFILLS, REFINEMENTS = ("flow", "linear", "spline"), ("averaging", "self", "plate", "hybrid")
KEPT = 48
"""Number of results that are cached."""
NO_REFINEMENT = {"method": "none", "reestimate": 0}


class _CancelledError(Exception):
    """Raised to leave work that the user cancelled."""


class TemporalWork:
    """Infill and refinement on the clip of a `TuningSession`. Settings are in the session's configuration.

    Results are cached by the settings that made them: `current` is the result for the current configuration, so undo
    brings it back. Methods may be called from any thread; only one computation runs at a time.
    """

    def __init__(self, session) -> None:
        self._session, self._fits = session, PartFits(session)
        self._failed = FailedFrames(session, self._fits)
        self._lock, self._working = threading.RLock(), threading.RLock()
        self._kept: OrderedDict[tuple[str, Part], Worked] = OrderedDict()
        self._filled: OrderedDict[tuple[str, Part], tuple[tuple[FrameFit, ...], float]] = OrderedDict()

    def __repr__(self) -> str:
        return f"TemporalWork({self._session.material.name!r}, {len(self._kept)} results)"

    # --- frames that count as failed ---

    @property
    def marked(self) -> tuple[Part, ...]:
        """Frames marked by the user, as separate parts."""
        return parts_of(self._failed.marked())

    def mark(self, frames: Iterable[int], label: str = "") -> Config:
        """Mark frames as failed, whatever their fit; one undo step. Raises `InputError` outside the clip."""
        return self._failed.mark(frames, label)

    def unmark(self, frames: Iterable[int]) -> Config:
        """Remove the mark from frames, so that good fits count again. Raises `InputError` outside the clip."""
        return self._failed.unmark(frames)

    def mark_flagged(
        self, part: Part | None = None, progress: Progress = silent, cancelled: Cancelled = never
    ) -> tuple[int, ...]:
        """Also mark the frames that diagnosis flags, and return them. Fits the frames first if necessary."""
        return self._failed.mark_flagged(self._fits.part(part), progress, cancelled)

    def failed(self, part: Part | None = None) -> tuple[int, ...]:
        """Frames that infill would fill, among those already fitted: marked, without a face, or with a bad fit."""
        return self._failed.within(self._fits.part(part))

    # --- work ---

    def run(
        self,
        part: Part | None = None,
        config: Config | None = None,
        progress: Progress = silent,
        cancelled: Cancelled = never,
    ) -> Worked | None:
        """Infill and refine a part (None: the clip) by a configuration (None: the current one); None if cancelled.

        Missing fits are computed first: for the whole clip, or under Deep Energies for the part only, from the start of
        its shot where a term links frames. On the whole clip the numbers equal those of `workbench track`; a part is
        treated like a clip, so its end frames have one neighbour only. Raises `InputError` for photos, if no method is
        chosen, or if pictures are missing.
        """
        config = self._session.config if config is None else config
        part = self._fits.part(part)
        steps = wanted_steps(config)
        if not steps:
            raise InputError("No temporal method is chosen; choose a method of infill or refinement.")
        if problem := problem_of(self._session.material, config):
            raise InputError(problem)
        key = time_key(config), part
        with self._working:
            if key not in self._kept:
                before = self._fits.fitted(part, config, progress, cancelled)
                if before is None:
                    return None
                try:
                    found = self._worked(part, config, before, progress, cancelled)
                except _CancelledError:
                    return None
                with self._lock:
                    self._kept[key] = found
                    while len(self._kept) > KEPT:
                        self._kept.popitem(last=False)
            with self._lock:
                self._kept.move_to_end(key)
                found = self._kept[key]
        self._session.tell("time")
        return found

    def compare(
        self,
        part: Part | None = None,
        progress: Progress = silent,
        cancelled: Cancelled = never,
    ) -> list[Worked] | None:
        """Run every method of infill (if any frame failed) and of refinement, with the other settings unchanged.

        Refinement methods run after the chosen infill. None if cancelled; finished results are kept.
        """
        config, part = self._session.config, self._fits.part(part)
        if self._fits.fitted(part, config, progress, cancelled) is None:
            return None
        made = []
        variants = self.variants(config, part)
        for number, variant in enumerate(variants, start=1):
            place = f"{number} of {len(variants)}: {name_of(variant)}"

            def told(step: str, done: int, total: int | None, place=place) -> None:
                progress(f"{place}, {step}", done, total)

            found = self.run(part, variant, told, cancelled)
            if found is None:
                return None
            made.append(found)
        return made

    def variants(self, config: Config, part: Part) -> list[Config]:
        """The configurations that `compare` runs."""
        made = [config.changed(refinement={"method": name}) for name in REFINEMENTS]
        if self.failed(part):
            made = [config.changed(infill={"method": name}, refinement=NO_REFINEMENT) for name in INFILLS] + made
        if not self._session.material.pictures.real:
            made = [variant for variant in made if not needs_pictures(variant, wanted_steps(variant))]
        return made

    # --- results ---

    @property
    def current(self) -> Worked | None:
        """The latest result under the current configuration; None if there is none."""
        return self.result()

    def result(self, part: Part | None = None) -> Worked | None:
        """The result under the current configuration on a part, or else the latest on any part."""
        key = time_key(self._session.config)
        with self._lock:
            kept = [item for (of, _), item in reversed(self._kept.items()) if of == key]
        return next((item for item in kept if item.part == part), kept[0] if kept else None)

    def comparable(self, part: Part | None = None) -> dict[str, Worked]:
        """Results that differ from the current settings only in their methods, by name.

        They share fits, failed frames and part: `part`, or else that of the latest result.
        """
        with self._lock:
            kept = list(self._kept.values())
        setting = _setting(self._session.config)
        kept = [item for item in kept if _setting(item.config) == setting]
        if not any(item.part == part for item in kept):
            part = kept[-1].part if kept else None
        return {item.name: item for item in sorted(kept, key=_order) if item.part == part}

    def fits_by(
        self, config: Config, progress: Progress | None = None, cancelled: Cancelled = never
    ) -> Sequence[FrameFit] | None:
        """The clip's fits as `workbench track` returns them, with infill and refinement if configured."""
        progress = progress or silent
        if self._alone(config):
            return self._fits.whole(config, progress, cancelled)
        found = self.run(None, config, progress, cancelled)
        return None if found is None else found.after

    def after_run(
        self, run: Run, progress: Progress | None = None, cancelled: Cancelled = never
    ) -> Sequence[FrameFit] | None:
        """A run's fits with the infill and refinement of its configuration, as far as they can work on this clip.

        None if cancelled. Nothing is kept of it.
        """
        config = run.config
        if self._alone(config) or problem_of(self._session.material, config):
            return run.fits
        with self._working:
            try:
                return self._worked(self._fits.part(None), config, run.fits, progress or silent, cancelled).after
            except _CancelledError:
                return None

    # --- within ---

    def _alone(self, config: Config) -> bool:
        """Whether frames are fitted each for itself and stay as they are."""
        return self._session.material.stills or len(self._session) < 2 or not wanted_steps(config)

    def _worked(
        self, part: Part, config: Config, before: Sequence[FrameFit], progress: Progress, cancelled: Cancelled
    ) -> Worked:
        steps = wanted_steps(config)
        views, done, total = self._views(part), 0, work_of(before, config, steps)

        def told(step: str, _done: int, _total: int | None) -> None:
            nonlocal done
            if cancelled():
                raise _CancelledError
            if step in STEPS:
                done += 1
                progress(step, min(done, total), total)

        def through(fits: Sequence[FrameFit], some: Sequence[Step]) -> tuple[FrameFit, ...]:
            return tuple(over_time(fits, views, self._session.model, config, some, told, len(fits)))

        fits, earlier = before, 0.0
        # Filled frames are reused for every refinement, except when renders go through the estimator: those take their
        # colours from the first frame of a run, so infill and refinement must run together.
        if "infill" in steps and config.flow.renders == "exact":
            fits, earlier = self._infilled(part, config, lambda: through(before, ("infill",)))
            done, steps = work_of(before, config, ("infill",)), steps[1:]
        began = time.perf_counter()
        after = through(fits, steps) if steps else fits
        return Worked(name_of(config), config, part, before, after, earlier + time.perf_counter() - began)

    def _infilled(self, part: Part, config: Config, make) -> tuple[tuple[FrameFit, ...], float]:
        """Filled frames, and the seconds that computing them took."""
        key = time_key(config.changed(refinement=NO_REFINEMENT)), part
        if key not in self._filled:
            began = time.perf_counter()
            self._filled[key] = make(), time.perf_counter() - began
            while len(self._filled) > KEPT:
                self._filled.popitem(last=False)
        return self._filled[key]

    def _views(self, part: Part) -> list[Frames]:
        frames = self._session.material.pictures.frames
        return [] if frames is None else [FrameRange(frames, *part)]


def problem_of(material: Material, config: Config) -> str:
    """Why the methods of a configuration cannot work on a material; empty where they can."""
    if config.camera.rig:
        return "A session does not hold the other views of a rig; run `workbench infill` or `workbench refine`."
    need = needs_pictures(config, wanted_steps(config))
    if need and not material.pictures.real:
        return (
            f"The method {need!r} needs pictures, and this material has only landmarks; choose linear, spline, "
            "averaging or self."
        )
    return ""


def work_of(fits: Sequence[FrameFit], config: Config, steps: Sequence[str]) -> int:
    """Approximate number of solves that the steps take on these fits."""
    turns = max(1, config.refinement.reestimate)
    infill = infill_plan(config)
    failed = sum(not usable(fit, infill) for fit in fits)
    first = {"meet": 2, "back-and-forth": 1}[config.infill.passes]
    each = first + config.infill.rounds if config.infill.method == "flow" else 1
    work = failed * each if "infill" in steps else 0
    work += turns * len(passes(refinement_plan(config))) * len(fits) if "refine" in steps else 0
    work += turns * len(fits) if "reestimate" in steps else 0
    return max(work, 1)


def _setting(config: Config) -> tuple[str, str]:
    """Key of the settings that results must share to be compared in a chart: all but the methods and their turns."""
    methods = {"infill": {"method"}, "refinement": {"method", "sweeps", "reestimate"}}
    return fits_key(config), config.model_dump_json(include=set(TIME_SECTIONS), exclude=methods)


def _order(worked: Worked) -> tuple[int, int]:
    refinement = ("none", *REFINEMENTS).index(worked.config.refinement.method)
    return refinement, ("none", *INFILLS).index(worked.config.infill.method)
