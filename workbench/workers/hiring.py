"""Which workers do the tasks, for how long, and their results in order."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any, Literal, Protocol, runtime_checkable

from workbench.errors import ConfigError
from workbench.workers.processes import Pool, ThisProcess
from workbench.workers.tasks import Do, Task, run

Kind = Literal["auto", "pool", "dask"]


@runtime_checkable
class Workers(Protocol):
    """Does tasks in any order."""

    said: str
    """What a user should know, such as the address of a dashboard; empty: nothing."""

    @property
    def count(self) -> int:
        """How many there are now."""

    def results(self, tasks: Sequence[Task], do: Do = run) -> Iterator[tuple[int, Any]]:
        """The number of each task with its result, as they are done; what fails has a `Failed` for a result.

        Raises `LostSchedulerError` if the workers cannot be reached any more.
        """

    def close(self) -> None:
        """Stop; what is not done stays undone."""


def workers_for(count: int = 1, scheduler: str | None = None, kind: Kind = "auto") -> Workers:
    """This many workers on this machine, or those of a Dask scheduler.

    On this machine they are a Dask cluster if `distributed` is installed, else a pool; `kind` chooses. Raises
    `ConfigError` for a scheduler with a pool, `MissingDependencyError` without the extra, `InputError` for a scheduler
    that cannot be reached.
    """
    if scheduler is not None and kind == "pool":
        raise ConfigError("A scheduler belongs to Dask, and a pool has none; leave one of them out.")
    if scheduler is None and kind == "auto":
        kind = "dask" if count > 1 and find_spec("distributed") else "pool"
    if scheduler is None and kind == "pool":
        return ThisProcess() if count <= 1 else Pool(count)
    from workbench.workers.dask_workers import DaskWorkers

    return DaskWorkers(count, scheduler)


@contextmanager
def working(workers: int | Workers) -> Iterator[Workers]:
    """Workers for a block of code: those that are given, or this many on this machine, which end with the block."""
    if not isinstance(workers, int):
        yield workers
        return
    hired = workers_for(workers)
    try:
        yield hired
    finally:
        hired.close()


def ready(workers: Workers) -> Workers:
    """The workers, once those that start with their first tasks have started: it takes seconds that are no work."""
    getattr(workers, "start", lambda: None)()
    return workers


def in_order(results: Iterator[tuple[int, Any]]) -> Iterator[Any]:
    """Results in the order of their tasks, each as soon as it and those before it are there."""
    waiting, number = {}, 0
    for done, result in results:
        waiting[done] = result
        while number in waiting:
            yield waiting.pop(number)
            number += 1
