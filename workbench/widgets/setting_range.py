"""The choice of a setting to sweep, found by its words as they are typed, with its range and number of values."""

from collections.abc import Callable

import ipywidgets as widgets

from workbench.errors import InputError
from workbench.session.sweep_settings import SweepSetting, found_setting

MOST_VALUES = 60
"""Of one setting: more cannot be told apart in the panel."""


class SettingRange:
    """A field for a setting, with fields for its range (`widgets`); `refused` is called with why a choice is none."""

    def __init__(self, tip: str, placeholder: str, count: int, refused: Callable[[Exception], None]) -> None:
        self._settings: tuple[SweepSetting, ...] = ()
        self._refused = refused
        self.setting: SweepSetting | None = None
        self.name = widgets.Combobox(
            placeholder=placeholder,
            tooltip=tip,
            continuous_update=False,
            layout=widgets.Layout(width="212px", flex="1 1 212px"),
        )
        self.low, self.high = (_field(f"{end} value of its range") for end in ("lowest", "highest"))
        self.count = widgets.BoundedIntText(
            count, min=2, max=MOST_VALUES, tooltip="number of values", layout=widgets.Layout(width="52px")
        )
        self.name.observe(self._on_name, "value")
        self.widgets = (self.name, self.low, widgets.Label("to"), self.high, widgets.Label("in"), self.count)

    def offer(self, settings: tuple[SweepSetting, ...]) -> None:
        """Let these settings be chosen."""
        if settings != self._settings:
            self._settings = settings
            self.name.options = [item.title for item in settings]

    def choose(self, setting: SweepSetting) -> None:
        """Choose a setting, with its usual range."""
        if setting != self.setting:
            self.setting = setting
            self.low.value, self.high.value = f"{setting.low:g}", f"{setting.high:g}"
        self.name.value = setting.title

    @property
    def axis(self) -> str | None:
        """What is chosen, in the language of `workbench sweep --set`; None for nothing. Raises `InputError`."""
        if not self.name.value.strip():
            return None
        if self.setting is None or self.setting.title != self.name.value:
            self.choose(found_setting(self._settings, self.name.value))
        low, high = (field.value.replace(",", ".").strip() for field in (self.low, self.high))
        return self.setting.axis(low, high, self.count.value)

    def _on_name(self, change) -> None:
        if not change["new"].strip():
            self.setting = None
            return
        try:
            self.choose(found_setting(self._settings, change["new"]))
        except InputError as error:
            self._refused(error)


def _field(tip: str) -> widgets.Text:
    return widgets.Text(tooltip=tip, continuous_update=False, layout=widgets.Layout(width="62px"))
