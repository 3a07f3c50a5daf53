"""Random scenes for training: a person, an expression, a pose, a camera, lights, hair and glasses."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.face.characters import Character
from workbench.face.dense_landmarks import pupil_vertices
from workbench.face.dressed_head import DressedHead, WornPart
from workbench.face.landmark_model import contour_blend
from workbench.face.model import Embedding, FaceModel
from workbench.face.usual_expressions import ONE_SIDED, other_side
from workbench.geometry import Camera
from workbench.geometry.rotations import axis_angle_from_yaw_pitch_roll
from workbench.landmarks.alignment import frame_from_points
from workbench.pictures.extras import Extras
from workbench.pictures.head_scene import HeadScene
from workbench.pictures.lighting import Light, Lighting
from workbench.pictures.mesh import to_camera, to_pixels
from workbench.training.accessories import glasses, hair
from workbench.training.brows import USUAL, brow_landmarks, random_brow_place
from workbench.training.shading import Shader, random_sky
from workbench.training.skin import SIDE as SKIN_SIDE
from workbench.training.skin import SkinPainter, places_of
from workbench.training.wardrobe import open_wardrobe

SIDE = 320
"""Pixels of a rendered picture."""
BOX_SIDES = 2.2
"""Face boxes (see `landmarks.alignment`) across a rendered picture."""
BOX_MM = 165.0
"""Side of a face box on an average head."""
PAINTED = 0.2
"""Share of people whose skin, eyes and teeth are painted, not photographed."""
MOST_YAW_DEG = 90.0
LIGHTS = 3
"""Lights of every picture, some of them off: VTK compiles its shaders for a number of lights."""
PAIRS = 0.75
"""Probability that both sides of a paired blendshape act alike."""

_BLANK = np.full((8, 8, 3), 255, np.uint8)


@dataclass(frozen=True)
class View:
    """What pictures show of a face."""

    size: tuple[int, int]
    """Width and height, pixels."""
    box_px: float
    """Side of the face box (see `landmarks.alignment`)."""
    middle: tuple[float, float] = (0.0, 0.0)
    """Of the picture, in the face frame."""
    most_yaw_deg: float = MOST_YAW_DEG


FACE_VIEW = View((SIDE, SIDE), SIDE / BOX_SIDES)
EYES_VIEW = View((320, 208), 390.0, (0.0, -0.18), 60.0)
"""Both eyes and what is around them, each about 60 pixels wide."""


@dataclass(frozen=True, eq=False)
class Posing:
    """A given pose and expression, where a random one is not wanted."""

    yaw_pitch_roll_deg: Float[np.ndarray, "3"]
    expression: Float[np.ndarray, "k"]


@dataclass(frozen=True, eq=False)
class RenderedFace:
    """One head on nothing."""

    rgba: UInt8[np.ndarray, "h w 4"]
    """Colours multiplied by the coverage, and the coverage."""
    points: Float[np.ndarray, "70 2"]
    """The 68 landmarks, then the pupils: the person's right one and the left one."""
    vertices: Float[np.ndarray, "v 2"]
    """The head's vertices: whoever wants other points of the surface has them here."""
    yaw_pitch_roll_deg: Float[np.ndarray, "3"]
    expression: Float[np.ndarray, "k"]
    focal_px: float
    glasses: bool


@dataclass(frozen=True, eq=False)
class Person:
    """Somebody who has pictures taken."""

    model: FaceModel
    albedo: UInt8[np.ndarray, "a a 3"]
    hair_color: Float[np.ndarray, "3"]
    worn: tuple[WornPart, ...] | None = None
    """What a dressed head wears; None: a plain head, whose eyes and teeth are painted."""
    brows: Embedding | None = None
    """Their landmarks on the skin, if not the head's."""
    painted_brows: bool = True
    """Worn ones alone have their landmarks in their own hair."""


class Studio:
    """Where random people are rendered; owns a GL context, so it is made and used in one thread."""

    def __init__(self, model: FaceModel, painter: SkinPainter, side: int) -> None:
        """`side`: pixels of a rendered picture."""
        self.model, self.painter = model, painter
        self.scene = HeadScene(model, (side, side), _BLANK, supersampling=1.6, fade_neck=False)

    def cast(self, rng: np.random.Generator) -> Person:
        """A random person."""
        identity = rng.normal(0, rng.uniform(0.4, 1.1), len(self.model.identity_deltas))
        albedo, hair_color = self.painter.paint(rng)
        return Person(self.model.personal(identity), albedo, hair_color)

    def close(self) -> None:
        """Give the GL context back."""
        self.scene.close()


