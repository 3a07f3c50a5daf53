"""Sixteen planted faults, and one of pupils: at which rank is the right reason? Is a clean clip left in peace?

    python benchmarks/diagnosis.py [--variants 4] [--preset joint] [--stream test]

Prints a table (fault → rank of the right reason in each variant, "–" for not listed) and one line of JSON.
"""

import argparse
import time
from collections import Counter

import numpy as np
from planted_faults import FAULTS, OF_PUPILS, STREAMS, case_at, clip, follow, good_config, observations_of, planted
from result import print_result
from rich.console import Console
from rich.table import Table

from workbench.config import Config
from workbench.diagnosis import FrameCase, diagnose_frame, flag_frames, reference_of
from workbench.planning import plan_of
from workbench.tracking import FaceItFitter, Track
from workbench.tracking.records import stack_fits

CLEAN_STEP = 12
GOAL_FIRST = 14
"""Faults, of the sixteen, whose right reason comes first."""


def main() -> None:
    """Run all and print."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--variants", type=int, default=4)
    arguments.add_argument("--preset", default="joint")
    arguments.add_argument("--stream", choices=sorted(STREAMS), default="test")
    chosen = arguments.parse_args()
    config = good_config(chosen.preset)
    head = clip(config).head
    fitter = FaceItFitter(head, plan_of(config, head.scheme))
    diagnose_frame(head, case_at(30, clip(config).landmarks, config), fitter)  # compile before anything is timed
    table, seconds, ranks = Table("fault", "right reason", "ranks", "seconds"), [], {}
    for fault, (code, _) in (FAULTS | (OF_PUPILS if "pupils" in head.scheme.groups else {})).items():
        found = [rank_of(fault, variant, chosen.stream, config, fitter) for variant in range(chosen.variants)]
        ranks[fault] = [rank for rank, _ in found]
        seconds += [spent for _, spent in found]
        shown = " ".join("–" if rank == 0 else str(rank) for rank in ranks[fault])
        table.add_row(fault, code, shown, f"{np.median([spent for _, spent in found]):.2f}")
    accused, flagged, looked_at = clean_clip(config, fitter)
    Console(stderr=True).print(table)
    Console(stderr=True).print(f"clean clip: {dict(accused)} in {looked_at} frames diagnosed, {flagged} frames flagged")
    all_ranks = np.concatenate(list(ranks.values()))
    first = sum(np.mean(np.array(found) == 1) > 0.5 for found in ranks.values())
    details = {
        "ranks": ranks,
        "variants_first": float(np.mean(all_ranks == 1)),
        "variants_first_two": float(np.mean((all_ranks == 1) | (all_ranks == 2))),
        "clean_accused": int(sum(accused.values())),
        "clean_flagged": flagged,
        "seconds_median": float(np.median(seconds)),
    }
    print_result(
        "diagnosis", float(first), "faults", f">= {GOAL_FIRST}", f"{len(ranks)} planted faults, most variants", details
    )


def rank_of(fault: str, variant: int, stream: str, config: Config, fitter: FaceItFitter) -> tuple[int, float]:
    """Rank of the right reason (0: not listed), and seconds that the diagnosis took, its shot's reference included."""
    case = planted(fault, variant, stream, config)
    began = time.perf_counter()
    reasons = diagnose_frame(fitter.model, case.case, fitter).reasons
    codes = [reason.code for reason in reasons]
    return (codes.index(case.code) + 1 if case.code in codes else 0), time.perf_counter() - began


def clean_clip(config: Config, fitter: FaceItFitter) -> tuple[Counter, int, int]:
    """Reasons found on frames of the clip without a fault, frames flagged, and frames diagnosed."""
    observations = observations_of(clip(config).noisy(np.random.default_rng(99)))
    fits = follow(observations, config)
    names = {"expression_names": list(fitter.model.expression_names)}
    flags = flag_frames(Track(**stack_fits([fit for fit, _ in fits]), meta=names), config)
    reference = reference_of(fitter.model, config, observations, fitter)
    accused, indices = Counter(), range(6, len(observations), CLEAN_STEP)
    for index in indices:
        pictures = (clip(config).pictures[index], clip(config).pictures[index - 1])
        case = FrameCase(
            observations[index], fits[index][1], config, observations, *pictures, clip(config).pictures.__getitem__
        )
        accused.update(reason.code for reason in diagnose_frame(fitter.model, case, fitter, reference).reasons)
    return accused, int(flags.flagged.sum()), len(indices)


if __name__ == "__main__":
    main()
