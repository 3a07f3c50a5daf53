"""Who does the tasks of a sweep: this process, a pool of processes, a Dask cluster. The bits are the same."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from importlib.util import find_spec
from typing import Any, Literal, Protocol

from workbench.errors import ConfigError
from workbench.runtime import keep_to_one_core
from workbench.sweeps.tasks import Failed, Task, guarded

MOST_DEATHS = 3
"""Processes that a task may end before it counts as failed."""
Kind = Literal["auto", "pool", "dask"]


class Workers(Protocol):
    """Does tasks in any order."""

    said: str
    """What a user should know, as the address of a dashboard; empty: nothing."""

    def results(self, tasks: Sequence[Task]) -> Iterator[tuple[int, Any]]:
        """The number of each task with its result, as they are done. Raises `WorkbenchError` for lost workers."""

    def close(self) -> None:
        """Stop; what is not done stays undone."""


class ThisProcess:
    """One task after the other, here."""

    said = ""

    def results(self, tasks: Sequence[Task]) -> Iterator[tuple[int, Any]]:
        """In their order."""
        for number, task in enumerate(tasks):
            yield number, guarded(task)

    def close(self) -> None:
        """Nothing to stop."""


class Pool:
    """Processes on this machine. One that dies is replaced, and its task done again."""

    said = ""

    def __init__(self, count: int, do: Callable[[Task], Any] = guarded):
        self._count, self._do = count, do
        self._pool: ProcessPoolExecutor | None = None

    def results(self, tasks: Sequence[Task]) -> Iterator[tuple[int, Any]]:
        """As they are done."""
        left, deaths = dict(enumerate(tasks)), [0] * len(tasks)
        while left:
            try:
                for number, result in self._round(left, deaths):
                    del left[number]
                    yield number, result
            except BrokenProcessPool:
                self.close()
                for number in [number for number in left if deaths[number] >= MOST_DEATHS]:
                    clip = left.pop(number).clip
                    yield number, Failed(f"{clip} ended the process that worked on it, {MOST_DEATHS} times.")

    def _round(self, left: dict[int, Task], deaths: list[int]) -> Iterator[tuple[int, Any]]:
        """The results of those that were at no death; then of the others, one at a time, to see whose they are.

        A dead process counts against all tasks that were being done then.
        """
        unsuspected = [number for number in left if not deaths[number]]
        at_once = self._count if unsuspected else 1
        if self._pool is None:
            # Spawned: a forked child of a process that runs JAX's threads hangs.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self._count, context, initializer=keep_to_one_core)
        waiting, rest = {}, iter([(number, left[number]) for number in unsuspected or left])
        while True:
            # No more are handed out than there are processes, so that those that are out are those being done.
            for number, task in rest:
                waiting[self._pool.submit(self._do, task)] = number
                if len(waiting) >= at_once:
                    break
            if not waiting:
                return
            done, _ = wait(waiting, return_when=FIRST_COMPLETED)
            broken = [waiting[future] for future in done if isinstance(future.exception(), BrokenProcessPool)]
            for future in done:
                if waiting[future] not in broken:
                    yield waiting.pop(future), future.result()
            if broken:
                for number in waiting.values():
                    deaths[number] += 1
                raise BrokenProcessPool

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None


def workers_for(count: int = 1, scheduler: str | None = None, kind: Kind = "auto") -> Workers:
    """So many workers on this machine, or those of a Dask scheduler.

    On this machine they are a Dask cluster where `distributed` is installed, else a pool; `kind` chooses. Raises
    `ConfigError` for a scheduler with a pool, `MissingDependencyError` without the extra, `InputError` for a scheduler
    that cannot be reached.
    """
    if scheduler is not None and kind == "pool":
        raise ConfigError("A scheduler belongs to Dask, and a pool has none; leave one of them out.")
    if scheduler is None and kind == "auto":
        kind = "dask" if count > 1 and find_spec("distributed") else "pool"
    if scheduler is None and kind == "pool":
        return ThisProcess() if count <= 1 else Pool(count)
    from workbench.sweeps.dask_workers import DaskWorkers

    return DaskWorkers(count, scheduler)
