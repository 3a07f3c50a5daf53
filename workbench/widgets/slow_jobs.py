"""Slow jobs that must all be done: one thread runs them in order."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


class SlowJobs:
    """Runs jobs one after another; errors go to `failed` and do not end the thread."""

    def __init__(self, failed: Callable[[Exception], None], name: str) -> None:
        self._failed = failed
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)

    def submit(self, job: Callable[..., object], *arguments: object) -> None:
        """Run a job after those already waiting."""
        self._pool.submit(self._do, job, *arguments)

    def wait_idle(self, timeout_s: float | int) -> bool:
        """Wait until all jobs are done; False if that takes longer."""
        try:
            self._pool.submit(int).result(timeout_s)
        except TimeoutError:
            return False
        return True

    def close(self) -> None:
        """Drop waiting jobs, without waiting for the current one."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _do(self, job: Callable[..., object], *arguments: object) -> None:
        try:
            job(*arguments)
        except Exception as error:
            self._failed(error)
