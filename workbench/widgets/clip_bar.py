"""Fitting all of a clip, after each change or on request."""

from collections.abc import Callable

import ipywidgets as widgets

from workbench.session import TuningSession
from workbench.widgets.clip_views import ClipViews
from workbench.widgets.controls import small_button, toggle
from workbench.widgets.latest import LatestWins
from workbench.widgets.waiting import OLD, Job

SETTLED_S = 0.3
"""Pause after the last change before the whole clip, or an exact identity, is fitted."""
LIVE_CLIP_FRAMES = 1500
"""Clips up to this length are re-fitted after each change unless the user switches this off."""


class ClipBar:
    """Buttons that fit a clip, and the thread that does it; only the latest request counts.

    `refit` is called if the fit of the shown frame is out of date; `settled` if there is nothing to run; `known` to
    show a run from before there was a panel; `failed` with errors.
    """

    def __init__(
        self,
        session: TuningSession,
        views: ClipViews,
        refit: Callable[[], None],
        settled: Callable[[], None],
        known: Callable[[], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._session, self._views, self._refit, self._settled, self._known = session, views, refit, settled, known
        self._worker: LatestWins[str] = LatestWins(self._work, failed, "panel-clip")
        self.run_clip = small_button("fit clip", "fit all frames with these settings")
        self.run_clip.on_click(lambda _button: self._worker.submit("run"))
        self.follow = toggle("auto", "fit the whole clip after each change", len(session) <= LIVE_CLIP_FRAMES)
        self.cancel = small_button("cancel", "stop fitting; the last complete run is kept")
        self.cancel.on_click(lambda _button: self._worker.submit("cancel"))
        self.progress = widgets.IntProgress(0, max=len(session), layout=widgets.Layout(width="120px"))
        self.said = widgets.HTML()
        self.hide_progress()
        self.widgets = self.run_clip, self.follow, self.cancel, self.progress

    @property
    def is_clip(self) -> bool:
        """Whether there is more than one frame."""
        return len(self._session) > 1

    @property
    def is_slow(self) -> bool:
        """Whether a clip is only run on request, because Deep Energies takes seconds per frame."""
        return self.is_clip and not self._session.config.traits.real_time

    def begin(self) -> None:
        """Show the run that there is, and start one if it is out of date or missing, and quick."""
        self._worker.submit("begin")

    def settle(self) -> None:
        """After a change of configuration: run the clip after a pause, if enabled."""
        self._worker.submit("settle")

    def wait_idle(self, timeout_s: float | int) -> bool:
        """Wait until nothing runs; False if that takes longer."""
        return self._worker.wait_idle(timeout_s)

    def close(self) -> None:
        """Stop the run and the thread."""
        self._worker.close()

    def hide_progress(self) -> None:
        """Hide the progress bar, and what cancels, when nothing is running."""
        self.progress.layout.visibility = self.cancel.layout.visibility = "hidden"
        self.said.value = ""
        self._views.curves.remove_class(OLD)

    def _work(self, wanted: str) -> None:
        if wanted == "begin":
            known = self._session.run is not None
            if known:
                self._known()
            wanted = "settle" if known or self.is_slow else "run"
        if wanted == "run" or (wanted == "settle" and not self._worker.wait_newer(SETTLED_S) and self._is_due()):
            self._run()

    def _is_due(self) -> bool:
        """Whether to run the clip now; if not, mark what is out of date."""
        if not self.is_clip:  # the shown fit is the whole run
            self._settled()
            return False
        stale = self._session.stale.any()  # False if only infill or refinement changed, because the fits are the same
        if stale and self.follow.value and not self.is_slow:
            return True
        if stale:
            self._refit()
        self._views.show_stale()
        self._settled()
        return False

    def _run(self) -> None:
        self.progress.value, self.progress.layout.visibility = 0, "visible"
        self.cancel.layout.visibility = "visible"
        self._views.show_stale()
        self._views.curves.add_class(OLD)
        shown, job = max(len(self._session) // 20, 1), Job("fitting the clip")

        def progress(step: str, done: int, total: int | None) -> None:
            if done % shown == 0:
                job.progress(step, done, total)
                self.progress.value, self.said.value = done, job.text

        self._session.fit_clip(progress, cancelled=self._worker.newer)
        self.hide_progress()
