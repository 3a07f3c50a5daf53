"""The configuration under change: sections set, taken back, kept under names, and compared. No frames, no fits."""

from collections.abc import Callable, Mapping
from typing import Any

from workbench.config import Config, Difference, differences
from workbench.errors import ConfigError
from workbench.session.gesture import Gesture
from workbench.session.history import History

HISTORY = 200
"""Steps that can be taken back."""


class TunedConfig:
    """A configuration with its history and its snapshots; `tell` hears of "config" and "snapshots" after a change."""

    def __init__(self, base: Config, tell: Callable[[str], None]) -> None:
        self.base = base
        self.exported: Config | None = None
        """What was exported last."""
        self.history: History[Config] = History(base, HISTORY)
        """Steps back and forth; changes go through `use`, which tells of them."""
        self._snapshots: dict[str, Config] = {}
        self._tell = tell

    @property
    def present(self) -> Config:
        """The configuration as it is."""
        return self.history.present

    def set(self, label: str = "", gesture: Gesture | str | None = None, **sections: Any) -> Config:
        """Change keys of sections, as `Config.changed`, and `use` the result. Raises `ConfigError` for bad values."""
        return self.use(self.present.changed(**sections), label or ", ".join(sections), gesture)

    def use(self, config: Config, label: str, gesture: Gesture | str | None = None) -> Config:
        """Replace the whole configuration; one step of undo."""
        if self.history.change(config, label, gesture):
            self._tell("config")
        return config

    def undo(self) -> str | None:
        """Take back the last change; its label, None if there is none."""
        return self._travelled(self.history.undo())

    def redo(self) -> str | None:
        """Make the change again that was taken back last; its label, None if there is none."""
        return self._travelled(self.history.redo())

    def take_snapshot(self, name: str) -> None:
        """Keep the present configuration under a name. Raises `ConfigError` for an empty name."""
        if not name.strip():
            raise ConfigError("A snapshot needs a name.")
        self._snapshots[name.strip()] = self.present
        self._tell("snapshots")

    @property
    def snapshots(self) -> Mapping[str, Config]:
        """Configurations that were kept, by name."""
        return dict(self._snapshots)

    def snapshot(self, name: str) -> Config:
        """A configuration that was kept. Raises `ConfigError` for a name that was never taken."""
        if name not in self._snapshots:
            known = ", ".join(self._snapshots) or "none yet"
            raise ConfigError(f"There is no snapshot {name!r}; there are: {known}.")
        return self._snapshots[name]

    def changes(self, since: Config | str | None = None) -> list[Difference]:
        """What differs from a configuration, a snapshot by name, or the start (default)."""
        if isinstance(since, str):
            since = self.snapshot(since)
        return differences(self.base if since is None else since, self.present)

    def _travelled(self, label: str | None) -> str | None:
        if label is not None:
            self._tell("config")
        return label
