"""A person's skin from pictures: what several views show of it, brought into the head's texture, and completed.

Each texel is looked up in every view that sees it. The light of a view is the nine spherical-harmonic coefficients that
`estimate_appearance` finds; its variation over the face is divided out, its colour and strength are not, as no picture
tells them from the skin's. Views agree by a robust mean in logarithms, weighted by angle, resolution and sharpness, so
that a hand or a microphone before the face in one of them counts for nothing. What no view shows is taken from another
skin, whose tone is bent to the seen one's over the mesh (a membrane: Laplace's equation with the seen differences as
data, as in gradient-domain blending), so that no seam shows where both meet.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import distance_transform_edt
from scipy.sparse import diags_array
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.rendering.appearance import differences, estimate_appearance
from workbench.rendering.camera import AnyCamera, to_screen
from workbench.rendering.lighting import LAMBERT, spherical_harmonics
from workbench.rendering.renderer import render
from workbench.rendering.topology import mesh_topology, vertex_normals
from workbench.rendering.uv_map import UVMap, uv_map

SIZE = 1024
"""Side of the texture."""
FACING = (0.3, 0.75)
"""Cosine to the camera from which a texel counts, and at which it counts fully."""
SURFACE_MM = 3.0
"""Depth within which a texel is the surface that the view sees."""
OUTLINE_SHARE, STEP_MM = 0.02, 6.0
"""All is unsure so near to the outline, in sides of a square as large as the face, and to such a jump in depth."""
CLEAR_MM = (1.5, 4.5)
"""Distance from eyes and mouth from which skin counts, and at which it counts fully: gaze and lips move there."""
EDGE_MM = 14.0
"""Over so much the part of the head that landmarks hold ends."""
LIT = 0.75
"""What a face shows of its albedo on average, in pictures of heads (`pictures.STUDIO`): drawn so, it is as bright as in
the clip."""
SHADE_RANGE = (0.35, 2.0)
"""Of the light at a texel, relative to the face's mean."""
DARKEST = 1.0 / 255.0
SPREAD = 0.35
"""Logarithm of the ratio to the views' median from which a view's colour is dropped."""
FOREIGN = 0.55
"""The same, between what all views show and the tone of the skin: hair, glasses."""
LEAST_WEIGHT, FULL_WEIGHT = 0.02, 0.25
"""Sums of weights from which a texel is painted, and at which it is without the other skin's share."""
FEATHER = 0.02
"""Width of the blend, in sides of the texture."""
NEIGHBOURS, MIRROR, PULL = 1000.0, 100.0, 20.0
"""Stiffness of the membrane between neighbours and mirror images against one texel, and its pull to the middle tone:
what is seen at the face's rim is the least sure, and no cheek is to pass it on to a whole neck."""
ROBUST_STEPS = 4
TONE_RANGE = 1.2
"""Largest change of another skin's tone, in logarithms."""
KEPT = ("brow", "lips")
"""Regions whose colour may differ from the skin's."""
BROW_MM = (14.0, 4.0)
"""So may what is so far above the line of a brow's landmarks, which real brows often are, and below, where rims of
glasses begin."""
PART_REGIONS = ("eyeL", "eyeR", "eye_cavity", "teethU", "teethL", "tongue", "mouth_cavity")
SMALL = 256
"""Side at which skins are compared."""


@dataclass(frozen=True, eq=False)
class SkinView:
    """A picture and the head in it."""

    picture: UInt8[np.ndarray, "h w 3"]
    """RGB."""
    vertices_camera: Float[np.ndarray, "v 3"]
    camera: AnyCamera
    share: float = 1.0
    """How much it counts: sharp pictures count more."""


@dataclass(frozen=True, eq=False)
class PaintedSkin:
    """What views show of a skin, in the head's texture."""

    color: Float[np.ndarray, "s s 3"]
    """RGB, 0 to 1; anything where nothing was seen."""
    seen: Float[np.ndarray, "s s"]
    """Sum of the weights of the views that agree."""

    @property
    def share(self) -> float:
        """Part of the texture that was seen."""
        return float((self.seen > LEAST_WEIGHT).mean())


