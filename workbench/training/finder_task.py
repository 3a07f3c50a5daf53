"""The face finder's task: pictures with no, one or several faces, and where their boxes are."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import functional

from workbench.landmarks.alignment import frame_from_points, rolled
from workbench.networks.face_finder import NAME, OUTPUTS, PADDING_GREY, STRIDE, UNIT_SIDE
from workbench.training.augment import cut_out, exposed, photographed, random_background
from workbench.training.loop import Batch, MapsTask, Phase
from workbench.training.pool import Pool

FACES = (0.15, 0.5, 0.2, 0.15)
"""Shares of pictures with no face, one, two and so on."""
MOST_FACES = len(FACES) - 1
SMALLEST, LARGEST = 16.0, 190.0
"""Box sides in pixels of a 256×256 picture."""
SPREAD = 0.18
"""Standard deviation of a face's blob in the score map, in box sides."""
SIZE_WEIGHT = 0.5
DARK = 0.35
"""Share of pictures before a dark ground: stages, halls, the night."""
LEAST_CONTRAST = 9.0
"""Standard deviation of grey values in a box below which nobody could see a face in it."""


@dataclass(frozen=True)
class FinderTask(MapsTask):
    """Four maps: the score (logit) of a box centred here, the log of its side, and the centre's offset."""

    architecture: str = NAME
    outputs: int = OUTPUTS

    def batch(self, pool: Pool, phase: Phase, rngs: list[np.random.Generator]) -> Batch:
        """Pictures, and boxes (centre x, y, side; side 0 where there is none) in pixels."""
        pictures = np.empty((len(rngs), phase.input_side, phase.input_side, 3), np.uint8)
        boxes = np.zeros((len(rngs), MOST_FACES, 3), np.float32)
        for place, rng in enumerate(rngs):
            pictures[place], boxes[place] = crowd(pool, rng, phase.input_side)
        return pictures, (boxes,)

    def loss(self, maps: Float[Tensor, "n 4 h w"], targets: tuple[Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Focal cross entropy of the score, and the errors of size and offset where a face's middle is."""
        (boxes,) = targets
        side = maps.shape[-1]
        at = torch.arange(side, dtype=torch.float32, device=maps.device)
        centre = (boxes[..., :2] + 0.5) / STRIDE - 0.5
        there = boxes[..., 2] > 0
        spread = (SPREAD * boxes[..., 2] / STRIDE).clamp_min(0.7)
        offset_x = centre[..., 0, None] - at
        offset_y = centre[..., 1, None] - at
        squared = offset_y[..., :, None] ** 2 + offset_x[..., None, :] ** 2
        blobs = there[..., None, None] * torch.exp(-0.5 * squared / spread[..., None, None] ** 2)
        target, nearest = blobs.max(dim=1)
        logits = maps[:, 0]
        probability = torch.sigmoid(logits)
        # Where a blob is above a half its middle counts as a face; elsewhere the emptier, the more an alarm costs.
        positive = (target > 0.5).float() * target
        gain = positive * (1 - probability) ** 2 * functional.softplus(-logits)
        alarm = (1 - target) ** 4 * probability**2 * functional.softplus(logits)
        count = positive.sum().clamp_min(1.0)
        score = (gain.sum() + alarm.sum()) / count
        log_side = torch.log(boxes[..., 2].clamp_min(1.0) / UNIT_SIDE)
        chosen = log_side.gather(1, nearest.flatten(1)).view_as(target)
        wanted_x = offset_x[..., None, :].expand_as(squared).gather(1, nearest[:, None])[:, 0] * STRIDE / UNIT_SIDE
        wanted_y = offset_y[..., :, None].expand_as(squared).gather(1, nearest[:, None])[:, 0] * STRIDE / UNIT_SIDE
        wrong = (maps[:, 1] - chosen).abs() + (maps[:, 2] - wanted_x).abs() + (maps[:, 3] - wanted_y).abs()
        size = (positive * wrong).sum() / count
        with torch.no_grad():
            found = ((probability > 0.5).float() * positive).sum() / count
            false = ((probability > 0.5) & (target < 0.1)).float().sum() / len(maps)
        loss = score + SIZE_WEIGHT * size
        return loss, {"loss": loss.detach(), "size": size.detach(), "found": found, "false_cells": false}


def crowd(pool: Pool, rng: np.random.Generator, side: int) -> tuple[np.ndarray, Float[np.ndarray, "faces 3"]]:
    """A picture with up to three heads of any size, and their boxes; those nearer the camera cover the others."""
    picture = random_background(rng, side)
    if rng.random() < DARK:
        picture = picture * np.float32(rng.uniform(0.03, 0.4))
    boxes = np.zeros((MOST_FACES, 3), np.float32)
    sizes = np.sort(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST), rng.choice(len(FACES), p=FACES))))
    scale = side / 256
    kept = 0
    for size in sizes * scale:
        rgba, points = cut_out(pool, int(rng.integers(len(pool))))
        frame = frame_from_points(points[:68].astype(np.float64))
        centre = rng.uniform(-0.1 * size, side + 0.1 * size, 2)
        if any(np.linalg.norm(centre - box[:2]) < 0.8 * max(size, box[2]) for box in boxes[:kept]):
            continue
        picture = _placed(picture, rgba, frame, centre, size, rng)
        if (centre > 0).all() and (centre < side - 1).all():
            boxes[kept] = (*centre, size)
            kept += 1
    for _ in range(rng.poisson(0.5)):
        _decoy(picture, rng)
    picture = np.clip(photographed(picture, rng), 0, 255).astype(np.uint8)
    for box in boxes[:kept]:
        if not can_be_seen(picture, box):
            box[:] = 0.0
    if rng.random() < 0.5:  # the padding of a picture that is not square
        margin = int(rng.uniform(0.1, 0.5) * side)
        if rng.random() < 0.5:
            picture[side - margin :] = PADDING_GREY
            outside = boxes[:, 1] > side - margin
        else:
            picture[:, side - margin :] = PADDING_GREY
            outside = boxes[:, 0] > side - margin
        boxes[outside] = 0.0
    return picture, boxes


