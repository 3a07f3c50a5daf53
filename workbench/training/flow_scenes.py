"""Pairs of pictures of one head that moved, with the exact flow both ways: what the flow network learns from."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float16, UInt8

from workbench.face.model import FaceModel
from workbench.flow.geometric import GeometricFlow, flow_of_seen, seen_surface
from workbench.geometry import Camera
from workbench.geometry.rotations import axis_angle_from_yaw_pitch_roll
from workbench.landmarks.alignment import frame_from_points
from workbench.pictures.extras import ColoredMesh, Extras
from workbench.pictures.lighting import Light, Lighting
from workbench.pictures.mesh import to_camera, to_pixels
from workbench.training.accessories import glasses, hair
from workbench.training.scenes import (
    BOX_MM,
    Person,
    Studio,
    landmarks_head,
    random_expression,
    random_lighting,
    random_pose_deg,
)
from workbench.training.skin import SkinPainter

SIDE = 256
"""Pixels of a rendered picture."""
BOX_SIDES = 1.8
"""Face boxes across a rendered picture."""
SEEN, VISIBLE, FACE = 1, 2, 4
"""Bits of a pair's marks: the mesh is here, the other picture shows the same point, and it is the face."""
LEAST_TURN_DEG, MOST_TURN_DEG = 0.2, 9.0
LEAST_SHIFT, MOST_SHIFT = 0.003, 0.16
"""Of the face's box, from one picture to the other."""
MESH_COLORED = 0.15
"""Share of pairs without a texture, smooth as the workbench's own renders."""
RELIT = 0.35
"""Share of pairs whose light changes in between."""


@dataclass(frozen=True, eq=False)
class RenderedPair:
    """One head on nothing, twice."""

    rgba: UInt8[np.ndarray, "2 s s 4"]
    """Colours multiplied by the coverage, and the coverage."""
    flow: Float16[np.ndarray, "2 s s 2"]
    """From the first picture to the second, and from the second to the first; pixels, zero beside the mesh."""
    marks: UInt8[np.ndarray, "2 s s"]
    """Sums of `SEEN`, `VISIBLE`, `FACE`."""


class PairStudio(Studio):
    """Renders pairs."""

    def __init__(self, model: FaceModel, painter: SkinPainter) -> None:
        super().__init__(model, painter, SIDE)
        self.is_face = face_triangles(model)

    def shoot(self, who: Person, rng: np.random.Generator) -> RenderedPair:
        """A random pair of this person."""
        person = who.model
        expressions = random_expressions(person.expression_names, rng)
        vertices = [person.vertices(expression) for expression in expressions]
        angles = random_pose_deg(rng)
        turn = rng.normal(0, 1, 3) * [1.0, 0.8, 0.6] * _log_uniform(rng, LEAST_TURN_DEG, MOST_TURN_DEG)
        rotations = [axis_angle_from_yaw_pitch_roll(angles + share * turn) for share in (-0.5, 0.5)]
        camera, centre = _framing(landmarks_head(person, vertices[0], angles[0]), rotations[0], rng)
        shift = rng.normal(0, 1, 3) * [1.0, 1.0, 0.8] * _log_uniform(rng, LEAST_SHIFT, MOST_SHIFT) * BOX_MM
        translations = [centre + share * shift for share in (-0.5, 0.5)]
        meshes = []
        if rng.random() < 0.75:
            meshes.append(hair(person.neutral, self.model, who.hair_color, rng))
        if rng.random() < 0.2:
            meshes.append(glasses(landmarks_head(person, vertices[0], angles[0]), rng)[0])
        colors = self.model.colors if rng.random() < MESH_COLORED else None
        self.scene.set_texture(who.albedo)
        self.scene.set_shine(rng.uniform(0.0, 0.35), rng.uniform(6, 40))
        lighting = random_lighting(rng)
        lightings = [lighting, changed_lighting(lighting, rng) if rng.random() < RELIT else lighting]
        extras = Extras(meshes=tuple(meshes), colors=colors)
        points = [to_camera(*state) for state in zip(vertices, rotations, translations, strict=True)]
        pictures = [
            self.scene.render(points[k], camera, lightings[k], extras, (rotations[k], translations[k]))
            for k in range(2)
        ]  # fmt: skip
        moved = [
            np.concatenate([points[k], *(to_camera(mesh.vertices, rotations[k], translations[k]) for mesh in meshes)])
            for k in range(2)
        ]
        flow, marks = self._truth(moved, meshes, camera)
        return RenderedPair(np.stack(pictures), flow.astype(np.float16), marks)

    def _truth(self, moved, meshes: list[ColoredMesh], camera: Camera):
        """Flow both ways and marks of head and extras together."""
        triangles, count = [self.model.triangles.astype(np.int32)], len(self.model.neutral)
        for mesh in meshes:
            triangles.append(mesh.triangles.astype(np.int32) + count)
            count += len(mesh.vertices)
        triangles = np.concatenate(triangles)
        is_face = np.zeros(len(triangles), bool)
        is_face[: len(self.is_face)] = self.is_face
        single = Camera(*(np.asarray(part, np.float32) for part in camera))
        # Hair is an open shell that is seen from both sides.
        options = {"size": (SIDE, SIDE), "cull_backfaces": False}
        moved = [points.astype(np.float32) for points in moved]
        seen = [seen_surface(points, triangles, single, **options) for points in moved]
        flows, marks = [], []
        for here, there in ((0, 1), (1, 0)):
            found = flow_of_seen(seen[here], moved[there], triangles, single, seen[there])
            flows.append(np.asarray(found.flow))
            marks.append(_marks(found, is_face[np.maximum(np.asarray(seen[here].triangle), 0)]))
        return np.stack(flows), np.stack(marks)


