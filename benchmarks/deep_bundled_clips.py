"""Deep Energies on frames of the bundled clips, whose truth is known: rotation under both of our heat-map networks.

A solve is given the person's own shape and the clip's lens; its colours come from the clip's most neutral frame.
"""

import argparse
import sys

import numpy as np
from deep_scenes import rotation_error_deg
from result import print_result

from workbench.config import preset
from workbench.face import load_default_head
from workbench.frames import open_frames
from workbench.landmarks.network_detector import NetworkDetector
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.tracking import FrameContext, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_target import energy_network, photo_landmarks

CLIPS = ("performance", "laugh", "glasses")
NETWORKS = ("heat-maps", "landmarks")


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", default=CLIPS, help="names of bundled clips")
    parser.add_argument("--frames", type=int, default=14, help="of each, spread over the clip")
    parser.add_argument("--character", help="renders show this one, a ready one or a folder of `workbench character`")
    options = parser.parse_args()
    worn = options.character
    look = {"deep": {"appearance": "character"}, "head": {"character": worn}} if worn else {}
    means = {
        clip: {name: _mean_error_deg(clip, name, options.frames, look) for name in NETWORKS} for clip in options.clips
    }
    of = {name: float(np.mean([mean[name] for mean in means.values()])) for name in NETWORKS}
    print_result(
        "deep_bundled_clips",
        value=of["landmarks"] / of["heat-maps"],
        unit="× the rotation error",
        goal="<= 1.0",
        against="heat-maps, the older weights",
        details={f"{clip}_{name}_deg": mean[name] for clip, mean in means.items() for name in NETWORKS},
    )


def _mean_error_deg(clip: str, network: str, count: int, look: dict[str, dict[str, str]]) -> float:
    with np.load(sample(f"{clip}-truth"), allow_pickle=False) as stored:
        truth = dict(stored)
    neutral = int(np.abs(truth["expression"]).sum(axis=1).argmin())
    chosen = np.linspace(3, len(truth["rotation"]) - 4, count).astype(int)
    pictures = {frame.index: frame.picture for frame in open_frames(sample(clip)).iterate()}
    (x, y), (across, down) = truth["focal_px"], truth["principal_point_px"]
    matrix = [[float(x), 0.0, float(across)], [0.0, float(y), float(down)], [0.0, 0.0, 1.0]]
    head, detector = load_default_head(), NetworkDetector()
    camera = {"matrix": matrix, "distortion": truth["distortion"].tolist()}
    config = preset("deep").changed(camera=camera, identity={"calibrate": False}, deep={"network": network})
    config = config.changed(**look)
    fitter = DeepFitter(head, plan_of(config))

    def observed(index: int) -> FrameObservation | None:
        picture = pictures[index]
        faces = detector.detect_faces(picture)
        if not faces:
            print(f"{clip} {index}: no face is found", file=sys.stderr)
            return None
        points = photo_landmarks(energy_network(network), picture, detector.align(picture, faces[0].box))
        return FrameObservation(index, points, points.image_size, picture=picture)

    calm = observed(neutral)
    appearance = None if calm is None else fitter.appearance([calm], truth["identity"])
    errors = []
    for observation in filter(None, map(observed, chosen.tolist())):
        context = FrameContext(0, truth["identity"], None, None, appearance)
        found = fitter.solve(fitter.problem(observation, context)).parameters
        errors.append(rotation_error_deg(found.rotation, truth["rotation"][observation.index]))
        print(clip, network, observation.index, f"{errors[-1]:.2f}", file=sys.stderr)
    return float(np.mean(errors))


if __name__ == "__main__":
    main()
