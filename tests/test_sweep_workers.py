"""Sweeps over processes: a pool, Dask on this machine, a scheduler with workers of its own; killed and gone on with."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from threading import Thread

import numpy as np
import psutil
import pytest

from tests.short_clips import write_clip
from workbench.config import preset
from workbench.errors import InputError, OutputError
from workbench.sweeps import Sweep, read_axis, run_sweep, sources_of, workers_for
from workbench.sweeps import sweep as sweep_module
from workbench.sweeps.tasks import Failed, Observed
from workbench.sweeps.workers import Pool, ThisProcess

OBJECTIVES = ("error", "jitter", "iterations")


@pytest.fixture(autouse=True)
def small_tasks(monkeypatch):
    monkeypatch.setattr(sweep_module, "FITS", 40)


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    clips = [str(write_clip(folder / f"clip{k}.csv", range(20 * k, 20 * k + 20))) for k in range(3)]
    return Sweep(sources_of(clips), (read_axis("weights.tau=log(1e-2,10,6)"),), preset("joint"), objectives=OBJECTIVES)


@pytest.fixture(scope="module")
def expected(sweep, tmp_path_factory):
    """What one process finds."""
    return run_sweep(sweep, tmp_path_factory.mktemp("one"), ThisProcess())


def same(one, other):
    assert len(one.values) == 18
    assert one.values.keys() == other.values.keys()
    for key, values in one.values.items():
        np.testing.assert_array_equal(values, other.values[key])


def children() -> set[int]:
    return {child.pid for child in psutil.Process().children(recursive=True)}


@contextmanager
def working(count, **options):
    before, workers = children(), workers_for(count, **options)
    try:
        yield workers
    finally:
        workers.close()
    until(lambda: not (children() - before) or all(name == "resource_tracker" for name in _names(children() - before)))


def _names(pids):
    for pid in pids:
        try:
            yield "resource_tracker" if "resource_tracker" in " ".join(psutil.Process(pid).cmdline()) else "worker"
        except psutil.NoSuchProcess:
            yield "resource_tracker"


def until(done, seconds=60.0):
    limit = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < limit, "waited for too long"
        time.sleep(0.1)


def test_two_workers_of_dask_find_the_same_bits_as_one_process(sweep, expected, tmp_path):
    with working(2, kind="dask") as workers:
        same(expected, run_sweep(sweep, tmp_path / "s", workers))
        assert "dashboard" in workers.said


def test_two_processes_of_a_pool_find_the_same_bits_though_one_is_killed(sweep, expected, tmp_path):
    with working(2, kind="pool") as workers:
        assert workers.said == ""
        killed = []

        def kill(step, done, total):
            if step == "fits" and done >= 100 and not killed:
                victim = next(iter(workers._pool._processes))
                os.kill(victim, signal.SIGKILL)
                killed.append(victim)

        same(expected, run_sweep(sweep, tmp_path / "s", workers, progress=kill))
        assert killed


@dataclass(frozen=True)
class Deadly:
    """A task whose clip ends the process."""

    clip: str = "poison.mp4"

    def run(self):
        os.kill(os.getpid(), signal.SIGKILL)


@dataclass(frozen=True)
class Harmless:
    number: int
    clip: str = "fine.mp4"

    def run(self):
        return self.number


def test_a_clip_that_ends_its_process_is_told_and_the_rest_goes_on():
    pool = Pool(2)
    try:
        results = dict(pool.results([Harmless(0), Deadly(), *(Harmless(k) for k in range(2, 12))]))
    finally:
        pool.close()
    assert [results[k] for k in (0, *range(2, 12))] == [0, *range(2, 12)]
    assert results[1] == Failed("poison.mp4 ended the process that worked on it, 3 times.")


class Cluster:
    """A scheduler and workers as processes of their own."""

    def __init__(self):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self.processes = []
        self.scheduler = self.start_scheduler()

    def start_scheduler(self):
        port = self.address.rpartition(":")[2]
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")
        return self.scheduler

    def start_worker(self):
        return self._start("dask_worker", self.address, "--nthreads", "1", "--no-dashboard", "--no-nanny")

    def _start(self, module, *arguments):
        line = [sys.executable, "-W", "ignore", "-m", f"distributed.cli.{module}", *arguments]
        process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.processes.append(process)
        return process

    def close(self):
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.wait(timeout=30)


@pytest.fixture
def cluster():
    made = Cluster()
    try:
        yield made
    finally:
        made.close()


def test_a_killed_worker_and_a_lost_scheduler_lose_nothing(sweep, expected, cluster, tmp_path):
    first, _ = cluster.start_worker(), cluster.start_worker()
    done_before = []

    def disturb(step, done, total):
        if step == "fits" and done >= 60 and first.poll() is None:
            first.kill()
            first.wait()
        if step == "fits" and done >= 160 and cluster.scheduler.poll() is None:
            done_before.append(done)
            cluster.scheduler.kill()
            cluster.scheduler.wait()

    workers = reached(cluster)
    try:
        with pytest.raises(OutputError, match=r"gone\. Finished work is kept; .*--resume"):
            run_sweep(sweep, tmp_path / "s", workers, progress=disturb)
    finally:
        workers.close()
    assert done_before[0] < 360
    assert len(list((tmp_path / "s" / "results").rglob("*.npz"))) >= done_before[0] // 20
    cluster.start_scheduler()
    cluster.start_worker()
    workers = reached(cluster)
    try:
        same(expected, run_sweep(sweep, tmp_path / "s", workers, resume=True))
    finally:
        workers.close()


def reached(cluster):
    limit = time.monotonic() + 60
    while True:
        try:
            return workers_for(scheduler=cluster.address)
        except InputError:
            assert time.monotonic() < limit


def test_a_scheduler_that_cannot_be_reached_is_one_sentence_and_exit_code_2(run, sweep):
    code, _, err = run("sweep", sweep.sources[0].clip, "--set", "weights.tau=1,2", "--scheduler", "tcp://127.0.0.1:9")
    assert code == 2
    assert "The scheduler tcp://127.0.0.1:9 cannot be reached" in err
    assert len(err.strip().splitlines()) == 1
    code, _, err = run("sweep", sweep.sources[0].clip, "--set", "weights.tau=1,2", "--scheduler", "nonsense")
    assert code == 2
    assert "cannot be reached" in err


def test_an_interrupt_ends_the_command_and_keeps_what_was_done(sweep, expected, tmp_path):
    program = "from workbench.cli import main; main()"
    clips = [source.clip for source in sweep.sources]
    measured = [part for name in OBJECTIVES for part in ("--objective", name)]
    line = ["sweep", *clips, "--set", "weights.tau=log(1e-2,10,6)", "--preset", "joint", *measured, "--out", "s"]
    process = subprocess.Popen([sys.executable, "-c", program, *line], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    watcher = Thread(target=lambda: until(lambda: list(tmp_path.rglob("results/*/*.npz")), 120))
    watcher.start()
    watcher.join()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode in (130, 0)
    assert process.returncode == 0 or "--resume continues from there" in err
    same(expected, run_sweep(replace(sweep), tmp_path / "s", ThisProcess(), resume=True))


def test_an_observation_is_told_by_its_digest(sweep, tmp_path):
    from workbench.sweeps.tasks import ObserveTask, guarded

    task = ObserveTask(sweep.sources[0], sweep.base.model_dump_json(), str(tmp_path))
    found = guarded(task)
    assert isinstance(found, Observed)
    assert found == guarded(task)
    other = guarded(replace(task, source=replace(task.source, stills=True)))
    assert other.digest != found.digest
    assert len(other.shots) == 20
