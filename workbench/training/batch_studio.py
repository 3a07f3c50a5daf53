"""Training pictures in whole batches, wherever PyTorch computes: the twin of `augment.augmented`.

The pool lies on the device, with backgrounds, shoulders and things before faces that `augment` has painted; framing,
light and composition are drawn anew for every picture. A GPU makes thousands a second, a processor's core about fifty.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional

from workbench.landmarks.alignment import FaceFrame, frame_from_points
from workbench.landmarks.network_detector import CROP_BOXES, CROP_SIDE, crop_frame
from workbench.landmarks.schemes import DensePoints
from workbench.training import variation
from workbench.training.augment import FEATHER, MIRRORED, occluder, random_background, shoulders
from workbench.training.batch_camera import Dice, photographed
from workbench.training.pool import Pool

BEYOND = 1.3
"""How much wider than the crop things before faces are painted, so that a shifted crop does not cut them off."""
SHOULDERS_BOXES = 3.0
"""Sides of the picture that shoulders are painted into, in face boxes; the face is at the middle of its top."""


@dataclass(frozen=True)
class Props:
    """How many of each are painted; each is used again and again, flipped, enlarged and tinted."""

    backgrounds: int = 2048
    occluders: int = 2048
    shoulders: int = 256


@dataclass(frozen=True, eq=False)
class Placement:
    """Of each picture, the similarity from one thing's pixels to another's: there = here @ matrix.T + origin."""

    matrix: Float[Tensor, "n 2 2"]
    origin: Float[Tensor, "n 2"]

    def __call__(self, points: Float[Tensor, "n k 2"]) -> Float[Tensor, "n k 2"]:
        return points @ self.matrix.mT + self.origin[:, None]

    def after(self, first: "Placement") -> "Placement":
        """This one after another."""
        return Placement(self.matrix @ first.matrix, self(first.origin[:, None])[:, 0])

    def back(self) -> "Placement":
        """The other way."""
        matrix = self.matrix.mT / self.matrix.square().sum((1, 2))[:, None, None] * 2
        return Placement(matrix, -(matrix @ self.origin[..., None])[..., 0])

    def of(self, places: Tensor) -> "Placement":
        """That of some of the pictures."""
        return Placement(self.matrix[places], self.origin[places])


class BatchStudio:
    """A pool of renders on a device, and what stands behind and before them."""

    def __init__(
        self,
        pool: Pool,
        side: int = CROP_SIDE,
        dense: DensePoints | None = None,
        device: str = "cpu",
        props: Props = Props(),
        seed: int = 0,
    ) -> None:
        self.side, self.device = side, device
        indices = range(len(pool))
        points = np.stack([pool.picture(index)[1] for index in indices]).astype(np.float64)
        further = () if dense is None else [np.stack([pool.surface(index, dense.vertices) for index in indices])]
        mirror = MIRRORED if dense is None else (*MIRRORED, *(len(MIRRORED) + dense.mirror))
        points = np.concatenate([points, *further], axis=1)
        self._pictures = torch.cat([
            torch.from_numpy(np.array(shard)).to(device).permute(0, 3, 1, 2).contiguous() for shard in pool.pictures
        ])  # fmt: skip
        size = self._pictures.shape[-1]
        mirrored = points[:, list(mirror)] * [-1, 1] + [size - 1, 0]
        self._points = torch.from_numpy(np.stack([points, mirrored], 1).astype(np.float32)).to(device)
        frames = [[frame_from_points(row[:68]) for row in pair] for pair in zip(points, mirrored, strict=True)]
        self._faces = _placements(frames, device)
        self._views = _placements([[crop_frame(face, side) for face in pair] for pair in frames], device)
        edge = torch.ones(size, device=device)
        edge[:FEATHER] = (torch.arange(FEATHER, device=device) + 0.5) / FEATHER
        edge = edge * edge.flip(0)
        self._fade = edge * edge[:, None]
        self._face_of_occluders, self._face_of_shoulders = (
            _placements([[face]], device) for face in (_wide_face(side), _face_above(side))
        )
        with ThreadPoolExecutor() as painters:
            self._backgrounds = _painted(painters.map(_background(side, seed), range(props.backgrounds)), device)
            self._occluders = _painted(painters.map(_occluder(points, side, seed), range(props.occluders)), device)
            self._shoulders = _painted(painters.map(_shoulders(side, seed), range(props.shoulders)), device)

    def shoot(
        self, count: int, seed: int
    ) -> tuple[Float[Tensor, "n 3 s s"], tuple[Float[Tensor, "n k 2"], Float[Tensor, "n"]]]:
        """Pictures (0..1), and of each its points in pixels and whether there is a face; the same for the same seed."""
        dice = Dice(seed, count, self.device)
        which, flipped = dice.index(len(self._pictures)), dice.chance(variation.MIRRORED_SHARE)
        to_render = self._framed(which, flipped, dice)
        face = to_render.back().after(_rows(self._faces, which, flipped))
        points = to_render.back()(self._points[which, flipped.long()])
        is_face = ~dice.chance(variation.FACELESS)
        head = self._lit(_sampled(self._head(which, flipped), to_render, self.side), dice)
        head = head * is_face[:, None, None, None]
        picture = self._with_bystanders(self._background(dice), dice)
        picture = self._clothed(picture, face, is_face, dice)
        picture = _over(head, picture)
        picture = self._occluded(picture, face, is_face, dice)
        places = dice.some(variation.SHADOWED)
        picture = picture.index_copy(0, places, _shadowed(picture[places], dice.among(places)))
        picture = photographed(picture, dice).clamp(0, 255).floor() / 255
        return picture, (points, is_face.float())

    def _head(self, which, flipped) -> Float[Tensor, "n 4 h w"]:
        heads = self._pictures[which].float() * self._fade
        return torch.where(flipped[:, None, None, None], heads.flip(3), heads)

    def _framed(self, which, flipped, dice) -> Placement:
        """From pixels of the crop that a detector would ask for, more or less, to those of the render."""
        view = _rows(self._views, which, flipped)
        own = torch.atan2(view.matrix[:, 1, 0], view.matrix[:, 0, 0])
        mostly = dice.cut_off(variation.UPRIGHT_ROLL_DEG)
        upright = dice.chance(variation.NEARLY_UPRIGHT)
        roll = torch.deg2rad(torch.where(upright, mostly, dice.uniform(*variation.ANY_ROLL_DEG)))
        scale = dice.cut_off(variation.SCALE_LOGARITHM).exp()
        middle = (self.side - 1) / 2
        shift = dice.cut_off(variation.SHIFT, 2) * self.side
        matrix = view.matrix @ _rolled(roll - own) * scale[:, None, None]
        centre = view((middle + shift)[:, None])[:, 0]
        return Placement(matrix, centre - middle * matrix.sum(2))

    def _lit(self, head, dice):
        """The head as a camera exposes it, in light of some colour: see `augment.exposed`."""
        colours, cover = head[:, :3], head[:, 3:]
        covered = (cover > 127).float()
        grey = ((colours * covered).sum((1, 2, 3)) / (3 * covered.sum((1, 2, 3))).clamp_min(1)).clamp_min(1)
        gain = (dice.uniform(*variation.EXPOSED) / grey).clamp(0.5, variation.MOST_GAIN)
        bright = colours * (gain / 255)[:, None, None, None]
        bright = 255 * torch.where(bright < 0.8, bright, 1 - 0.2 * torch.exp(-(bright - 0.8) / 0.2))
        kept = (dice.chance(variation.KEPT_LIGHT) | (covered.sum((1, 2, 3)) == 0))[:, None, None, None]
        light = 1 + dice.normal(variation.HEAD_COLOUR, 3)
        return torch.cat([torch.where(kept, colours, torch.minimum(bright, cover)) * light[..., None, None], cover], 1)

    def _background(self, dice):
        """One of those painted: a part of it, turned over, its colours exchanged and tinted."""
        pictures = self._backgrounds[dice.index(len(self._backgrounds))].float()
        zoom, middle = dice.uniform(0.5, 1), (self.side - 1) / 2
        upside_down, mirrored = (torch.where(dice.chance(0.5), -1.0, 1.0) * zoom for _ in range(2))
        place = (dice.uniform(-1, 1, 2) * (1 - zoom)[:, None] + 1) * middle
        matrix = torch.diag_embed(torch.stack([mirrored, upside_down], 1))
        pictures = _sampled(pictures, Placement(matrix, place - middle * matrix.sum(2)), self.side)
        order = torch.argsort(dice.uniform(0, 1, 3), 1)
        pictures = pictures.gather(1, order[..., None, None].expand_as(pictures))
        return (pictures * (1 + dice.normal(0.15, 3))[..., None, None]).clamp(0, 255)

    def _with_bystanders(self, background, dice):
        """Now and then somebody else stands behind."""
        places = dice.some(variation.BYSTANDERS)
        if len(places) == 0:
            return background
        dice = dice.among(places)
        heads = self._head(dice.index(len(self._pictures)), dice.chance(0.5))
        size = dice.uniform(*variation.BYSTANDER_PX) * self.side / CROP_SIDE
        corner = torch.stack([dice.uniform(-0.5, 0.5) * size, dice.uniform(-0.5, 0.5) * size], 1)
        corner = corner + dice.uniform(0, 1, 2) * (self.side - size)[:, None].clamp_min(0)
        # Area averaging first, for renders that are drawn much smaller.
        half = functional.avg_pool2d(heads, 2)
        shrink = half.shape[-1] / size
        matrix = torch.eye(2, device=self.device) * shrink[:, None, None]
        small = _sampled(half, Placement(matrix, 0.5 * (shrink[:, None] - 1) - corner * shrink[:, None]), self.side)
        return background.index_copy(0, places, _over(small, background[places]))

    def _clothed(self, picture, face, is_face, dice):
        """Shoulders below the chin."""
        cover = self._shoulders[dice.index(len(self._shoulders))].float() / 255
        cover = _sampled(cover, self._face_of_shoulders.of(0).after(face.back()), self.side, "border")
        cover = cover * (is_face & ~dice.chance(variation.BARE))[:, None, None, None]
        stripes = 1 + variation.CLOTH_GRAIN * dice.noise(len(picture), 1, self.side, 1)
        return picture * (1 - cover) + cover * dice.uniform(0, 255, 3)[..., None, None] * stripes

    def _occluded(self, picture, face, is_face, dice):
        """Something before the face, where it was painted in the face's frame."""
        places = dice.some(variation.OCCLUDED)
        if len(places) == 0:
            return picture
        dice, face = dice.among(places), face.of(places)
        things = self._occluders[dice.index(len(self._occluders))].float()
        things = _sampled(things, self._face_of_occluders.of(0).after(face.back()), self.side)
        tint = (1 + dice.normal(0.15, 3))[..., None, None]
        things = torch.cat([torch.minimum(things[:, :3] * tint, things[:, 3:]), things[:, 3:]], 1)
        things = things * is_face[places][:, None, None, None]
        return picture.index_copy(0, places, _over(things, picture[places]))


