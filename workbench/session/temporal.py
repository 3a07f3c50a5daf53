"""Infill and refinement of a session's clip: frames marked as failed, methods that are tried, before and after."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from workbench.config import Config
from workbench.diagnosis import flag_frames
from workbench.errors import InputError
from workbench.frames import FrameRange, Frames
from workbench.geometry import yaw_pitch_roll_deg
from workbench.pipeline.temporal_run import STEPS, Step, needs_pictures, over_time, wanted_steps
from workbench.planning import infill_plan, refinement_plan
from workbench.session.metrics import metrics_of
from workbench.tracking import FrameFit, Track
from workbench.tracking.infill import usable, usable_frames
from workbench.tracking.records import stack_fits
from workbench.tracking.refinement import passes

TIME_SECTIONS = ("flow", "infill", "refinement")
"""Sections of the configuration that a single frame's fit does not depend on."""
INFILLS, REFINEMENTS = ("flow", "linear", "spline"), ("averaging", "self", "plate", "hybrid")
ANGLES, PLACES = ("yaw", "pitch", "roll"), ("x", "y", "z")
KEPT, KEPT_SETTINGS = 48, 4
"""Results that are kept for going back to, and settings of single frames whose fits are."""
NO_REFINEMENT = {"method": "none", "reestimate": 0}
AS_FITTED = "as fitted"

Part = tuple[int, int]
"""First and last frame."""
Progress = Callable[[str, int, int | None], None]
Cancelled = Callable[[], bool]


@dataclass(frozen=True, eq=False)
class Worked:
    """Frames of a clip before and after infill and refinement by one configuration."""

    name: str
    config: Config
    part: Part
    before: tuple[FrameFit, ...]
    after: tuple[FrameFit, ...]
    seconds: float

    def pair(self, frame: int) -> tuple[FrameFit, FrameFit] | None:
        """A frame before and after; None outside the part."""
        first, last = self.part
        return (self.before[frame - first], self.after[frame - first]) if first <= frame <= last else None

    @property
    def filled(self) -> tuple[int, ...]:
        """Frames that infill made."""
        return tuple(fit.index for fit in self.after if fit.source == "filled")

    def numbers(self) -> dict[str, float]:
        """Filled frames, jitter of the pose in degrees, errors in % of the eye distance, seconds.

        `hidden_percent` is over filled frames that had landmarks, which the infill did not look at.
        """
        metrics = metrics_of(self.after)
        numbers = {"filled": float(len(self.filled)), "seconds": self.seconds}
        for name, of in (("jitter_deg", "jitter_deg"), ("error_percent", "all_68_percent_mean")):
            if of in metrics:
                numbers[name] = metrics[of]
        hidden = [
            replace(after, observed=before.observed).errors[2]
            for before, after in zip(self.before, self.after, strict=True)
            if after.source == "filled" and before.found and np.nan_to_num(before.confidence).max() > 0.0
        ]
        if hidden:
            numbers["hidden_percent"] = float(np.mean(hidden))
        return numbers


class _CancelledError(Exception):
    """Leaves the work that a user took back."""


