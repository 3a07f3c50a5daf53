"""Tuning in the panel: the clip chooses settings by an objective; its result is taken in one undo step or discarded."""

import html
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import ipywidgets as widgets
import numpy as np

from workbench.config import Config
from workbench.errors import ConfigError, InputError
from workbench.landmarks.scheme import LandmarkScheme
from workbench.learning import LEARNABLE, Tuned
from workbench.learning.examples import runs_in
from workbench.learning.learnable import POINTS
from workbench.learning.parts import LENGTH, SHORTEST, read_frames, usual_cuts
from workbench.objectives import TABLE, read_sum
from workbench.session import TuningSession
from workbench.session.knob_words import plain_words
from workbench.session.knobs import inert_among
from workbench.session.parts import read_parts
from workbench.session.sweep_settings import value_at
from workbench.tracking import FrameObservation
from workbench.widgets.chart_view import ChartView
from workbench.widgets.controls import small_button, toggle
from workbench.widgets.page_work import PageWork
from workbench.widgets.panel_layout import Beside, classed, one_row, wrapped
from workbench.widgets.status_line import StatusLine

OBJECTIVES = ("left-out-parts", "left-out-points", "left-out-frames", "jitter + error", "error", "jitter")
"""Offered by name; any sum may be typed. None needs a truth or pictures."""
POINT_WORDS = "68 point weights"
USUAL = ("weights.tau", "weights.sigma_smooth")
STEPS, MOST_STEPS = 12, 200
CONTROLS_PX = 620
LEARNED_ON, HELD_OUT = "frames it learns on", "held-out frames"
ROLES = {"train": "The frames to learn on", "watch": "The first half of the held-out frames"}
"""The parts that need a stretch, in words."""


@dataclass(frozen=True)
class Asked:
    """A tuning that was asked for."""

    objective: str
    learn: tuple[str, ...]
    parts: Mapping[str, str]
    """FIRST:END by name, as `session.tune` takes them."""
    steps: int


