"""Calibrated rigs: several cameras with their places in one world (Deep Energies Sec. 8.4).

Poses follow OpenCV, `points_view = rotation_view_world @ points_world + translation_view_world_mm`, so a camera stands
at `-rotation_view_world.T @ translation_view_world_mm`. The first view is the reference: its camera frame is the one in
which a head is solved, and every other view is reached from it by a fixed rotation and translation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, combinations, repeat
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from workbench.arrays import AnyArray
from workbench.errors import InputError
from workbench.geometry.camera import Camera, project

LEAST_BASELINE_MM, MOST_BASELINE_MM = 5.0, 20_000.0
ROTATION_TOLERANCE = 1e-3
"""Error of RᵀR that is put down to rounded digits and repaired."""
ASPECT_TOLERANCE = 0.01
LEAST_FOCAL_PX = 1e-3
"""Less is a damaged number: no picture has room for what such a lens sees."""
FARTHEST_MM = 20_000.0
LEAST_SHARED_MM = 10.0
"""Radius of a ball, up to so far from the reference camera, that all pictures must be able to show whole."""


class PlacedCamera(NamedTuple):
    """One view for the solvers: a pytree of arrays, so that another rig compiles nothing.

    `Rig.placed` holds all views in one, with a leading axis to map over.
    """

    camera: Camera
    rotation_view_reference: Float[AnyArray, "3 3"]
    """Turns the reference camera's frame into this view's."""
    translation_view_reference_mm: Float[AnyArray, "3"]
    """The reference camera's place in this view's frame, millimetres."""


@dataclass(frozen=True, eq=False)
class View:
    """One camera of a rig; checked and read-only.

    Raises `InputError` for an empty name, a picture without pixels, a focal length that is not positive, a principal
    point outside the picture, or an invalid rotation. Digits lost in a file (1e-3 of RᵀR) are repaired.
    """

    name: str
    image_size: tuple[int, int]
    """(width, height) of the pictures that the intrinsic parameters belong to, pixels."""
    camera: Camera
    rotation_view_world: Float[np.ndarray, "3 3"]
    """World to view."""
    translation_view_world_mm: Float[np.ndarray, "3"]
    """The world's origin in this view's frame, millimetres."""

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise InputError("Every view of a rig needs a name; call them left and right, or by their serial numbers.")
        camera = Camera(*(_read_only(values) for values in self.camera))
        width, height = (int(length) for length in self.image_size)
        _check_intrinsics(self.name, camera, (width, height))
        translation = _read_only(self.translation_view_world_mm)
        if not np.isfinite(translation).all():
            raise InputError(f"The translation of view {self.name!r} is {translation.tolist()}; give finite numbers.")
        object.__setattr__(self, "image_size", (width, height))
        object.__setattr__(self, "camera", camera)
        object.__setattr__(self, "rotation_view_world", _read_only(_checked_rotation(self)))
        object.__setattr__(self, "translation_view_world_mm", translation)

    @property
    def position_world_mm(self) -> Float[np.ndarray, "3"]:
        """Position of the camera in the world, millimetres."""
        return -self.rotation_view_world.T @ self.translation_view_world_mm


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras that see the same thing at the same time; the first view is the reference.

    A rig of one view is a single camera. Raises `InputError` for no view, names that come twice, two cameras in one
    place, cameras nearer than 5 mm or farther apart than 20 m (a wrong unit), or pictures that share no point.
    """

    views: tuple[View, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "views", tuple(self.views))
        if not self.views:
            raise InputError("A rig has at least one view, got none.")
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise InputError(f"The name {twice[0]!r} is used for two views of the rig; give each its own.")
        _check_baselines(self.views)
        if len(self.views) > 1:
            _check_shared_point(self)

    def __len__(self) -> int:
        return len(self.views)

    @property
    def names(self) -> tuple[str, ...]:
        """The views' names, the reference first."""
        return tuple(view.name for view in self.views)

    def view(self, name: str) -> View:
        """The view of this name. Raises `InputError` that lists the names."""
        return self.views[self.index(name)]

    def index(self, name: str) -> int:
        """The place of the view of this name, 0 for the reference. Raises `InputError` that lists the names."""
        if name not in self.names:
            raise InputError(f"The rig has no view {name!r}; its views are {', '.join(self.names)}.")
        return self.names.index(name)

    def resized(self, image_sizes: Sequence[tuple[int, int] | None]) -> "Rig":
        """The rig for pictures of these sizes (width, height), in the order of the views; those without one stay.

        Raises `InputError` as `resized_view` does.
        """
        sizes = zip(self.views, chain(image_sizes, repeat(None)), strict=False)
        views = tuple(view if size is None else resized_view(view, size) for view, size in sizes)
        return self if views == self.views else Rig(views)

    @cached_property
    def rotation_view_reference(self) -> Float[np.ndarray, "v 3 3"]:
        """For each view, the rotation from the reference camera's frame; the first is the identity."""
        return _read_only(np.stack([rotation for rotation, _ in self._from_reference()]))

    @cached_property
    def translation_view_reference_mm(self) -> Float[np.ndarray, "v 3"]:
        """For each view, the reference camera's place in its frame, millimetres; the first is zero."""
        return _read_only(np.stack([translation for _, translation in self._from_reference()]))

    @cached_property
    def position_reference_mm(self) -> Float[np.ndarray, "v 3"]:
        """Position of each view's camera in the reference camera's frame, millimetres."""
        rotations, translations = self.rotation_view_reference, self.translation_view_reference_mm
        return _read_only(-np.einsum("vji,vj->vi", rotations, translations))

    @cached_property
    def placed(self) -> PlacedCamera:
        """All views as one pytree with a leading axis, for `jax.vmap` or one index at a time."""
        cameras = Camera(*(np.stack(values) for values in zip(*(view.camera for view in self.views), strict=True)))
        return PlacedCamera(cameras, self.rotation_view_reference, self.translation_view_reference_mm)

    def placed_view(self, view: int | str) -> PlacedCamera:
        """One view, by its place or its name, for `to_view` and the solvers."""
        index = self.index(view) if isinstance(view, str) else view
        return jax.tree.map(lambda values: values[index], self.placed)

    def _from_reference(self) -> list[tuple[np.ndarray, np.ndarray]]:
        reference, *others = self.views
        pose = (reference.rotation_view_world, reference.translation_view_world_mm)
        # Exactly the identity: R·Rᵀ would leave rounding in the frame that all else is measured in.
        relative = [(np.eye(3), np.zeros(3))]
        return relative + [relative_pose(*pose, v.rotation_view_world, v.translation_view_world_mm) for v in others]


