"""The plan past one machine: its simulation does what queues, stragglers and deaths do."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
from cluster_plan import Machine, Work, plan, simulated

WORK = Work(tasks=4000, mean_s=10.0, spread=0.3)


def test_without_trouble_all_workers_are_busy_to_the_end():
    found = simulated(WORK, Machine(workers=20, hand_out_s=0.0))
    assert found.seconds == pytest.approx(4000 * 10.0 / 20, rel=0.02)
    assert found.busy > 0.98
    assert found.lost_s == 0.0


def test_twice_the_workers_take_half_the_time_until_the_scheduler_is_the_limit():
    one, two = (simulated(WORK, Machine(workers=count)).seconds for count in (20, 40))
    assert one / two == pytest.approx(2.0, rel=0.02)
    limited = simulated(WORK, Machine(workers=2000, hand_out_s=0.1)).seconds
    assert limited >= 4000 * 0.1


def test_stragglers_and_deaths_cost_what_they_should():
    sound = simulated(WORK, Machine(workers=20))
    slow = simulated(WORK, Machine(workers=20, slow_share=0.5))
    # Half of the workers at a third of the speed: two thirds of it are left.
    assert slow.seconds == pytest.approx(sound.seconds / (2 / 3), rel=0.15)
    dying = simulated(WORK, Machine(workers=20, death_per_hour=36.0, replaced_s=0.0))
    # A death in 100 s of work, 5 s into a task of 10 s on average.
    assert dying.lost_s == pytest.approx(4000 * 10.0 / 100.0 * 5.0, rel=0.3)
    assert dying.seconds == pytest.approx(sound.seconds + dying.lost_s / 20, rel=0.03)


def test_the_queue_is_the_same_for_the_same_seed():
    machine = replace(Machine(workers=7), death_per_hour=10.0)
    assert simulated(WORK, machine, 3) == simulated(WORK, machine, 3)
    assert simulated(WORK, machine, 3) != simulated(WORK, machine, 4)


def test_the_page_says_what_the_plan_says():
    page = (Path(__file__).resolve().parent.parent / "docs" / "scale.md").read_text(encoding="utf-8")
    found = plan()
    assert f"takes {found['processor_s_per_minute']:.1f} processor seconds" in page
    assert f"{round(found['processor_hours'], -1):,.0f} h" in page
    assert f"{found['tasks']:,} tasks" in page
    assert f"| {found['hours']:.1f} h |" in page