class TunePage(Beside):
    """The page of tuning. `give_way` waits up to some seconds until the panel's own work is done."""

    def __init__(self, session: TuningSession, give_way: Callable[[float], object], height_px: int) -> None:
        self._session = session
        self.result: Tuned | None = None
        self._values: list[tuple[float, float]] = []
        self.said, self.words = StatusLine(), classed(StatusLine(), "fw-meaning")
        self._jobs: PageWork[Asked] = PageWork(
            self._work, self.said, give_way, "panel-tune", "stop; the best so far is evaluated"
        )
        self.stop, self.progress = self._jobs.stop, self._jobs.progress
        self.chart = ChartView(height_px=height_px - 38, title="")
        self._build_controls()
        rows = [
            widgets.HBox([widgets.Label("minimise"), self.objective], layout=one_row()),
            self.words,
            widgets.HBox([widgets.Label("learn"), *self.learn.values()], layout=wrapped()),
            widgets.HBox(
                [widgets.Label("learn on"), self.train, widgets.Label("hold out"), self.held_out,
                 widgets.Label("steps"), self.steps, self.go, self.stop, self.take, self.discard],
                layout=wrapped(),
            ),
            self.progress, self.said,
        ]  # fmt: skip
        super().__init__(rows, CONTROLS_PX, self.chart, height_px)
        self.add_class("fw-tune")
        self._explain()
        self.show_config()
        self._show_result(None)
        if why := too_short(len(session)):
            self.said.say(why)
            self.go.disabled, self.go.tooltip = True, why

    # --- for scripts and tests ---

    def run(self) -> None:
        """Tune what is chosen."""
        self.said.guarded(self._submit)

    @property
    def running(self) -> bool:
        """Whether a tuning runs."""
        return self._jobs.running

    def wait_idle(self, timeout_s: float | int) -> bool:
        """Wait for the tuning; False if it takes longer."""
        return self._jobs.wait_idle(timeout_s)

    def close(self) -> None:
        """Stop the tuning and its thread."""
        self._jobs.close()
        super().close()

    def show_config(self) -> None:
        """Offer what can be learned from the session's configuration."""
        can = learnable(self._session.config, self._session.material.scheme)
        for path, button in self.learn.items():
            button.layout.display = None if path in can else "none"

    # --- parts ---

    def _build_controls(self) -> None:
        self.objective = widgets.Combobox(
            value=OBJECTIVES[0], options=OBJECTIVES, continuous_update=False, layout=widgets.Layout(width="150px"),
            tooltip="what to minimise; also a sum, for example jitter + 0.5*error",
        )  # fmt: skip
        self.objective.observe(lambda _change: self.said.guarded(self._explain), "value")
        self.learn = {
            path: toggle(POINT_WORDS if path == POINTS else plain_words(path, path).name, path, path in USUAL)
            for path in LEARNABLE
        }
        first, last = usual_parts(len(self._session))
        self.train = _field(first, "first and last frame that it learns on")
        self.held_out = _field(last, "first and last frame that it does not learn on: the first half chooses the "
                               "step that is kept, the second half gives the reported error")  # fmt: skip
        self.steps = widgets.BoundedIntText(
            STEPS, min=1, max=MOST_STEPS, tooltip="steps along the gradient", layout=widgets.Layout(width="56px")
        )
        self.go = small_button("tune", "follow the gradient through the solver", "primary")
        self.go.on_click(lambda _button: self.run())
        self.take = small_button("take", "use what was learned; undo brings back the previous settings", "success")
        self.take.on_click(lambda _button: self.said.guarded(self._take))
        self.discard = small_button("discard", "forget it; nothing changes")
        self.discard.on_click(lambda _button: self._discard())

    def _explain(self) -> None:
        rows = [TABLE[name] for name in read_sum(self.objective.value).names]
        blind = "; ".join(row.blind for row in rows)
        self.words.tell(html.escape("; ".join(row.says for row in rows)))
        self.words.layout.display = None
        self.objective.tooltip = f"cannot see: {blind}"

    # --- what the user does ---

    def _submit(self) -> None:
        self._explain()
        if why := too_short(len(self._session)):
            raise InputError(why)
        can = learnable(self._session.config, self._session.material.scheme)
        learn = tuple(path for path, button in self.learn.items() if button.value and path in can)
        if not learn:
            raise ConfigError("Choose what to learn first, such as steady head.")
        parts = parts_texts(self.train.value, self.held_out.value)
        check_faces(self._session.material.observations, parts)
        # What it means is known by now, and its lines are those that the result needs to be seen whole.
        self.words.layout.display = "none"
        self._jobs.ask(Asked(self.objective.value, learn, parts, self.steps.value))

    def _take(self) -> None:
        changes = learned_changes(self.result)
        self._session.set(f"tuned: {self.result.config.provenance.objective}", **changes)
        self.said.say("Taken; undo brings back the previous settings.")
        self._show_result(None)

    def _discard(self) -> None:
        self.said.say("Discarded; nothing has changed.")
        self._show_result(None)

    def _show_result(self, result: Tuned | None) -> None:
        self.result = result
        self.take.disabled = self.discard.disabled = result is None

    # --- work, in the thread of the page ---

    def _work(self, asked: Asked) -> None:
        self._show_result(None)
        self._values = []
        self.chart.set_series(np.zeros(0), {})
        self.said.say("getting ready …")
        with self._jobs.shown(asked.steps):
            found = self._session.tune(
                asked.objective, asked.learn, **asked.parts, steps=asked.steps,
                progress=partial(self._told, asked.objective), cancelled=self._jobs.stopping,
            )  # fmt: skip
        self._show_result(found)
        self.said.say(conclusion(found))

    def _told(self, objective: str, _what: str, done: int, total: int, value: float, watched: float | None) -> None:
        self._values.append((value, np.nan if watched is None else watched))
        learned_on, held_out = np.array(self._values).T
        steps = np.arange(1, len(learned_on) + 1, dtype=float)
        self.chart.set_series(steps, {LEARNED_ON: learned_on, HELD_OUT: held_out}, x_label="step", y_label=objective)
        self.progress.value = done
        last = ", judging it on all frames …" if done == total else ""
        self.said.say(f"step {done} of {total}{last}")