def relative_pose(
    rotation_a_world: Float[AnyArray, "3 3"],
    translation_a_world: Float[AnyArray, "3"],
    rotation_b_world: Float[AnyArray, "3 3"],
    translation_b_world: Float[AnyArray, "3"],
) -> tuple[Float[AnyArray, "3 3"], Float[AnyArray, "3"]]:
    """`rotation_b_a`, `translation_b_a` of two views in one world: R_b·R_aᵀ and t_b − R_ba·t_a. Any unit; traceable."""
    rotation_b_a = rotation_b_world @ rotation_a_world.T
    return rotation_b_a, translation_b_world - rotation_b_a @ translation_a_world


def to_view(points_reference: Float[AnyArray, "*n 3"], view: PlacedCamera) -> Float[AnyArray, "*n 3"]:
    """Points of the reference camera's frame in the view's, millimetres."""
    return points_reference @ view.rotation_view_reference.T + view.translation_view_reference_mm


def to_reference(points_view: Float[AnyArray, "*n 3"], view: PlacedCamera) -> Float[AnyArray, "*n 3"]:
    """Points of a view's camera frame in the reference camera's, millimetres; the inverse of `to_view`."""
    return (points_view - view.translation_view_reference_mm) @ view.rotation_view_reference


def project_to_view(points_reference: Float[AnyArray, "*n 3"], view: PlacedCamera) -> Float[AnyArray, "*n 2"]:
    """Points of the reference camera's frame in the view's picture, pixels."""
    return project(view.camera, to_view(jnp.asarray(points_reference), view))


def pose_in_view(
    rotation: Float[np.ndarray, "*n 3"], translation_mm: Float[np.ndarray, "*n 3"], view: PlacedCamera
) -> tuple[Float[np.ndarray, "*n 3"], Float[np.ndarray, "*n 3"]]:
    """A head's pose (axis-angle, millimetres) in the reference camera as the view's camera sees it; on the host."""
    flat = np.array(rotation, float).reshape(-1, 3)
    turned = Rotation.from_matrix(np.asarray(view.rotation_view_reference)) * Rotation.from_rotvec(flat)
    return turned.as_rotvec().reshape(np.shape(rotation)), np.asarray(to_view(np.asarray(translation_mm, float), view))


def resized_view(view: View, image_size: tuple[int, int]) -> View:
    """The view for pictures of another size (width, height) of the same aspect, as of a clip that was scaled down.

    Raises `InputError` where the aspect differs by more than 1 %: such pictures were cut, not scaled.
    """
    if tuple(image_size) == view.image_size:
        return view
    scale = np.array(image_size, float) / np.array(view.image_size, float)
    if abs(scale[0] / scale[1] - 1.0) > ASPECT_TOLERANCE:
        raise InputError(
            f"Pictures of {_size(image_size)} are not scaled copies of view {view.name!r}'s {_size(view.image_size)}; "
            "calibrate the camera at the size that is used."
        )
    # Pixel centres: the picture's corner, half a pixel before the first centre, stays where it is.
    centre = (view.camera.principal_point_px + 0.5) * scale - 0.5
    camera = Camera(view.camera.focal_px * scale, centre, view.camera.distortion)
    return replace(view, image_size=image_size, camera=camera)


