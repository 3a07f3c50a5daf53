"""What is learned on one clip without its truth, judged by the truth of two others.

The sparsity (by search), point weights, and these with ω_τ (both by gradient) are learned on a rendered clip so that
fits predict landmarks that they have not seen. Then all of the two other clips are fitted under the preset and under
what was learned. The value is the change of their true errors, mean over rotation, position and blendshape weights;
nothing was chosen by it.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from result import print_result

from workbench.config import preset, write_config
from workbench.face import load_default_head
from workbench.learning import Parts, Wanted, change_of, tuned
from workbench.objectives import read_sum
from workbench.samples import sample
from workbench.sweeps import ClipSolver, read_axis
from workbench.sweeps.results import objectives_of
from workbench.sweeps.stored_clips import ClipSource, observe

CLIPS = ("performance", "laugh", "glasses")
OBJECTIVE = "left-out-parts"
TRUE_ERRORS = ("rotation", "position", "weights")
LEARNED = {"sparsity": (), "points": ("landmarks.weights",), "points and tau": ("landmarks.weights", "weights.tau")}
SPARSITY = "weights.sigma_smooth=log(2,200)"
"""Ten times less and more than the preset has."""
CONFIG = preset("joint").changed(camera={"fov_deg": 33.0})
"""The preset, with the field of view that the clips were rendered with."""


def main() -> None:
    """Learn, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--on", nargs="+", choices=CLIPS, default=["performance"], help="clips to learn on")
    parser.add_argument("--learn", nargs="+", choices=LEARNED, default=list(LEARNED), help="what to learn")
    parser.add_argument("--steps", type=int, default=24)
    parser.add_argument("--trials", type=int, default=12)
    parser.add_argument("--objective", default=OBJECTIVE, help="an objective without a truth, or a sum of them")
    parser.add_argument("--out", type=Path, help="folder for what was learned")
    asked = parser.parse_args()
    head = load_default_head()
    clips = {name: observed_with_truth(name, head) for name in CLIPS}
    for name in asked.on:
        for what in asked.learn:
            with tempfile.TemporaryDirectory() as folder:
                place = (asked.out or Path(folder)) / f"{name}-{what.replace(' ', '-')}.toml"
                found = learned_on(clips[name], LEARNED[what], asked, head, place)
                write_config(found.config, place)
            judged(name, what, found, {other: clip for other, clip in clips.items() if other != name}, head)


def observed_with_truth(name, head):
    """A clip with its stored landmarks; its truth is for judging alone."""
    files = (str(sample(name)), str(sample(f"{name}-landmarks")), str(sample(f"{name}-truth")))
    return observe(ClipSource(*files), CONFIG, head, name)


def learned_on(clip, paths, asked, head, place):
    """What a clip teaches: three quarters of it are learned on, an eighth chooses the step, an eighth reports."""
    count = len(clip.observations)
    first, second = round(0.75 * count), round(0.875 * count)
    parts = Parts(range(first), range(second, count), range(first, second))
    search = () if paths else (read_axis(SPARSITY),)
    wanted = Wanted(read_sum(asked.objective), parts, paths, search, asked.steps, asked.trials)

    def tell(what, done, total, value, watched):
        print(f"{clip.name} {what} {done} of {total}: {value:.4g}, watched {watched}", file=sys.stderr, flush=True)

    place.parent.mkdir(parents=True, exist_ok=True)
    return tuned(head, CONFIG, clip, wanted, tell, place)


def judged(name, what, found, others, head) -> None:
    """Print the change of the true errors on the other clips, with their intervals."""
    solver, changes, details = ClipSolver(head), [], {}
    for other, clip in others.items():
        names = (*TRUE_ERRORS, "error", "jitter")
        before, after = objectives_of(solver, [CONFIG, found.config], clip, clip.shots, names)
        for error, old, new in zip(names, before, after, strict=True):
            details[f"{other}, {error}"] = f"{np.nanmean(old):.4g} → {np.nanmean(new):.4g}: {change_of(old, new)}"
            changes += [np.nanmean(new) / np.nanmean(old) - 1.0] if error in TRUE_ERRORS else []
    details |= {"objective on its own held-out frames": str(found.change)}
    details |= {"omega_tau": found.config.weights.tau, "omega_sigma": found.config.weights.sigma_smooth}
    print_result(f"learned_weights: {what}, on {name}", 100.0 * float(np.mean(changes)), "% change of true errors",
                 "<= -15", "the preset joint on unseen clips", details)  # fmt: skip


if __name__ == "__main__":
    main()
