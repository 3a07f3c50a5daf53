"""Peak resident memory of a run with infill and refinement on 600 frames against 100: it must not grow with a clip."""

import argparse
import tempfile
from pathlib import Path

from fresh_process import in_fresh_process, peak_mib
from result import print_result

SHORT, LONG = 100, 600
GAP_EVERY, GAP = 40, 4
"""Four frames of every forty have no landmarks."""


def main() -> None:
    """Run a short and a long clip, each in its own process, and print the ratio of their peaks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="FOLDER", help="write the two clips and stop")
    parser.add_argument("--track", type=Path, metavar="CLIP", help="run one clip, print the peak in MiB and stop")
    arguments = parser.parse_args()
    if arguments.write:
        return write_clips(arguments.write)
    if arguments.track:
        return print(peak_of_run(arguments.track))
    with tempfile.TemporaryDirectory() as folder:
        in_fresh_process(__file__, "--write", folder)
        in_fresh_process(__file__, "--track", f"{folder}/{SHORT}.mp4")  # fills the compilation cache
        short, long = (
            float(in_fresh_process(__file__, "--track", f"{folder}/{frames}.mp4")) for frames in (SHORT, LONG)
        )
    details = {f"mib_{SHORT}_frames": short, f"mib_{LONG}_frames": long}
    print_result("temporal_memory", long / short, "ratio", "<= 1.1", f"the peak of {SHORT} frames", details)


def write_clips(folder: Path) -> None:
    """The bundled clip forwards and backwards to both lengths, and its landmarks with gaps."""
    from workbench.frames import VideoWriter, open_frames
    from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord, read_landmark_file
    from workbench.samples import sample

    pictures = [frame.picture for frame in open_frames(sample("performance")).iterate()]
    records = list(read_landmark_file(sample("performance-landmarks")))
    count = min(len(pictures), len(records))
    for frames in (SHORT, LONG):
        with (
            VideoWriter(folder / f"{frames}.mp4") as writer,
            LandmarkCsvWriter(folder / f"{frames}.csv", confidence=False) as table,
        ):
            for frame in range(frames):
                place = frame % (2 * count)
                place = min(place, 2 * count - 1 - place)
                writer.write(pictures[place])
                found = None if frame % GAP_EVERY >= GAP_EVERY - GAP else records[place].landmarks
                size = pictures[place].shape[1::-1]
                table.write(LandmarkRecord(frame, f"frame-{frame}", found, size))


def peak_of_run(clip: Path) -> float:
    """Track a clip with infill and refinement into a temporary folder; this process's peak memory in MiB."""
    from workbench.config import preset
    from workbench.face import load_default_head
    from workbench.pipeline import track

    config = preset("joint").changed(
        infill={"method": "flow"}, refinement={"method": "hybrid"}, flow={"side": 128, "points": 200}
    )
    with tempfile.TemporaryDirectory() as folder:
        track(clip, folder, load_default_head(), config, landmarks=clip.with_suffix(".csv"), pictures=False)
    return peak_mib()


if __name__ == "__main__":
    main()
