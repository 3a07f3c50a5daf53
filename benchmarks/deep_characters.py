"""Deep Energies on pictures of characters whose pose is known: textured renders with hair against plain ones.

The photos are drawn by another renderer (VTK), with the characters' eyes, teeth, lashes, hair, shirt and shine, in
studio light. A solve is given the person's own shape; its colours are the model's own, estimated from the photo, or the
character's.
"""

import argparse
import sys

import jax.numpy as jnp
import numpy as np
from deep_scenes import rotation_error_deg
from result import print_result

from workbench.config import preset
from workbench.face import load_character, load_default_head, posed_vertices
from workbench.geometry import axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.network_detector import NetworkDetector
from workbench.pictures import HeadRenderer
from workbench.planning import plan_of
from workbench.tracking import FrameContext, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_target import energy_network, photo_landmarks

SIZE, FOV_DEG = (640, 480), 40.0
PEOPLE = ("mei", "nora", "amara", "bruno", "leila", "thabo")
LARGEST_DEG = (25.0, 12.0, 8.0)
"""Of yaw, pitch and roll."""
KINDS = ("model", "estimate", "character")


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("people", nargs="*", default=PEOPLE, help="names of characters")
    parser.add_argument("--frames", type=int, default=2, help="of each")
    parser.add_argument("--network", choices=("ensemble", "heat-maps", "landmarks"), default="ensemble")
    options = parser.parse_args()
    head, camera, detector = load_default_head(), camera_from_fov(SIZE, FOV_DEG), NetworkDetector()
    errors: dict[str, list[tuple[float, float]]] = {kind: [] for kind in KINDS}
    for name in options.people:
        dressed, random = load_character(name, gaze=False), np.random.default_rng(sum(map(ord, name)))
        fitters = {kind: DeepFitter(head, plan_of(_config(kind, name, options.network))) for kind in KINDS}
        with HeadRenderer(dressed.person, SIZE, dressed=dressed) as renderer:
            for _ in range(options.frames):
                rotation = axis_angle_from_yaw_pitch_roll(random.uniform(-1.0, 1.0, 3) * LARGEST_DEG)
                place = np.array([random.uniform(-30.0, 30.0), 20.0, random.uniform(520.0, 680.0)])
                expression = np.zeros(len(head.expression_names))
                expression[random.integers(len(expression), size=3)] = random.uniform(0.0, 0.4, 3)
                vertices = posed_vertices(dressed.person, expression, np.zeros(6))
                photo = renderer.render(vertices, camera, rotation, place, (120, 125, 130))
                faces = detector.detect_faces(photo)
                if not faces:
                    print(f"{name}: no face is found", file=sys.stderr)
                    continue
                seen = photo_landmarks(energy_network(options.network), photo, detector.align(photo, faces[0].box))
                observation = FrameObservation(0, seen, SIZE, picture=photo)
                identity = np.asarray(dressed.character.identity, float)
                for kind, fitter in fitters.items():
                    appearance = fitter.appearance([observation], identity)
                    context = FrameContext(0, identity, None, None, appearance)
                    found = fitter.solve(fitter.problem(observation, context)).parameters
                    apart_mm = float(jnp.linalg.norm(found.translation - place))
                    errors[kind].append((rotation_error_deg(found.rotation, rotation), apart_mm))
                    print(name, kind, *(f"{value:.2f}" for value in errors[kind][-1]), file=sys.stderr)
    means = {kind: np.mean(rows, axis=0) for kind, rows in errors.items()}
    print_result(
        "deep_energies_characters",
        value=float(means["character"][0] / means["estimate"][0]),
        unit="× the rotation error",
        goal="<= 0.8",
        against="one colour per vertex, estimated from the same photo, and no hair",
        details={
            "frames": len(errors["character"]),
            **{f"{kind}_rotation_deg": float(mean[0]) for kind, mean in means.items()},
            **{f"{kind}_translation_mm": float(mean[1]) for kind, mean in means.items()},
        },
    )


def _config(kind: str, name: str, network: str):
    deep = {"appearance": kind, "network": network}
    return preset("deep").changed(deep=deep, camera={"fov_deg": FOV_DEG}, head={"character": name})


if __name__ == "__main__":
    main()