def _background(side: int, seed: int) -> Callable[[int], UInt8[np.ndarray, "3 s s"]]:
    def paint(place: int) -> UInt8[np.ndarray, "3 s s"]:
        painted = random_background(np.random.default_rng([seed, 1, place]), side)
        return np.clip(painted, 0, 255).astype(np.uint8).transpose(2, 0, 1)

    return paint


def _occluder(points: Float[np.ndarray, "n k 2"], side: int, seed: int) -> Callable[[int], UInt8[np.ndarray, "4 s s"]]:
    """Colours multiplied by coverage, and coverage: before a face that fills `_wide_face`."""

    def paint(place: int) -> UInt8[np.ndarray, "4 s s"]:
        rng = np.random.default_rng([seed, 2, place])
        face = points[rng.integers(len(points)), :68]
        face = _wide_face(side).to_image(frame_from_points(face).to_face(face))
        canvas = np.empty((side, side, 3), np.float32)
        canvas[:] = rng.uniform(0, 255, 3)
        layer, cover = occluder(canvas, face, rng)
        rgba = np.concatenate([np.clip(layer, 0, 255) * cover, 255 * cover], 2)
        return np.rint(rgba).astype(np.uint8).transpose(2, 0, 1)

    return paint


def _shoulders(side: int, seed: int) -> Callable[[int], UInt8[np.ndarray, "1 s s"]]:
    def paint(place: int) -> UInt8[np.ndarray, "1 s s"]:
        cover = shoulders(_face_above(side), side, np.random.default_rng([seed, 3, place]))
        return np.rint(255 * cover).astype(np.uint8)[None]

    return paint