def painted_skin(views: Sequence[SkinView], model: FaceModel, size: int = SIZE) -> PaintedSkin:
    """The skin that the views show. Raises `InputError` if none of them shows a face large enough."""
    mapped = uv_map(model, size)
    static = mapped.of(_held(model)) * mapped.inside
    chosen = static > 0.0
    samples = [sampled for view in views if (sampled := _sampled(view, model, mapped, chosen)) is not None]
    if not samples:
        raise InputError(
            "No picture shows the face large enough for its skin, which needs 1000 usable pixels; "
            "choose a clip in which the face is larger and looks at the camera."
        )
    logs = np.stack([np.log(np.maximum(colors, DARKEST)) for colors, _ in samples]).astype(np.float32)
    weights = np.stack([weight for _, weight in samples]).astype(np.float32) * static[chosen]
    logs = _one_exposure(logs, weights)
    middle = _weighted_median(logs, weights)
    apart = np.abs(logs - middle).max(axis=2)
    weights *= np.clip(1.0 - (apart / SPREAD) ** 2, 0.0, None) ** 2
    total = weights.sum(axis=0)
    mean = np.einsum("vt,vtc->tc", weights, np.exp(logs)) / np.maximum(total, 1e-9)[:, None]
    color, seen = np.zeros((size, size, 3)), np.zeros((size, size))
    color[chosen], seen[chosen] = mean, total
    return PaintedSkin(np.clip(color, 0.0, 1.0), seen)


def completed_skin(
    painted: PaintedSkin, model: FaceModel, skins: Mapping[str, UInt8[np.ndarray, "_ _ 3"]]
) -> tuple[UInt8[np.ndarray, "s s 3"], str]:
    """The painted skin with what is missing from the most alike of other skins (RGB, same UVs), and that one's name."""
    size = len(painted.seen)
    mapped = uv_map(model, size)
    name = closest_skin(painted, skins)
    other = np.maximum(cv2.resize(skins[name], (size, size), interpolation=cv2.INTER_AREA) / 255.0, DARKEST)
    own = np.log(np.maximum(painted.color, DARKEST)) - np.log(other)
    weight = np.clip(painted.seen / FULL_WEIGHT, 0.0, 1.0) * (painted.seen > LEAST_WEIGHT)
    kept = mapped.of((model.in_regions(KEPT) | _near_brows(model)).astype(float)) > 0.5
    # What differs from its surroundings all over the clip is no skin: a strand of hair, the rim of glasses.
    middle = _median_color(own, weight)
    trusted = weight * (np.abs((own - middle).mean(axis=-1)) < FOREIGN)
    for _ in range(ROBUST_STEPS):
        tone = middle + mapped.of(_membrane(own - middle, trusted, mapped, model))
        apart = (own - tone).mean(axis=-1)
        trusted = weight * np.clip(1.0 - (apart / FOREIGN) ** 2, 0.0, None) ** 2
    weight = np.where(kept, weight, weight * (np.abs(apart) < FOREIGN))
    base = other * np.exp(np.clip(tone, -TONE_RANGE, TONE_RANGE))
    share = _feathered(weight, mapped)[..., None]
    blended = share * painted.color + (1.0 - share) * base
    # Beside the islands texels repeat the nearest inside: a mesh's seams and mipmaps look there.
    nearest = distance_transform_edt(~mapped.inside, return_distances=False, return_indices=True)
    return np.rint(255.0 * np.clip(blended, 0.0, 1.0)).astype(np.uint8)[tuple(nearest)], name


def closest_skin(painted: PaintedSkin, skins: Mapping[str, UInt8[np.ndarray, "_ _ 3"]]) -> str:
    """The skin most like the painted one where that was seen: in CIE Lab, without detail, its mean counting less."""
    weight = cv2.resize(np.minimum(painted.seen, FULL_WEIGHT), (SMALL, SMALL), interpolation=cv2.INTER_AREA)
    own = _coarse(painted.color, weight)
    costs = {}
    for name, skin in skins.items():
        difference = (_coarse(skin / 255.0, weight) - own)[weight > LEAST_WEIGHT]
        mean = difference.mean(axis=0)
        costs[name] = 0.5 * np.linalg.norm(mean) + np.linalg.norm(difference - mean, axis=1).mean()
    return min(costs, key=costs.__getitem__)


