"""The views of a Deep Energies solve, one per camera: camera, landmarks with weights, and light."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.energies.deep import DeepView, crop_of
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters, load_default_head
from workbench.geometry import Camera
from workbench.landmarks.network_detector import CROP_BOXES
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import outer_eye_distance
from workbench.landmarks.surroundings import Surroundings, plain_surroundings, seen_around
from workbench.networks import DenseNetwork, EnergyNetwork
from workbench.rendering import Appearance, ambient_light, directional_light, orthographic_camera, turned_light
from workbench.rendering.camera import AnyCamera, OrthographicCamera
from workbench.runtime import COMPUTING
from workbench.tracking.deep_programs import DeepScene, project_points
from workbench.tracking.observation import FrameObservation
from workbench.tracking.plan import Plan, StagePlan

EYES_PER_BOX = 0.726
"""What counts as the default head's outer-eye distance, in sides of the face box (the eyes themselves take up 0.56 of
it). Unlike the distance in the picture, it does not shrink with yaw."""
NEAR = 0.25
"""Of the photo's crop: within this part of its side, this logarithm of it and these radians a render's own crop is near
enough to be seen in the photo's."""
FAR_MM = 1e5
"""An orthographic view is recorded as a camera at this distance, so that every consumer of a fit can draw it."""


def recorded_camera(plan: Plan, image_size: tuple[int, int]) -> Camera:
    """The camera of the reference view; for an orthographic view, an equivalent distant camera."""
    camera = plan.camera.of(image_size)
    if not plan.camera.parallel:
        return camera
    scale = _start_scale(plan, camera)
    return Camera(np.full(2, scale * FAR_MM), np.asarray(camera.principal_point_px, float), np.zeros(8))


def views_of(
    plan: Plan,
    network: EnergyNetwork,
    eyes: float,
    observation: FrameObservation,
    light: Float[np.ndarray, "9 3"],
) -> tuple[DeepView, ...]:
    """The views of a frame, with all landmarks at full weight; `light` in the reference camera's frame.

    `eyes` is the model's `eyes_per_box`.

    Raises `InputError` if the number of views with landmarks or surroundings is not that of the rig, and for pictures
    of another shape than it was calibrated with.
    """
    rig, around = plan.camera.rig, observation.surroundings or _surroundings(plan, observation)
    if rig is None:
        size = observation.image_size
        place = _Place(_solver_camera(plan, size), size, np.eye(3), np.zeros(3))
        return (_view(plan, network, eyes, place, observation.landmarks, light, around[0]),)
    seen = (observation.landmarks, *observation.others)
    if len(seen) != len(rig):
        raise InputError(
            f"The rig has {len(rig)} views ({', '.join(rig.names)}), but the frame has landmarks of {len(seen)}; "
            "`workbench track` takes one clip for each view, a session takes one camera: leave camera.rig out there."
        )
    if len(around) != len(rig):
        raise InputError(
            f"The rig has {len(rig)} views ({', '.join(rig.names)}), but the frame has surroundings of {len(around)}; "
            "give those of each view, or none."
        )
    rig = rig.resized(observation.view_sizes)
    poses = zip(rig.rotation_view_reference, rig.translation_view_reference_mm, strict=True)
    places = [_Place(view.camera, view.image_size, *pose) for view, pose in zip(rig.views, poses, strict=True)]
    return tuple(
        _view(plan, network, eyes, place, landmarks, turned_light(light, place.rotation), behind)
        for place, landmarks, behind in zip(places, seen, around, strict=True)
    )


def weighed(views: Sequence[DeepView], stage: StagePlan) -> tuple[DeepView, ...]:
    """The views with the landmark weights of a stage."""
    weights = stage.landmark_weights
    return tuple(view._replace(weights=jnp.asarray(weights * np.asarray(view.weights))) for view in views)


def holding(views: Sequence[DeepView], scene: DeepScene, parameters: FaceParameters) -> tuple[DeepView, ...]:
    """The views of a solve from here: those whose render is about where the photo's face is hold the photo's crop.

    A regression errs by where in its crop a face is: seen through one window, photo and render err alike. A face that
    starts farther off would not be in that window, so D follows it until the next stage.
    """
    return tuple(
        view if view.crop is None else view._replace(held=float(_is_near(view, scene, parameters))) for view in views
    )


