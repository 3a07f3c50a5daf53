"""A stand-in for a matchmove artist: dots painted on a face, tracked through a film, and the head poses they give.

Deep Energies Sec. 8.4 compares its rigid alignment with one made by hand from painted dots. What follows knows neither
the landmark network nor the energies: optical flow of a few pixels, and OpenCV's pose from points.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from workbench.face import FaceModel
from workbench.geometry import Camera
from workbench.geometry.triangulation import camera_matrix
from workbench.pictures.mesh import corner_sum, to_camera, to_pixels, vertex_normals
from workbench.reproduction.head_pose import Poses, pose_by_pnp
from workbench.reproduction.people import Motion, SimulatedPerson
from workbench.training.skin import vertex_places

DOTS = 24
DOT_PX, DOT_COLOR = 1.8, (25, 20, 20)
"""Radius in the albedo."""
STILL_MM = 1.0
"""Most that any blendshape moves a vertex with a dot."""
FACING, ABOVE_BROWS_MM = 0.35, 20.0
"""Cosine to the head's front, and how far up the forehead, which hair may cover."""
WINDOW_PX, LEVELS = 13, 3
ROUND_TRIP_PX = 0.7
"""A dot is lost if its flow forth and back ends farther from where it began."""
OUTLIER_PX = 1.5
"""A dot farther than this from where the others put it is left out of a frame's pose."""
FEWEST = 4
BITS = 4


def rigid_vertices(head: FaceModel, count: int = DOTS) -> Int[np.ndarray, "{count}"]:
    """Vertices between brows and nose that no expression moves much, as far from one another as they can be."""
    points, landmarks = head.neutral, head.landmarks.of(head.neutral)
    moved_mm = np.linalg.norm(head.expression_deltas, axis=-1).max(axis=0)
    outward = vertex_normals(points, head.triangles, corner_sum(head.triangles, len(points)))
    top, bottom = landmarks[17:27, 1].min() - ABOVE_BROWS_MM, landmarks[33, 1]
    fit = (moved_mm < STILL_MM) & (outward[:, 2] < -FACING) & (points[:, 1] > top) & (points[:, 1] < bottom)
    able = np.intersect1d(np.flatnonzero(fit), head.regions["skin"])
    chosen = [able[np.linalg.norm(points[able] - landmarks[27], axis=1).argmin()]]
    for _ in range(count - 1):
        apart = np.linalg.norm(points[able][:, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(able[apart.argmax()])
    return np.array(chosen)


def with_dots(who: SimulatedPerson, vertices: Int[np.ndarray, "n"]) -> SimulatedPerson:
    """The person with a dark dot on each of these vertices."""
    albedo = who.albedo.copy()
    for place in np.rint(vertex_places(who.model)[vertices] * (1 << BITS)).astype(int).tolist():
        cv2.circle(albedo, tuple(place), round(DOT_PX * (1 << BITS)), DOT_COLOR, -1, cv2.LINE_AA, BITS)
    return replace(who, albedo=albedo)


@dataclass(frozen=True, eq=False)
class TrackedDots:
    """Where dots are in the frames of a film, pixels; lost ones stay lost."""

    pixels: Float[np.ndarray, "f n 2"]
    seen: Bool[np.ndarray, "f n"]


def track_dots(pictures: Sequence[UInt8[np.ndarray, "h w 3"]], first: Float[np.ndarray, "n 2"]) -> TrackedDots:
    """Follow dots from their places in the first picture by Lucas and Kanade's flow, there and back."""
    given = {"winSize": (WINDOW_PX, WINDOW_PX), "maxLevel": LEVELS}
    last, places = cv2.cvtColor(pictures[0], cv2.COLOR_RGB2GRAY), first.astype(np.float32)
    pixels, seen = [places], [np.ones(len(places), bool)]
    for picture in pictures[1:]:
        grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        moved, found, _ = cv2.calcOpticalFlowPyrLK(last, grey, places, None, **given)
        back, _, _ = cv2.calcOpticalFlowPyrLK(grey, last, moved, None, **given)
        kept = (found[:, 0] > 0) & (np.linalg.norm(back - places, axis=1) < ROUND_TRIP_PX)
        last, places = grey, moved
        pixels.append(places)
        seen.append(seen[-1] & kept)
    return TrackedDots(np.array(pixels, float), np.array(seen))


def poses_of_dots(dots: TrackedDots, points_head: Float[np.ndarray, "dots 3"], camera: Camera) -> Poses:
    """The pose of each frame from the dots that agree on one; NaN where fewer than four do."""
    poses = np.full((len(dots.pixels), 3), np.nan), np.full((len(dots.pixels), 3), np.nan)
    matrix = camera_matrix(camera)
    for k, (pixels, seen) in enumerate(zip(dots.pixels, dots.seen, strict=True)):
        if seen.sum() < FEWEST:
            continue
        *_, agreeing = cv2.solvePnPRansac(
            points_head[seen], pixels[seen], matrix, np.asarray(camera.distortion, float),
            reprojectionError=OUTLIER_PX, flags=cv2.SOLVEPNP_SQPNP,
        )  # fmt: skip
        if agreeing is not None and len(agreeing) >= FEWEST:
            kept = np.flatnonzero(seen)[agreeing.ravel()]
            poses[0][k], poses[1][k] = pose_by_pnp(points_head[kept], pixels[kept], camera)
    return poses


def matchmove(
    pictures: Sequence[UInt8[np.ndarray, "h w 3"]],
    points_head: Float[np.ndarray, "n 3"],
    motion: Motion,
    camera: Camera,
) -> Poses:
    """The poses of a film from its dots, whose places in the first picture are known."""
    first = to_pixels(camera, to_camera(points_head, motion.rotation[0], motion.translation_mm[0]))
    return poses_of_dots(track_dots(pictures, first), points_head, camera)