class FaceStudio:
    """Renders random heads: most in the art of the default head, some with painted skin, eyes and teeth."""

    def __init__(
        self,
        model: FaceModel,
        painter: SkinPainter,
        view: View = FACE_VIEW,
        mien: Callable[[tuple[str, ...], np.random.Generator], Float[np.ndarray, "k"]] | None = None,
    ) -> None:
        """`model` with the eyes' units; `mien` draws the weights of an expression (`random_expression` by default)."""
        self.view, self.mien = view, mien or random_expression
        self.model, self.painter, self.wardrobe = model, painter, open_wardrobe(model, SKIN_SIDE)
        self.shader = Shader(model)
        self.pupils = pupil_vertices(model)
        nobody = Character("nobody", "", "", "", "", "", "", np.zeros(len(model.identity_deltas)))
        # All that a dressed head is asked for here: which triangles show, and how parts follow.
        self.nobody = DressedHead(nobody, model, _BLANK, (), self.wardrobe.store.scale_vertices)
        self.plain = HeadScene(model, view.size, _BLANK, supersampling=1.2, fade_neck=False)
        self.dressed = HeadScene(model, view.size, _BLANK, supersampling=1.2, fade_neck=False, dressed=self.nobody)
        self.wearing: tuple[WornPart, ...] = ()

    def cast(self, rng: np.random.Generator) -> Person:
        """A random person."""
        identity = rng.normal(0, rng.uniform(0.4, 1.35), len(self.model.identity_deltas))
        person = self.model.personal(np.clip(identity, -3.5, 3.5))
        place = random_brow_place(rng)
        brows = brow_landmarks(self.model, place)
        places = places_of(brows, self.model)
        if rng.random() < PAINTED:
            albedo, hair_color = self.painter.paint(rng, places)
            return Person(person, albedo, hair_color, brows=brows)
        albedo, hair_color, painted = self.painter.over_photo(self.wardrobe.skin(rng), rng, places)
        worn = self.wardrobe.dress(rng, hair_color, place)
        if not painted and all(part.part.kind != "brows" for part in worn):
            brows = brow_landmarks(self.model, USUAL)
        return Person(person, albedo, hair_color, worn, brows, painted)

    def shoot(self, who: Person, rng: np.random.Generator, posing: Posing | None = None) -> RenderedFace:
        """A random picture of this person.

        With a `posing`, one of it: the same seed then gives the same camera, lights and glasses.
        """
        person, view = who.model, self.view
        expression, angles = self.mien(person.expression_names, rng), random_pose_deg(rng, view.most_yaw_deg)
        if posing is not None:
            expression, angles = posing.expression, posing.yaw_pitch_roll_deg
        vertices = person.vertices(expression)
        rotation = axis_angle_from_yaw_pitch_roll(angles)
        worn_head = [] if who.worn is None else self._worn(who.worn, person.neutral, vertices)
        framed = landmarks_head(person, vertices, angles[0])
        points_head = self._points(who, framed, vertices, worn_head)
        distance = np.exp(rng.uniform(np.log(300), np.log(2500)))
        focal = view.box_px * distance / BOX_MM
        centre = (np.array(view.size) - 1) / 2
        camera = Camera(np.array([focal, focal]), centre, random_lens(rng, view.box_px * BOX_SIDES / focal))
        translation = np.array([0.0, 0.0, distance])
        for _ in range(2):  # centre the face, and give it its size
            frame = frame_from_points(to_pixels(camera, to_camera(points_head[:68], rotation, translation)))
            translation[2] *= frame.side / view.box_px
            offset = (frame.to_image(np.array([view.middle]))[0] - centre) * translation[2] / focal
            translation[:2] -= offset
        points_camera = to_camera(vertices, rotation, translation)
        meshes, lenses, worn = [], [], []
        if who.worn is None:
            scene = self.plain
        else:
            scene = self.dressed
            worn = [to_camera(part, rotation, translation) for part in worn_head]
            if self.wearing is not who.worn:
                scene.wear(who.worn)
                self.wearing = who.worn
        scene.set_texture(who.albedo)
        scene.set_shine(rng.uniform(0.0, 0.35), rng.uniform(6, 40))
        bare = who.worn is None or all(part.part.kind != "hair" for part in who.worn)
        if rng.random() < (0.75 if who.worn is None else 0.35 if bare else 0.0):
            meshes.append(hair(person.neutral, self.model, who.hair_color, rng))
        if rng.random() < 0.22:
            frame_mesh, lenses = glasses(framed, rng)
            meshes.append(frame_mesh)
        lighting = random_lighting(rng, LIGHTS)
        above = [points for points, part in zip(worn, who.worn or (), strict=True) if part.part.kind == "hair"]
        above += [to_camera(mesh.vertices, rotation, translation) for mesh in meshes]
        light = self.shader.light(points_camera, lighting, random_sky(rng), above)
        extras = Extras(light=light, meshes=tuple(meshes))
        rgba = scene.render(points_camera, camera, lighting, extras, (rotation, translation), worn)
        if lenses:
            rgba = _tinted(rgba, [to_pixels(camera, to_camera(lens, rotation, translation)) for lens in lenses], rng)
        points = to_pixels(camera, to_camera(points_head, rotation, translation))
        pixels = to_pixels(camera, points_camera)
        return RenderedFace(np.ascontiguousarray(rgba), points, pixels, angles, expression, focal, bool(lenses))

    def _worn(self, worn, rest, vertices) -> tuple[Float[np.ndarray, "_ 3"], ...]:
        return replace(self.nobody, worn=worn).parts_on(rest, vertices)

    def _points(self, who: Person, landmarks, vertices, worn_head) -> Float[np.ndarray, "70 3"]:
        """Landmarks and pupils in the head frame: those of the brows where hair is seen."""
        points = landmarks.copy()
        if who.brows is not None:
            points[17:27] = who.brows.of(vertices)
        for part, own in zip(who.worn or (), worn_head, strict=True):
            if part.part.kind == "brows" and not who.painted_brows:
                points[17:27] = self.wardrobe.brow_line(part.part.style).of(own)
        return np.concatenate([points, vertices[self.pupils].mean(axis=1)])

    def close(self) -> None:
        """Give the GL contexts back."""
        self.plain.close()
        self.dressed.close()


