"""Sweeps in the panel: an objective over one setting as a curve or over two as a map; a click takes a point."""

import html
import time
from collections.abc import Callable
from dataclasses import dataclass

import ipywidgets as widgets

from workbench.config import Config
from workbench.errors import ConfigError
from workbench.objectives import TABLE
from workbench.session import TuningSession
from workbench.session.sweep_settings import SweepSetting, place_among, sweep_settings, value_at
from workbench.sweeps import Point, SweepResult, config_at
from workbench.sweeps.space import shown
from workbench.widgets.controls import small_button
from workbench.widgets.page_work import PageWork
from workbench.widgets.panel_layout import Beside, classed, wrapped
from workbench.widgets.setting_range import SettingRange
from workbench.widgets.status_line import StatusLine
from workbench.widgets.sweep_view import SweepView

CHEAP = ("error", "jitter", "iterations")
"""Objectives that cost nothing beyond the fits: they are measured each time, so that one can look at the others."""
FRAMES, VALUES, VALUES_OF_SECOND = 60, 15, 7
CONTROLS_PX = 578
CHANGED = "<span style='opacity:.7'>Other settings have changed since then; run it again.</span>"
WARM = "warm"


@dataclass(frozen=True)
class Asked:
    """A sweep that was asked for."""

    settings: tuple[str, ...]
    names: tuple[str, ...]
    objective: str
    frames: int


class SweepPage(Beside):
    """The page of sweeps. `give_way` waits up to some seconds until the panel's own work is done.

    Points are computed in a thread of their own, a few at a time; the latest request counts.
    """

    def __init__(self, session: TuningSession, give_way: Callable[[float], object], height_px: int) -> None:
        self._session = session
        self._settings: tuple[SweepSetting, ...] = ()
        self.result: SweepResult | None = None
        self._asked: Asked | None = None
        self._names: tuple[str, ...] = ()
        self._began, self._chosen, self._warmed = 0.0, False, False
        self.said, self.note = StatusLine(), widgets.HTML()
        self._jobs: PageWork[Asked | str] = PageWork(
            self._work,
            self.said,
            give_way,
            "panel-sweep",
            "stop; results so far are kept",
            "Stopped; results so far are kept.",
        )
        self.stop, self.progress = self._jobs.stop, self._jobs.progress
        self.view = SweepView(height_px - 12)
        self.view.on_pick(self.take)
        self._build_controls()
        rows = [
            *(widgets.HBox([*choice.widgets, widgets.Label("values")], layout=wrapped()) for choice in self._choices),
            widgets.HBox(
                [widgets.Label("measure"), self.objective, widgets.Label("on"), self.frames, widgets.Label("frames"),
                 self.go, self.stop],
                layout=wrapped(),
            ),
            self.meaning, self.progress, self.said, self.note,
        ]  # fmt: skip
        super().__init__(rows, CONTROLS_PX, self.view, height_px)
        classed(self, "fw-sweeps")
        self.show_config()
        self._explain()

    # --- for scripts and tests ---

    def run(self) -> None:
        """Sweep what is chosen."""
        self.said.guarded(self._submit)

    def take(self, number: int) -> None:
        """Set the session to a point of the sweep; one undo step."""
        self.said.guarded(self._take, number)

    @property
    def running(self) -> bool:
        """Whether a sweep runs."""
        return self._jobs.running

    def wait_idle(self, timeout_s: float | int) -> bool:
        """Wait for the sweep; False if it takes longer."""
        return self._jobs.wait_idle(timeout_s)

    def close(self) -> None:
        """Stop the sweep and its thread."""
        self._jobs.close()
        super().close()

    # --- what the panel tells ---

    def turned(self, is_front: bool) -> None:
        """Once the page is looked at, compile what a sweep needs."""
        if is_front and not self._warmed:
            self._warmed = True
            self._jobs.submit(WARM)

    def moved(self, path: str) -> None:
        """A slider was moved: until a setting is chosen here, it is the one to sweep."""
        path = path.replace("group.", "landmarks.weights.")
        if self._chosen or (self.first.setting is not None and self.first.setting.path == path):
            return
        setting = next((item for item in self._settings if item.path == path), None)
        if setting is not None:
            self.first.choose(setting)
            self._chosen = False

    def show_config(self) -> None:
        """Update from the session's configuration."""
        self._settings = sweep_settings(self._session.config, self._session.material.scheme)
        for choice in self._choices:
            choice.offer(self._settings)
        if self.result is None or self._asked is None:
            return
        self.view.mark(self._now())
        self.note.value = "" if same_besides(self._session.config, self.result) else CHANGED

    # --- parts ---

    def _build_controls(self) -> None:
        self.first = SettingRange(
            "setting to sweep: type words such as steady or lens; until then, the slider that was moved last",
            "search for a setting to sweep", VALUES, self.said.failed,
        )  # fmt: skip
        self.second = SettingRange(
            "a second setting makes a map; empty: a curve", "and a second one: a map", VALUES_OF_SECOND,
            self.said.failed,
        )  # fmt: skip
        self._choices = (self.first, self.second)
        self.first.name.observe(self._on_chosen, "value")
        self.objective = widgets.Dropdown(
            options=[(name.replace("-", " "), name) for name in self._measurable()], value="error",
            layout=widgets.Layout(width="132px"),
        )  # fmt: skip
        self.objective.observe(self._on_objective, "value")
        self.meaning = classed(widgets.HTML(), "fw-meaning")
        self.frames = widgets.BoundedIntText(
            min(FRAMES, len(self._session)), min=1, max=len(self._session), tooltip="frames, spread over the clip",
            layout=widgets.Layout(width="62px"),
        )  # fmt: skip
        self.go = small_button("run", "fit the frames at every value", "primary")
        self.go.on_click(lambda _button: self.run())

    def _measurable(self) -> list[str]:
        """The objectives that need no truth, nor another camera."""
        there = {None, "flow"} if self._session.material.pictures.real else {None}
        return [name for name, row in TABLE.items() if row.needs in there]

    def _on_chosen(self, change) -> None:
        self._chosen = bool(change["new"])

    def _on_objective(self, _change) -> None:
        self._explain()
        if self.result is None:
            return
        if self.objective.value in self.result.objectives:
            self._draw(self.result)
        else:
            self.said.say(f"Run it again to measure {self.objective.value}.")

    def _explain(self) -> None:
        row = TABLE[self.objective.value]
        self.meaning.value = html.escape(f"{row.says[0].upper()}{row.says[1:]}; less is better.")
        self.meaning.tooltip = self.objective.tooltip = f"{row.says}; cannot see: {row.blind}"

    # --- what the user does ---

    def _submit(self) -> None:
        chosen = [(choice, choice.axis) for choice in self._choices]
        chosen = [(choice, axis) for choice, axis in chosen if axis is not None]
        if not chosen:
            raise ConfigError("Choose a setting first: type words such as steady, lens or jaw.")
        names = tuple(choice.setting.words for choice, _ in chosen)
        self._warmed = True  # what a sweep needs, the first one compiles; warming up would take its place
        self._jobs.ask(Asked(tuple(axis for _, axis in chosen), names, self.objective.value, self.frames.value))

    def _take(self, number: int) -> None:
        point = self.result.points[number]
        told = point_words(point, self._settings)
        self._session.use(config_at(self._session.config, point), f"sweep: {told}")
        self.said.say(f"Took {told}; undo brings back the previous settings.")

    # --- work, in the thread of the page ---

    def _work(self, asked: Asked | str) -> None:
        if asked == WARM:
            tolerance = self._session.config.solver.tolerance
            self._session.sweep(f"solver.tolerance={tolerance!r}", objectives=("error",), frames=1)
            return
        self._asked, self._began = asked, time.monotonic()
        self.note.value = ""
        self.said.say("sweeping …")
        objectives = tuple(dict.fromkeys((asked.objective, *CHEAP)))
        with self._jobs.shown():
            found = self._session.sweep(
                asked.settings, objectives=objectives, frames=asked.frames,
                progress=self._told, cancelled=self._jobs.stopping, grown=self._grown,
            )  # fmt: skip
        if len(found.values) == len(found.points):
            seconds = time.monotonic() - self._began
            self.said.say(f"{conclusion(found, asked.objective, self._settings)} ({seconds:.1f} s)")

    def _told(self, _step: str, done: int, total: int | None) -> None:
        self.progress.max, self.progress.value = total or done, done
        self.said.say(progress_text(done, total or done, time.monotonic() - self._began))

    def _grown(self, result: SweepResult) -> None:
        self.result, self._names = result, self._asked.names
        self._draw(result)

    def _draw(self, result: SweepResult) -> None:
        if self.objective.value in result.objectives:
            self.view.show(result, self.objective.value, self._names, self._now())

    def _now(self) -> float | None:
        """Where the session's value lies on the curve."""
        if len(self.result.axes) != 1:
            return None
        (axis,) = self.result.axes
        return place_among(axis.values, value_at(self._session.config, axis.path), axis.scale == "log")


