"""The presets derived again: what a bundled clip says for them without its truth, judged by the truth of others.

One setting after the other, each from what was chosen before it: a sweep over its values, and of those within 5 % of
the least objective the one nearest to the preset's. Values that a clip does not speak against stay as they are. ω_τ is
the steadiest at equal error. The table has the interval of each choice by bootstrap over frames, and the value the
change of the true errors of the two other clips, mean over rotation, position and blendshape weights. With --people
the same follows for short films of random people, whose landmarks are the bundled network's.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from learned_weights import CLIPS, judged, observed_with_truth, setting

from workbench.config import preset
from workbench.face import load_default_head
from workbench.geometry import Rig
from workbench.landmarks.network_detector import NetworkDetector
from workbench.objectives import Truth
from workbench.reproduction.stereo_film import FOV_DEG, SIZE, film_views, network_landmarks, talk_and_nod, two_cameras
from workbench.samples import sample
from workbench.sweeps import Sweep, SweptClip, nearest, read_axis, run_sweep, sources_of, steadiest
from workbench.tracking import FrameObservation
from workbench.workers import ThisProcess

FIRST_SEED, FILM_FRAMES = 101, 48
STEADIEST = "jitter at equal error"
PARTS = "left-out-parts"
OURS = {
    "identity.weight": ("1.25,2.5,5,10,20,40,80,160,320", PARTS),
    "weights.sigma_smooth": ("1.25,2.5,5,10,20,40,80,160,320", PARTS),
    "weights.tau": ("0.001,0.003,0.01,0.03,0.1,0.3,1,3,10", STEADIEST),
}
SETTINGS = {
    "joint": OURS,
    "calibrated": OURS,
    "face-it": {
        "weights.sigma": ("0.1,0.3,1,3,10,30,100,300", PARTS),
        "weights.beta": ("0.3,3,30,300,3000,30000", PARTS),
        "weights.tau": ("0.0001,0.0003,0.001,0.003,0.01,0.03,0.1,0.3,1", STEADIEST),
    },
}
"""By preset: the values that are tried of each setting, among them the preset's, and what chooses."""


def main() -> None:
    """Derive, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", nargs="+", choices=SETTINGS, default=list(SETTINGS))
    parser.add_argument("--on", nargs="+", choices=CLIPS, default=["performance"], help="clips to derive from")
    parser.add_argument("--frames", type=int, default=120, help="budget of frames of a sweep")
    parser.add_argument("--people", type=int, default=0, help="films of random people to judge by besides")
    parser.add_argument("--out", type=Path, help="folder for the sweeps' results; what is there is not done again")
    asked = parser.parse_args()
    head = load_default_head()
    clips = {name: observed_with_truth(name, head) for name in CLIPS}
    films = {f"person {seed}": film_of(head, seed) for seed in range(FIRST_SEED, FIRST_SEED + asked.people)}
    for name in asked.presets:
        base = preset(name).changed(camera={"fov_deg": FOV_DEG})
        for clip in asked.on:
            with tempfile.TemporaryDirectory() as folder:
                place = (asked.out or Path(folder)) / clip
                config, table = derived(base, clip, place, asked.frames)
            others = {other: seen for other, seen in clips.items() if other != clip}
            judged(f"derived_presets: {name}, on {clip}", base, config, others, head, {"derived": table})
            if films:
                judged(f"derived_presets: {name}, on {clip}, by films", base, config, films, head, {})


def film_of(head, seed):
    """A random person who talks and nods, seen by one camera, with the truth."""
    motion, detector = talk_and_nod(head.expression_names, FILM_FRAMES), NetworkDetector()
    shots = film_views(head, Rig(two_cameras().views[:1]), motion, seed)
    seen = tuple(FrameObservation(shot.frame, network_landmarks(detector, shot.picture), SIZE) for shot in shots)
    truth = Truth(motion.rotation, motion.translation_mm, motion.expression)
    return SweptClip(f"person {seed}", f"film {seed}", seen, False, truth)


def derived(base, clip, place, frames):
    """The configuration that a clip's landmarks lead to, and a line for each setting."""
    config, table = base, {}
    sources = sources_of([str(sample(f"{clip}-landmarks"))])
    for path, (values, wanted) in SETTINGS[base.preset].items():
        axis, shipped = read_axis(f"{path}={values}"), setting(base, path)
        objectives = ("error", "jitter") if wanted == STEADIEST else (wanted,)
        sweep = Sweep(sources, (axis,), config, objectives=objectives, frames=frames)
        result = run_sweep(sweep, place, ThisProcess(), resume=True)
        away = np.abs(np.log(np.array(axis.values) / shipped))
        rule = steadiest() if wanted == STEADIEST else nearest(away, wanted)
        number = rule({name: result.means(name) for name in objectives})
        config, interval = result.config(number), result.interval(axis, rule)
        before, after = (result.means(objectives[-1])[k] for k in (axis.values.index(shipped), number))
        low, high = interval
        table[path] = (
            f"{shipped:g} → {axis.values[number]:g} ({low:g} to {high:g}) by {wanted}: {before:.4g} → {after:.4g}"
        )
        print(f"{base.preset}, {clip}, {path}: {table[path]}", file=sys.stderr, flush=True)
    return config, table


if __name__ == "__main__":
    main()
