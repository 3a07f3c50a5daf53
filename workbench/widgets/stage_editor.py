"""The schedule as a table: reorder, enable, free parameters, landmark groups, limits; run, run to here, step."""

import difflib
import itertools
import re
from collections.abc import Callable, Collection

import ipywidgets as widgets

from workbench.config import NAMED_TERMS, Config, Stage
from workbench.errors import ConfigError
from workbench.reading import shortened
from workbench.widgets.controls import small_button

LETTERS = {
    "rotation": "R",
    "translation": "t",
    "expression": "w",
    "jaw_open": "j1",
    "jaw": "j6",
    "identity": "i",
    "scale": "s",
}
"""Letters of the parameters that a stage can free: head rotation and translation, blendshape weights, jaw opening, the
whole jaw joint, face shape, scale."""
TITLE = "<b style='white-space:nowrap'>{}</b>"


class StageRow:
    """One row of the table."""

    def __init__(self, number: int, changed: Callable[[int, dict], None], act: Callable[[str, int], None]) -> None:
        self._number, self._changed, self._quiet = number, changed, False
        self._landmarks: dict[str, float] = {}
        """The weights as they were shown; their text holds six digits of each."""
        self.enabled = widgets.Checkbox(indent=False, tooltip="run this stage", layout=widgets.Layout(width="24px"))
        self.name = widgets.Text(continuous_update=False, tooltip="name", layout=_growing("146px", "180px"))
        self.free = {
            block: widgets.ToggleButton(description=letter, tooltip=f"free: {block}", layout=_tiny())
            for block, letter in LETTERS.items()
        }
        self.landmarks = widgets.Text(
            continuous_update=False, layout=_growing("110px", "200px"),
            tooltip="groups, subsets or point numbers with weights; later ones win: all 1, jaw 0.25, 30 2",
        )  # fmt: skip
        self.terms = widgets.Text(
            continuous_update=False, layout=_growing("106px", "150px"),
            tooltip=f"additional terms of this stage: {', '.join(NAMED_TERMS)}",
        )  # fmt: skip
        self.limit = widgets.BoundedIntText(min=0, max=500, tooltip="iteration limit (ρ, ε)", layout=_fixed("44px"))
        self.when = widgets.Dropdown(
            options=["always", "start"], tooltip="start: only on the first frame of a shot (FACE IT!)",
            layout=_fixed("76px"),
        )  # fmt: skip
        self.result = widgets.Label(layout=widgets.Layout(width="114px", flex="1 0 114px", max_width="260px"))
        buttons = {"up": ("↑", "earlier"), "down": ("↓", "later"), "here": ("▶|", "run to here and stop"),
                   "drop": ("✕", "remove this stage")}  # fmt: skip
        self.buttons = {}
        for action, (text, tip) in buttons.items():
            button = widgets.Button(description=text, tooltip=tip, layout=_tiny())
            button.on_click(lambda _button, action=action: act(action, number))
            self.buttons[action] = button
        for name in ("enabled", "name", "landmarks", "terms", "limit", "when"):
            getattr(self, name).observe(self._on_change, "value")
        for toggle in self.free.values():
            toggle.observe(self._on_change, "value")
        self.widget = widgets.HBox([
            self.enabled, self.name, *self.free.values(), self.landmarks, self.terms, self.limit, self.when,
            *self.buttons.values(), self.result,
        ], layout=_whole())  # fmt: skip

    def show(self, stage: Stage, blocks: Collection[str]) -> None:
        """Show a stage without calling back, with toggles for the parameters that its system can free."""
        self._quiet, self._landmarks = True, stage.landmarks
        for block, toggle in self.free.items():
            toggle.layout.display = None if block in blocks else "none"
        try:
            self.enabled.value, self.name.value, self.limit.value = stage.enabled, stage.name, stage.limit
            self.when.value, self.landmarks.value = stage.when, landmarks_text(stage.landmarks)
            self.terms.value = ", ".join(stage.terms)
            for block, toggle in self.free.items():
                toggle.value = block in stage.free
        finally:
            self._quiet = False

    def _on_change(self, _change) -> None:
        if self._quiet:
            return
        try:
            unchanged = self.landmarks.value == landmarks_text(self._landmarks)
            landmarks = self._landmarks if unchanged else read_landmarks(self.landmarks.value)
            terms = read_terms(self.terms.value)
        except ConfigError as error:
            self.result.value = str(error)
            return
        self._changed(self._number, {
            "enabled": self.enabled.value,
            "name": self.name.value,
            "free": tuple(block for block, toggle in self.free.items() if toggle.value),
            "landmarks": landmarks,
            "terms": terms,
            "limit": self.limit.value,
            "when": self.when.value,
        })  # fmt: skip


