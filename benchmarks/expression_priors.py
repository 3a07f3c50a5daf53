"""Priors of the weights on the bundled clips, whose truth is known: few shapes, both sides alike, usual expressions.

Each clip's pictures are looked at once by the network detector, then fitted under `joint` with the terms of each prior
in its last stage. Mean absolute error of the weights; how much of the true weights' size is found; how far the mean
head's face under the found weights is from that under the true ones, as a retargeted performance would be; and how
wrong the difference of both sides is.
"""

import argparse

import numpy as np
from dense_landmarks import CLIPS
from result import print_result

import workbench
from workbench.config import preset
from workbench.energies.flow import face_triangles
from workbench.face import load_default_head
from workbench.face.usual_expressions import usual_expressions
from workbench.session import Material, TuningSession

PRIORS = {
    "few (joint)": ((), {}),
    "few, both sides alike": (("symmetry",), {"symmetry": 20.0}),
    "few, both sides very much alike": (("symmetry",), {"symmetry": 100.0}),
    "few and usual": (("usual",), {"usual": 1.0}),
    "usual": (("usual",), {"usual": 1.0, "sigma_smooth": 1.0}),
}


def main() -> None:
    """Look, fit under each prior, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clips", nargs="+", choices=CLIPS, default=list(CLIPS))
    parser.add_argument("--frames", type=int, default=120)
    asked = parser.parse_args()
    found = {prior: [] for prior in PRIORS}
    for clip in asked.clips:
        session, truth = looked_at(clip, asked.frames)
        for prior, (terms, weights) in PRIORS.items():
            stages = [stage.model_dump() for stage in session.config.stages]
            stages[-1]["terms"] = terms
            track = session.fit_clip(config=session.config.changed(stages=stages, weights=weights))
            found[prior].append(judged(track, truth))
    means = {
        prior: {name: float(np.mean([row[name] for row in rows])) for name in rows[0]} for prior, rows in found.items()
    }
    print_result(
        "expression priors: what both sides differ by wrongly, weights alike",
        means["few, both sides alike"]["sides, wrong"] / means["few (joint)"]["sides, wrong"],
        "times that without",
        "<= 1",
        "joint, on the same points",
        {"mean": means, "clips": dict(zip(asked.clips, zip(*found.values(), strict=True), strict=True))},
    )


def looked_at(clip, frames):
    """A session on the network's points of a clip, its lens known, and its truth."""
    with np.load(workbench.sample(f"{clip}-truth"), allow_pickle=False) as stored:
        truth = {name: stored[name] for name in stored.files}
    tracker = workbench.LandmarkTracker(workbench.make_detector("network"))
    observed = []
    for frame, _ in zip(workbench.open_frames(workbench.sample(clip)).iterate(0), range(frames), strict=False):
        landmarks = tracker.step(frame.picture).landmarks
        size = frame.picture.shape[1], frame.picture.shape[0]
        observed.append(workbench.FrameObservation(len(observed), landmarks, size))
    fov_deg = float(2 * np.degrees(np.arctan(truth["image_size"].max() / 2 / truth["focal_px"][0])))
    config = preset("joint").changed(camera={"fov_deg": fov_deg})
    return TuningSession(load_default_head(), Material(clip, tuple(observed), None, stills=False), config), truth


def judged(track, truth):
    """The errors of a clip's fits."""
    head = load_default_head()
    face = np.unique(head.triangles[face_triangles(head)])
    seen = np.flatnonzero(track.found)
    made, true = track.expression[seen], truth["expression"][track.index[seen]]
    moved = np.tensordot(made - true, head.expression_deltas[:, face], axes=1)
    sides = usual_expressions(head.expression_names).sides
    return {
        "weights": float(np.abs(made - true).mean()),
        "size found": float((made * true).sum() / (true**2).sum()),
        "expression, mm": float(np.linalg.norm(moved, axis=-1).mean()),
        "sides, wrong": float(np.abs((made - true) @ sides.T).mean()),
    }


if __name__ == "__main__":
    main()