def eyes_per_box(model: FaceModel, network: EnergyNetwork) -> float:
    """What counts as a model's outer-eye distance, in sides of the face box that the network's crop tells.

    By the neutral face as it is seen from the front: a model whose eyes are farther apart in the crop than the default
    head's has as much more than `EYES_PER_BOX`.
    """
    own, default = (_eyes_per_crop(each, network) for each in (model, load_default_head()))
    return EYES_PER_BOX * (own / default)


def percent_px(network: EnergyNetwork, eyes: float, points: Float[np.ndarray, "points 2"]) -> float:
    """One percent of a face's outer-eye distance, in pixels, estimated from the size of its crop.

    `eyes` is the model's `eyes_per_box`.
    """
    return 0.01 * eyes / CROP_BOXES * float(crop_of(network, jnp.asarray(points)).side)


def light_of(appearance: Appearance | None) -> Float[np.ndarray, "9 3"]:
    """The light of an appearance, in the reference camera's frame; plain frontal light if none was estimated."""
    if appearance is not None:
        return appearance.light
    return ambient_light(0.6) + directional_light((0.2, -0.5, -1.0), 0.4)


def _surroundings(plan: Plan, observation: FrameObservation) -> tuple[Surroundings, ...]:
    """Of the first view by its picture, of the others plain; all plain where no render is looked at."""
    picture = None if plan.deep.energy == "points" else observation.picture
    first = seen_around(picture, observation.landmarks)
    return (first, *(plain_surroundings() for _ in observation.others))


def _is_near(view: DeepView, scene: DeepScene, parameters: FaceParameters) -> bool:
    with COMPUTING:
        points = np.asarray(project_points(scene, view, parameters), float)
        own = crop_of(scene.network, jnp.asarray(points))
    apart = np.linalg.norm(np.subtract(own.centre, view.crop.centre)) / view.crop.side
    differences = apart, np.log(own.side / view.crop.side), own.roll - view.crop.roll
    return bool(np.max(np.abs(differences)) < NEAR)


def _eyes_per_crop(model: FaceModel, network: EnergyNetwork) -> float:
    points = model.landmarks.of(model.neutral)[:, :2]
    return float(outer_eye_distance(points)) / float(crop_of(network, jnp.asarray(points)).side)


class _Place(NamedTuple):
    """A camera of a solve, and where it is in the reference camera's frame."""

    camera: AnyCamera
    image_size: tuple[int, int]
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]


def _view(
    plan: Plan,
    network: EnergyNetwork,
    eyes: float,
    place: _Place,
    landmarks: Landmarks2D | None,
    light: Float[np.ndarray, "9 3"],
    around: Surroundings,
) -> DeepView:
    camera = place.camera
    whitening = crop = None
    if landmarks is None:
        target, counts, share, unit = np.zeros((68, 2)), np.zeros(68), np.zeros(68), 1.0
    else:
        target, confidence = landmarks.points, landmarks.confidence
        alike = np.ones(len(target))
        share = {"deep": alike, "points": 0.0 * alike, "mixed": confidence}[plan.deep.energy]
        unit = percent_px(network, eyes, target) if plan.solver.percent else 1.0
        counts, whitening = plan.measured(landmarks)
        if isinstance(network, DenseNetwork):
            crop = jax.tree.map(np.asarray, crop_of(network, jnp.asarray(target)))
    return DeepView(
        camera=Camera(*(jnp.asarray(part, float) for part in camera)) if isinstance(camera, Camera) else camera,
        rotation=jnp.asarray(place.rotation, jnp.float32),
        translation=jnp.asarray(place.translation, jnp.float32),
        target=jnp.asarray(target),
        weights=jnp.asarray(counts),
        share=jnp.asarray(share),
        unit_px=jnp.asarray(unit),
        light=jnp.asarray(light, jnp.float32),
        surroundings=jax.tree.map(jnp.asarray, around),
        whitening=None if whitening is None else jnp.asarray(whitening),
        crop=crop,
        image_size=jnp.asarray(place.image_size, float),
    )


def _solver_camera(plan: Plan, image_size: tuple[int, int]) -> Camera | OrthographicCamera:
    camera = plan.camera.of(image_size)
    if not plan.camera.parallel:
        return Camera(*(jnp.asarray(part, float) for part in camera))
    made = orthographic_camera(image_size, _start_scale(plan, camera))
    return OrthographicCamera(*(jnp.asarray(part, float) for part in made))


def _start_scale(plan: Plan, camera: Camera) -> float:
    """Pixels per millimetre at the start's distance."""
    return float(np.mean(np.asarray(camera.focal_px))) / plan.deep.distance_mm
