"""Sweeps over processes: a pool, a scheduler with workers of its own; killed and gone on with."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from threading import Thread

import numpy as np
import pytest

from tests.clusters import Cluster, until
from tests.short_clips import write_clip
from workbench.config import preset
from workbench.errors import LostSchedulerError
from workbench.sweeps import Sweep, read_axis, run_sweep, sources_of
from workbench.sweeps import sweep as sweep_module
from workbench.sweeps.tasks import Observed, ObserveTask, model_source
from workbench.workers import Pool, ThisProcess, dask_workers, guarded
from workbench.workers.tasks import run as by_itself

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


def test_a_process_of_a_pool_finds_the_same_bits_though_it_is_killed(sweep, expected, tmp_path):
    # One, for each that starts loads JAX first; several and their deaths are tried in test_workers.py.
    workers, killed = Pool(1), []

    def kill(step, done, total):
        if step == "fits" and done >= 100 and not killed:
            victim = next(iter(workers._pool._processes))
            os.kill(victim, signal.SIGKILL)
            killed.append(victim)

    try:
        same(expected, run_sweep(sweep, tmp_path / "s", workers, progress=kill))
    finally:
        workers.close()
    assert killed


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

    workers = cluster.reached()
    try:
        with pytest.raises(LostSchedulerError, match=r"gone\. Finished work is kept; .*--resume"):
            run_sweep(sweep, tmp_path / "s", workers, progress=disturb)
    finally:
        workers.close()
    assert done_before[0] < 360
    assert len(list((tmp_path / "s" / "results").rglob("*.npz"))) >= done_before[0] // 20
    cluster.start_scheduler()
    cluster.start_worker()
    workers = cluster.reached()
    try:
        same(expected, run_sweep(sweep, tmp_path / "s", workers, resume=True))
    finally:
        workers.close()


def test_a_scheduler_that_cannot_be_reached_is_one_sentence_and_exit_code_2(run, sweep, monkeypatch):
    monkeypatch.setattr(dask_workers, "REACH_S", 1.0)
    code, _, err = run("sweep", sweep.sources[0].clip, "--set", "weights.tau=1,2", "--scheduler", "tcp://127.0.0.1:9")
    assert code == 2
    assert "The scheduler tcp://127.0.0.1:9 cannot be reached" in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize("address", ["nonsense", "tcp://localhost", "http://127.0.0.1:8790", ""])
def test_what_is_no_address_of_a_scheduler_is_refused_before_a_client_waits_for_it(run, sweep, monkeypatch, address):
    monkeypatch.setattr("distributed.Client", lambda *given, **named: pytest.fail("waited"))
    code, _, err = run("sweep", sweep.sources[0].clip, "--set", "weights.tau=1,2", "--scheduler", address)
    assert code == 2
    assert f"The scheduler {address} cannot be reached (" in err


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
    task = ObserveTask(sweep.sources[0], sweep.base.model_dump_json(), str(tmp_path), model_source(""))
    found = guarded(by_itself, task)
    assert isinstance(found, Observed)
    assert found == guarded(by_itself, task)
    other = guarded(by_itself, replace(task, source=replace(task.source, stills=True)))
    assert other.digest != found.digest
    assert len(other.shots) == 20