def random_lens(rng: np.random.Generator, width: float) -> Float[np.ndarray, "5"]:
    """Distortion (k1, k2, p1, p2, k3) of a lens whose picture is `width` focal lengths wide: most often none."""
    edge = rng.normal(0, 0.05) if rng.random() < 0.3 else 0.0  # by how much a corner moves, of its distance
    return np.array([np.clip(edge, -0.1, 0.1) / (0.5 * width**2), 0.0, 0.0, 0.0, 0.0])


def landmarks_head(person: FaceModel, vertices: Float[np.ndarray, "v 3"], yaw_deg: float) -> Float[np.ndarray, "68 3"]:
    """The 68 points of these head-frame vertices, the jaw's contour where a camera sees it at this yaw."""
    yaws = np.radians(np.concatenate([[0.0], person.contour_yaw_deg]))
    blend = np.asarray(contour_blend(yaws, float(np.radians(yaw_deg)), 1.0))[1:]
    contour = np.tensordot(blend, person.contour.of(vertices), axes=1)
    return np.concatenate([contour, person.landmarks.of(vertices)[17:]])


def random_pose_deg(rng: np.random.Generator, most_yaw: float = 65.0) -> Float[np.ndarray, "3"]:
    """Yaw, pitch, roll in degrees: mostly near frontal, up to `most_yaw`."""
    yaw = rng.normal(0, 20) if rng.random() < 0.55 else rng.uniform(-most_yaw, most_yaw)
    yaw = np.clip(yaw, -most_yaw, most_yaw)
    return np.array([yaw, np.clip(rng.normal(0, 12), -35, 35), np.clip(rng.normal(0, 6), -20, 20)])


MIENS: tuple[dict[str, float], ...] = (
    {"mouthSmileLeft": 0.9, "cheekSquintLeft": 0.6, "eyeSquintLeft": 0.5},
    {"mouthSmileLeft": 1.0, "cheekSquintLeft": 0.8, "eyeSquintLeft": 0.6, "jawOpen": 0.45, "mouthUpperUpLeft": 0.4},
    {"mouthSmileLeft": 0.8, "mouthLowerDownLeft": 0.6, "mouthUpperUpLeft": 0.6, "mouthStretchLeft": 0.3},
    {"jawOpen": 0.8, "eyeWideLeft": 0.8, "browInnerUp": 0.8, "browOuterUpLeft": 0.8},
    {"browDownLeft": 0.9, "noseSneerLeft": 0.4, "mouthPressLeft": 0.5, "eyeSquintLeft": 0.4},
    {"browDownLeft": 0.8, "jawOpen": 0.7, "mouthUpperUpLeft": 0.6, "mouthLowerDownLeft": 0.6, "noseSneerLeft": 0.6},
    {"browInnerUp": 0.9, "mouthFrownLeft": 0.8, "mouthShrugLower": 0.4},
    {"noseSneerLeft": 0.9, "mouthUpperUpLeft": 0.6, "browDownLeft": 0.5, "eyeSquintLeft": 0.5},
    {"mouthPucker": 0.9, "mouthFunnel": 0.3},
    {"mouthFunnel": 0.9, "jawOpen": 0.35},
    {"jawOpen": 0.3, "mouthLowerDownLeft": 0.5, "mouthStretchLeft": 0.3},
    {"mouthClose": 0.2, "jawOpen": 0.2, "mouthPressLeft": 0.5, "mouthRollLower": 0.5},
    {"jawOpen": 1.0, "eyeBlinkLeft": 0.8, "browDownLeft": 0.4},
    {"jawLeft": 0.6, "mouthLeft": 0.7},
    {"cheekPuff": 0.9, "mouthPressLeft": 0.6},
)
"""Smile, laugh, grin, surprise, anger, a shout, sadness, disgust, lips of o and u, speech, closed lips, a yawn, and
mouths to one side; with weights of the left sides."""


