"""A Dask scheduler and its workers as processes of their own, and tasks that try workers."""

import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass

from workbench.errors import InputError
from workbench.workers import Workers, workers_for


@dataclass(frozen=True)
class Deadly:
    """A task whose clip ends the process."""

    clip: str = "poison.mp4"

    def run(self):
        os.kill(os.getpid(), signal.SIGKILL)


@dataclass(frozen=True)
class Harmless:
    """A task that returns its number."""

    number: int
    clip: str = "fine.mp4"

    def run(self):
        return self.number


class Counted:
    """Does tasks by telling where, and how often it has come to this process."""

    arrived = 0

    def __setstate__(self, state):
        Counted.arrived += 1

    def __getstate__(self):
        return {"made": 1}

    def __call__(self, task):
        time.sleep(0.05)
        return os.getpid(), Counted.arrived


class Cluster:
    """A scheduler and workers as processes of their own."""

    def __init__(self):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self.processes = []
        self.start_scheduler()

    def start_scheduler(self):
        port = self.address.rpartition(":")[2]
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")

    def start_worker(self):
        return self._start("dask_worker", self.address, "--nthreads", "1", "--no-dashboard", "--no-nanny")

    def _start(self, module, *arguments):
        line = [sys.executable, "-W", "ignore", "-m", f"distributed.cli.{module}", *arguments]
        process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.processes.append(process)
        return process

    def reached(self) -> Workers:
        """Its workers, as soon as the scheduler answers."""
        limit = time.monotonic() + 60
        while True:
            try:
                return workers_for(scheduler=self.address)
            except InputError:
                assert time.monotonic() < limit

    def close(self):
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.wait(timeout=30)


def until(done, seconds=60.0):
    """Wait for something."""
    limit = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < limit, "waited for too long"
        time.sleep(0.1)