class TemporalWork:
    """What uses time, on the clip of a `TuningSession`. Settings live in the session's configuration.

    Results are kept by the settings that made them: `current` is the one of the present configuration, so undo brings
    it back. Methods may be called from any thread; work waits for work that is going on.
    """

    def __init__(self, session) -> None:
        self._session = session
        self._lock, self._working = threading.RLock(), threading.RLock()
        self._kept: OrderedDict[tuple[str, Part], Worked] = OrderedDict()
        self._filled: OrderedDict[tuple[str, Part], tuple[tuple[FrameFit, ...], float]] = OrderedDict()
        self._single: OrderedDict[str, dict[int, FrameFit]] = OrderedDict()

    def __repr__(self) -> str:
        return f"TemporalWork({self._session.material.name!r}, {len(self._kept)} results)"

    # --- frames that count as failed ---

    @property
    def marked(self) -> tuple[Part, ...]:
        """Frames that the user named, as parts that do not touch."""
        return parts_of(self._marked())

    def mark(self, frames: Iterable[int], label: str = "") -> Config:
        """Count frames as failed, whatever their fit; one step of undo. Raises `InputError` outside the clip."""
        frames = self._checked(frames)
        return self._name(self._marked() | frames, label or f"failed: {parts_text(parts_of(frames))}")

    def unmark(self, frames: Iterable[int]) -> Config:
        """Let frames stand as they were fitted, if their fit is good."""
        frames = self._checked(frames)
        return self._name(self._marked() - frames, f"not failed: {parts_text(parts_of(frames))}")

    def mark_flagged(
        self, part: Part | None = None, progress: Progress = lambda *_: None, cancelled: Cancelled = lambda: False
    ) -> tuple[int, ...]:
        """Count the frames that diagnosis flags as failed, too; which they are. Fits the frames first if need be."""
        config = self._session.config
        part = self._part(part)
        fits = self._before(part, config, progress, cancelled)
        if fits is None:
            return ()
        track = Track(meta={}, **stack_fits(list(fits)))
        flagged = tuple((part[0] + np.flatnonzero(flag_frames(track, config).flagged)).tolist())
        if flagged:
            self.mark(flagged, f"flagged as failed: {parts_text(parts_of(flagged))}")
        return flagged

    def failed(self, part: Part | None = None) -> tuple[int, ...]:
        """Frames that infill would fill, as far as they are fitted: marked, without a face, or with a bad fit."""
        first, last = self._part(part)
        config = self._session.config
        infill = infill_plan(config)
        if self._ran(config):
            bad = set(np.flatnonzero(~usable_frames(self._session.run.track, infill)).tolist())
        else:
            bad = {frame for frame, fit in self._singles(config).items() if not usable(fit, infill)}
        bad |= self._marked()
        return tuple(frame for frame in range(first, last + 1) if frame in bad)

    # --- work ---

    def run(
        self,
        part: Part | None = None,
        config: Config | None = None,
        progress: Progress = lambda *_: None,
        cancelled: Cancelled = lambda: False,
    ) -> Worked | None:
        """Infill and refine a part (None: the clip) by a configuration (None: the present one); None if cancelled.

        Frames that are not fitted under it are fitted first: the whole clip, with Deep Energies the part alone. On
        the whole clip the numbers are those of `workbench track`; a part ends like a clip, with neighbours on one side.
        Raises `InputError` for photos, and where nothing is chosen or pictures are missing.
        """
        config = self._session.config if config is None else config
        part = self._part(part)
        steps = wanted_steps(config)
        if not steps:
            raise InputError("Nothing is chosen that uses time; choose a method of infill or refinement.")
        self._check_pictures(config, steps)
        key = time_key(config), part
        with self._working:
            if key not in self._kept:
                try:
                    found = self._worked(part, config, steps, progress, cancelled)
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
        progress: Progress = lambda *_: None,
        cancelled: Cancelled = lambda: False,
    ) -> list[Worked] | None:
        """Every method of infill (where a frame fails) and of refinement, the other settings as they stand.

        Methods of refinement follow the infill that is chosen. None if cancelled; what was finished stays.
        """
        config, part = self._session.config, self._part(part)
        if self._before(part, config, progress, cancelled) is None:
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
        """The newest result under the present configuration; None if there is none."""
        return self.result()

    def result(self, part: Part | None = None) -> Worked | None:
        """The result under the present configuration on a part, or else the newest on any."""
        key = time_key(self._session.config)
        with self._lock:
            kept = [item for (of, _), item in reversed(self._kept.items()) if of == key]
        return next((item for item in kept if item.part == part), kept[0] if kept else None)

    def comparable(self, part: Part | None = None) -> dict[str, Worked]:
        """Results that differ from the present settings by the methods alone, by name.

        They have their fits, failed frames and part in common: `part`, or else that of the newest.
        """
        with self._lock:
            kept = list(self._kept.values())
        setting = _setting(self._session.config)
        kept = [item for item in kept if _setting(item.config) == setting]
        if not any(item.part == part for item in kept):
            part = kept[-1].part if kept else None
        return {item.name: item for item in sorted(kept, key=_order) if item.part == part}

    def fits_by(
        self, config: Config, progress: Progress | None = None, cancelled: Cancelled = lambda: False
    ) -> Sequence[FrameFit] | None:
        """The clip's fits as `workbench track` leaves them: worked on over time if the configuration asks for it."""
        progress = progress or (lambda *_: None)
        if self._session.material.stills or not wanted_steps(config):
            return self._whole(config, progress, cancelled)
        found = self.run(None, config, progress, cancelled)
        return None if found is None else found.after

    # --- within ---

    def _worked(
        self, part: Part, config: Config, steps: Sequence[Step], progress: Progress, cancelled: Cancelled
    ) -> Worked:
        before = self._before(part, config, progress, cancelled)
        if before is None:
            raise _CancelledError
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
        # Filled frames serve every refinement. But renders that go through the estimator take their colours from the
        # first frame of a run, and infill and refinement belong together.
        if "infill" in steps and config.flow.renders == "exact":
            fits, earlier = self._infilled(part, config, lambda: through(before, ("infill",)))
            done, steps = work_of(before, config, ("infill",)), steps[1:]
        began = time.perf_counter()
        after = through(fits, steps) if steps else fits
        return Worked(name_of(config), config, part, before, after, earlier + time.perf_counter() - began)

    def _infilled(self, part: Part, config: Config, make) -> tuple[tuple[FrameFit, ...], float]:
        """Filled frames, and the seconds that they took when they were made."""
        key = time_key(config.changed(refinement=NO_REFINEMENT)), part
        if key not in self._filled:
            began = time.perf_counter()
            self._filled[key] = make(), time.perf_counter() - began
            while len(self._filled) > KEPT:
                self._filled.popitem(last=False)
        return self._filled[key]

    def _before(
        self, part: Part, config: Config, progress: Progress, cancelled: Cancelled
    ) -> tuple[FrameFit, ...] | None:
        """The fits of single frames; None if cancelled."""
        first, last = part
        if not config.traits.real_time and not self._ran(config):
            single = self._singles(config)
            for frame in range(first, last + 1):
                if cancelled():
                    return None
                if frame not in single:
                    single[frame] = self._session.fit_frame(frame, config=config)
                progress("fit", frame - first + 1, last - first + 1)
            return tuple(single[frame] for frame in range(first, last + 1))
        fits = self._whole(config, progress, cancelled)
        return None if fits is None else fits[first : last + 1]

    def _whole(self, config: Config, progress: Progress, cancelled: Cancelled) -> Sequence[FrameFit] | None:
        """The last whole run's fits if they are this configuration's; a whole run otherwise."""
        if not self._ran(config) and self._session.fit_clip(progress, cancelled, config) is None:
            return None
        return self._session.run.fits

    def _ran(self, config: Config) -> bool:
        run = self._session.run
        return run is not None and fits_key(run.config) == fits_key(config)

    def _singles(self, config: Config) -> dict[int, FrameFit]:
        with self._lock:
            kept = self._single.setdefault(fits_key(config), {})
            self._single.move_to_end(fits_key(config))
            while len(self._single) > KEPT_SETTINGS:
                self._single.popitem(last=False)
        return kept

    def _views(self, part: Part) -> list[Frames]:
        frames = self._session.material.pictures.frames
        return [] if frames is None else [FrameRange(frames, *part)]

    def _check_pictures(self, config: Config, steps) -> None:
        if config.camera.rig:
            raise InputError("The other views of a rig are not in a session; export, and run `workbench track`.")
        need = needs_pictures(config, steps)
        if need and not self._session.material.pictures.real:
            raise InputError(
                f"The method {need!r} looks at the pictures, and there are landmarks alone; choose linear, spline, "
                "averaging or self."
            )

    def _part(self, part: Part | None) -> Part:
        count = len(self._session)
        if self._session.material.stills or count < 2:
            raise InputError("Infill and refinement use frames that follow each other; open a clip, not photos.")
        first, last = (0, count - 1) if part is None else part
        if not 0 <= first < last < count:
            raise InputError(f"A part of this clip lies within 0-{count - 1} and has two frames, got {first}-{last}.")
        return first, last

    def _marked(self) -> set[int]:
        return {
            frame
            for first, last in self._session.config.infill.frames
            for frame in range(first, min(last, len(self._session) - 1) + 1)
        }

    def _checked(self, frames: Iterable[int]) -> set[int]:
        first, last = self._part(None)
        frames = {int(frame) for frame in frames}
        wrong = [frame for frame in frames if not first <= frame <= last]
        if wrong:
            raise InputError(f"There is no frame {wrong[0]}; the clip has frames {first} to {last}.")
        return frames

    def _name(self, frames: Iterable[int], label: str) -> Config:
        return self._session.set(label, infill={"frames": parts_of(frames)})