def _coarse(color: np.ndarray, weight: np.ndarray) -> Float[np.ndarray, "s s 3"]:
    small = cv2.resize(np.asarray(color, np.float32), (SMALL, SMALL), interpolation=cv2.INTER_AREA)
    known = weight[..., None].astype(np.float32)
    blur = (
        cv2.GaussianBlur(small * known, (0, 0), 4.0) / np.maximum(cv2.GaussianBlur(known, (0, 0), 4.0), 1e-6)[..., None]
    )
    return cv2.cvtColor(np.clip(blur, 0.0, 1.0), cv2.COLOR_RGB2LAB).astype(float)


def _sampled(
    view: SkinView, model: FaceModel, mapped: UVMap, chosen: Bool[np.ndarray, "s s"]
) -> tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, "t"]] | None:
    """Colours of the chosen texels without the light's variation, and weights; None where the face is too small."""
    vertices = np.asarray(view.vertices_camera, float)
    try:
        light = estimate_appearance(view.picture, model, vertices, view.camera).light
    except InputError:
        return None
    height, width = view.picture.shape[:2]
    topology = mesh_topology(model.triangles, len(vertices))
    rendering = render(
        vertices, topology, view.camera, model.colors / 255.0, np.zeros((9, 3)), np.zeros(3),
        size=(width, height), antialias=False,
    )  # fmt: skip
    depth = np.asarray(rendering.depth)
    corners = mapped.corners(chosen, len(vertices))
    points = corners @ vertices
    normals = corners @ np.asarray(vertex_normals(vertices.astype(np.float32), topology), float)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    pixels = np.asarray(to_screen(view.camera, points).pixels)
    place = np.rint(pixels).astype(int)
    within = ((place >= 0) & (place < [width, height])).all(axis=1)
    column, row = np.where(within[:, None], place, 0).T
    facing = -(normals * points).sum(axis=1) / np.linalg.norm(points, axis=1)
    angle = np.clip((facing - FACING[0]) / (FACING[1] - FACING[0]), 0.0, 1.0) ** 2
    weight = view.share * angle * within * _sure(depth)[row, column]
    weight *= np.abs(points[:, 2] - depth[row, column]) < SURFACE_MM
    flat = pixels.astype(np.float32).reshape(1, -1, 2)
    # OpenCV looks up at most 2¹⁵ places along a line.
    lines = [flat[:, start : start + 32_000] for start in range(0, flat.shape[1], 32_000)]
    looked = [cv2.remap(view.picture, line[..., 0], line[..., 1], cv2.INTER_LINEAR)[0] for line in lines]
    colors = np.concatenate(looked) / 255.0
    shade = (np.stack(spherical_harmonics(*normals.T), axis=1) * LAMBERT) @ np.asarray(light, float)
    shade /= np.maximum(np.average(shade, axis=0, weights=weight + 1e-9), 1e-6)
    return colors / (LIT * np.clip(shade, *SHADE_RANGE)), weight


