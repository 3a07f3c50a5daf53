"""A session in the widgets that every front end has: settings, and a picture of fit and head that follows them."""

import ipywidgets as widgets
import numpy as np

from workbench.pictures import HeadPanel, draw_overlay, side_by_side
from workbench.plots import close_up
from workbench.session import TuningSession
from workbench.session.knobs import changed_by, label_of
from workbench.widgets.cell_reruns import replace_earlier
from workbench.widgets.character_choice import CharacterChoice
from workbench.widgets.closing import close_all_of
from workbench.widgets.controls import Controls
from workbench.widgets.history_bar import HistoryBar
from workbench.widgets.kernel_comms import lose_no_messages
from workbench.widgets.latest import LatestWins
from workbench.widgets.panel_layout import classed, style_sheet
from workbench.widgets.playground import PARTS, SEEN_WHOLE, SIDE_PX, jpeg
from workbench.widgets.status_line import StatusLine

SETTINGS_PX = 470


class PlainPanel(widgets.VBox):
    """A view of a `TuningSession` without programs of its own in the browser, for front ends that load none.

    It has the settings, history and frames of a `TuningPanel`; landmarks cannot be picked, and the head does not turn.
    Callbacks submit to a worker, and only the latest counts; scripts and tests wait for it with `wait_idle`.
    In JupyterLab, a rerun of the cell that made it closes it.
    """

    def __init__(self, session: TuningSession) -> None:
        lose_no_messages()
        self.session, self._closed = session, False
        self.status = StatusLine()
        self.history = HistoryBar(session, self.status)
        self.controls = Controls(session.base, self._on_knob, SETTINGS_PX, scheme=session.material.scheme)
        self.frame = widgets.IntSlider(
            min=0, max=len(session) - 1, description="frame", continuous_update=False,
            layout=widgets.Layout(width="100%", display=None if len(session) > 1 else "none"),
        )  # fmt: skip
        self.image = widgets.Image(format="jpeg", layout=widgets.Layout(**SEEN_WHOLE))
        self._character = CharacterChoice(session, session.model)
        self._heads = self._head_panel()
        self._worker: LatestWins[int] = LatestWins(self._refit, self.status.failed, "plain-panel")
        self._leave = session.listen(self._on_session)
        self.frame.observe(lambda change: self._worker.submit(change["new"]), "value")
        self.controls.widget.layout.flex = "0 0 320px"
        seen = widgets.VBox([self.frame, self.image, self.status], layout=widgets.Layout(flex="1 1 0", min_width="0"))
        super().__init__([style_sheet(), self.history.widget, widgets.HBox([self.controls.widget, seen])])
        classed(self, "fw-panel")
        replace_earlier(self)
        self._show_config()
        self._worker.submit(0)

    def __repr__(self) -> str:
        return f"PlainPanel({self.session!r})"

    def wait_idle(self, timeout_s: float | int = 60.0) -> bool:
        """Wait until everything requested is shown; False if that takes longer."""
        return self._worker.wait_idle(timeout_s)

    def close(self) -> None:
        """Stop following the session, stop the thread and free the renderer."""
        if self._closed:
            return
        self._closed = True
        self._leave()
        self._worker.close()
        self._heads.painter.close()
        close_all_of(self)

    def _on_knob(self, path: str, value: object) -> None:
        changes = changed_by(self.session.config, path, value)
        if not self.status.guarded(lambda: self.session.set(label_of(path), path, **changes)):
            self.controls.show(self.session.config)

    def _on_session(self, what: str) -> None:
        if what == "snapshots":
            self.history.show_snapshots()
        elif what in ("config", "run"):
            self._show_config()
            self._worker.submit(self.frame.value)

    def _show_config(self) -> None:
        self.controls.show(self.session.config)
        self.history.show()

    def _head_panel(self) -> HeadPanel:
        return HeadPanel(self.session.model, (SIDE_PX, SIDE_PX), dressed=self._character.dressed)

    def _refit(self, frame: int) -> None:
        """Fit a frame and show it; in the worker's thread."""
        fit, picture = self.session.fit_frame(frame), self.session.picture(frame)
        if self._character.follow():
            self._heads.painter.close()
            self._heads = self._head_panel()
        head = self._heads.submit(fit)  # drawn in parallel with the overlay
        seen = draw_overlay(*close_up(picture, fit, SIDE_PX), parts=PARTS) if fit.found else _middle(picture)
        self.image.value = jpeg(side_by_side(seen, head.result()[0]))
        self.status.show_fit(fit, len(self.session))


def _middle(picture: np.ndarray) -> np.ndarray:
    """A square from the middle of a picture without a face."""
    side = min(SIDE_PX, *picture.shape[:2])
    top, left = ((length - side) // 2 for length in picture.shape[:2])
    return picture[top : top + side, left : left + side]