def fits_key(config: Config) -> str:
    """What the fits of single frames depend on."""
    return config.model_dump_json(exclude={"preset", "provenance", *TIME_SECTIONS})


def time_key(config: Config) -> str:
    """What the frames after infill and refinement depend on."""
    return fits_key(config) + config.model_dump_json(include=set(TIME_SECTIONS))


def name_of(config: Config) -> str:
    """The methods of a configuration in a few words."""
    infill, refinement = config.infill.method, config.refinement
    words = [] if infill == "none" else [infill]
    if refinement.method != "none":
        sweeps = f" ×{refinement.sweeps}" if refinement.sweeps > 1 else ""
        words.append(refinement.method + sweeps)
    if refinement.reestimate:
        words.append("re-estimated" + (f" ×{refinement.reestimate}" if refinement.reestimate > 1 else ""))
    return " + ".join(words) or AS_FITTED


def work_of(fits: Sequence[FrameFit], config: Config, steps: Sequence[str]) -> int:
    """About how many solves the steps take on these fits."""
    turns = max(1, config.refinement.reestimate)
    infill = infill_plan(config)
    failed = sum(not usable(fit, infill) for fit in fits)
    each = 2 + config.infill.rounds if config.infill.method == "flow" else 1
    work = failed * each if "infill" in steps else 0
    work += turns * len(passes(refinement_plan(config))) * len(fits) if "refine" in steps else 0
    work += turns * len(fits) if "reestimate" in steps else 0
    return max(work, 1)


