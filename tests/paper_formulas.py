"""The formulas of FACE IT! (2019) and Deep Energies (2023) in plain NumPy, written from the papers and nothing else.

Frames and units are the papers': pixels in the picture, the camera looking along +z. Every function takes complex
numbers too, so that `gradient` differentiates it to the last digit by a step along the imaginary axis.
"""

from collections.abc import Callable, Sequence

import numpy as np

A, B, C = 1.002, 2e-5, 2.5
"""The constants of E_beta (FACE IT! Eq. 12)."""

BETA = 50.0
"""The sharpness of the soft-argmax (Deep Energies Eq. 3)."""

LAMBDA = 1e2
"""The weight of the blendshapes' regularisation (Deep Energies Sec. 8.2)."""


def gradient(function: Callable, at: np.ndarray) -> np.ndarray:
    """The derivatives of a function by every entry of its argument, one row each: Im f(x + ih) / h."""
    step = 1e-40
    rows = [np.imag(function(at + 1j * step * axis)) / step for axis in np.eye(len(at))]
    return np.array(rows)


def squared(residuals: np.ndarray) -> complex:
    """The square of the 2-norm; without conjugation, so that it stays differentiable by the imaginary step."""
    return np.sum(residuals * residuals)


def magnitude(values: np.ndarray) -> np.ndarray:
    """|x|, differentiable by the imaginary step away from zero."""
    return values * np.sign(np.real(values))


def agrees(ours: np.ndarray, papers: np.ndarray, relative: float = 1e-9) -> bool:
    """Whether numbers are the paper's, relative to the largest of them; never where those are all zero."""
    ours, papers = np.real(np.asarray(ours)), np.real(np.asarray(papers))
    largest = np.abs(papers).max()
    return ours.shape == papers.shape and bool(largest > 0.0 and np.abs(ours - papers).max() <= relative * largest)


# FACE IT!