def face_triangles(model: FaceModel) -> Bool[np.ndarray, "t"]:
    """The front of the head, brows to chin and cheek to cheek with eyes and lips: where a face's flow counts."""
    landmarks = model.landmarks.of(model.neutral)
    middle = model.neutral[model.triangles].mean(axis=1)
    top, bottom = landmarks[17:27, 1].min() - 12.0, landmarks[8, 1] + 3.0
    left, right = landmarks[0, 0], landmarks[16, 0]
    deepest = landmarks[[0, 16], 2].mean()
    return (
        (middle[:, 1] > top) & (middle[:, 1] < bottom)
        & (middle[:, 0] > left) & (middle[:, 0] < right) & (middle[:, 2] < deepest)
    )  # fmt: skip


def random_expressions(
    names: tuple[str, ...], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """The weights of two pictures: from a random expression some of the way to another; one in six does not change."""
    first, other = random_expression(names, rng), random_expression(names, rng)
    share = 0.0 if rng.random() < 0.17 else _log_uniform(rng, 0.03, 1.0)
    return first, first + share * (other - first)


def changed_lighting(lighting: Lighting, rng: np.random.Generator) -> Lighting:
    """The same lights a little later: turned, dimmed or brightened."""
    lights = []
    for light in lighting.lights:
        direction = np.asarray(light.direction) + rng.normal(0, 0.15, 3)
        strength = light.intensity * float(np.exp(rng.normal(0, 0.15)))
        lights.append(Light(tuple(direction.tolist()), strength, light.color))
    return Lighting(tuple(lights), float(np.clip(lighting.ambient * np.exp(rng.normal(0, 0.15)), 0, 1)))


def _framing(points_head, rotation, rng) -> tuple[Camera, Float[np.ndarray, "3"]]:
    """A camera from wide to tele, and the place that puts the face in the middle at its size."""
    distance = np.exp(rng.uniform(np.log(300), np.log(2500)))
    focal = SIDE / BOX_SIDES * distance / BOX_MM
    camera = Camera(np.array([focal, focal]), np.full(2, (SIDE - 1) / 2), np.zeros(8))
    translation = np.array([0.0, 0.0, distance])
    for _ in range(2):
        frame = frame_from_points(to_pixels(camera, to_camera(points_head, rotation, translation)))
        translation[2] *= frame.side / (SIDE / BOX_SIDES)
        translation[:2] -= (frame.origin - (SIDE - 1) / 2) * translation[2] / focal
    return camera, translation


def _marks(found: GeometricFlow, face) -> UInt8[np.ndarray, "s s"]:
    seen, visible = np.asarray(found.seen), np.asarray(found.visible)
    return (SEEN * seen + VISIBLE * visible + FACE * (seen & face)).astype(np.uint8)


def _log_uniform(rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