def _check_intrinsics(name: str, camera: Camera, image_size: tuple[int, int]) -> None:
    width, height = image_size
    if width < 1 or height < 1:
        raise InputError(f"The pictures of view {name!r} are {_size(image_size)} pixels; give (width, height).")
    if not all(np.isfinite(values).all() for values in camera):
        raise InputError(f"The camera of view {name!r} holds a number that is not finite; calibrate it again.")
    if not (camera.focal_px >= LEAST_FOCAL_PX).all():
        raise InputError(f"The focal lengths of view {name!r} are {camera.focal_px.tolist()}; both must be positive.")
    x, y = camera.principal_point_px
    if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
        raise InputError(
            f"The principal point ({x:.1f}, {y:.1f}) of view {name!r} lies outside its picture of {_size(image_size)}; "
            "the calibration may be for another picture size."
        )


def _checked_rotation(view: View) -> Float[np.ndarray, "3 3"]:
    """The nearest rotation to the view's; raises `InputError` that says what is wrong with it."""
    rotation = np.asarray(view.rotation_view_world, float)
    error = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if not error <= ROTATION_TOLERANCE:
        raise InputError(
            f"The rotation of view {view.name!r} is not a rotation (RᵀR is off the identity by {error:.2g}); "
            "its columns must be orthonormal."
        )
    if np.linalg.det(rotation) < 0:
        raise InputError(
            f"The rotation of view {view.name!r} mirrors (determinant -1); flip one axis: "
            "the frame is +x right, +y down, +z forward."
        )
    return rotation if error < 1e-12 else Rotation.from_matrix(rotation).as_matrix()


def _check_baselines(views: tuple[View, ...]) -> None:
    for a, b in combinations(views, 2):
        baseline = float(np.linalg.norm(a.position_world_mm - b.position_world_mm))
        pair = f"views {a.name!r} and {b.name!r}"
        if baseline < 1e-6:
            raise InputError(f"The cameras of {pair} are in the same place; give each view its own translation.")
        if not LEAST_BASELINE_MM <= baseline <= MOST_BASELINE_MM:
            raise InputError(
                f"The cameras of {pair} are {baseline:.4g} mm apart, expected {LEAST_BASELINE_MM:g} to "
                f"{MOST_BASELINE_MM:g}; set unit to what the translations are measured in (mm, cm or m)."
            )


def _check_shared_point(rig: Rig) -> None:
    if _largest_shared_ball(rig) < LEAST_SHARED_MM:
        raise InputError(
            f"The pictures of {', '.join(rig.names)} share no point in front of the cameras; "
            'perhaps the poses are those of the cameras in the world: set pose = "world_from_view".'
        )


def _largest_shared_ball(rig: Rig) -> float:
    """Radius in millimetres of the largest ball that all pictures show whole, lens distortion left out; 0 for none.

    A linear programme: the Chebyshev centre of the intersection of the pictures' pyramids.
    """
    rows, limits = [], []
    for index, view in enumerate(rig.views):
        rotation, translation = rig.rotation_view_reference[index], rig.translation_view_reference_mm[index]
        for normal in _inward_normals(view):
            # normal · (R·p + t) ≥ radius: inside the pyramid, as deep as the ball is thick.
            rows.append([*(-normal @ rotation), 1.0])
            limits.append(normal @ translation)
    bounds = [(None, None), (None, None), (None, FARTHEST_MM), (0.0, None)]
    found = linprog([0.0, 0.0, 0.0, -1.0], np.array(rows), np.array(limits), bounds=bounds)
    return float(found.x[3]) if found.success else 0.0


def _inward_normals(view: View) -> Float[np.ndarray, "4 3"]:
    """Unit normals of the picture's four sides as planes through the camera, pointing inwards, view frame."""
    (fx, fy), (cx, cy), (width, height) = view.camera.focal_px, view.camera.principal_point_px, view.image_size
    left, right, top, bottom = (-0.5 - cx) / fx, (width - 0.5 - cx) / fx, (-0.5 - cy) / fy, (height - 0.5 - cy) / fy
    normals = np.array([[1.0, 0.0, -left], [-1.0, 0.0, right], [0.0, 1.0, -top], [0.0, -1.0, bottom]])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _size(image_size: tuple[int, int]) -> str:
    return f"{image_size[0]} × {image_size[1]}"


def _read_only(values: AnyArray) -> np.ndarray:
    array = np.array(values, float)
    array.setflags(write=False)
    return array
