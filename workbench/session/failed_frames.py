"""Frames of a session's clip that count as failed: marked by the user, without a face, or with a bad fit."""

from collections.abc import Iterable

import numpy as np

from workbench.config import Config
from workbench.diagnosis import flag_frames
from workbench.errors import InputError
from workbench.planning import infill_plan
from workbench.session.material import Cancelled, Progress
from workbench.session.part_fits import PartFits
from workbench.session.parts import Part, parts_of, parts_text
from workbench.tracking import Track
from workbench.tracking.infill import usable, usable_frames
from workbench.tracking.records import stack_fits


class FailedFrames:
    """Marks are part of the session's configuration, so undo restores them."""

    def __init__(self, session, fits: PartFits) -> None:
        self._session, self._fits = session, fits

    def marked(self) -> set[int]:
        """Frames marked by the user."""
        last = len(self._session) - 1
        parts = self._session.config.infill.frames
        return {frame for begin, end in parts for frame in range(begin, min(end, last) + 1)}

    def mark(self, frames: Iterable[int], label: str = "") -> Config:
        """Mark frames as failed; one undo step. Raises `InputError` outside the clip."""
        frames = self._checked(frames)
        return self._name(self.marked() | frames, label or f"failed: {parts_text(parts_of(frames))}")

    def unmark(self, frames: Iterable[int]) -> Config:
        """Remove the mark from frames, so that their fits count again. Raises `InputError` outside the clip."""
        frames = self._checked(frames)
        return self._name(self.marked() - frames, f"not failed: {parts_text(parts_of(frames))}")

    def mark_flagged(self, part: Part, progress: Progress, cancelled: Cancelled) -> tuple[int, ...]:
        """Also mark the frames of a part that diagnosis flags. Returns those frames; none if cancelled."""
        config = self._session.config
        fits = self._fits.fitted(part, config, progress, cancelled)
        if fits is None:
            return ()
        track = Track(meta={}, **stack_fits(list(fits)))
        flagged = tuple((part[0] + np.flatnonzero(flag_frames(track, config).flagged)).tolist())
        if flagged:
            self.mark(flagged, f"flagged as failed: {parts_text(parts_of(flagged))}")
        return flagged

    def within(self, part: Part) -> tuple[int, ...]:
        """Failed frames of a part, among those already fitted."""
        config = self._session.config
        infill = infill_plan(config)
        if self._fits.ran(config):
            bad = set(np.flatnonzero(~usable_frames(self._session.run.track, infill)).tolist())
        else:
            bad = {frame for frame, fit in self._fits.singles(config).items() if not usable(fit, infill)}
        bad |= self.marked()
        return tuple(frame for frame in range(part[0], part[1] + 1) if frame in bad)

    def _checked(self, frames: Iterable[int]) -> set[int]:
        first, last = self._fits.part(None)
        frames = {int(frame) for frame in frames}
        wrong = [frame for frame in frames if not first <= frame <= last]
        if wrong:
            raise InputError(f"There is no frame {wrong[0]}; the clip has frames {first} to {last}.")
        return frames

    def _name(self, frames: Iterable[int], label: str) -> Config:
        return self._session.set(label, infill={"frames": parts_of(frames)})