def blendshape_face(neutral: np.ndarray, targets: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Eq. 3: f = b_0 + sum_k w_k (b_k - b_0); targets (n, p, 3), neutral (p, 3)."""
    return neutral + np.einsum("k,kpc->pc", w, targets - neutral)


def procrustes_rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Eq. 4: the rotation R that makes ||R A - B||_F least; points are rows here, columns in the paper."""
    u, _, vt = np.linalg.svd(target.T @ source)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def rotation(r: np.ndarray) -> np.ndarray:
    """The matrix of an angle-axis vector (FACE IT! below Eq. 9), by Rodrigues' formula."""
    angle = np.sqrt(np.sum(r * r))
    x, y, z = r / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def perspective(points: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """The operator pi of Eq. 8: points (.., 3) in the camera's frame to pixels."""
    image = points @ intrinsics.T
    return image[..., :2] / image[..., 2:]


def pose_energy(
    r: np.ndarray, t: np.ndarray, points: np.ndarray, landmarks: np.ndarray, intrinsics: np.ndarray
) -> complex:
    """E_pose (Eq. 8): sum_i ||pi(R P_i + t) - p_i||^2."""
    return squared(perspective(points @ rotation(r).T + t, intrinsics) - landmarks)


def smoothness_energy(earlier: np.ndarray, before: np.ndarray, now: np.ndarray, landmarks: int = 68) -> complex:
    """E_tau (Eq. 9): the second difference of [r|t] over three frames, in a sum over the landmarks as printed."""
    return sum(squared(earlier - 2 * before + now) for _ in range(landmarks))


def fit_energy(
    w: np.ndarray,
    neutral: np.ndarray,
    targets: np.ndarray,
    pose: tuple[np.ndarray, np.ndarray],
    landmarks: np.ndarray,
    intrinsics: np.ndarray,
) -> complex:
    """E_fit (Eq. 10), with the pose that the operator pi needs and the paper does not write there."""
    r, t = pose
    return squared(perspective(blendshape_face(neutral, targets, w) @ rotation(r).T + t, intrinsics) - landmarks)


def sparsity_energy(w: np.ndarray) -> complex:
    """E_sigma (Eq. 11) as printed: sum over k = 1..n of ||w||_1, whose summand does not depend on k."""
    return sum(np.sum(magnitude(w)) for _ in w)


def range_energy(w: np.ndarray) -> complex:
    """E_beta (Eq. 12) as printed, (pi / 4) (atan((w - a) / b) - atan((w + a - 1) / b)) + c, summed over the weights."""
    steps = np.pi / 4 * (np.arctan((w - A) / B) - np.arctan((w + A - 1) / B)) + C
    return np.sum(steps)


def total_energy(energies: dict[str, complex], omega: dict[str, float]) -> complex:
    """E (Eqs. 5 to 7) of the energies `pose`, `fit`, `tau`, `beta` and `sigma`."""
    sparse = omega["pose"] * energies["pose"] + omega["fit"] * energies["fit"]
    prior = omega["tau"] * energies["tau"] + omega["beta"] * energies["beta"] + omega["sigma"] * energies["sigma"]
    return omega["sparse"] * sparse + omega["prior"] * prior


# Deep Energies


def skinned(
    points: np.ndarray, share: np.ndarray, pivot: np.ndarray, turn: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """x(w) by linear blend skinning of one joint (Sec. 3): the joint carries each point by its share in [0, 1]."""
    carried = (points - pivot) @ turn.T + pivot + shift
    return (1 - share)[:, None] * points + share[:, None] * carried


def rigid(points: np.ndarray, turn: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Eq. 1: x_R = R(theta) x(w) + t."""
    return points @ turn.T + t


def soft_argmax(heatmap: np.ndarray, beta: float = BETA) -> np.ndarray:
    """Eq. 3: the mean of the 3 x 3 pixel positions (column, row) around the maximum, weighted by exp(beta H)."""
    row, column = np.unravel_index(np.argmax(np.real(heatmap)), heatmap.shape)
    above, below = 0, 0
    for y in range(row - 1, row + 2):
        for x in range(column - 1, column + 2):
            weight = np.exp(beta * heatmap[y, x])
            above = above + weight * np.array([x, y])
            below = below + weight
    return above / below


def crop(picture: np.ndarray, box: tuple[int, int, int, int]) -> np.ndarray:
    """C (Sec. 4): the pixels of the picture within the box (left, top, right, bottom), in whole pixels."""
    left, top, right, bottom = box
    return picture[top:bottom, left:right]


def resize(picture: np.ndarray, size: int) -> np.ndarray:
    """S (Sec. 4): a square picture at size x size pixels by bilinear interpolation, the two areas one on the other.

    The centre of pixel k is at k + 1/2 of either area; outside the outermost centres the nearest pixel counts.
    """
    last = len(picture) - 1
    places = np.clip((np.arange(size) + 0.5) * len(picture) / size - 0.5, 0, last)
    low = np.minimum(np.floor(places).astype(int), last - 1)
    share = places - low
    rows = picture[low] * (1 - share)[:, None] + picture[low + 1] * share[:, None]
    return rows[:, low] * (1 - share) + rows[:, low + 1] * share


def full_resolution(positions: np.ndarray, box: tuple[float, float, float, float], size: int = 256) -> np.ndarray:
    """m~ = C^-1(S^-1(4 m^, D), D) (Sec. 4) as printed: times 4, times the box's side over 256, plus its corner."""
    left, top, right, _ = box
    return 4 * positions * (right - left) / size + np.array([left, top])


def landmark_residuals(render: np.ndarray, picture: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """E_1 (Sec. 8.1): W (N(F) - N(F*)), W with one weight a landmark on its diagonal; (68, 2) in pixels."""
    return np.diag(weights) @ (render - picture)


def edge_residuals(render: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """The summands of E_2 (Sec. 8.1), (m*_i - m*_(i-1)) - (m_i - m_(i-1)) for every i that has a predecessor."""
    return np.array([picture[i] - picture[i - 1] - (render[i] - render[i - 1]) for i in range(1, len(render))])


def regularisation(w: np.ndarray, strength: float = LAMBDA) -> np.ndarray:
    """E_2 of Sec. 8.2, lambda w: a vector beside the vector E_1."""
    return strength * w


def deviation(parameters: np.ndarray, initial: np.ndarray, strength: float) -> np.ndarray:
    """The prior of Sec. 5 and Sec. 7, which the paper describes and does not print: deviations from given values."""
    return strength * (parameters - initial)


def infill_energy(picture_flow: np.ndarray, render_flow: np.ndarray) -> complex:
    """Sec. 6: ||N(F1*, F2*) - N(F1, F2)||_2."""
    return np.sqrt(squared(picture_flow - render_flow))


def plate_flow_energy(picture_flows: Sequence[np.ndarray], render_flows: Sequence[np.ndarray]) -> complex:
    """Sec. 7: ||N(F1*, F2*) - N(F1, F2)||_2 + ||N(F2*, F3*) - N(F2, F3)||_2."""
    return sum(infill_energy(picture, render) for picture, render in zip(picture_flows, render_flows, strict=True))


def self_flow_energy(first: np.ndarray, second: np.ndarray) -> complex:
    """Sec. 7: ||N(F1, F2) - N(F2, F3)||_2 of the two flows."""
    return np.sqrt(squared(first - second))


def lerp(first: np.ndarray, last: np.ndarray, share: float) -> np.ndarray:
    """App. A: the straight line from first to last."""
    return (1 - share) * first + share * last


def slerp(first: np.ndarray, last: np.ndarray, share: float) -> np.ndarray:
    """App. A: the shorter great arc between two unit quaternions."""
    nearer = last if first @ last >= 0 else -last
    angle = np.arccos(first @ nearer)
    return (np.sin((1 - share) * angle) * first + np.sin(share * angle) * nearer) / np.sin(angle)


def mean_quaternion(quaternions: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """App. B, reference [49]: the quaternion q that makes q' M q greatest, M = sum_i w_i q_i q_i'; unit length."""
    matrix = sum(weight * np.outer(q, q) for weight, q in zip(weights, quaternions, strict=True))
    return np.linalg.eigh(matrix)[1][:, -1]


def quaternion(turn: np.ndarray) -> np.ndarray:
    """The unit quaternion (x, y, z, w) of a rotation matrix, from the axis and the angle of its antisymmetric part."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = np.arctan2(np.linalg.norm(axis), np.trace(turn) - 1)
    return np.append(axis / np.linalg.norm(axis) * np.sin(angle / 2), np.cos(angle / 2))


def matrix(q: np.ndarray) -> np.ndarray:
    """The rotation matrix of a unit quaternion (x, y, z, w)."""
    v, w = q[:3], q[3]
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * cross


def window_average(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """App. B: the weighted mean over a window of three frames; values (3, k)."""
    return weights @ values / np.sum(weights)


def orthographic(points: np.ndarray, scale: float, t: np.ndarray) -> np.ndarray:
    """App. C.2: the parallel projection along the viewing axis with one uniform scale and a translation in pixels."""
    return scale * points[..., :2] + t