def progress_text(done: int, total: int, seconds: float) -> str:
    """How far a sweep has come after some seconds, and how long the rest will take."""
    if done >= total:
        return f"{done} of {total} fits"
    return f"{done} of {total} fits, about {max(seconds * (total - done) / max(done, 1), 1.0):.0f} s left"


def conclusion(result: SweepResult, objective: str, settings: tuple[SweepSetting, ...]) -> str:
    """The lowest value of an objective and where it is, in a sentence."""
    best, row = result.best(objective), TABLE[objective]
    if best is None:
        return f"{objective} has no value on these frames; use more of them."
    lowest = f"{result.means(objective)[best]:.3g} {row.unit}".strip()
    return f"Lowest {objective}: {lowest}, at {point_words(result.points[best], settings)}. Click a point to take it."


def point_words(point: Point, settings: tuple[SweepSetting, ...]) -> str:
    """A point in plain words."""
    words = {item.path: item.words for item in settings}
    return ", ".join(f"{words.get(path, path)} {shown(value)}" for path, value in point.values)


def same_besides(config: Config, result: SweepResult) -> bool:
    """Whether a configuration has what a sweep was made with, but for what it swept; False if it lacks what was."""
    point, kept = result.points[0], {"provenance"}
    try:
        swept = config_at(config, point)
    except ConfigError:
        return False
    return swept.model_dump(exclude=kept) == result.config(0).model_dump(exclude=kept)
