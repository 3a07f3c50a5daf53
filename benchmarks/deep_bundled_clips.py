"""Deep Energies on frames of the bundled clips, whose truth is known: rotation by our networks and their mean.

A solve is given the clip's lens and the person's own shape, or one that is calibrated on the same frames; its colours
come from the clip's most neutral frame.
"""

import argparse
import sys

import numpy as np
from deep_scenes import rotation_error_deg
from result import print_result

from workbench.config import Config, preset
from workbench.face import load_default_head
from workbench.frames import open_frames
from workbench.geometry import Camera
from workbench.geometry.triangulation import camera_matrix
from workbench.landmarks.network_detector import NetworkDetector
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.tracking import FrameContext, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_target import energy_network, photo_landmarks

CLIPS = ("performance", "laugh", "glasses")
NETWORKS = ("heat-maps", "landmarks", "ensemble")


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", default=CLIPS, help="names of bundled clips")
    parser.add_argument("--frames", type=int, default=14, help="of each, spread over the clip")
    parser.add_argument("--character", help="renders show this one, a ready one or a folder of `workbench character`")
    parser.add_argument("--calibrated", action="store_true", help="calibrate the shape instead of giving it")
    options = parser.parse_args()
    worn = options.character
    look = {"deep": {"appearance": "character"}, "head": {"character": worn}} if worn else {}
    means = {}
    for name in options.clips:
        clip = _Clip(name, options.frames)
        means[name] = {network: clip.mean_error_deg(network, look, options.calibrated) for network in NETWORKS}
    of = {name: float(np.mean([mean[name] for mean in means.values()])) for name in NETWORKS}
    print_result(
        "deep_bundled_clips",
        value=of["ensemble"] / min(of["heat-maps"], of["landmarks"]),
        unit="× the rotation error",
        goal="<= 1.0",
        against="the better of the networks that the ensemble is made of",
        details={f"{clip}_{name}_deg": mean[name] for clip, mean in means.items() for name in NETWORKS},
    )


class _Clip:
    """A bundled clip: its truth, and pictures and faces of its most neutral frame and of some others."""

    def __init__(self, name: str, count: int):
        self.name = name
        with np.load(sample(f"{name}-truth"), allow_pickle=False) as stored:
            self.truth = dict(stored)
        self.neutral = int(np.abs(self.truth["expression"]).sum(axis=1).argmin())
        chosen = np.linspace(3, len(self.truth["rotation"]) - 4, count).astype(int).tolist()
        detector, self.pictures, self.faces = NetworkDetector(), {}, {}
        for frame in open_frames(sample(name)).iterate():
            if frame.index not in {*chosen, self.neutral}:
                continue
            found = detector.detect_faces(frame.picture)
            if not found:
                print(f"{name} {frame.index}: no face is found", file=sys.stderr)
                continue
            self.pictures[frame.index] = frame.picture
            self.faces[frame.index] = detector.align(frame.picture, found[0].box)
        self.chosen = [number for number in chosen if number in self.faces]

    def mean_error_deg(self, network: str, look: dict[str, dict[str, str]], calibrated: bool) -> float:
        """Mean error of the rotation over the chosen frames."""
        config = self._config(network).changed(identity={"calibrate": calibrated}, **look)
        fitter, identity = DeepFitter(load_default_head(), plan_of(config)), self.truth["identity"]
        seen = {number: self._observation(number, network) for number in self.faces}
        if calibrated:
            identity = fitter.calibrate(list(seen.values()), len(seen)).identity
        appearance = fitter.appearance([seen[self.neutral]] if self.neutral in seen else [], identity)
        context, errors = FrameContext(0, identity, None, None, appearance), []
        for number in self.chosen:
            found = fitter.solve(fitter.problem(seen[number], context)).parameters
            errors.append(rotation_error_deg(found.rotation, self.truth["rotation"][number]))
            print(self.name, network, number, f"{errors[-1]:.2f}", file=sys.stderr)
        return float(np.mean(errors))

    def _config(self, network: str) -> Config:
        lens = Camera(*(self.truth[part] for part in Camera._fields))
        camera = {"matrix": camera_matrix(lens).tolist(), "distortion": lens.distortion.tolist()}
        return preset("deep").changed(camera=camera, deep={"network": network})

    def _observation(self, number: int, network: str) -> FrameObservation:
        picture = self.pictures[number]
        points = photo_landmarks(energy_network(network), picture, self.faces[number])
        return FrameObservation(number, points, points.image_size, picture=picture)


if __name__ == "__main__":
    main()
