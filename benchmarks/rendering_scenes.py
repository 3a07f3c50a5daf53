"""Random scenes of the default head for the renderer's benchmarks, and derivatives by finite differences."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from workbench.face import FaceModel, FaceParameters, load_default_head
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_fov, project
from workbench.rendering import (
    RenderModel,
    ambient_light,
    directional_light,
    face_vertices,
    render_face,
    render_model,
)

CLASSES = ("translation", "rotation", "jaw", "expression")
FOV_DEG = 30.0


@dataclass(frozen=True)
class RenderScene:
    """A head somewhere in the picture, random in pose, person, expression, light and background."""

    parameters: FaceParameters
    light: Float[Array, "9 3"]
    background: Float[Array, "3"]
    directions: dict[str, FaceParameters]
    """One random direction for each class of parameters."""


def random_scene(head: FaceModel, seed: int) -> RenderScene:
    """Yaw within 35°, five blendshapes, an open mouth, a directional light over an ambient one."""
    random = np.random.default_rng(seed)
    angles = random.uniform([-35.0, -20.0, -15.0], [35.0, 20.0, 15.0])
    translation = np.append(random.uniform(-20.0, 20.0, 2), random.uniform(480.0, 620.0))
    count, jaw = len(head.expression_names), head.expression_names.index("jawOpen")
    active = random.choice(count, 5, replace=False)
    weights = np.zeros(count)
    weights[active] = random.uniform(0.1, 0.7, 5)
    weights[jaw] = random.uniform(0.05, 0.6)
    parameters = (
        axis_angle_from_yaw_pitch_roll(angles),
        translation,
        weights,
        random.normal(0.0, 0.7, len(head.identity_deltas)),
    )
    light = ambient_light(0.35) + directional_light(tuple(random.normal(0.0, 1.0, 3) * [1, 1, 0.3] - [0, 0, 1]), 0.7)
    background = random.uniform(0.0, 1.0, 3)
    shapes = np.zeros(count)
    shapes[active] = random.normal(0.0, 1.0, 5)
    steps = (
        {"translation": _unit(random.normal(0.0, 1.0, 3))},
        {"rotation": _unit(random.normal(0.0, 1.0, 3))},
        {"expression": np.eye(count)[jaw]},
        {"expression": _unit(shapes)},
    )
    zero = FaceParameters(*(np.zeros_like(part) for part in parameters))
    directions = {name: _single(zero._replace(**step)) for name, step in zip(CLASSES, steps, strict=True)}
    return RenderScene(
        _single(FaceParameters(*parameters)),
        jnp.asarray(light, jnp.float32),
        jnp.asarray(background, jnp.float32),
        directions,
    )


class Differentiator:
    """Derivatives of pictures of the default head, by the renderer and by finite differences."""

    def __init__(self, size_px: int, supersampling: int) -> None:
        self.head = load_default_head()
        self.model = render_model(self.head)
        self.size = (size_px, size_px)
        camera = camera_from_fov(self.size, FOV_DEG)
        self.camera = Camera(*(jnp.asarray(part, jnp.float32) for part in camera))
        grid = (np.stack(np.meshgrid(*[np.arange(supersampling)] * 2), -1).reshape(-1, 2) + 0.5) / supersampling - 0.5
        self._offsets = jnp.asarray(grid, jnp.float32)
        self._supersampled = jax.jit(self._mean_over_offsets)
        self._speeds = jax.jit(self._pixel_speeds)

    def picture(self, parameters: FaceParameters, scene: RenderScene, model: RenderModel, camera: Camera, **options):
        """The head's picture."""
        return render_face(
            model, parameters, camera, model.colors, scene.light, scene.background, size=self.size, **options
        ).color

    def derivative(self, **options) -> Callable:
        """(parameters, scene) -> derivative of the picture along a direction, compiled once."""

        def along(parameters, direction, light, background, model, camera):
            scene = RenderScene(parameters, light, background, {})
            return jax.jvp(lambda p: self.picture(p, scene, model, camera, **options), (parameters,), (direction,))[1]

        compiled = jax.jit(along)
        return lambda parameters, direction, scene: np.asarray(
            compiled(parameters, direction, scene.light, scene.background, self.model, self.camera), float
        )

    def step(self, scene: RenderScene, direction: FaceParameters, step_px: float) -> float:
        """The step along a direction that moves the 95th percentile of the moving vertices by `step_px`."""
        speeds = np.asarray(self._speeds(scene.parameters, direction))
        return step_px / float(np.percentile(speeds[speeds > 1e-6], 95))

    def central_difference(self, scene: RenderScene, direction: FaceParameters, step: float) -> np.ndarray:
        """(I(p + h) − I(p − h)) / 2h of the picture that is supersampled without any smoothing of edges."""
        above, below = (
            self._supersampled(
                moved(scene.parameters, direction, sign * step), scene.light, scene.background, self.model, self.camera
            )
            for sign in (1.0, -1.0)
        )
        return (np.asarray(above, float) - np.asarray(below, float)) / (2.0 * step)

    def _mean_over_offsets(self, parameters, light, background, model, camera):
        scene = RenderScene(parameters, light, background, {})

        def add(total, offset):
            shifted = camera._replace(principal_point_px=camera.principal_point_px - offset)
            return total + self.picture(parameters, scene, model, shifted, antialias=False), None

        start = jnp.zeros((*self.size[::-1], 3), jnp.float32)
        return jax.lax.scan(add, start, self._offsets)[0] / len(self._offsets)

    def _pixel_speeds(self, parameters, direction):
        pixels = jax.jvp(lambda p: project(self.camera, face_vertices(self.model, p)), (parameters,), (direction,))[1]
        return jnp.linalg.norm(pixels, axis=1)


def moved(parameters: FaceParameters, direction: FaceParameters, step: float) -> FaceParameters:
    """Parameters a step along a direction."""
    return jax.tree.map(lambda value, way: value + jnp.float32(step) * way, parameters, direction)


def agreement(derivative: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Cosine and relative error of an image derivative."""
    norms = np.linalg.norm(derivative) * np.linalg.norm(reference)
    error = np.linalg.norm(derivative - reference) / np.linalg.norm(reference)
    return float((derivative * reference).sum() / norms), float(error)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def _single(parameters: FaceParameters) -> FaceParameters:
    return FaceParameters(*(jnp.asarray(part, jnp.float32) for part in parameters))
