"""A plan for 10,000 hours of video on 1,000 workers, from measured rates, by a small simulation.

Tasks wait in one queue; whoever is free takes the next one. Lengths spread as a log-normal distribution does, some
workers are slow, some die in the middle of a task, which is then done again, and the scheduler needs a moment for every
task. `sweep_scaling.py` checks it against real runs. Prints the plan's numbers, each from those in `RATES`.
"""

import heapq
from dataclasses import dataclass, replace

import numpy as np
from result import print_result

HOURS, FRAMES_PER_S = 10_000, 25
RATES = {
    "observe_s": 0.0118,
    "fit_s": 0.0009,
    "identity_s": 0.15,
    "clip_bytes": 1500,
    "result_bytes": 26,
    "task_bytes": 1700,
    "worker_mb": 760,
}
"""Processor seconds a frame from the picture to landmarks (detector `network`, 640 × 480) and for a fit, and for the
identity of a shot; bytes a frame of stored landmarks, and of the result of four objectives; bytes of a task for each
configuration in it; memory of a worker. All measured on the machine that docs/scale.md names."""
SHOT_S = 60.0
"""Length of a shot: what one task finds the landmarks of, and fits."""


@dataclass(frozen=True)
class Work:
    """Tasks that do not wait for one another."""

    tasks: int
    mean_s: float
    spread: float = 0.3
    """Standard deviation of the logarithm of their lengths."""


@dataclass(frozen=True)
class Machine:
    """Workers and their scheduler."""

    workers: int
    hand_out_s: float = 0.001
    """What the scheduler needs for a task; it hands out one after the other."""
    slow_share: float = 0.0
    slow_by: float = 3.0
    """Stragglers: so many of the workers take so many times as long."""
    death_per_hour: float = 0.0
    """Deaths of a worker in an hour of its work; the task that it was at is lost."""
    replaced_s: float = 30.0
    """Until a dead worker's place is taken, warm."""


@dataclass(frozen=True)
class Outcome:
    """What a simulated run takes."""

    seconds: float
    busy: float
    """Share of the workers' time in which they do work that counts."""
    lost_s: float
    """Work that was done twice, seconds of one worker."""


def simulated(work: Work, machine: Machine, seed: int = 0) -> Outcome:
    """Run the queue until it is empty."""
    random = np.random.default_rng(seed)
    lengths = random.lognormal(np.log(work.mean_s) - 0.5 * work.spread**2, work.spread, work.tasks)
    slowness = np.where(random.random(machine.workers) < machine.slow_share, machine.slow_by, 1.0)
    free = [(0.0, worker) for worker in range(machine.workers)]
    heapq.heapify(free)
    queue, handed_out, last, lost = list(lengths[::-1]), 0.0, 0.0, 0.0
    while queue:
        time, worker = heapq.heappop(free)
        length = queue.pop()
        handed_out = max(handed_out, time) + machine.hand_out_s
        takes = length * slowness[worker]
        dies_after = random.exponential(3600.0 / machine.death_per_hour) if machine.death_per_hour else np.inf
        if dies_after < takes:
            queue.append(length)
            lost += dies_after
            heapq.heappush(free, (handed_out + dies_after + machine.replaced_s, worker))
            continue
        last = max(last, handed_out + takes)
        heapq.heappush(free, (handed_out + takes, worker))
    return Outcome(last, float((lengths.sum()) / (machine.workers * last)), lost)


def task_seconds(settings: int = 1) -> float:
    """Processor seconds of one shot: its landmarks, its identity, its fits."""
    frames = SHOT_S * FRAMES_PER_S
    return frames * (RATES["observe_s"] + settings * RATES["fit_s"]) + RATES["identity_s"]


def plan(workers: int = 1000, settings: int = 1) -> dict[str, float]:
    """The numbers of the plan for so many workers and settings."""
    minutes, frames = HOURS * 60, HOURS * 3600 * FRAMES_PER_S
    work = Work(int(HOURS * 3600 / SHOT_S), task_seconds(settings))
    sound = Machine(workers)
    troubled = replace(sound, slow_share=0.02, death_per_hour=0.01)
    good, bad = simulated(work, sound), simulated(work, troubled)
    return {
        "processor_s_per_minute": task_seconds(settings) * 60.0 / SHOT_S,
        "processor_hours": minutes * task_seconds(settings) / SHOT_S / 60.0,
        "tasks": work.tasks,
        "hours": good.seconds / 3600.0,
        "busy": good.busy,
        "hours_with_trouble": bad.seconds / 3600.0,
        "busy_with_trouble": bad.busy,
        "lost_hours": bad.lost_s / 3600.0,
        "landmarks_gb": frames * RATES["clip_bytes"] / 1e9,
        "results_gb": settings * frames * RATES["result_bytes"] / 1e9,
        "memory_gb": workers * RATES["worker_mb"] / 1e3,
        "scheduler_mb": work.tasks * settings * RATES["task_bytes"] / 1e6,
        "scheduler_tasks_per_s": work.tasks / good.seconds,
    }


def main() -> None:
    """Print the plan."""
    details = {f"{settings} setting(s)": plan(settings=settings) for settings in (1, 100)}
    hours = details["1 setting(s)"]["hours_with_trouble"]
    print_result("cluster_plan", hours, "h", None, "10,000 hours of video on 1,000 workers", details)


if __name__ == "__main__":
    main()
