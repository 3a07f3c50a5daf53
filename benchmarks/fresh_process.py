"""A benchmark's own program run again in a process of its own, and the memory that a process took."""

import resource
import subprocess
import sys


def in_fresh_process(program: str, *arguments: str) -> str:
    """Run a program and return what it prints.

    On Linux a process starts with its parent's peak, so the parent should import nothing large before it.
    """
    command = [sys.executable, program, *arguments]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def peak_mib() -> float:
    """Peak resident memory of this process so far, MiB."""
    # Linux counts kibibytes, macOS bytes.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024.0**2 if sys.platform == "darwin" else 1024.0)
