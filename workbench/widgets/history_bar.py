"""Undo and redo, presets and snapshots of a session."""

import itertools

import ipywidgets as widgets

from workbench.config import PRESETS
from workbench.session import TuningSession
from workbench.session.tuned_config import preset_on, snapshot_title
from workbench.widgets.controls import small_button
from workbench.widgets.panel_layout import classed, group, in_line
from workbench.widgets.status_line import StatusLine


class HistoryBar:
    """A line of controls for the history of a session; `status` shows refused requests."""

    def __init__(self, session: TuningSession, status: StatusLine) -> None:
        self._session, self._status = session, status
        self.undo = classed(small_button("↶", "undo the last change"), "fw-undo")
        self.redo = classed(small_button("↷", "redo the last undone change"), "fw-redo")
        self.undo.on_click(lambda _button: session.undo())
        self.redo.on_click(lambda _button: session.redo())
        self.reset = widgets.Dropdown(
            options=self._places(), value="", layout=widgets.Layout(width="104px"),
            tooltip="go to a preset, the start or a snapshot; undo brings you back",
        )  # fmt: skip
        self.reset.add_class("fw-go-to")
        self.reset.observe(self._on_reset, "value")
        self.name = widgets.Text(
            placeholder="snapshot", tooltip="name of a snapshot", layout=widgets.Layout(width="82px")
        )
        self.keep = small_button("keep", "keep the current configuration under this name (S)")
        self.keep.on_click(lambda _button: self.take())
        self.widget = in_line(group(self.undo, self.redo), group(self.reset, self.name, self.keep))

    def show(self) -> None:
        """Update the buttons from the history."""
        undo, redo = self._session.undo_label, self._session.redo_label
        self.undo.disabled, self.redo.disabled = not undo, not redo
        self.undo.tooltip = f"undo: {undo}" if undo else "undo: nothing"
        self.redo.tooltip = f"redo: {redo}" if redo else "redo: nothing"

    def show_snapshots(self) -> None:
        """Update the list of snapshots."""
        self.reset.options = self._places()

    def take(self) -> None:
        """Keep a snapshot under the typed name, or a numbered one."""
        self._status.guarded(self._take)

    def _on_reset(self, change) -> None:
        if change["new"]:
            kind, _, name = change["new"].partition(":")
            self.reset.value = ""
            if kind == "preset":
                self._session.use(preset_on(name, self._session.config), f"preset {name}")
            elif kind == "start":
                self._session.use(self._session.base, "the start")
            else:
                self._status.guarded(self._session.restore_snapshot, name)

    def _take(self) -> None:
        name = self.name.value.strip() or self._free_name()
        self._session.take_snapshot(name)
        self.name.value = ""
        self._status.say(f"Kept {name!r}: you can go back to it or compare with it in the menus.")

    def _free_name(self) -> str:
        numbered = (f"snapshot {number}" for number in itertools.count(1))
        return next(name for name in numbered if name not in self._session.snapshots)

    def _places(self) -> list[tuple[str, str]]:
        presets = [(f"preset {name}", f"preset:{name}") for name in PRESETS]
        snapshots = [(snapshot_title(name), f"snapshot:{name}") for name in self._session.snapshots]
        return [("go to…", ""), ("the start", "start:"), *presets, *snapshots]
