"""What is handed to workers: small tasks without effect but what they return or store.

A task may run anywhere and twice. What goes wrong with it is its result: the others go on.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from workbench.errors import MissingDependencyError, OutputError, WorkbenchError
from workbench.reading import reason_of


class Task(Protocol):
    """A piece of work on a clip."""

    @property
    def clip(self) -> str:
        """What it works on, for sentences about what went wrong."""


Do = Callable[[Any], Any]
"""Does a task and returns its result; sent to a worker once, however many tasks it does there."""


@dataclass(frozen=True)
class Failed:
    """What became of a task that could not be done."""

    reason: str
    """One sentence."""
    fatal: bool = False
    """Whether no other task can be done either: the results have no place."""


def run(task: Any) -> Any:
    """The result of a task that can do itself."""
    return task.run()


def guarded(do: Do, task: Task) -> Any:
    """The result of a task, or one sentence that says why there is none."""
    try:
        return do(task)
    except (OutputError, MissingDependencyError) as error:
        return Failed(str(error), fatal=True)
    except WorkbenchError as error:
        return Failed(str(error))
    except Exception as error:
        return Failed(f"{task.clip} cannot be fitted ({type(error).__name__}: {reason_of(error)}).")