def _wide_face(side: int) -> FaceFrame:
    """Where the face's box is in the pictures that things before faces are painted into."""
    return FaceFrame(np.eye(2) * side / (CROP_BOXES * BEYOND), np.full(2, (side - 1) / 2))


def _face_above(side: int) -> FaceFrame:
    """Where the face's box is above the pictures that shoulders are painted into."""
    return FaceFrame(np.eye(2) * side / SHOULDERS_BOXES, np.array([(side - 1) / 2, 0.0]))


def _painted(pictures: Iterable[UInt8[np.ndarray, "c s s"]], device: str) -> UInt8[Tensor, "n c s s"]:
    return torch.from_numpy(np.stack(list(pictures))).to(device)


def _placements(frames: list[list[FaceFrame]], device: str) -> Placement:
    matrix = torch.tensor(np.array([[frame.matrix for frame in row] for row in frames]), dtype=torch.float32)
    origin = torch.tensor(np.array([[frame.origin for frame in row] for row in frames]), dtype=torch.float32)
    return Placement(matrix.to(device), origin.to(device))


def _rows(placements: Placement, which: Tensor, flipped: Tensor) -> Placement:
    return Placement(placements.matrix[which, flipped.long()], placements.origin[which, flipped.long()])


def _rolled(angle: Float[Tensor, "n"]) -> Float[Tensor, "n 2 2"]:
    cosine, sine = torch.cos(angle), torch.sin(angle)
    return torch.stack([torch.stack([cosine, -sine], 1), torch.stack([sine, cosine], 1)], 1)


