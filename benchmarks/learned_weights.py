"""What is learned on one clip without its truth, judged by the truth of two others.

What holds the shape of a person's face near the mean face and the sparsity of the weights (by search), point weights,
and these with ω_τ (both by gradient) are learned on a rendered clip so that fits predict landmarks that they have not
seen. Then all of the two other clips are fitted under the preset and under what was learned. The value is the change of
their true errors, mean over rotation, position and blendshape weights; nothing was chosen by it.
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
SHAPE, SPARSITY = "identity.weight=log(0.5,500)", "weights.sigma_smooth=log(2,200)"
"""Ten times less than the preset has; ten times more, and of the shape a hundred times."""
LEARNED = {
    "shape and sparsity": ((), (SHAPE, SPARSITY)),
    "shape": ((), (SHAPE,)),
    "sparsity": ((), (SPARSITY,)),
    "points": (("landmarks.weights",), ()),
    "points and tau": (("landmarks.weights", "weights.tau"), ()),
}
"""Settings by gradient, and by search."""
OMEGAS = ("weights.sigma_smooth", "weights.tau")
CONFIG = preset("joint").changed(camera={"fov_deg": 33.0})
"""The preset, with the field of view that the clips were rendered with."""


def main() -> None:
    """Learn, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--on", nargs="+", choices=CLIPS, default=["performance"], help="clips to learn on")
    parser.add_argument("--learn", nargs="+", choices=LEARNED, default=list(LEARNED), help="what to learn")
    parser.add_argument("--steps", type=int, default=24)
    parser.add_argument("--trials", type=int, default=24)
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
            others = {other: clip for other, clip in clips.items() if other != name}
            learned = {path: setting(found.config, path) for path in ("identity.weight", *OMEGAS)}
            details = {"objective on its own held-out frames": str(found.change), "learned": learned}
            judged(f"learned_weights: {what}, on {name}", CONFIG, found.config, others, head, details)


def observed_with_truth(name, head):
    """A clip with its stored landmarks; its truth is for judging alone."""
    files = (str(sample(name)), str(sample(f"{name}-landmarks")), str(sample(f"{name}-truth")))
    return observe(ClipSource(*files), CONFIG, head, name)


def setting(config, path: str) -> float:
    """The value of a setting that its section holds."""
    section, key = path.split(".")
    return getattr(getattr(config, section), key)


def learned_on(clip, learned, asked, head, place):
    """What a clip teaches: three quarters of it are learned on, an eighth chooses the step, an eighth reports."""
    count, (by_gradient, by_search) = len(clip.observations), learned
    first, second = round(0.75 * count), round(0.875 * count)
    parts = Parts(range(first), range(second, count), range(first, second))
    search = tuple(map(read_axis, by_search))
    wanted = Wanted(read_sum(asked.objective), parts, by_gradient, search, asked.steps, asked.trials)

    def tell(what, done, total, value, watched):
        print(f"{clip.name} {what} {done} of {total}: {value:.4g}, watched {watched}", file=sys.stderr, flush=True)

    place.parent.mkdir(parents=True, exist_ok=True)
    return tuned(head, CONFIG, clip, wanted, tell, place)


def judged(title, base, config, others, head, details) -> None:
    """Print the change of the true errors on the other clips, with their intervals."""
    solver, changes, found = ClipSolver(head), [], {}
    for other, clip in others.items():
        names = (*TRUE_ERRORS, "error", "jitter")
        before, after = objectives_of(solver, [base, config], clip, clip.shots, names)
        for error, old, new in zip(names, before, after, strict=True):
            found[f"{other}, {error}"] = f"{np.nanmean(old):.4g} → {np.nanmean(new):.4g}: {change_of(old, new)}"
            changes += [np.nanmean(new) / np.nanmean(old) - 1.0] if error in TRUE_ERRORS else []
    against = f"the preset {base.preset} on unseen clips"
    print_result(title, 100.0 * float(np.mean(changes)), "% change of true errors", "<= -15", against, found | details)


if __name__ == "__main__":
    main()
