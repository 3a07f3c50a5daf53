"""A tuning panel on 10,000 frames: seconds to the first fit in the middle of the clip, and the peak of its memory."""

import argparse
import tempfile
import time
from pathlib import Path

from fresh_process import in_fresh_process, peak_mib
from memory import LONG, write_landmark_files
from result import print_result

MOST_MIB = 900.0
AGAINST = f"from going to the middle of {LONG} frames to the shown fit, after the warm-up, while the clip is fitted"


def main() -> None:
    """Open the panel in a process of its own, and print both numbers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write the landmark files and stop")
    parser.add_argument("--open", type=Path, metavar="FILE", help="open one file, print seconds and MiB and stop")
    arguments = parser.parse_args()
    if arguments.write:
        return write_landmark_files(arguments.write)
    if arguments.open:
        return print(*measured(arguments.open))
    with tempfile.TemporaryDirectory() as folder:
        in_fresh_process(__file__, "--write", folder)
        clip = f"{folder}/{LONG}.csv"
        in_fresh_process(__file__, "--open", clip)  # leaves the compiled programs in the cache, as any earlier start
        numbers = (float(word) for word in in_fresh_process(__file__, "--open", clip).split())
    seconds, opened, whole, peak = numbers
    details = {"seconds_to_open": opened, "seconds_whole_clip": whole, "peak_mib": peak, "peak_goal_mib": MOST_MIB}
    print_result("panel_scale", seconds, "s", "<= 1.5", AGAINST, details)


def measured(clip: Path) -> tuple[float, float, float, float]:
    """Seconds to the first fit in the middle, to the panel, and to the whole clip with its curves; peak in MiB."""
    from workbench.session import open_session
    from workbench.widgets import TuningPanel

    began = time.perf_counter()
    session = open_session(clip)
    session.warm_up()
    opened = time.perf_counter()
    panel = TuningPanel(session)
    middle, asked = len(session) // 2, time.perf_counter()
    panel.go(middle)
    while panel.fit is None or panel.fit.index != middle:
        time.sleep(0.005)
    shown = time.perf_counter()
    panel.wait_idle(600.0)
    whole = time.perf_counter()
    panel.close()
    return shown - asked, asked - opened, whole - began, peak_mib()


if __name__ == "__main__":
    main()