def _sampled(
    pictures: Float[Tensor, "n c h h"], to_pictures: Placement, side: int, beyond: str = "zeros"
) -> Float[Tensor, "n c s s"]:
    """A square of each picture, bilinear."""
    at = torch.arange(side, dtype=torch.float32, device=pictures.device)
    pixels = torch.stack(torch.meshgrid(at, at, indexing="xy"), -1).reshape(1, -1, 2)
    places = to_pictures(pixels.expand(len(pictures), -1, 2)).unflatten(1, (side, side))
    grid = (2 * places + 1) / pictures.shape[-1] - 1
    return functional.grid_sample(pictures, grid, padding_mode=beyond, align_corners=False)


def _over(rgba: Float[Tensor, "n 4 h w"], picture: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 3 h w"]:
    return rgba[:, :3] + picture * (1 - rgba[:, 3:] / 255)


def _shadowed(pictures, dice):
    """A soft or hard edge of shadow or light across each picture."""
    at = torch.linspace(-1, 1, pictures.shape[-1], device=pictures.device)
    angle, place = dice.uniform(0, 2 * np.pi), dice.uniform(*variation.SHADOW_PLACE)
    steepness = dice.uniform(*variation.SHADOW_STEEPNESS_LOGARITHM).exp()
    across = torch.cos(angle)[:, None, None] * at + torch.sin(angle)[:, None, None] * at[:, None] - place[:, None, None]
    share = torch.sigmoid(-across * steepness[:, None, None])
    return pictures * (1 + dice.uniform(*variation.SHADOW_LIGHT)[:, None, None] * share)[:, None]
