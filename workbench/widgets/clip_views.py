"""Views of the whole clip: the residual strip and the curves of pose and weights of the last run."""

from collections.abc import Callable

import ipywidgets as widgets
import numpy as np

from workbench.geometry import yaw_pitch_roll_deg
from workbench.session import TuningSession
from workbench.widgets.chart_view import ChartView, gaps
from workbench.widgets.controls import menu
from workbench.widgets.timeline_view import TimelineView

CURVES = 5
"""Number of weights in the chart, which shows those of a family that vary most: more of them cannot be followed."""
FAMILIES = {"those that vary most": ""} | {
    f"of the {name}": name for name in ("mouth", "jaw", "eye", "brow", "cheek", "nose")
}
FAMILIES["of the gaze"] = "eyeLook"
"""Beginnings of the names of the weights that can be shown."""


class ClipViews:
    """Timeline and curves of the last run of a session; `go(frame)` is called when the user picks a frame."""

    def __init__(self, session: TuningSession, go: Callable[[int], None]) -> None:
        self._session, self._go = session, go
        self._values = np.zeros((0, len(session.material.scheme)))
        self.timeline = TimelineView(height_px=100, scheme=session.material.scheme, unit="% of eye distance")
        self.timeline.observe(lambda change: self._go(change["new"]), "frame")
        self.pose = ChartView(height_px=140, title="head pose")
        self.weights = ChartView(height_px=122, title="")
        self.choice = menu(FAMILIES, "172px", "weights to show")
        self.choice.observe(lambda _change: self._show_weights(), "value")
        for chart in (self.pose, self.weights):
            chart.on_pick(lambda x: self._go(round(x)))
        self.curves = widgets.HBox(
            [widgets.VBox(column, layout=widgets.Layout(width="50%", min_width="0"))
             for column in ([self.pose], [self.choice, self.weights])]
        )  # fmt: skip

    def show_frame(self, frame: int) -> None:
        """Move the cursors."""
        if self.timeline.frame != frame:
            self.timeline.frame = frame
        for chart in (self.pose, self.weights):
            chart.cursor = float(frame)

    def in_view(self) -> tuple[int, int]:
        """First and last frame in view in the strip; the whole clip until it is displayed."""
        first, last = self.timeline.in_view
        return (first, last) if last > first else (0, len(self._session) - 1)

    def next_flagged(self, frame: int, way: int = 1) -> int:
        """The next (`way` 1) or previous (-1) flagged frame, around the ends; the frame itself if none is flagged."""
        flagged = self.timeline.flagged[::way]
        return next((other for other in flagged if way * other > way * frame), flagged[0] if flagged else frame)

    def why(self, frame: int) -> str:
        """Why the last run flags a frame; empty if it does not."""
        run = self._session.run
        return "" if run is None else run.flags.text[frame]

    def show_stale(self) -> None:
        """Mark the frames whose fits belong to another configuration."""
        run = self._session.run
        if run is not None:
            self.timeline.update_frames(0, self._values, stale=self._session.stale)

    def show_run(self) -> None:
        """Show the last run."""
        track = self._session.run.track
        self._values = track.residuals_percent
        flags = self._session.run.flags
        self.timeline.set_track(
            self._values, flags.flagged, self._session.stale, track.found, track.shot, why=flags.text
        )
        frames = np.arange(len(track), dtype=float)
        angles = yaw_pitch_roll_deg(track.rotation)
        self.pose.set_series(
            frames, dict(zip(("yaw", "pitch", "roll"), angles.T, strict=True)), y_label="degrees", x_label="frame",
            shaded=gaps(np.flatnonzero(~track.found)),
        )  # fmt: skip
        self._show_weights()

    def _show_weights(self) -> None:
        if self._session.run is None:
            return
        track, family = self._session.run.track, self.choice.value
        frames, names = np.arange(len(track), dtype=float), self._session.model.expression_names
        motion = np.nan_to_num(np.nanstd(track.expression, axis=0)) if track.found.any() else np.zeros(len(names))
        most = [k for k in np.argsort(-motion, kind="stable") if names[k].startswith(family)][:CURVES]
        self.weights.set_series(
            frames,
            {names[k]: track.expression[:, k] for k in most},
            y_label="weight",
            x_label="frame",
            shaded=gaps(np.flatnonzero(~track.found)),
        )
