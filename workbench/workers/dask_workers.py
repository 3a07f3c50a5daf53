"""Tasks on a Dask cluster: of this machine, or of a scheduler anywhere."""

import logging
import queue
import signal
import time
import warnings
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

from workbench.errors import InputError, LostSchedulerError
from workbench.extras import needs
from workbench.reading import reason_of
from workbench.runtime import ONE_CORE
from workbench.workers.tasks import Do, Failed, Task, guarded, run

REACH_S = 10.0
"""Longest that a scheduler is waited for."""
LOOK_S = 1.0
"""Time between two looks at whether the scheduler is there."""
MALLOC = {"MALLOC_TRIM_THRESHOLD_": 1 << 28, "MALLOC_MMAP_THRESHOLD_": 1 << 25, "MALLOC_ARENA_MAX": 1}
"""Environment of this machine's workers. By default Dask's return memory to the system at once and ask for it again
with each array of a fit; that and Dask's profiler make a sweep a seventh longer."""
AWAY_S = 120.0
"""Longest that this machine's workers may all be away: one whose process died is started again within seconds."""
AHEAD = 4
"""Tasks a worker that are handed to the scheduler at once: enough that none waits, and few enough to stop soon."""


class DaskWorkers:
    """Workers of a Dask scheduler; without an address, a cluster of processes on this machine."""

    def __init__(self, count: int = 1, scheduler: str | None = None):
        """Raises `MissingDependencyError` without the extra, `InputError` for a scheduler that cannot be reached."""
        with needs("cluster"):
            import dask
            from distributed import Client, LocalCluster
            from distributed.comm import get_address_host_port
        # What becomes of workers and scheduler is told by the errors below.
        for name in ("distributed", "distributed.client"):  # Dask gives the second one a level of its own
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.address = scheduler or ""
        self._cluster = None
        if scheduler is None:
            # A nanny starts its worker again. Dask would close a nanny whose worker has been away for 15 s, as on a
            # busy machine, and one that takes its place can find the name still taken and never come up.
            dask.config.set({"distributed.deploy.lost-worker-timeout": "1 day"})
            environment = dask.config.get("distributed.nanny.pre-spawn-environ") | MALLOC
            born = {"distributed.nanny.pre-spawn-environ": environment, "distributed.worker.profile.enabled": False}
            with dask.config.set(born):
                self._cluster = LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address=":0",
                    silence_logs=50,
                    env=ONE_CORE,
                    preload=[__name__],
                )
            self.address = self._cluster.scheduler_address
        try:
            if scheduler is not None:
                get_address_host_port(scheduler)  # over what is no address, a client fails and goes on waiting
            self._client = Client(self._cluster or scheduler, timeout=REACH_S, set_as_default=False)
        except (OSError, ValueError, ImportError) as error:
            raise InputError(
                f"The scheduler {scheduler} cannot be reached ({reason_of(error)}); start one with `dask scheduler` "
                "and workers with `dask worker`, or leave --scheduler out."
            ) from error
        self._do: tuple[Do | None, Any] = (None, None)
        self.said = f"Dask dashboard: {self._client.dashboard_link}"

    @property
    def count(self) -> int:
        """Workers of the scheduler now; at least one, which may be yet to come."""
        return max(1, self._at_work())

    def _at_work(self) -> int:
        return len(self._client.scheduler_info(n_workers=-1)["workers"])

    def results(self, tasks: Sequence[Task], do: Do = run) -> Iterator[tuple[int, Any]]:
        """As they are done. Raises `LostSchedulerError`."""
        done: queue.SimpleQueue = queue.SimpleQueue()
        rest, out = deque(range(len(tasks))), {}
        suspects, alone = deque(), set()
        there = self._there(do)
        seen_s = time.monotonic()
        while rest or suspects or out:
            if not (rest or out):
                # A dead worker counts against all tasks that it held: one at a time tells whose deaths they are.
                alone.add(suspects[0])
                rest.append(suspects.popleft())
            room = AHEAD * self.count - len(out)
            for number in [rest.popleft() for _ in range(min(room, len(rest)))]:
                # Impure: the same task may be asked for again after its result was torn.
                future = self._client.submit(guarded, there, tasks[number], pure=False, retries=1)
                out[future] = number
                future.add_done_callback(done.put)
            try:
                future = done.get(timeout=LOOK_S)
            except queue.Empty:
                seen_s = self._last_seen(seen_s)
                continue
            seen_s = time.monotonic()
            number = out.pop(future, None)
            if number is None:
                continue
            if future.status == "finished":
                yield number, future.result()
            elif future.status == "error" and number not in alone:
                suspects.append(number)
            elif future.status == "error":
                # The task itself raises nothing: its worker died again and again.
                yield number, Failed(f"{tasks[number].clip} cannot be fitted ({reason_of(future.exception())}).")
            elif future.status == "cancelled":
                raise self._lost()
            else:
                # Its worker died with the result before it was fetched: the scheduler has it done again.
                out[future] = number
                future.add_done_callback(done.put)

    def _there(self, do: Do) -> Any:
        """`do` on the cluster: workers fetch it once, and the scheduler gives it out again where its holder died."""
        if do is not self._do[0]:
            with warnings.catch_warnings():
                # It may hold a face model, of some ten MB, and goes to the scheduler once.
                warnings.filterwarnings("ignore", "Sending large graph")
                self._do = do, self._client.submit(_handed_on, do, pure=False)
        return self._do[1]

    def _last_seen(self, before_s: float) -> float:
        """When there were workers last, who had been seen at `before_s`. Raises `LostSchedulerError`."""
        if self._client.status not in ("running", "newly-created"):
            raise self._lost()
        if self._cluster is None or self._at_work():
            return time.monotonic()
        if time.monotonic() - before_s > AWAY_S:
            raise LostSchedulerError(
                f"The workers are gone, and none has come back for {AWAY_S:.0f} s. Finished work is kept; free some "
                "memory and continue with --resume."
            )
        return before_s

    def _lost(self) -> LostSchedulerError:
        return LostSchedulerError(
            f"The scheduler {self.address} is gone. Finished work is kept; start it again and continue with --resume."
        )

    def close(self) -> None:
        """Leave the scheduler; a cluster of this machine ends."""
        self._client.close(timeout=2)
        if self._cluster is not None:
            # What is still going on ends with this process.
            with suppress(TimeoutError):
                self._cluster.close(timeout=10)


def dask_setup(worker: Any) -> None:
    """What Dask calls where a worker of this machine starts: Ctrl-C is left to the command, which ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _handed_on(do: Do) -> Do:
    return do
