"""Lens, sensor and codec for whole batches, wherever PyTorch computes: the twin of `augment.photographed`."""

import math
from functools import cache

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from workbench.landmarks.network_detector import CROP_SIDE
from workbench.training import variation

SIZES = 6
"""Lower resolutions in one batch; the pictures that lose resolution share them."""
LUMINANCE = (
    (16, 11, 10, 16, 24, 40, 51, 61), (12, 12, 14, 19, 26, 58, 60, 55), (14, 13, 16, 24, 40, 57, 69, 56),
    (14, 17, 22, 29, 51, 87, 80, 62), (18, 22, 37, 56, 68, 109, 103, 77), (24, 35, 55, 64, 81, 104, 113, 92),
    (49, 64, 78, 87, 103, 121, 120, 101), (72, 92, 95, 98, 112, 100, 103, 99),
)  # fmt: skip
CHROMINANCE = (
    (17, 18, 24, 47, 99, 99, 99, 99), (18, 21, 26, 66, 99, 99, 99, 99), (24, 26, 56, 99, 99, 99, 99, 99),
    (47, 66, 99, 99, 99, 99, 99, 99), *((99,) * 8,) * 4,
)  # fmt: skip
"""JPEG's tables for quality 50 (ITU-T T.81, annex K)."""
TO_YCC = ((0.299, 0.587, 0.114), (-0.168736, -0.331264, 0.5), (0.5, -0.418688, -0.081312))
TO_RGB = ((1.0, 0.0, 1.402), (1.0, -0.344136, -0.714136), (1.0, 1.772, 0.0))


