"""N of Deep Energies: crop, resize, network, soft-argmax and back to the picture's pixels, as one function (Fig. 2)."""

from collections.abc import Callable
from typing import NamedTuple

from jaxtyping import Array, Float

from workbench.arrays import AnyArray, Scalar
from workbench.networks.crop import INPUT_SIDE, CropBox, crop_and_resize, to_picture
from workbench.networks.soft_argmax import BETA, soft_argmax

HeatMapNetwork = Callable[[Float[Array, "3 h w"]], Float[Array, "n m m"]]
"""A crop in 0..1 RGB, channels first, to one heat map for each landmark: 3×256×256 to 68×64×64."""


class NetworkLandmarks(NamedTuple):
    """What the network sees in one picture."""

    points: Float[Array, "n 2"]
    """m̃: the landmarks in the picture's pixels, (0, 0) the centre of the top-left pixel."""
    heat_maps: Float[Array, "n m m"]
    """The network's answer on the crop."""


def landmarks_of(
    network: HeatMapNetwork,
    picture: Float[AnyArray, "h w 3"],
    box: CropBox,
    beta: Scalar = BETA,
    *,
    side: int = INPUT_SIDE,
    reduction: int = 1,
) -> NetworkLandmarks:
    """N(F) = C⁻¹(S⁻¹(4·m̂, D), D) with m̂ the soft-argmax of the network on S(C(F, D), D).

    `picture` is RGB in 0..1; `box` is the network's crop (`fan_box` of a detection for 3D-FAN), constant in the
    derivative. `side` (the network's input) and `reduction` (see `crop_and_resize`) are static, all else may be traced.
    The paper's factor 4 maps edges to edges: heat-map pixel m covers input pixels 4m to 4m + 3, whose middle is
    4(m + 1/2) − 1/2.
    """
    heat_maps = network(crop_and_resize(picture, box, side, reduction))
    points_map = soft_argmax(heat_maps, beta)
    return NetworkLandmarks(to_picture(points_map, box, heat_maps.shape[-1]), heat_maps)
