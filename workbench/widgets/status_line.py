"""One line of status: what happens, and what went wrong."""

import html
from collections.abc import Callable

import ipywidgets as widgets

from workbench.errors import WorkbenchError

WRONG = "color:var(--jp-error-color1, #b3261e)"


def error_text(error: Exception) -> str:
    """What to say of an error: ours are whole sentences, others have their type before them."""
    return str(error) if isinstance(error, WorkbenchError) else f"{type(error).__name__}: {error}"


class StatusLine(widgets.HTML):
    """A line of text, in the page's font or, as `code`, in that of programs; may be set from any thread."""

    def __init__(self, tag: str = "span", **options: object) -> None:
        self._tag = tag
        super().__init__(**options)

    def say(self, text: str, wrong: bool = False) -> None:
        """Show a text; `wrong`: in red."""
        self.value = f"<{self._tag} style='{WRONG if wrong else ''}'>{html.escape(text)}</{self._tag}>"

    def failed(self, error: Exception) -> None:
        """Show an error, as of a thread that has nobody to raise to."""
        self.say(error_text(error), wrong=True)

    def guarded(self, act: Callable[..., object], *arguments: object) -> None:
        """Do something that the user asked for; if it is refused, show why."""
        try:
            act(*arguments)
        except WorkbenchError as error:
            self.failed(error)
