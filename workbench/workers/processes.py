"""Workers on this machine without anything to install: this process, or several that are replaced when they die."""

import multiprocessing
import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from threading import Thread
from typing import Any

from workbench.runtime import starting_on_one_core
from workbench.workers.tasks import Do, Failed, Task, guarded, run

MOST_DEATHS = 3
"""Processes that a task may end before it counts as failed."""


class ThisProcess:
    """One task after the other, here."""

    said, count = "", 1

    def results(self, tasks: Sequence[Task], do: Do = run) -> Iterator[tuple[int, Any]]:
        """In their order."""
        for number, task in enumerate(tasks):
            yield number, guarded(do, task)

    def close(self) -> None:
        """Nothing to stop."""


class Pool:
    """Processes on this machine. One that dies is replaced, and its task done again."""

    said = ""

    def __init__(self, count: int):
        self.count = count
        self._do: Do = run
        self._pool: ProcessPoolExecutor | None = None

    def results(self, tasks: Sequence[Task], do: Do = run) -> Iterator[tuple[int, Any]]:
        """As they are done."""
        if do is not self._do:
            self.close()
            self._do = do
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
                    died = f"died {MOST_DEATHS} times, perhaps for lack of memory"
                    yield number, Failed(f"The process that worked on {clip} {died}.")

    def _round(self, left: dict[int, Task], deaths: list[int]) -> Iterator[tuple[int, Any]]:
        """The results of those that were at no death; then of the others, one at a time, to see whose they are.

        A dead process counts against all tasks that were being done then.
        """
        unsuspected = [number for number in left if not deaths[number]]
        at_once = self.count if unsuspected else 1
        if self._pool is None:
            # Spawned: a forked child of a process that runs JAX's threads hangs.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.count, context, initializer=_begin, initargs=(self._do,))
            with starting_on_one_core():
                # It starts a process where none is idle; those of later tasks would load only when the first are done.
                for _ in range(self.count):
                    self._pool.submit(int)
        waiting, rest = {}, iter([(number, left[number]) for number in unsuspected or left])
        while True:
            # No more are handed out than there are processes, so that those that are out are those being done.
            for number, task in rest:
                with starting_on_one_core():
                    waiting[self._pool.submit(_done, task)] = number
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


_DO: list[Do] = []
"""How this process, one of a pool, does its tasks."""


def _begin(do: Do) -> None:
    """Start a process of a pool. Ctrl-C reaches all processes of a command; the command itself ends the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_the_command, daemon=True).start()
    _DO[:] = [do]


def _end_with_the_command() -> None:
    """A process of a pool holds both ends of its queue, and would wait for ever where the command was killed."""
    multiprocessing.parent_process().join()
    os._exit(1)


def _done(task: Task) -> Any:
    return guarded(_DO[0], task)
