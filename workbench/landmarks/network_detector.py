"""Faces and landmarks by the workbench's own networks: no other package, no licence strings, closed eyes are seen.

Trained on renders of the default head alone (`workbench/networks/bundled/MODEL_CARD.md` has data, recipe and limits).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from workbench.arrays import AnyArray
from workbench.landmarks.alignment import MEAN_SHAPE, FaceFrame, frame_from_box, frame_from_points, rolled, sampled
from workbench.landmarks.detection import Box, Effort, FaceDetection
from workbench.landmarks.lids import true_lids
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import GROUPS, MIRROR
from workbench.landmarks.turned_faces import sureness
from workbench.networks import BETA, Calibration, CropBox, LandmarkNetwork, place_and_mass, read_landmark_network
from workbench.networks.face_finder import FaceFinder, FoundFace, read_face_finder, without_doubles
from workbench.networks.frozen import FrozenNetwork
from workbench.networks.landmark_network import LANDMARKS, confidence_by_mass

CROP_SIDE = 256
"""Pixels of the network's input."""
CROP_BOXES = 1.6
"""Face boxes (see `landmarks.alignment`) across the network's input."""
CROP_DROP = 0.1
"""How far the crop's centre is below the box's, in box sides."""
STILL_MOVES = ((0.0, 0.0, 1.0), (0.0, -0.02, 0.94), (0.0, 0.02, 1.06))
"""Moved frames (x, y in box sides, scale) whose answers are averaged on a still, each also mirrored. None moves
sideways: a mirrored picture gets the mirrored answer."""
OTHER_ROLLS = (-0.9, 0.9)
"""Rolls in radians that are looked at too where the upright look leaves doubt: training went up to 40 degrees."""
DOUBTFUL = 0.8
"""Median confidence of the inner points up to which a look leaves doubt; wrong answers reach 0.7."""
CLEAR = 0.9
"""Sureness (`turned_faces`) below which a followed face is looked at twice, the second time mirrored. On such renders
that takes 9 to 10 percent off the error; on a clear face, two looks are not worth a slower frame."""
LEAST_FACE = 0.3
"""Median confidence of the inner points from which a face is certain; of boxes of walls and hands, 99 in 100 are below
0.03."""
STEADY_SIDES, STEADY_CONFIDENCE = 0.02, 0.34
"""A face may be doubtful, as a profile is, of which half the points are hidden: it counts where six looks at it scatter
by at most this much (box sides, median of the inner points), and the quarter of them that is surest is this sure."""
PROMISING = 0.15
"""Confidence of that quarter at first sight from which six looks are worth their time."""
CANDIDATES = 8
"""The finder's surest proposals that the landmark network looks at."""
SMALLEST_SIDE = 16
"""Pictures with a shorter side in pixels hold no face with 68 landmarks."""

_INNER = np.array(GROUPS["inner"])
BUNDLED = Path(__file__).resolve().parent.parent / "networks" / "bundled"


class _Proposal(NamedTuple):
    """A proposal of the finder's, looked at."""

    look: Landmarks2D
    score: float


@dataclass(frozen=True, eq=False)
class NetworkLook:
    """One look of the landmark network: its answer, and what it made it of."""

    landmarks: Landmarks2D
    probability: Float[np.ndarray, "68 m m"]
    """Of each landmark's place, over a map that spans the crop; sums to one."""
    to_image: FaceFrame
    """Takes the pixels of the crop (`CROP_SIDE` a side) to the picture's."""


