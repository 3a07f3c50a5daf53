"""Stills a second from landmarks to track, tables and pictures, each with an identity of its own; their memory."""

import argparse
import json
import tempfile
import time
from pathlib import Path

from fresh_process import in_fresh_process, peak_mib
from result import print_result

ROWS, WARM = 500, 100
"""Memory is looked at from row `WARM` on: by then everything is loaded."""


def main() -> None:
    """Track stills with and without pictures, each in its own process, and print the rate with pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the landmark file and stop")
    parser.add_argument("--track", type=Path, metavar="FILE", help="track it, print the numbers and stop")
    parser.add_argument("--no-pictures", action="store_true")
    arguments = parser.parse_args()
    if arguments.write:
        return write_landmarks(arguments.write, arguments.rows)
    if arguments.track:
        return print(json.dumps(track_stills(arguments.track, not arguments.no_pictures)))
    with tempfile.TemporaryDirectory() as folder:
        file = f"{folder}/stills.csv"
        in_fresh_process(__file__, "--write", file, "--rows", str(arguments.rows))
        plain = json.loads(in_fresh_process(__file__, "--track", file, "--no-pictures"))
        drawn = json.loads(in_fresh_process(__file__, "--track", file))
    details = {
        "rows": arguments.rows,
        "seconds_each": 1.0 / drawn["rate"],
        "seconds_each_without_pictures": 1.0 / plain["rate"],
        f"mib_row_{WARM}": drawn["mib_warm"],
        "mib_at_the_end": drawn["mib_end"],
        "memory_ratio": drawn["mib_end"] / drawn["mib_warm"],
    }
    print_result("stills", drawn["rate"], "stills/s", ">= 6", "goal of the memory's ratio: <= 1.1", details)


def write_landmarks(file: Path, rows: int) -> None:
    """Frames of the synthetic clip as stills."""
    from synthetic_clip import IMAGE_SIZE, synthetic_clip

    from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord

    clip = synthetic_clip(rows)
    with LandmarkCsvWriter(file) as writer:
        for row in range(rows):
            writer.write(LandmarkRecord(row, f"still-{row}", clip.observation(row).landmarks, IMAGE_SIZE))


def track_stills(file: Path, pictures: bool) -> dict[str, float]:
    """Stills a second from the first finished one on, and this process's peak memory at row `WARM` and at the end."""
    from workbench.config import preset
    from workbench.face import load_default_head
    from workbench.pipeline import track

    moments, warm = [], []

    def progress(step: str, done: int, total: int | None) -> None:
        moments.append(time.perf_counter())
        if done == WARM:
            warm.append(peak_mib())

    with tempfile.TemporaryDirectory() as folder:
        track(
            file, folder, load_default_head(), preset("calibrated"), stills=True, pictures=pictures, progress=progress
        )
        rate = (len(moments) - 1) / (time.perf_counter() - moments[0])
    return {"rate": rate, "mib_warm": warm[0] if warm else peak_mib(), "mib_end": peak_mib()}


if __name__ == "__main__":
    main()
