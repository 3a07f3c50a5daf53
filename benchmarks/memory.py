"""Peak resident memory of tracking 10,000 frames against 1,000: a long video must not need more."""

import argparse
import tempfile
from pathlib import Path

from fresh_process import in_fresh_process, peak_mib
from result import print_result

SHORT, LONG = 1_000, 10_000
CLIP_FRAMES = 500
"""The files repeat this many synthetic frames, forwards and backwards, so that the head never jumps."""


def main() -> None:
    """Track a short and a long landmark file, each in its own process, and print the ratio of their peaks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write the two landmark files and stop")
    parser.add_argument("--track", type=Path, metavar="FILE", help="track one file, print the peak in MiB and stop")
    arguments = parser.parse_args()
    if arguments.write:
        return write_landmark_files(arguments.write)
    if arguments.track:
        return print(peak_of_tracking(arguments.track))
    with tempfile.TemporaryDirectory() as folder:
        in_fresh_process(__file__, "--write", folder)
        short, long = (
            float(in_fresh_process(__file__, "--track", f"{folder}/{frames}.csv")) for frames in (SHORT, LONG)
        )
    details = {f"mib_{SHORT}_frames": short, f"mib_{LONG}_frames": long}
    print_result("memory", long / short, "ratio", "<= 1.1", f"the peak of {SHORT} frames", details)


def write_landmark_files(folder: Path) -> None:
    """A landmark file for each length."""
    from synthetic_clip import IMAGE_SIZE, synthetic_clip

    from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord

    clip = synthetic_clip(CLIP_FRAMES)
    for frames in (SHORT, LONG):
        with LandmarkCsvWriter(folder / f"{frames}.csv") as writer:
            for frame in range(frames):
                place = frame % (2 * CLIP_FRAMES)
                place = min(place, 2 * CLIP_FRAMES - 1 - place)
                landmarks = clip.observation(place).landmarks
                writer.write(LandmarkRecord(frame, f"frame-{frame}", landmarks, IMAGE_SIZE))


def peak_of_tracking(landmarks: Path) -> float:
    """Track a landmark file into a temporary folder; peak resident memory of this process in MiB."""
    from workbench.config import preset
    from workbench.face import load_default_head
    from workbench.pipeline import track

    with tempfile.TemporaryDirectory() as folder:
        track(landmarks, folder, load_default_head(), preset("calibrated"), pictures=False)
    return peak_mib()


if __name__ == "__main__":
    main()
