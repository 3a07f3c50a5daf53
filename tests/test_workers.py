"""Workers: a pool and Dask on this machine do tasks in any order; what ends a process is told, the rest goes on."""

import os
import re
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import dask
import distributed  # noqa: F401  before its settings are set for a test, or Dask drops them all afterwards
import psutil
import pytest

from tests.clusters import Counted, Deadly, Harmless, until
from workbench.errors import ConfigError, LostSchedulerError
from workbench.workers import Failed, Pool, ThisProcess, dask_workers, in_order, workers_for, working


@pytest.fixture(scope="module", params=["pool", "dask"])
def workers(request):
    """Two of each kind; no process is left afterwards."""
    before, made = children(), workers_for(2, kind=request.param)
    yield made
    made.close()
    until(lambda: not (children() - before))


def children() -> set[int]:
    """The processes that this one started, but for Python's own that keeps count of resources."""
    found = set()
    for child in psutil.Process().children(recursive=True):
        try:
            if "resource_tracker" not in " ".join(child.cmdline()):
                found.add(child.pid)
        except psutil.NoSuchProcess:
            continue
    return found


def test_what_does_the_tasks_is_sent_to_each_process_once(workers):
    tasks = [Harmless(k) for k in range(12)]
    results = dict(workers.results(tasks, Counted()))
    assert sorted(results) == [*range(12)]
    assert {arrived for _, arrived in results.values()} == {1}
    assert {pid for pid, _ in results.values()} <= children()
    assert workers.count == 2


@pytest.mark.parametrize("name", ["OPENBLAS_NUM_THREADS", "NPROC"])
def test_a_process_is_born_with_one_thread_for_blas_and_one_for_xla(monkeypatch, name):
    # A script's own imports, which may load BLAS, run in the process before anything of the workbench.
    monkeypatch.delenv(name, raising=False)
    pool = Pool(1)
    (pid, _) = dict(pool.results([Harmless(0)], Counted()))[0]
    assert psutil.Process(pid).environ()[name] == "1"
    assert name not in os.environ
    pool.close()


def test_the_processes_of_a_pool_start_together_even_for_one_task():
    before, pool = children(), Pool(2)
    assert dict(pool.results([Harmless(0)])) == {0: 0}
    assert len(children() - before) == 2
    pool.close()


def test_a_clip_that_ends_its_process_is_told_and_the_rest_goes_on(workers):
    results = dict(workers.results([Harmless(0), Deadly(), *(Harmless(k) for k in range(2, 12))]))
    assert [results[k] for k in (0, *range(2, 12))] == [0, *range(2, 12)]
    assert isinstance(results[1], Failed)
    assert re.match(r"(The process that worked on )?poison\.mp4 (died 3 times, perhaps|cannot)", results[1].reason)


def test_ctrl_c_is_left_to_the_command(workers):
    tasks, do = [Harmless(k) for k in range(12)], Counted()
    at_work = {pid for pid, _ in dict(workers.results(tasks, do)).values()}
    for pid in at_work:
        os.kill(pid, signal.SIGINT)
    assert len(dict(workers.results(tasks, do))) == 12
    assert at_work <= children()


def test_a_worker_that_dask_would_give_up_is_waited_for():
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "1 ms"}):
        alone = workers_for(1, kind="dask")
        (nanny,) = alone._cluster.workers.values()
        (pid, _) = dict(alone.results([Harmless(0)], Counted()))[0]
        os.kill(pid, signal.SIGKILL)
        until(lambda: not psutil.pid_exists(pid))
        assert dict(alone.results([Harmless(3)])) == {0: 3}
        assert [*alone._cluster.workers.values()] == [nanny]
        alone.close()


def test_a_worker_that_dies_late_in_a_long_run_is_waited_for_as_long_as_one_that_dies_early(monkeypatch):
    later_s = [0.0]
    monkeypatch.setattr(dask_workers, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + later_s[0]))
    monkeypatch.setattr(dask_workers, "LOOK_S", 0.2)
    alone = workers_for(1, kind="dask")
    results = alone.results([Harmless(k) for k in range(40)], Counted())
    done = [next(results)]
    later_s[0] = 10.0 * dask_workers.AWAY_S
    done.append(next(results))
    os.kill(done[0][1][0], signal.SIGKILL)
    done += results
    assert sorted(number for number, _ in done) == [*range(40)]
    alone.close()


def test_workers_that_do_not_come_back_are_told(monkeypatch):
    monkeypatch.setattr(dask_workers, "AWAY_S", 2.0)
    alone = workers_for(1, kind="dask")
    (nanny,) = alone._cluster.workers.values()
    alone._cluster.sync(nanny.close)
    with pytest.raises(LostSchedulerError, match=r"none has come back for 2 s. Finished work is kept"):
        list(alone.results([Harmless(0)]))
    alone.close()


def test_a_dashboard_is_told_where_there_is_one(workers):
    assert ("dashboard" in workers.said) == (not isinstance(workers, Pool))


def test_processes_of_a_pool_end_with_the_command_that_is_killed():
    program = """
import os, sys, time
from tests.clusters import Counted, Harmless
from workbench.workers import Pool
if __name__ == "__main__":
    pool = Pool(1)
    print(dict(pool.results([Harmless(0)], Counted()))[0][0], flush=True)
    time.sleep(60)
"""
    command = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    worker = int(command.stdout.readline())
    assert psutil.pid_exists(worker)
    os.kill(command.pid, signal.SIGKILL)
    command.communicate(timeout=30)
    until(lambda: not psutil.pid_exists(worker))


def test_results_come_in_order_each_as_soon_as_those_before_it_are_there():
    given = []

    def results():
        for number in (1, 2, 0, 4, 3):
            given.append(number)
            yield number, f"result {number}"

    taken = in_order(results())
    assert next(taken) == "result 0"
    assert given == [1, 2, 0]
    assert list(taken) == [f"result {number}" for number in (1, 2, 3, 4)]


def test_workers_that_are_given_stay_and_those_of_a_number_end_with_the_block():
    class Watched(ThisProcess):
        closed = False

        def close(self):
            self.closed = True

    mine = Watched()
    with working(mine) as given:
        assert given is mine
    assert not mine.closed
    with working(1) as made:
        assert isinstance(made, ThisProcess)


def test_workers_without_a_scheduler_are_this_process_or_a_pool():
    assert isinstance(workers_for(1), ThisProcess)
    with pytest.raises(ConfigError, match="a pool has none"):
        workers_for(2, "tcp://nowhere:1", "pool")
