"""Random scenes for training: a person, an expression, a pose, a camera, lights, hair and glasses."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.face.landmark_model import contour_blend
from workbench.face.model import FaceModel
from workbench.geometry import Camera
from workbench.geometry.rotations import axis_angle_from_yaw_pitch_roll
from workbench.landmarks.alignment import frame_from_points
from workbench.pictures.extras import Extras
from workbench.pictures.head_scene import HeadScene
from workbench.pictures.lighting import Light, Lighting
from workbench.pictures.mesh import to_camera, to_pixels
from workbench.training.accessories import glasses, hair
from workbench.training.skin import SkinPainter

SIDE = 320
"""Pixels of a rendered picture."""
BOX_SIDES = 2.2
"""Face boxes (see `landmarks.alignment`) across a rendered picture."""
BOX_MM = 165.0
"""Side of a face box on an average head."""
PAIRS = 0.75
"""Probability that both sides of a paired blendshape act alike."""


@dataclass(frozen=True, eq=False)
class RenderedFace:
    """One head on nothing."""

    rgba: UInt8[np.ndarray, "s s 4"]
    """Colours multiplied by the coverage, and the coverage."""
    landmarks: Float[np.ndarray, "68 2"]
    yaw_pitch_roll_deg: Float[np.ndarray, "3"]
    expression: Float[np.ndarray, "k"]


@dataclass(frozen=True, eq=False)
class Person:
    """Somebody who has pictures taken."""

    model: FaceModel
    albedo: UInt8[np.ndarray, "a a 3"]
    hair_color: Float[np.ndarray, "3"]


class Studio:
    """Where random people are rendered; owns a GL context, so it is made and used in one thread."""

    def __init__(self, model: FaceModel, painter: SkinPainter, side: int) -> None:
        """`side`: pixels of a rendered picture."""
        self.model, self.painter = model, painter
        blank = np.full((8, 8, 3), 255, np.uint8)
        self.scene = HeadScene(model, (side, side), blank, supersampling=1.6, fade_neck=False)

    def cast(self, rng: np.random.Generator) -> Person:
        """A random person."""
        identity = rng.normal(0, rng.uniform(0.4, 1.1), len(self.model.identity_deltas))
        albedo, hair_color = self.painter.paint(rng)
        return Person(self.model.personal(identity), albedo, hair_color)

    def close(self) -> None:
        """Give the GL context back."""
        self.scene.close()


class FaceStudio(Studio):
    """Renders random heads."""

    def __init__(self, model: FaceModel, painter: SkinPainter) -> None:
        super().__init__(model, painter, SIDE)

    def shoot(self, who: Person, rng: np.random.Generator) -> RenderedFace:
        """A random picture of this person."""
        person = who.model
        expression = random_expression(person.expression_names, rng)
        vertices = person.vertices(expression)
        angles = random_pose_deg(rng)
        rotation = axis_angle_from_yaw_pitch_roll(angles)
        points_head = landmarks_head(person, vertices, angles[0])
        distance = np.exp(rng.uniform(np.log(300), np.log(2500)))
        focal = SIDE / BOX_SIDES * distance / BOX_MM
        camera = Camera(np.array([focal, focal]), np.full(2, (SIDE - 1) / 2), np.zeros(5))
        translation = np.array([0.0, 0.0, distance])
        for _ in range(2):  # centre the face, and give it its size
            frame = frame_from_points(to_pixels(camera, to_camera(points_head, rotation, translation)))
            translation[2] *= frame.side / (SIDE / BOX_SIDES)
            offset = (frame.origin - (SIDE - 1) / 2) * translation[2] / focal
            translation[:2] -= offset
        self.scene.set_texture(who.albedo)
        self.scene.set_shine(rng.uniform(0.0, 0.35), rng.uniform(6, 40))
        meshes, lenses = [], []
        if rng.random() < 0.75:
            meshes.append(hair(person.neutral, self.model, who.hair_color, rng))
        if rng.random() < 0.22:
            frame_mesh, lenses = glasses(points_head, rng)
            meshes.append(frame_mesh)
        rgba = self.scene.render(
            to_camera(vertices, rotation, translation), camera, random_lighting(rng), Extras(meshes=tuple(meshes)),
            (rotation, translation),
        )  # fmt: skip
        if lenses:
            rgba = _tinted(rgba, [to_pixels(camera, to_camera(lens, rotation, translation)) for lens in lenses], rng)
        points = to_pixels(camera, to_camera(points_head, rotation, translation))
        return RenderedFace(np.ascontiguousarray(rgba), points, angles, expression)


def landmarks_head(person: FaceModel, vertices: Float[np.ndarray, "v 3"], yaw_deg: float) -> Float[np.ndarray, "68 3"]:
    """The 68 points of these head-frame vertices, the jaw's contour where a camera sees it at this yaw."""
    yaws = np.radians(np.concatenate([[0.0], person.contour_yaw_deg]))
    blend = np.asarray(contour_blend(yaws, float(np.radians(yaw_deg)), 1.0))[1:]
    contour = np.tensordot(blend, np.stack([
        np.einsum("lkc,lk->lc", vertices[v], b)
        for v, b in zip(person.contour.vertices, person.contour.barycentric, strict=True)
    ]), axes=1)  # fmt: skip
    inner = np.einsum("lkc,lk->lc", vertices[person.landmarks.vertices[17:]], person.landmarks.barycentric[17:])
    return np.concatenate([contour, inner])