class NetworkDetector:
    """The network detector, with the bundled weights or others of the same kind."""

    name = "network"

    def __init__(self, landmarks: LandmarkNetwork | None = None, finder: FaceFinder | None = None) -> None:
        network = landmarks or bundled_landmark_network()
        self._maps = FrozenNetwork(network)
        self._calibration = jax.tree.map(np.asarray, network.calibration)
        self._finder = finder or bundled_face_finder()

    def detect_faces(self, picture: UInt8[np.ndarray, "h w 3"], effort: Effort = "full") -> list[FaceDetection]:
        """Faces, the largest first: what the finder finds and the landmark network agrees to.

        "quick" looks at the whole picture for upright faces; the others for rolled ones too, and if there is no face at
        first sight, at ever smaller parts of it until there is one. If nothing is certain, what they doubted counts
        where it stays in other looks.
        """
        if min(picture.shape[:2]) < SMALLEST_SIDE:
            return []
        quick, doubtful = effort == "quick", []
        proposals = chain([self._finder.find(picture)], () if quick else self._finder.find_smaller(picture))
        for found in proposals:
            seen = [self._proposed(picture, face, quick) for face in found[:CANDIDATES]]
            sure = [face for face in seen if _median_confidence(face.look) > LEAST_FACE]
            if sure:
                return _boxes(sure)
            doubtful += seen
        return [] if quick else _boxes(self._steady(picture, doubtful))

    def align(self, picture: UInt8[np.ndarray, "h w 3"], box: Box) -> Landmarks2D:
        """The landmarks of the face in `box`: a look that finds its frame, then the mean of six in that frame."""
        return _mean_look(self._looks(picture, box))

    def refine(self, picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "points 2"]) -> Landmarks2D:
        """The landmarks of the face near `points`: by one look, or the mean of two where it is not clear."""
        face = frame_from_points(points)
        look = self._look(picture, face)
        return look if sureness(look) >= CLEAR else _mean_look([look, self._look(picture, face, mirrored=True)])

    def look(self, picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "points 2"]) -> NetworkLook:
        """What the network sees in the crop around `points`, with the lids as they are: `refine`'s first look."""
        to_image = crop_frame(frame_from_points(points))
        landmarks, heat_maps = self._answer(sampled_crop(picture, to_image), picture, to_image, mirrored=False)
        return NetworkLook(landmarks, _probability(heat_maps[:LANDMARKS]), to_image)

    def _looks(self, picture: np.ndarray, box: Box) -> list[Landmarks2D]:
        """Six looks at a still, in the frame that a first one finds."""
        return self._looks_about(picture, self._first_look(picture, box))

    def _looks_about(self, picture: np.ndarray, first: Landmarks2D) -> list[Landmarks2D]:
        face = frame_from_points(first.points)
        return [
            self._look(picture, face.moved(x, y, scale), mirrored)
            for x, y, scale in STILL_MOVES
            for mirrored in (False, True)
        ]

    def _proposed(self, picture: np.ndarray, found: FoundFace, quick: bool) -> "_Proposal":
        """What the landmark network sees in a proposal of the finder's."""
        box, score = found
        return _Proposal(self._look(picture, frame_from_box(box)) if quick else self._first_look(picture, box), score)

    def _steady(self, picture: np.ndarray, doubtful: list["_Proposal"]) -> Iterator["_Proposal"]:
        """Of doubtful faces those on which six looks agree, by the mean of these looks."""
        by_promise = sorted(((_surest(face.look), face) for face in doubtful), key=lambda pair: -pair[0])
        for promise, face in by_promise[:CANDIDATES]:
            if promise < PROMISING:
                return
            looks = self._looks_about(picture, face.look)
            mean = _mean_look(looks)
            if _scatter(looks, mean) <= STEADY_SIDES and _surest(mean) >= STEADY_CONFIDENCE:
                yield _Proposal(mean, face.score)

    def _first_look(self, picture: np.ndarray, box: Box) -> Landmarks2D:
        """The upright look at a box, or the surest of several rolled ones where that leaves doubt."""
        upright = frame_from_box(box)
        best = self._look(picture, upright)
        for roll in OTHER_ROLLS:
            if _median_confidence(best) > DOUBTFUL:
                break
            best = max(best, self._look(picture, _rolled(upright, roll)), key=_median_confidence)
        return best

    def _look(self, picture: np.ndarray, face: FaceFrame, mirrored: bool = False) -> Landmarks2D:
        to_image = crop_frame(face)
        landmarks, _ = self._answer(sampled_crop(picture, to_image, mirrored), picture, to_image, mirrored)
        return replace(landmarks, points=true_lids(landmarks.points))

    def _answer(
        self, crop: np.ndarray, picture: np.ndarray, to_image: FaceFrame, mirrored: bool
    ) -> tuple[Landmarks2D, np.ndarray]:
        """Landmarks in the picture, and the network's heat maps (of the mirrored crop if it was)."""
        heat_maps = self._maps(crop)
        points, confidence = _read(heat_maps[:LANDMARKS], self._calibration)
        if mirrored:
            points, confidence = points[list(MIRROR)], confidence[list(MIRROR)]
            points[:, 0] = CROP_SIDE - 1 - points[:, 0]
        size = (picture.shape[1], picture.shape[0])
        return Landmarks2D(to_image.to_image(points), np.clip(confidence, 0, 1), size), heat_maps