def learnable(config: Config, scheme: LandmarkScheme | None = None) -> tuple[str, ...]:
    """The settings with a gradient that act on a configuration's fits and are above 0; `scheme`: see `inert_among`."""
    if config.traits.renders:
        return ()
    left_out = inert_among(config, LEARNABLE, scheme)
    return tuple(
        path for path in LEARNABLE if path == POINTS or (path not in left_out and value_at(config, path) > 0.0)
    )


def usual_parts(frames: int) -> tuple[str, str]:
    """The frames to learn on and to hold out that are offered for a clip of so many."""
    first, _ = usual_cuts(frames)
    return f"0-{max(first - 1, 0)}", f"{first}-{frames - 1}"


def too_short(frames: int) -> str:
    """Why a clip of so many frames cannot be tuned on; empty where it can."""
    if frames >= SHORTEST:
        return ""
    return (
        f"Tuning needs a clip of at least {SHORTEST} frames: {LENGTH} to learn on and {2 * LENGTH} held out. "
        f"This one has {frames}."
    )


def parts_texts(train: str, held_out: str) -> dict[str, str]:
    """FIRST:END of the parts by name, from first and last frames as 0-99.

    Of the frames held out, the first half chooses the step that is kept and the second half gives the reported error.
    Raises `InputError` for anything else, and for parts without room for a stretch.
    """
    (first, last), (start, end) = _part(train), _part(held_out)
    if last - first + 1 < LENGTH:
        raise InputError(f"Learn on at least {LENGTH} frames; {first}-{last} are {last - first + 1}.")
    if end - start + 1 < 2 * LENGTH:
        raise InputError(
            f"Hold out at least {2 * LENGTH} frames: half of them choose the step, the other half only report; "
            f"{start}-{end} are {end - start + 1}."
        )
    middle = (start + end + 1) // 2
    return {"train": f"{first}:{last + 1}", "watch": f"{start}:{middle}", "held_out": f"{middle}:{end + 1}"}


def check_faces(observations: Sequence[FrameObservation], parts: Mapping[str, str]) -> None:
    """Raise `InputError`, in the words of the page, for parts outside the clip, or that lack faces to learn by."""
    if max(read_frames(text).stop for text in parts.values()) > len(observations):
        raise InputError(f"The clip has frames 0-{len(observations) - 1}; choose within them.")
    for name, what in ROLES.items():
        frames = read_frames(parts[name])
        if not runs_in(observations, frames):
            where = f"{frames.start}-{frames.stop - 1}"
            raise InputError(f"{what}, {where}, have no run of {LENGTH} with a face and without a cut; choose more.")


def _part(text: str) -> tuple[int, int]:
    parts = read_parts(text)
    if len(parts) != 1:
        raise InputError(f"Write the frames of a part as 0-99, got {text!r}.")
    return parts[0]


def learned_changes(tuned: Tuned) -> dict[str, dict]:
    """The learned settings alone, as arguments for `session.set`."""
    changes: dict[str, dict] = {}
    for path in tuned.config.provenance.learned:
        section, key = path.split(".")
        changes.setdefault(section, {})[key] = getattr(getattr(tuned.config, section), key)
    return changes


def conclusion(tuned: Tuned) -> str:
    """What was learned and whether it holds on frames that nothing was chosen by, in a sentence."""
    change = tuned.change
    verdict = "better" if change.high < 0.0 else "worse" if change.low > 0.0 else "not surely better or worse"
    frames = read_frames(tuned.config.provenance.parts["held_out"])
    told = str(change) if np.isnan(change.percent) else f"{change}, {verdict}".replace("-", "−")
    where = f"On frames {frames.start}-{frames.stop - 1}, held out"
    return f"{where}: {told}. {'; '.join(_found(tuned))}. Take it or discard it."


def _found(tuned: Tuned) -> Iterator[str]:
    for path in tuned.config.provenance.learned:
        if path == POINTS:
            weights = tuned.config.point_weights()
            yield f"point weights {min(weights):.2g} to {max(weights):.2g}"
        else:
            before, after = value_at(tuned.base, path), value_at(tuned.config, path)
            yield f"{plain_words(path, path).name} {before:.3g} → {after:.3g}"


def _field(value: str, tip: str) -> widgets.Text:
    return widgets.Text(value=value, tooltip=tip, continuous_update=False, layout=widgets.Layout(width="84px"))