class StageEditor:
    """The stages of a configuration; calls `changed(stages, label)` with a new list, `run(what, stage)` with a command.

    Commands are "all", "here" (up to and including a stage), "step" (one more iteration) and "back" (one fewer).
    """

    def __init__(
        self, changed: Callable[[list[dict], str], None], run: Callable[[str, int], None], height_px: int
    ) -> None:
        self._changed, self._run, self._stages = changed, run, ()
        self._rows: list[StageRow] = []
        self.add = small_button("+ stage", "add a stage that frees the weights")
        self.all = small_button("▶ all", "run all stages")
        self.back = small_button("◀ one back", "one iteration fewer")
        self.step = small_button("step ▶", "one more iteration, through the stages in order")
        self.place = widgets.Label()
        self.add.on_click(lambda _button: self._add())
        for button, what in ((self.all, "all"), (self.back, "back"), (self.step, "step")):
            button.on_click(lambda _button, what=what: self._run(what, -1))
        self._header = widgets.HBox(layout=_whole())
        self._bar = widgets.HBox(
            [self.all, self.back, self.step, self.place, self.add], layout=widgets.Layout(flex="0 0 auto")
        )
        # As high as its stages, because a table that scrolls inside its page hides the last ones.
        self.widget = widgets.VBox(
            [self._bar, self._header], layout=widgets.Layout(min_height=f"{height_px}px", overflow="auto hidden")
        )
        self.widget.add_class("fw-stages")

    def show(self, config: Config) -> None:
        """Show the stages of a configuration."""
        self._stages = config.stages
        if len(self._rows) < len(config.stages):
            more = range(len(self._rows), len(config.stages))
            self._rows += [StageRow(k, self._on_row, self._on_action) for k in more]
            self._header.children = self._header.children or _titles(self._rows[0])
            self.widget.children = (self._bar, self._header, *(row.widget for row in self._rows))
        for k, row in enumerate(self._rows):
            row.widget.layout.display = None if k < len(config.stages) else "none"
            if k < len(config.stages):
                row.show(config.stages[k], config.traits.blocks)
        for title, below in zip(
            self._header.children, self._rows[0].widget.children if self._rows else (), strict=True
        ):
            title.layout.display = below.layout.display

    def show_results(self, results: dict[str, str], place: str = "") -> None:
        """Show the result of each stage in the last fit, by name, and the position in stepping."""
        self.place.value = place
        for k, row in enumerate(self._rows[: len(self._stages)]):
            row.result.value = results.get(self._stages[k].name, "")

    def _on_row(self, number: int, values: dict) -> None:
        stages = [stage.model_dump() for stage in self._stages]
        stages[number] |= values
        self._changed(stages, f"stage {values['name']}")

    def _on_action(self, action: str, number: int) -> None:
        if action == "here":
            self._run("here", number)
            return
        stages = [stage.model_dump() for stage in self._stages]
        name = stages[number]["name"]
        if action == "drop":
            del stages[number]
        else:
            other = number + (-1 if action == "up" else 1)
            if not 0 <= other < len(stages):
                return
            stages[number], stages[other] = stages[other], stages[number]
        self._changed(stages, f"{'remove' if action == 'drop' else 'move'} stage {name}")

    def _add(self) -> None:
        names = {stage.name for stage in self._stages}
        name = next(f"stage {k}" for k in itertools.count(1) if f"stage {k}" not in names)
        added = Stage(name=name, free=("expression",)).model_dump()
        self._changed([*(stage.model_dump() for stage in self._stages), added], f"add {name}")


def _tiny() -> widgets.Layout:
    """Layout of a one-letter button; one per button, because hiding a layout hides all widgets that share it."""
    return widgets.Layout(width="24px", padding="0", margin="2px 1px", flex="0 0 auto")


def _fixed(width: str) -> widgets.Layout:
    """Layout of a field that keeps its width on a narrow page."""
    return widgets.Layout(width=width, flex="0 0 auto")


def _growing(width: str, most: str) -> widgets.Layout:
    """Layout of a field that grows on a wide page."""
    return widgets.Layout(width=width, flex=f"1 0 {width}", max_width=most)


def _whole() -> widgets.Layout:
    """Layout of a row that is never cut: on a narrow page, the table scrolls sideways with its titles."""
    return widgets.Layout(flex="0 0 auto", min_width="max-content")


def _titles(row: StageRow) -> tuple[widgets.HTML, ...]:
    """A title above each part of a row, equally wide, so that both grow together on a wide page."""
    titles = {row.name: "stage", row.free["rotation"]: "free", row.landmarks: "landmarks",
              row.terms: "terms", row.limit: "limit", row.when: "when", row.result: "last fit"}  # fmt: skip
    return tuple(
        widgets.HTML(
            TITLE.format(titles.get(below, "")),
            layout=widgets.Layout(
                width=below.layout.width,
                flex=below.layout.flex,
                max_width=below.layout.max_width,
                margin=below.layout.margin,
                min_width="0",
                overflow="visible",
            ),
        )
        for below in row.widget.children
    )


def landmarks_text(landmarks: dict[str, float]) -> str:
    """Groups and weights as a user types them."""
    return ", ".join(f"{name} {weight:g}" for name, weight in landmarks.items())


def read_landmarks(text: str) -> dict[str, float]:
    """Groups and weights of a text like "all 1, jaw 0.25". Raises `ConfigError` for anything else."""
    if re.search(r"\d,\d", text):  # jaw 0 and point 25, or a decimal comma
        raise ConfigError(
            f"Write weights with a decimal point, for example 'jaw 0.25', and a space after each comma, got {text!r}."
        )
    found = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, weight = part.rpartition(" ")
        try:
            found[name.strip() or weight] = float(weight) if name else 1.0
        except ValueError:
            raise ConfigError(f"Expected a group and its weight, such as 'jaw 0.25', got {part!r}.") from None
    return found


def read_terms(text: str) -> tuple[str, ...]:
    """Names of terms in a text like "tau, edges". Raises `ConfigError` for an unknown term."""
    found = tuple(filter(None, re.split(r"[,\s]+", text)))
    for name in found:
        if name not in NAMED_TERMS:
            near = difflib.get_close_matches(name, NAMED_TERMS, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"the terms are {', '.join(NAMED_TERMS)}."
            raise ConfigError(f"There is no term {shortened(repr(name))}; {hint}")
    return found
