"""Diagnosis and uncertainty of the shown frame: requested from the session, shown in the panel."""

from collections.abc import Callable

import numpy as np

from workbench.config import Config
from workbench.diagnosis import Change, vertex_uncertainty
from workbench.errors import WorkbenchError
from workbench.session import TuningSession
from workbench.session.dependence import fits_key
from workbench.session.history import Step
from workbench.tracking import FrameFit
from workbench.widgets.diagnosis_view import DiagnosisView
from workbench.widgets.status_line import StatusLine
from workbench.widgets.waiting import Job


class FrameDiagnosis:
    """The diagnosis page (`view`) of a session.

    `later` is called with slow jobs; `frame` returns the number of the shown frame.
    """

    def __init__(
        self,
        session: TuningSession,
        status: StatusLine,
        later: Callable[[Callable[[Job], None]], None],
        frame: Callable[[], int],
        height_px: int,
    ) -> None:
        self._session, self._status, self._later, self._frame = session, status, later, frame
        self.view = DiagnosisView(self._on_ask, self.apply, self.take_back, height_px)
        self._answered: list[str] = []
        """Keys of the fits that the shown diagnosis is about: those of its settings, and those after its changes."""

    def show_config(self) -> None:
        """Grey the diagnosis out while the session's settings give other fits."""
        self.view.show_outdated(fits_key(self._session.config) not in self._answered)

    def apply(self, change: Change) -> Step[Config] | None:
        """Apply the change proposed by a reason: its undo step; None if the session refuses it, or has it already."""
        before = self._session.undo_steps
        if not self._status.guarded(self._session.apply, change, self._frame()):
            return None
        if self._session.undo_steps == before:
            self._status.say("The settings already have this change.")
            return None
        self._answered.append(fits_key(self._session.config))
        self.show_config()
        return self._session.undo_steps[-1]

    def take_back(self, applied: Step[Config]) -> bool:
        """Undo a change by its step, unless that has been done; False if other changes came after it."""
        steps = self._session.undo_steps
        if applied not in steps:
            self._status.say("This change has been undone already.")
            return True
        if steps[-1] != applied:
            self._status.say("Other changes came after this one; undo them first (Ctrl Z).")
            return False
        self._session.undo()
        return True

    def uncertainty(self, fit: FrameFit) -> np.ndarray:
        """Standard deviation of every vertex of a fit, mm."""
        frame = fit.index if len(self._session) > 1 else 0
        return vertex_uncertainty(self._session.model, self._session.uncertainty(frame), fit)

    def _on_ask(self) -> None:
        self.view.clear(f"Diagnosing frame {self._frame()} …")
        self._later(self._diagnose)

    def _diagnose(self, job: Job) -> None:
        frame, config = self._frame(), self._session.config
        try:
            found = self._session.diagnose(frame, job.progress, job.cancelled)
        except WorkbenchError as error:
            self.view.clear(str(error))
            return
        if frame == self._frame():
            self._answered = [fits_key(config)]
            self.view.show(frame, found)
            self.show_config()