def random_expression(names: tuple[str, ...], rng: np.random.Generator) -> Float[np.ndarray, "k"]:
    """Weights of a random expression: some blendshapes, often in pairs; now and then eyes or jaw all the way."""
    weights = dict.fromkeys(names, 0.0)

    def act(name: str, weight: float) -> None:
        paired = rng.random() < PAIRS and name not in ONE_SIDED
        for side in (name, other_side(name)) if paired else (name,):
            if side in weights:
                weights[side] = max(weights[side], float(np.clip(weight * rng.uniform(0.8, 1.2), 0, 1)))

    kind = rng.random()
    if kind < 0.3:  # what faces do together, more or less of it
        together, amount = MIENS[rng.integers(len(MIENS))], rng.uniform(0.3, 1.0)
        for name, weight in together.items():
            act(name, amount * weight)
    elif kind < 0.88:
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
    for name in ONE_SIDED:
        if name in weights and weights[name] <= weights.get(other_side(name), 0.0):
            weights[name] = 0.0
    if rng.random() < 0.6:  # both eyes look the same way
        across, upright = rng.uniform(-1, 1), rng.uniform(-1, 1)
        for side, inward in (("Left", -1), ("Right", 1)):
            weights[f"eyeLook{'In' if across * inward > 0 else 'Out'}{side}"] = abs(across)
            weights[f"eyeLook{'Up' if upright > 0 else 'Down'}{side}"] = abs(upright)
    return np.array([weights[name] for name in names])


def looking_around(names: tuple[str, ...], rng: np.random.Generator) -> Float[np.ndarray, "k"]:
    """Weights of a random expression with eyes that look anywhere: together mostly, crossed or apart sometimes."""
    weights = dict(zip(names, random_expression(names, rng).tolist(), strict=True))
    both = rng.uniform(-1, 1, 2) if rng.random() < 0.75 else np.clip(rng.normal(0, 0.25, 2), -1, 1)
    apart = rng.normal(0, 0.06, 2) if rng.random() < 0.8 else np.array([rng.uniform(-0.7, 0.7), rng.normal(0, 0.15)])
    for side, half in (("Left", 0.5), ("Right", -0.5)):
        weights |= gaze_weights(side, *np.clip(both + half * apart, -1, 1).tolist())
    return np.array([weights[name] for name in names])


def gaze_weights(side: str, across: float, upward: float) -> dict[str, float]:
    """The four units of an eye that looks `across` (1: all the way to the subject's left) and `upward`."""
    outward = across if side == "Left" else -across
    amounts = {"Out": outward, "In": -outward, "Up": upward, "Down": -upward}
    return {f"eyeLook{way}{side}": max(amount, 0.0) for way, amount in amounts.items()}


def random_lighting(rng: np.random.Generator, count: int | None = None) -> Lighting:
    """One to four distant lights of any colour temperature, from soft to harsh; with a `count`, some of them off."""
    lights = []
    for order in range(rng.integers(1, 5) if count is None else count):
        direction = rng.normal(0, 1, 3) * [1.0, 0.7, 0.7] + [0, -0.3, -0.7]
        warmth = rng.normal(0, 0.12)
        intensity = rng.uniform(0.3, 1.0) if order == 0 else rng.uniform(0, 0.45)
        color = tuple(np.clip([1 + warmth, 1.0, 1 - warmth], 0, 1.3).tolist())
        if count is not None and order == 0:
            intensity *= 1.4
        if count is not None and order > 0 and rng.random() < 0.4:
            intensity = 0.0
        lights.append(Light(tuple(direction.tolist()), float(intensity), color))
    if count is not None and rng.random() < 0.3:  # an overcast sky, a room without a lamp
        dim = rng.uniform(0.0, 0.4)
        lights = [replace(light, intensity=dim * light.intensity) for light in lights]
        return Lighting(tuple(lights), float(rng.uniform(0.5, 1.0)))
    return Lighting(tuple(lights), float(rng.uniform(0.05, 0.6) if count is None else rng.uniform(0.1, 0.7)))


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