def _sure(depth: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """1 where a pixel shows the head away from its outline and from jumps in depth, as beside the nose; else 0."""
    head = np.isfinite(depth)
    filled = np.where(head, depth, 1e6).astype(np.float32)
    around = np.ones((3, 3), np.uint8)
    jump = cv2.dilate(filled, around) - cv2.erode(filled, around) > STEP_MM
    away = distance_transform_edt(np.pad(head & ~jump, 1))[1:-1, 1:-1]
    outline = distance_transform_edt(np.pad(head, 1))[1:-1, 1:-1]
    return ((away > 1.5) & (outline > OUTLINE_SHARE * np.sqrt(head.sum()))).astype(float)


def _held(model: FaceModel) -> Float[np.ndarray, "v"]:
    """How far landmarks hold a vertex to the pictures: skin before the jaw's ends, above the chin, off the eyes."""
    landmarks = model.landmarks.of(model.neutral)
    ends, chin = landmarks[[0, 16], 2].mean(), landmarks[8, 1]
    places = model.neutral
    held = np.clip((ends - places[:, 2]) / EDGE_MM, 0.0, 1.0) * np.clip((chin - places[:, 1]) / EDGE_MM, 0.0, 1.0)
    held *= ~model.in_regions(("scalp", *PART_REGIONS))
    inner = places[model.in_regions(PART_REGIONS)]
    if len(inner):
        near, far = CLEAR_MM
        held *= np.clip((cKDTree(inner).query(places)[0] - near) / (far - near), 0.0, 1.0)
    return held


def _near_brows(model: FaceModel) -> Bool[np.ndarray, "v"]:
    points = model.landmarks.of(model.neutral)[17:27].reshape(2, 5, 3)
    along = np.linspace(0.0, 1.0, 5)[:, None, None, None]
    line = ((1.0 - along) * points[:, :-1] + along * points[:, 1:]).reshape(-1, 3)
    away, nearest = cKDTree(line).query(model.neutral)
    return (away < BROW_MM[0]) & (model.neutral[:, 1] - line[nearest, 1] < BROW_MM[1])


def _one_exposure(logs: Float[np.ndarray, "n t 3"], weights: Float[np.ndarray, "n t"]) -> Float[np.ndarray, "n t 3"]:
    """The views in one strength and colour of light, their mean's."""
    for _ in range(2):
        middle = _weighted_median(logs, weights)
        gains = np.stack([
            [_median(difference[:, channel], weight) for channel in range(3)]
            for difference, weight in zip(logs - middle, weights, strict=True)
        ])  # fmt: skip
        counts = weights.sum(axis=1)
        gains -= (counts[:, None] * gains).sum(axis=0) / max(float(counts.sum()), 1e-9)
        logs = logs - gains[:, None].astype(np.float32)
    return logs


def _weighted_median(logs: Float[np.ndarray, "n t 3"], weights: Float[np.ndarray, "n t"]) -> Float[np.ndarray, "t 3"]:
    order = np.argsort(logs, axis=0)
    ranked = np.take_along_axis(np.broadcast_to(weights[..., None], logs.shape), order, axis=0).cumsum(axis=0)
    half = (ranked >= 0.5 * ranked[-1]).argmax(axis=0)
    chosen = np.take_along_axis(order, half[None], axis=0)
    return np.take_along_axis(logs, chosen, axis=0)[0]


def _median(values: Float[np.ndarray, "t"], weights: Float[np.ndarray, "t"]) -> float:
    order = np.argsort(values)
    ranked = weights[order].cumsum()
    return float(values[order[np.searchsorted(ranked, 0.5 * ranked[-1])]]) if ranked[-1] > 0.0 else 0.0


def _median_color(own: Float[np.ndarray, "s s 3"], weight: Float[np.ndarray, "s s"]) -> Float[np.ndarray, "3"]:
    seen = weight > 0.0
    return np.array([_median(own[seen][:, channel], weight[seen]) for channel in range(3)])


def _membrane(
    own: Float[np.ndarray, "s s 3"], weight: Float[np.ndarray, "s s"], mapped: UVMap, model: FaceModel
) -> Float[np.ndarray, "v 3"]:
    """Differences of the vertices that follow the seen ones and run smoothly over mesh and mirror image elsewhere."""
    chosen, count = weight > 0.0, len(model.neutral)
    corners = mapped.corners(chosen, count)
    weighted = diags_array(weight[chosen]) @ corners
    edges = np.unique(np.sort(model.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    mirrored = np.stack([np.arange(count), model.mirror], axis=1)
    mirrored = mirrored[mirrored[:, 0] < mirrored[:, 1]]
    stiff = NEIGHBOURS * differences(edges, count) + MIRROR * differences(mirrored, count)
    normal = (corners.T @ weighted + stiff + PULL * diags_array(np.ones(count))).tocsc()
    return np.stack([spsolve(normal, weighted.T @ own[chosen][:, channel]) for channel in range(3)], axis=1)


def _feathered(weight: Float[np.ndarray, "s s"], mapped: UVMap) -> Float[np.ndarray, "s s"]:
    """Share of the painted skin: none beyond what was seen, and rising softly towards its inside."""
    nearest = distance_transform_edt(~mapped.inside, return_distances=False, return_indices=True)
    width = FEATHER * len(weight)
    inward = np.clip(distance_transform_edt((weight > 0.0)[tuple(nearest)]) / width, 0.0, 1.0)
    soft = cv2.GaussianBlur(weight, (0, 0), 0.25 * width)
    return inward * inward * (3.0 - 2.0 * inward) * np.where(weight > 0.0, np.minimum(soft, 1.0), 0.0)