def random_pose_deg(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """Yaw, pitch, roll in degrees: mostly near frontal, up to 65° of yaw."""
    yaw = rng.normal(0, 20) if rng.random() < 0.55 else rng.uniform(-65, 65)
    return np.array([np.clip(yaw, -65, 65), np.clip(rng.normal(0, 12), -35, 35), np.clip(rng.normal(0, 6), -20, 20)])


def random_expression(names: tuple[str, ...], rng: np.random.Generator) -> Float[np.ndarray, "k"]:
    """Weights of a random expression: some blendshapes, often in pairs; now and then eyes or jaw all the way."""
    weights = dict.fromkeys(names, 0.0)

    def act(name: str, weight: float) -> None:
        for side in (name, _other_side(name)) if rng.random() < PAIRS else (name,):
            if side in weights:
                weights[side] = max(weights[side], float(np.clip(weight * rng.uniform(0.8, 1.2), 0, 1)))

    if rng.random() < 0.85:
        movable = [name for name in names if not name.startswith(("eyeLook", "tongue", "eyeBlink", "jawOpen"))]
        for name in rng.choice(movable, size=min(1 + rng.poisson(2.5), len(movable)), replace=False):
            act(str(name), rng.beta(1.2, 1.6))
    if rng.random() < 0.4:
        weights["jawOpen"] = float(rng.beta(1.1, 1.8) if rng.random() < 0.7 else rng.uniform(0.5, 1.0))
    elif rng.random() < 0.3:
        act("mouthSmileLeft", rng.uniform(0.3, 1.0))
    kind = rng.random()
    if kind < 0.16:
        act("eyeBlinkLeft", rng.uniform(0.85, 1.0))
    elif kind < 0.42:
        act("eyeBlinkLeft" if rng.random() < 0.5 else "eyeBlinkRight", rng.uniform(0.0, 1.0))
    if rng.random() < 0.6:  # both eyes look the same way
        across, upright = rng.uniform(-1, 1), rng.uniform(-1, 1)
        for side, inward in (("Left", -1), ("Right", 1)):
            weights[f"eyeLook{'In' if across * inward > 0 else 'Out'}{side}"] = abs(across)
            weights[f"eyeLook{'Up' if upright > 0 else 'Down'}{side}"] = abs(upright)
    return np.array([weights[name] for name in names])


def random_lighting(rng: np.random.Generator) -> Lighting:
    """One to four distant lights of any colour temperature, from soft to harsh."""
    lights = []
    for order in range(rng.integers(1, 5)):
        direction = rng.normal(0, 1, 3) * [1.0, 0.7, 0.7] + [0, -0.3, -0.7]
        warmth = rng.normal(0, 0.12)
        intensity = rng.uniform(0.3, 1.0) if order == 0 else rng.uniform(0, 0.45)
        color = tuple(np.clip([1 + warmth, 1.0, 1 - warmth], 0, 1.3).tolist())
        lights.append(Light(tuple(direction.tolist()), float(intensity), color))
    return Lighting(tuple(lights), float(rng.uniform(0.05, 0.6)))


def _other_side(name: str) -> str:
    return name.replace("Left", "Right") if "Left" in name else name.replace("Right", "Left")


def _tinted(rgba, lenses, rng):
    """Glass over the eyes: clear, tinted or dark, sometimes with a reflection."""
    glass = np.zeros(rgba.shape[:2], np.uint8)
    for lens in lenses:
        cv2.fillPoly(glass, [np.rint(lens * 16).astype(np.int32)], 255, cv2.LINE_AA, 4)
    share = glass[..., None] / 255.0 * (rng.uniform(0.6, 0.97) if rng.random() < 0.25 else rng.uniform(0, 0.25))
    picture = rgba[..., :3].astype(float)
    cover = rgba[..., 3:] / 255.0
    tint = rng.uniform(0, 70, 3)
    picture = picture * (1 - share) + share * tint * cover
    if rng.random() < 0.4:
        height, width = glass.shape
        x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
        angle = rng.uniform(0, np.pi)
        band = np.exp(
            -(((x * np.cos(angle) + y * np.sin(angle) - rng.uniform(-0.4, 0.4)) / rng.uniform(0.03, 0.2)) ** 2)
        )
        picture += (band * glass / 255.0 * rng.uniform(20, 160))[..., None] * cover
    return np.concatenate([np.clip(picture, 0, 255).astype(np.uint8), rgba[..., 3:]], axis=-1)
