"""The fits that infill and refinement start from: of the whole clip, or of one part if each fit takes seconds."""

import threading
from collections import OrderedDict
from collections.abc import Sequence

from workbench.config import Config
from workbench.errors import InputError, StoppedError
from workbench.planning import plan_of
from workbench.session.clip_run import Run
from workbench.session.dependence import fits_key
from workbench.session.material import Cancelled, Progress
from workbench.session.parts import Part
from workbench.tracking import FrameFit

KEPT_SETTINGS = 4
"""Number of settings whose single-frame fits are cached."""


class PartFits:
    """Fits of parts of a session's clip under any configuration, computed when missing."""

    def __init__(self, session) -> None:
        self._session = session
        self._single: OrderedDict[str, dict[int, FrameFit]] = OrderedDict()
        self._lock = threading.Lock()

    def part(self, part: Part | None) -> Part:
        """The part, or the whole clip for None. Raises `InputError` for photos, and for a part outside the clip."""
        count = len(self._session)
        if self._session.material.stills or count < 2:
            raise InputError("Infill and refinement need consecutive frames; open a clip, not photos.")
        first, last = (0, count - 1) if part is None else part
        if not 0 <= first < last < count:
            raise InputError(
                f"A part of this clip must be within 0-{count - 1} and have at least two frames, got {first}-{last}."
            )
        return first, last

    def fitted(
        self, part: Part, config: Config, progress: Progress, cancelled: Cancelled
    ) -> tuple[FrameFit, ...] | None:
        """The fits of a part before infill and refinement; None if cancelled."""
        first, last = part
        if config.traits.real_time or self.ran(config):
            fits = self.whole(config, progress, cancelled)
            return None if fits is None else fits[first : last + 1]
        frames, single = range(first, last + 1), self.singles(config)
        if not set(frames) <= set(single):
            linked = plan_of(config, self._session.model.scheme).linked
            (self._walked if linked else self._alone)(frames, config, progress, cancelled)
        return tuple(single[frame] for frame in frames) if set(frames) <= set(single) else None

    def _alone(self, frames: range, config: Config, progress: Progress, cancelled: Cancelled) -> None:
        """Fit the frames that are missing, each for itself, until cancelled."""
        single = self.singles(config)
        for done, frame in enumerate(frames, start=1):
            if cancelled():
                return
            if frame not in single:
                try:
                    single[frame] = self._session.fit_frame(frame, config=config, cancelled=cancelled)
                except StoppedError:
                    return
            progress("fit", done, len(frames))

    def _walked(self, frames: range, config: Config, progress: Progress, cancelled: Cancelled) -> None:
        """Fit the frames in turn, each continuing the one before, from the beginning of their shot, until cancelled."""
        shots, single = self._session.material.shots, self.singles(config)
        begin = next(shot.start for shot in shots if frames.start in shot)
        walked = range(begin, frames.stop)
        for frame, (fit, _) in zip(walked, self._session.runs.walked(walked, config, cancelled), strict=False):
            single[frame] = fit
            progress("fit", frame - begin + 1, len(walked))

    def whole(self, config: Config, progress: Progress, cancelled: Cancelled) -> Sequence[FrameFit] | None:
        """The fits of the last complete run if it used this configuration, else of a new run. None if cancelled.

        A new run becomes the last one unless it is by an earlier configuration of the session.
        """
        run = self._last(config)
        if run is None:
            session = self._session
            if fits_key(config) != fits_key(session.config):
                run = session.runs.aside(config, progress, cancelled)
            else:
                run = session.runs.fit(config, progress, cancelled)
                if run is not None:
                    session.tell("run")
        return None if run is None else run.fits

    def ran(self, config: Config) -> bool:
        """Whether the last complete run has the fits of a configuration."""
        return self._last(config) is not None

    def _last(self, config: Config) -> Run | None:
        """The last complete run, if it has the fits of a configuration; another thread may replace it meanwhile."""
        run = self._session.run
        return run if run is not None and fits_key(run.config) == fits_key(config) else None

    def singles(self, config: Config) -> dict[int, FrameFit]:
        """The fits computed outside of whole runs under a configuration, by frame."""
        key = fits_key(config)
        with self._lock:
            kept = self._single.setdefault(key, {})
            self._single.move_to_end(key)
            while len(self._single) > KEPT_SETTINGS:
                self._single.popitem(last=False)
        return kept
