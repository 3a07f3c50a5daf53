"""Two or three configurations side by side: the same frame from the same viewpoint, differences in mm, and metrics."""

from collections.abc import Callable

import ipywidgets as widgets

from workbench.config import Config
from workbench.session import TuningSession
from workbench.session.comparing import Compared, against, compared
from workbench.session.tuned_config import NOW, START
from workbench.widgets.changes_page import comparison_html, configurations, metrics_under
from workbench.widgets.closing import close_all_of
from workbench.widgets.controls import small_button, toggle
from workbench.widgets.head_backends import make_head_view
from workbench.widgets.head_view import HeadView, legend
from workbench.widgets.latest import LatestWins
from workbench.widgets.waiting import Job, Waiting

SIZE = (176, 126)
BESIDE_PX = 430
"""Width of the table of metrics; where less is left, it stands below the heads."""
NONE = "–"
LEAST_SCALE_MM = 0.5
"""Smallest end of the scale of differences: less is noise."""
HINT = "<span style='opacity:.7'>Keep a <i>snapshot</i> (S) to compare with it, or choose the start.</span>"


class ComparePage(widgets.VBox):
    """Heads of the shown frame under up to three configurations, and their metrics over the clip.

    The first is what the others are coloured by: their distance from it, without the pose. Nothing is fitted or drawn
    until the page is in front (`turned`). `later` is called with slow jobs, `failed` with errors.
    """

    def __init__(
        self,
        session: TuningSession,
        backend: str,
        waiting: Waiting,
        later: Callable[[Callable[[Job], None], str], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._session, self._backend, self._waiting = session, backend, waiting
        self._frame, self._open = 0, False
        self._worker: LatestWins[int] = LatestWins(self._work, failed, "panel-compare")
        self.views: list[HeadView] = []
        self._links: list[widgets.Widget] = []
        self.choices = [
            widgets.Dropdown(options=options, value=value, tooltip=tip, layout=widgets.Layout(width=f"{SIZE[0]}px"))
            for options, value, tip in (
                ([NOW, START], NOW, "what the others are compared with"),
                ([NOW, START, NONE], START, "a configuration"),
                ([NOW, START, NONE], NONE, "another configuration"),
            )
        ]
        self.color = toggle("differences", "colour by the distance from the first head, mm; else the skin", True)
        self.fit_all = small_button("fit the clip", "fit the whole clip under each of these, for the table")
        self.fit_all.on_click(lambda _button: later(self._fit_all, "fitting the clip under each"))
        for control in (*self.choices, self.color):
            control.observe(lambda _change: self._ask(), "value")
        self.captions = [widgets.HTML() for _ in self.choices]
        self._cells = [
            widgets.VBox(
                [choice, widgets.VBox(), caption], layout=widgets.Layout(flex="0 0 auto", width=f"{SIZE[0] + 6}px")
            )
            for choice, caption in zip(self.choices, self.captions, strict=True)
        ]
        self.table, self.scale = widgets.HTML(HINT), widgets.HTML()
        beside = widgets.VBox(
            [widgets.HBox([self.color, self.fit_all]), self.scale, self.table],
            layout=widgets.Layout(flex=f"1 1 {BESIDE_PX}px", min_width="0", overflow="auto"),
        )
        row = widgets.HBox([*self._cells, beside], layout=widgets.Layout(flex_flow="row wrap"))
        super().__init__([row], layout=widgets.Layout(overflow="auto hidden"))
        self.add_class("fw-compare")
        self.refresh()

    def turned(self, is_front: bool) -> None:
        """Work only while the page is in front."""
        if is_front and not self.views:
            self._make_views()
        self._open = is_front  # only now, because another thread may ask at any time
        self._ask()

    def show_frame(self, frame: int) -> None:
        """Show another frame, or the same after a change."""
        self._frame = frame
        self._ask()

    def refresh(self) -> None:
        """Update the menus and the heads after snapshots have changed."""
        names = list(configurations(self._session))
        for number, choice in enumerate(self.choices):
            options, chosen = [*names, NONE][: None if number else -1], choice.value
            if list(choice.options) != options:
                choice.options = options
                choice.value = chosen if chosen in options else options[-1]
        self._ask()

    def wait_idle(self, timeout_s: float | int) -> bool:
        """Wait until the heads are shown; False if that takes longer."""
        return self._worker.wait_idle(timeout_s)

    def close(self) -> None:
        """Stop the thread and free the views."""
        self._worker.close()
        for view in self.views:
            view.close()
        super().close()

    def _make_views(self) -> None:
        model = self._session.model
        self.views = [make_head_view(model, SIZE, self._backend) for _ in self.choices]
        for view, cell in zip(self.views, self._cells, strict=True):
            view.set_view("camera")
            view.widget.children = view.widget.children[:1]  # one scale for all stands beside them
            choice, empty, caption = cell.children
            cell.children = (choice, view.widget, caption)
            close_all_of(empty)
        canvases = [view.canvas for view in self.views if hasattr(view, "canvas")]
        for canvas in canvases[1:]:
            self._links.append(widgets.jslink((canvases[0], "_viewpoint"), (canvas, "_viewpoint")))

    def _ask(self) -> None:
        if self._open:
            self._worker.submit(self._frame)

    def _chosen(self) -> list[tuple[str, Config] | None]:
        known = configurations(self._session)
        return [(choice.value, known[choice.value]) if choice.value in known else None for choice in self.choices]

    # --- in the thread of the page, and in that of slow jobs ---

    def _work(self, frame: int) -> None:
        chosen = self._chosen()
        with self._waiting.during("fitting the frame for comparison", cancel=self._leave) as job:
            fits = [one and compared(self._session, frame, one[1], job.cancelled) for one in chosen]
        if self._worker.newer():
            return
        if not all(fit.found for fit in fits if fit):
            self._show_no_face()
            return
        first = fits[0]
        shown = [fit and against(self._session, fit, first) for fit in fits]
        high = max([LEAST_SCALE_MM, *(float(item.apart_mm.max()) for item in shown if item)])
        colors = self.color.value and any(shown[1:])
        self.scale.value = legend("distance from the first, mm", 0.0, high) if colors else ""
        for number, (view, item) in enumerate(zip(self.views, shown, strict=True)):
            self._cells[number].children[1].layout.visibility = "visible" if item else "hidden"
            self.captions[number].value = "" if item is None else caption_html(item, number == 0)
            if item is not None:
                view.set_pose(first.rotation, first.translation, first.camera, first.image_size)
                view.set_vertices(item.vertices, self._session.model.personal(item.fit.identity).neutral)
                view.set_values(item.apart_mm if colors and number else None, 0.0, high, "distance, mm")
        self.show_table()

    def _show_no_face(self) -> None:
        self.scale.value = "no face in this frame"
        for cell, caption in zip(self._cells, self.captions, strict=True):
            cell.children[1].layout.visibility, caption.value = "hidden", ""
        self.show_table()

    def show_table(self) -> None:
        """The metrics of the configurations that are shown, as far as their clip has been fitted."""
        rows = {name: metrics_under(self._session, config) for name, config in filter(None, self._chosen())}
        self.table.value = comparison_html(rows) or HINT
        missing = [name for name, numbers in rows.items() if not numbers]
        self.fit_all.disabled = not missing or len(self._session) < 2

    def _leave(self) -> None:
        self.choices[1].value = self.choices[2].value = NONE

    def _fit_all(self, job: Job) -> None:
        for _name, config in filter(None, self._chosen()):
            if self._session.runs.aside(config, job.progress, job.cancelled) is None:
                return
        self._ask()


def caption_html(item: Compared, first: bool) -> str:
    """The error of a fit, and how far it is from the first one."""
    error = f"error <b>{item.fit.errors[2]:.1f} %</b>" if item.fit.seen else "not seen"
    if first:
        return error
    pose = f"pose: turned by {item.turned_deg:.1f}° and moved by {item.moved_mm:.0f} mm from the first"
    return f"<span title='{pose}'>{error} · up to {item.apart_mm.max():.1f} mm</span>"
