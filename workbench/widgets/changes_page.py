"""The changes since the start of a session, and the metrics of its last run."""

import html

import ipywidgets as widgets

from workbench.session import TuningSession


class ChangesPage(widgets.HTML):
    """A list of changes, with the metrics of the last run if it is up to date."""

    def __init__(self, session: TuningSession, height_px: int) -> None:
        self._session = session
        super().__init__(layout=widgets.Layout(height=f"{height_px}px", overflow="auto"))

    def show(self) -> None:
        """Update from the session."""
        self.value = changes_html(self._session)


def changes_html(session: TuningSession) -> str:
    """The changes since the start, and the metrics then and now, as HTML."""
    rows = "".join(f"<li><code>{html.escape(str(item))}</code></li>" for item in session.changes())
    unexported = len(session.unexported)
    text = f"<b>Changed since the start</b><ul style='margin:2px 0'>{rows or '<li>nothing</li>'}</ul>"
    if session.run is not None and not session.stale.any():
        numbers = ", ".join(f"{name} {value:g}" for name, value in session.metrics().items())
        text += f"<b>Last run</b>: {html.escape(numbers)}"
    return text + f"<br>{unexported} change(s) not exported yet."
