"""Dense landmarks against the 68 of the same networks, on rendered clips whose truth is exact.

Each clip is tracked from its pictures under `joint` with the network detector and under `dense`: mean absolute error of
the 44 weights by family, distance of the face's vertices from the true ones by part of the face, and the time of a
solve. The vertices are compared after the best rigid motion, and once more at the true face's size, which a picture
hardly tells: a head that is too large lies farther away. Last, the blendshapes that the points cannot tell apart on a
frontal face.
"""

import argparse
import tempfile

import numpy as np
from result import print_result
from scipy.spatial.transform import Rotation

from workbench.config import preset
from workbench.diagnosis import indistinguishable_groups
from workbench.energies.flow import face_triangles
from workbench.face import FaceParameters, in_scheme, landmark_model, load_default_head, model_landmarks
from workbench.geometry import camera_from_fov
from workbench.landmarks.scheme import GROUPS, IBUG68
from workbench.landmarks.schemes import DENSE
from workbench.pipeline import track
from workbench.samples import sample

CLIPS = ("performance", "laugh", "glasses")
FAMILIES = ("brow", "eye", "cheek", "jaw", "mouth", "nose")
PARTS = ("brows", "eyes", "nose", "mouth")
NEAR_MM = 14.0
"""How far from the 68 landmarks of a part its vertices reach; the rest of the face is cheeks, forehead and chin."""
SERIES = {"68": preset("joint").changed(landmarks={"detector": "network"}), "dense": preset("dense")}


def main() -> None:
    """Track, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clips", nargs="+", choices=CLIPS, default=list(CLIPS))
    parser.add_argument("--frames", type=int, default=120)
    asked = parser.parse_args()
    head = load_default_head()
    regions = regions_of(head)
    found = {
        name: {clip: judged(clip, config, head, regions, asked.frames) for clip in asked.clips}
        for name, config in SERIES.items()
    }
    means = {name: mean_of(list(rows.values())) for name, rows in found.items()}
    groups = {scheme.name: groups_of(in_scheme(head, scheme)) for scheme in (IBUG68, DENSE)}
    print_result(
        "dense landmarks: distance of the face's vertices from the truth",
        means["dense"]["mm, face"] / means["68"]["mm, face"],
        "times that of 68 points",
        "<= 0.5",
        "the network detector's 68 points, on the same frames",
        {"mean": means, "clips": found, "not told apart on a frontal face": groups},
    )


def regions_of(head) -> dict[str, np.ndarray]:
    """Vertices of the face by part."""
    face = np.unique(head.triangles[face_triangles(head)])
    points = head.landmarks.of(head.neutral)
    near = {}
    for part in PARTS:
        away = np.linalg.norm(head.neutral[face][:, None] - points[list(GROUPS[part])][None], axis=2)
        near[part] = face[away.min(axis=1) < NEAR_MM]
    rest = np.setdiff1d(face, np.concatenate(list(near.values())))
    return {"face": face, **near, "cheeks, forehead, chin": rest}


def judged(clip, config, head, regions, frames):
    """The errors of a clip's fits."""
    truth = np.load(sample(f"{clip}-truth"))
    fov = 2 * np.degrees(np.arctan(truth["image_size"].max() / 2 / truth["focal_px"][0]))
    with tempfile.TemporaryDirectory() as folder:
        config = config.changed(camera={"fov_deg": float(fov)})
        found = track(sample(clip), folder, head, config, pictures=False, frames=(0, frames - 1)).track
    seen = np.flatnonzero(found.found)
    # Nobody's eyes turn in these clips, and the weights that turn them are no part of their truth.
    weights_found = found.expression[:, [found.expression_names.index(name) for name in head.expression_names]]
    wrong = np.abs(weights_found[seen] - truth["expression"][found.index[seen]])
    true, person = head.personal(truth["identity"]), head.personal(found.identity[seen[0]])
    pairs = [(weights_found[k], truth["expression"][found.index[k]]) for k in seen[::4]]
    heads = [(person.vertices(own), true.vertices(real)) for own, real in pairs]
    away, shape = (
        np.mean([distances(*pair, regions["face"], sized) for pair in heads], axis=0) for sized in (False, True)
    )
    names = head.expression_names
    weights = {family: [k for k, name in enumerate(names) if name.startswith(family)] for family in FAMILIES}
    return {
        "found": len(seen) / len(found),
        "weights": float(wrong.mean()),
        **{f"weights, {family}": float(wrong[:, columns].mean()) for family, columns in weights.items()},
        **{f"mm, {part}": float(away[vertices].mean()) for part, vertices in regions.items()},
        **{f"mm at its size, {part}": float(shape[vertices].mean()) for part, vertices in regions.items()},
        "solve_ms": float(np.median(found.milliseconds[seen, 2])),
        "landmarks_ms": float(np.median(found.milliseconds[seen, 1])),
    }


def distances(made, true, face, sized):
    """Distance of each vertex from the true one after the rigid motion that fits the face best, mm; NaN elsewhere.

    `sized`: after the best change of size, too.
    """
    origin = true[face].mean(axis=0)
    turn, _ = Rotation.align_vectors(true[face] - origin, made[face] - made[face].mean(axis=0))
    turned, wanted = turn.apply(made[face] - made[face].mean(axis=0)), true[face] - origin
    size = (turned * wanted).sum() / (turned**2).sum() if sized else 1.0
    away = np.full(len(made), np.nan)
    away[face] = np.linalg.norm(size * turned - wanted, axis=1)
    return away


def mean_of(rows):
    """The mean over clips."""
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def groups_of(head):
    """Blendshapes that the head's landmarks cannot tell apart from the front."""
    model, nobody = landmark_model(head), np.zeros(len(head.identity_deltas))
    points = model_landmarks(model, np.eye(len(model.contour_yaw))[0], nobody)
    neutral = np.zeros(len(head.expression_names))
    frontal = FaceParameters(np.zeros(3), np.array([0.0, 0.0, 600.0]), neutral, nobody)
    found = indistinguishable_groups(points, camera_from_fov((640, 480), 45.0), [frontal], head.expression_names)
    return [list(group) for group in found.groups]


if __name__ == "__main__":
    main()