class Dice:
    """Random numbers for `count` pictures: the few that decide come from the CPU, noise from the device itself.

    Nothing here waits for the device.
    """

    def __init__(self, seed: int, count: int, device: str) -> None:
        self.count, self.device = count, device
        self._decisions = torch.Generator().manual_seed(seed)
        self._noise = torch.Generator(device).manual_seed(seed)

    def one(self, low: float, high: float) -> float:
        """A number for all pictures."""
        return low + (high - low) * float(torch.rand((), generator=self._decisions))

    def uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Numbers of each picture, (count, *shape)."""
        drawn = torch.rand((self.count, *shape), generator=self._decisions)
        return self._there(low + (high - low) * drawn)

    def log_uniform(self, low: float, high: float, *shape: int) -> Tensor:
        """Numbers of each picture whose logarithms are uniform."""
        return self.uniform(math.log(low), math.log(high), *shape).exp()

    def normal(self, deviation: float, *shape: int) -> Tensor:
        """Numbers of each picture about 0."""
        return self._there(deviation * torch.randn((self.count, *shape), generator=self._decisions))

    def cut_off(self, spread: tuple[float, float], *shape: int) -> Tensor:
        """Normal numbers of a deviation, none beyond a largest amount."""
        deviation, largest = spread
        return self.normal(deviation, *shape).clamp(-largest, largest)

    def chance(self, share: float) -> Bool[Tensor, "n"]:
        """Which pictures it happens to."""
        return self._there(torch.rand(self.count, generator=self._decisions) < share)

    def index(self, end: int) -> Tensor:
        """A number below `end` for each picture."""
        return self._there(torch.randint(end, (self.count,), generator=self._decisions))

    def some(self, share: float) -> Tensor:
        """The places of those pictures that it happens to."""
        return self._there((torch.rand(self.count, generator=self._decisions) < share).nonzero()[:, 0])

    def among(self, places: Tensor) -> "Dice":
        """The same dice for some of the pictures."""
        part = object.__new__(Dice)
        part.__dict__ = {**self.__dict__, "count": len(places)}
        return part

    def noise(self, *shape: int) -> Tensor:
        """A standard normal field."""
        return torch.randn(shape, generator=self._noise, device=self.device)

    def _there(self, numbers: Tensor) -> Tensor:
        return numbers if self.device == "cpu" else numbers.pin_memory().to(self.device, non_blocking=True)


def photographed(pictures: Float[Tensor, "n 3 s s"], dice: Dice) -> Float[Tensor, "n 3 s s"]:
    """What lens, sensor and codec do to each picture (0..255): colour, contrast, blur, lost resolution, noise, JPEG."""
    unit = pictures.shape[-1] / CROP_SIDE
    pictures = torch.where(
        _each(dice.chance(variation.DEVELOPED)), _developed(pictures.clamp(0, 255), dice), pictures
    ).clamp(0, 255)
    for share, change in (
        (variation.DIM, _dim),
        (variation.OUT_OF_FOCUS, _out_of_focus),
        (variation.MOVED, _moved),
        (variation.COARSE, _coarse),
        (variation.NOISY, _noisy),
    ):
        places = dice.some(share)
        if len(places):
            pictures = pictures.index_copy(0, places, change(pictures[places], dice.among(places), unit))
    places = dice.some(variation.COMPRESSED)
    return pictures.index_copy(0, places, _compressed(pictures[places], dice.among(places)))


def blurred(
    pictures: Float[Tensor, "n c h w"], deviations: Float[Tensor, "n"], most: float
) -> Float[Tensor, "n c h w"]:
    """Each picture with a Gaussian of its own, of a deviation of at `most` so many pixels."""
    reach = math.ceil(3 * most)
    at = torch.arange(-reach, reach + 1, device=pictures.device)
    kernels = torch.exp(-0.5 * (at / deviations[:, None].clamp_min(1e-3)) ** 2)
    kernels = kernels / kernels.sum(1, keepdim=True)
    return _filtered(_filtered(pictures, kernels[:, None, :]), kernels[:, :, None])


def jpeg(pictures: Float[Tensor, "n 3 h w"], quality: Float[Tensor, "n"]) -> Float[Tensor, "n 3 h w"]:
    """What JPEG leaves of each picture (0..255) at its quality, colours at half the resolution."""
    height, width = pictures.shape[-2:]
    margin = (0, -width % 16, 0, -height % 16)
    to_ycc, to_rgb, *tables = _constants(pictures.device)
    ycc = torch.einsum("ij,njhw->nihw", to_ycc, functional.pad(pictures.clamp(0, 255), margin, "replicate"))
    scale = torch.where(quality < 50, 5000 / quality.clamp_min(1), 200 - 2 * quality)
    luminance, chrominance = (((table * scale[:, None, None] + 50) / 100).floor().clamp(1, 255) for table in tables)
    light = _quantised(ycc[:, :1] - 128, luminance) + 128
    colours = _quantised(functional.avg_pool2d(ycc[:, 1:], 2), chrominance)
    colours = functional.interpolate(colours, scale_factor=2, mode="bilinear")
    decoded = torch.einsum("ij,njhw->nihw", to_rgb, torch.cat([light, colours], 1))
    return decoded[..., :height, :width].round().clamp(0, 255)


@cache
def _constants(device: torch.device) -> list[Tensor]:
    return [torch.tensor(rows, device=device) for rows in (TO_YCC, TO_RGB, LUMINANCE, CHROMINANCE)]


def _quantised(channels: Float[Tensor, "n c h w"], tables: Float[Tensor, "n 8 8"]) -> Float[Tensor, "n c h w"]:
    height, width = channels.shape[-2:]
    k = torch.arange(8, device=channels.device)
    cosines = 0.5 * torch.cos((2 * k + 1) * k[:, None] * math.pi / 16)
    cosines[0] /= math.sqrt(2)
    blocks = channels.unflatten(3, (width // 8, 8)).unflatten(2, (height // 8, 8))
    numbers = torch.einsum("ui,ncaibj,vj->ncaubv", cosines, blocks, cosines)
    steps = tables[:, None, None, :, None, :]
    numbers = (numbers / steps).round() * steps
    return torch.einsum("ui,ncaubv,vj->ncaibj", cosines, numbers, cosines).flatten(4, 5).flatten(2, 3)


def _developed(pictures, dice):
    """Tone curve, colour of the light, saturation, contrast."""
    gamma, gain = (_each(dice.normal(spread).exp()) for spread in (variation.GAMMA_LOGARITHM, variation.GAIN_LOGARITHM))
    curve = (pictures / 255) ** gamma * gain + _each(dice.normal(variation.BLACK))
    pictures = curve * _each(dice.normal(variation.COLOUR_LOGARITHM, 3).exp())
    grey = pictures.mean(1, keepdim=True)
    saturation = torch.where(dice.chance(variation.GREY), 0.0, dice.uniform(*variation.SATURATION))
    pictures = grey + _each(saturation) * (pictures - grey)
    middle = pictures.mean((1, 2, 3), keepdim=True)
    return 255 * (middle + _each(dice.normal(variation.CONTRAST_LOGARITHM).exp()) * (pictures - middle))


def _dim(pictures, dice, _unit):
    """Too little light: few photons, noise by their square root, and brightened again."""
    full = _each(dice.log_uniform(*variation.WHITE_PHOTONS))
    photons = pictures * (full / 255)
    noisy = photons + torch.sqrt(photons + 2.0) * dice.noise(*pictures.shape)
    return noisy * (255 / full) * _each(dice.uniform(*variation.BRIGHTENED))


def _out_of_focus(pictures, dice, unit):
    return blurred(pictures, unit * dice.uniform(*variation.FOCUS_PX), variation.FOCUS_PX[1] * unit)


def _moved(pictures, dice, unit):
    """Motion blur."""
    half = (dice.uniform(*variation.MOTION_PX).floor() * unit).round().clamp_min(3) / 2 - 0.5
    angle = dice.uniform(0, math.pi)
    reach = math.ceil(max(1.0, variation.MOTION_PX[1] // 2 * unit))
    at = torch.arange(-reach, reach + 1, device=pictures.device)
    along = torch.cos(angle)[:, None, None] * at + torch.sin(angle)[:, None, None] * at[:, None]
    across = torch.cos(angle)[:, None, None] * at[:, None] - torch.sin(angle)[:, None, None] * at
    beyond = (along.abs() - half[:, None, None]).clamp_min(0)
    kernels = (1 - torch.hypot(across, beyond)).clamp_min(0)
    return _filtered(pictures, kernels / kernels.sum((1, 2), keepdim=True))


def _coarse(pictures, dice, unit):
    """Lost resolution; in half of the pictures with noise and compression at the lower one."""
    side = pictures.shape[-1]
    made = torch.empty_like(pictures)
    for group in range(SIZES):
        part = pictures[group::SIZES]
        own = dice.among(part)
        if len(part) == 0:
            continue
        size = int(math.exp(dice.one(math.log(variation.LEAST_RESOLUTION_PX), math.log(CROP_SIDE))) * unit)
        small = functional.interpolate(part, size=(min(side, max(size, 4)),) * 2, mode="area")
        worse = own.some(variation.COARSE_DAMAGED)
        if len(worse):
            noise = _each(own.among(worse).uniform(*variation.COARSE_NOISE)) * own.noise(len(worse), *small.shape[1:])
            small = small.index_copy(0, worse, _compressed(small[worse] + noise, own.among(worse)))
        way = "bilinear" if dice.one(0, 1) < variation.SMOOTHLY_ENLARGED else "bicubic"
        made[group::SIZES] = functional.interpolate(small, size=(side, side), mode=way)
    return made


def _noisy(pictures, dice, _unit):
    noise = dice.noise(*pictures.shape)
    widths = torch.full((len(noise),), variation.GRAIN_PX, device=noise.device)
    smooth = 2 * blurred(noise, widths, variation.GRAIN_PX)
    noise = torch.where(_each(dice.chance(variation.GRAINY)), smooth, noise)
    return pictures + _each(dice.log_uniform(*variation.NOISE)) * noise


def _compressed(pictures, dice):
    return jpeg(pictures, dice.uniform(*variation.QUALITY).floor())


def _filtered(pictures: Float[Tensor, "n c h w"], kernels: Float[Tensor, "n k l"]) -> Float[Tensor, "n c h w"]:
    """Each picture with its own kernel, mirrored beyond the border."""
    count, channels = pictures.shape[:2]
    down, across = ((size - 1) // 2 for size in kernels.shape[1:])
    padded = functional.pad(pictures, (across, across, down, down), "reflect").flatten(0, 1)[None]
    weights = kernels.repeat_interleave(channels, dim=0)[:, None]
    return functional.conv2d(padded, weights, groups=count * channels)[0].unflatten(0, (count, channels))


def _each(numbers: Tensor) -> Tensor:
    """Numbers of each picture (n) or of each of its channels (n, 3), to go with (n, 3, h, w)."""
    return numbers.reshape(*numbers.shape, *(1,) * (4 - numbers.ndim))