def sampled_crop(
    picture: UInt8[np.ndarray, "h w 3"], to_image: FaceFrame, mirrored: bool = False
) -> UInt8[np.ndarray, "s s 3"]:
    """The networks' input, or its mirror image; `to_image` takes the pixels of the unmirrored one to the picture's."""
    crop = sampled(picture, to_image, CROP_SIDE, cv2.BORDER_CONSTANT)
    return np.ascontiguousarray(crop[:, ::-1]) if mirrored else crop


def crop_frame(face: FaceFrame, side: int = CROP_SIDE) -> FaceFrame:
    """The similarity from the pixels of the network's input to the picture's, for this face."""
    return face.moved(y=CROP_DROP, scale=CROP_BOXES).crop(side)


def network_box(face: FaceFrame) -> CropBox:
    """The same view of a face for the differentiable chain (`networks.landmarks_of`)."""
    square = face.moved(y=CROP_DROP, scale=CROP_BOXES)
    return CropBox(square.origin, np.float64(square.side), np.arctan2(face.matrix[1, 0], face.matrix[0, 0]))


def landmark_crop(points: Float[AnyArray, "points 2"]) -> CropBox:
    """`network_box` of the face frame of known landmarks (pixels), of which the inner of the 68 count; traceable."""
    source = MEAN_SHAPE[_INNER] - MEAN_SHAPE[_INNER].mean(axis=0)
    middle = points[_INNER].mean(axis=0)
    turned = np.stack([-source[:, 1], source[:, 0]], axis=1)
    offsets = points[_INNER] - middle
    cosine, sine = (jnp.sum(offsets * axis) / np.sum(source**2) for axis in (source, turned))
    matrix = jnp.stack([jnp.stack([cosine, -sine]), jnp.stack([sine, cosine])])
    centre = middle + matrix @ (np.array([0.0, CROP_DROP]) - MEAN_SHAPE[_INNER].mean(axis=0))
    return CropBox(centre, CROP_BOXES * jnp.hypot(cosine, sine), jnp.arctan2(sine, cosine))


@cache
def bundled_landmark_network() -> LandmarkNetwork:
    """The landmark network that comes with the package."""
    return read_landmark_network(BUNDLED / "landmarks.safetensors")


@cache
def bundled_face_finder() -> FaceFinder:
    """The face finder that comes with the package."""
    return read_face_finder(BUNDLED / "finder.safetensors")


def _read(
    heat_maps: Float[np.ndarray, "n m m"], calibration: Calibration | None
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Points in the crop's pixels, and confidences."""
    stride = CROP_SIDE / heat_maps.shape[-1]
    places, mass = (read.astype(np.float64) for read in place_and_mass(heat_maps))
    return (places + 0.5) * stride - 0.5, confidence_by_mass(mass, calibration)


def _probability(heat_maps: Float[np.ndarray, "n m m"]) -> Float[np.ndarray, "n m m"]:
    """Softmax of β·H over each map: the networks are trained for this."""
    share = np.exp(BETA * (heat_maps - heat_maps.max(axis=(1, 2), keepdims=True)))
    return share / share.sum(axis=(1, 2), keepdims=True)


def _rolled(face: FaceFrame, roll: float) -> FaceFrame:
    return FaceFrame(face.matrix @ rolled(roll), face.origin)


def _median_confidence(landmarks: Landmarks2D) -> float:
    """Median confidence of the inner points: the contour is a guess on many good faces."""
    return float(np.median(landmarks.confidence[_INNER]))


def _surest(landmarks: Landmarks2D) -> float:
    """The confidence that a quarter of the inner points reach."""
    return float(np.quantile(landmarks.confidence[_INNER], 0.75))


def _mean_look(looks: list[Landmarks2D]) -> Landmarks2D:
    """The mean of looks at one face; of covariances too, because looks err alike."""
    told = ("points", "confidence") if looks[0].covariance is None else ("points", "confidence", "covariance")
    return replace(looks[0], **{name: np.mean([getattr(look, name) for look in looks], axis=0) for name in told})


def _scatter(looks: list[Landmarks2D], mean: Landmarks2D) -> float:
    """Root mean square distance of the looks' points from the mean, in box sides; the median of the inner points."""
    squares = np.mean([((look.points - mean.points) ** 2).sum(axis=-1) for look in looks], axis=0)
    return float(np.median(np.sqrt(squares)[_INNER])) / frame_from_points(mean.points).side


def _boxes(faces: Iterable[_Proposal]) -> list[FaceDetection]:
    """The boxes of the landmarks, none twice, the largest first."""
    found = without_doubles([(frame_from_points(face.look.points).box(), face.score) for face in faces])
    return sorted((FaceDetection(box, score) for box, score in found), key=lambda face: -face.area)
