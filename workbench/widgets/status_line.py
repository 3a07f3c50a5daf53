"""One line of status and error messages."""

import html
from collections.abc import Callable

import ipywidgets as widgets

from workbench.errors import WorkbenchError

WRONG = "color:var(--jp-error-color1, #b3261e)"


def error_text(error: Exception) -> str:
    """The message of an error: ours are complete sentences, others are prefixed with their type."""
    return str(error) if isinstance(error, WorkbenchError) else f"{type(error).__name__}: {error}"


class StatusLine(widgets.HTML):
    """A line of text in the page's font or, with `tag` "code", in a monospaced one; may be set from any thread."""

    def __init__(self, tag: str = "span", **options: object) -> None:
        self._tag = tag
        super().__init__(**options)

    def say(self, text: str, wrong: bool = False) -> None:
        """Show a text; `wrong`: in red."""
        self.value = f"<{self._tag} style='{WRONG if wrong else ''}'>{html.escape(text)}</{self._tag}>"

    def failed(self, error: Exception) -> None:
        """Show an error, for example from a thread that cannot raise it to a caller."""
        self.say(error_text(error), wrong=True)

    def guarded(self, act: Callable[..., object], *arguments: object) -> None:
        """Run an action requested by the user; if it is refused, show why."""
        try:
            act(*arguments)
        except WorkbenchError as error:
            self.failed(error)