def _decoy(picture, rng) -> None:
    """What is as bright as a face and none: hands, collars, cloths of skin's colours."""
    side = len(picture)
    tone = rng.uniform(60, 250) * np.array([1.0, rng.uniform(0.65, 1.0), rng.uniform(0.5, 1.0)])
    centre, size = rng.uniform(0, side, 2), np.exp(rng.uniform(np.log(4), np.log(40))) * side / 256
    if rng.random() < 0.6:  # a palm with fingers
        cv2.ellipse(picture, (tuple(centre), (size, 1.3 * size), float(rng.uniform(0, 180))), tone.tolist(), -1)
        start = rng.uniform(0, 2 * np.pi)
        for finger in range(rng.integers(2, 6)):
            angle = start + 0.3 * finger
            tip = centre + rng.uniform(0.8, 1.4) * size * np.array([np.cos(angle), np.sin(angle)])
            ends = [tuple(np.rint(end).astype(int).tolist()) for end in (centre, tip)]
            shade = (tone * rng.uniform(0.7, 1.1)).tolist()
            cv2.line(picture, *ends, shade, max(1, round(size / 4)), cv2.LINE_AA)
    else:
        outline = centre + rng.normal(0, size, (rng.integers(3, 6), 2))
        cv2.fillPoly(picture, [np.rint(outline).astype(np.int32)], tone.tolist(), cv2.LINE_AA)


def can_be_seen(picture: UInt8[np.ndarray, "s s 3"], box: Float[np.ndarray, "3"]) -> bool:
    """Whether there is anything to see in a box: a face in the dark, or blown out, is no lesson."""
    x, y, half = box[0], box[1], box[2] / 2
    top, left = max(0, round(y - half)), max(0, round(x - half))
    inside = picture[top : round(y + half) + 1, left : round(x + half) + 1]
    return float(inside.mean(axis=2).std()) >= LEAST_CONTRAST


def _placed(picture, rgba, frame, centre, size, rng):
    """The head with its box at `centre`, `size` pixels wide, turned a little."""
    side = len(picture)
    angle = np.radians(np.clip(rng.normal(0, 12), -40, 40) if rng.random() < 0.8 else rng.uniform(-60, 60))
    turn = rolled(angle)
    matrix = turn * size / frame.side
    head = exposed(rgba, rng)
    shrink = frame.side / size
    if shrink > 1.5:  # so that small heads do not alias
        head = cv2.resize(head, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
        matrix, origin = turn, (frame.origin + 0.5) / shrink - 0.5
    else:
        origin = frame.origin
    placement = np.column_stack([matrix, centre - matrix @ origin])
    head = cv2.warpAffine(head, placement, (side, side), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    if rng.random() < 0.8:  # shoulders
        points = centre + size * np.array([[-0.35, 0.8], [-1.1, 1.2], [-1.3, 4], [1.3, 4], [1.1, 1.2], [0.35, 0.8]])
        cv2.fillPoly(picture, [np.rint(points).astype(np.int32)], rng.uniform(0, 255, 3).tolist(), cv2.LINE_AA)
    light = rng.uniform(0.6, 1.15)
    return head[..., :3] * np.float32(light) + picture * (1 - head[..., 3:].astype(np.float32) / 255)