def curve(fits: Sequence[FrameFit], quantity: str, names: Sequence[str] = ()) -> Float[np.ndarray, "n"]:
    """One number of each frame: yaw, pitch or roll in degrees, x, y or z in mm, or the weight of a blendshape.

    `names` are those of the blendshapes; NaN in frames without a face.
    """
    if quantity in ANGLES:
        rotations = np.stack([np.asarray(fit.rotation, float) for fit in fits])
        angles = np.full((len(fits), 3), np.nan)
        known = np.isfinite(rotations).all(axis=1)
        if known.any():
            angles[known] = yaw_pitch_roll_deg(rotations[known])
        return angles[:, ANGLES.index(quantity)]
    if quantity in PLACES:
        return np.array([float(fit.translation[PLACES.index(quantity)]) for fit in fits])
    column = list(names).index(quantity)
    return np.array([float(fit.expression[column]) for fit in fits])


def moving_weights(fits: Sequence[FrameFit], names: Sequence[str], count: int) -> list[str]:
    """The blendshapes whose weights move most."""
    weights = np.stack([fit.expression for fit in fits if fit.found] or [np.zeros(len(names))])
    return [names[k] for k in np.argsort(-weights.std(axis=0), kind="stable")[:count]]


def parts_of(frames: Iterable[int]) -> tuple[Part, ...]:
    """Frames as parts that do not touch."""
    parts: list[Part] = []
    for frame in sorted(set(frames)):
        if parts and frame == parts[-1][1] + 1:
            parts[-1] = (parts[-1][0], frame)
        else:
            parts.append((frame, frame))
    return tuple(parts)


def parts_text(parts: Sequence[Part], most: int = 6) -> str:
    """Parts as a user writes them: 40-52, 60; the rest counted."""
    words = [f"{first}-{last}" if last > first else str(first) for first, last in parts]
    rest = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(words[:most]) + rest


def read_parts(text: str) -> tuple[Part, ...]:
    """Parts from "40-52, 60". Raises `InputError` for anything else."""
    parts = []
    for word in text.replace("–", "-").replace(",", " ").split():
        first, _, last = word.partition("-")
        if not (first.isdigit() and (last or first).isdigit() and int(first) <= int(last or first)):
            raise InputError(f"Frames are given as 40-52 or 60, got {word!r}.")
        parts.append((int(first), int(last or first)))
    return tuple(parts)


def _setting(config: Config) -> tuple[str, str]:
    """What results have in common that a chart compares."""
    return fits_key(config), config.infill.model_dump_json(exclude={"method"})


def _order(worked: Worked) -> tuple[int, int]:
    refinement = ("none", *REFINEMENTS).index(worked.config.refinement.method)
    return refinement, ("none", *INFILLS).index(worked.config.infill.method)
