"""The configuration being tuned: changes, undo, snapshots and comparison. No frames, no fits."""

from collections.abc import Callable, Mapping
from typing import Any

from workbench.config import Config, Difference, differences, preset
from workbench.errors import ConfigError
from workbench.session.gesture import Gesture
from workbench.session.history import History

HISTORY = 200
"""Maximum number of undo steps."""
START, NOW = "the start", "now"
"""Names of the first and of the current configuration, which no snapshot may have."""


def preset_on(name: str, config: Config) -> Config:
    """A preset for the landmarks of a configuration."""
    return preset(name).changed(landmarks=config.landmarks.kept_by_presets())


def snapshot_title(name: str) -> str:
    """The name of a snapshot after this word, unless it begins with it."""
    return name if name.startswith("snapshot") else f"snapshot {name}"


class TunedConfig:
    """A configuration with history and snapshots; `tell` is called with "config" or "snapshots" after a change."""

    def __init__(self, base: Config, tell: Callable[[str], None]) -> None:
        self.base = base
        self.exported: Config | None = None
        """The configuration exported last."""
        self.history: History[Config] = History(base, HISTORY)
        """Undo and redo steps; changes go through `use`, which notifies listeners."""
        self._snapshots: dict[str, Config] = {}
        self._tell = tell

    @property
    def present(self) -> Config:
        """The current configuration."""
        return self.history.present

    def set(self, label: str = "", gesture: Gesture | str | None = None, **sections: Any) -> Config:
        """Change keys of sections like `Config.changed`, and `use` the result. Raises `ConfigError` for bad values."""
        return self.use(self.present.changed(**sections), label or ", ".join(sections), gesture)

    def use(self, config: Config, label: str, gesture: Gesture | str | None = None) -> Config:
        """Replace the whole configuration; one undo step."""
        if self.history.change(config, label, gesture):
            self._tell("config")
        return config

    def undo(self) -> str | None:
        """Undo the last change. Returns its label; None if there is none."""
        return self._travelled(self.history.undo())

    def redo(self) -> str | None:
        """Redo the change that was undone last. Returns its label; None if there is none."""
        return self._travelled(self.history.redo())

    def take_snapshot(self, name: str) -> None:
        """Store the current configuration under a name. Raises `ConfigError` for an empty or reserved name."""
        name = name.strip()
        if not name:
            raise ConfigError("A snapshot needs a name.")
        if name in (START, NOW):
            raise ConfigError(f"{name!r} is not free as the name of a snapshot; choose another one.")
        self._snapshots[name] = self.present
        self._tell("snapshots")

    @property
    def snapshots(self) -> Mapping[str, Config]:
        """Stored configurations, by name."""
        return dict(self._snapshots)

    def snapshot(self, name: str) -> Config:
        """A stored configuration. Raises `ConfigError` for an unknown name."""
        if name not in self._snapshots:
            known = ", ".join(self._snapshots) or "none yet"
            raise ConfigError(f"There is no snapshot {name!r}; the snapshots are: {known}.")
        return self._snapshots[name]

    def changes(self, since: Config | str | None = None) -> list[Difference]:
        """Differences from a configuration, a snapshot by name, or the start (default)."""
        if isinstance(since, str):
            since = self.snapshot(since)
        return differences(self.base if since is None else since, self.present)

    def _travelled(self, label: str | None) -> str | None:
        if label is not None:
            self._tell("config")
        return label
