"""Processor time and memory of importing the workbench, of the command line's help, and of loading what a fit needs."""

import statistics
import subprocess
import sys

from result import print_result

ROUNDS = 5
PROGRAMS = {
    "import": "import workbench",
    "help": "from workbench.cli import app; app(['--help'], standalone_mode=False)",
    "fit": "import workbench; workbench.fit",
    "python": "",
}
TOLD = "import resource, sys; used = resource.getrusage(resource.RUSAGE_SELF)"
PRINTED = "print(used.ru_utime + used.ru_stime, used.ru_maxrss / (2**20 if sys.platform == 'darwin' else 2**10))"


def main() -> None:
    """Each program in fresh processes, in turns."""
    taken = {name: [] for name in PROGRAMS}
    for _ in range(ROUNDS):
        for name, program in PROGRAMS.items():
            taken[name].append(seconds_and_mib(program))
    seconds = {name: statistics.median(pair[0] for pair in pairs) for name, pairs in taken.items()}
    memory = {name: statistics.median(pair[1] for pair in pairs) for name, pairs in taken.items()}
    details = {f"{name}_s": value for name, value in seconds.items()}
    details |= {f"{name}_mib": value for name, value in memory.items()}
    print_result("import_time", seconds["import"], "s", "<= 1.2", "nothing", details)


def seconds_and_mib(program: str) -> tuple[float, float]:
    """Processor time and peak memory of a fresh Python that runs a program."""
    command = [sys.executable, "-c", f"{program}\n{TOLD}\n{PRINTED}"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    seconds, mib = done.stdout.split()[-2:]
    return float(seconds), float(mib)


if __name__ == "__main__":
    main()
