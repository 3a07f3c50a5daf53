"""N of Deep Energies: crop, resize, network, and back to the picture's pixels, as one function (Fig. 2).

Heat maps are read by the soft-argmax (Eq. 3); a dense network answers places, and how sure each is.
"""

from collections.abc import Callable
from typing import NamedTuple

from jaxtyping import Array, Float

from workbench.arrays import AnyArray, Scalar
from workbench.networks.crop import INPUT_SIDE, CropBox, crop_and_resize, to_picture, whitening_in_picture
from workbench.networks.dense_network import DenseNetwork
from workbench.networks.ensemble import EnsembleNetwork
from workbench.networks.fan import Fan
from workbench.networks.landmark_network import LandmarkNetwork
from workbench.networks.soft_argmax import BETA, soft_argmax

HeatMapNetwork = Callable[[Float[Array, "3 h w"]], Float[Array, "n m m"]]
"""A crop in 0..1 RGB, channels first, to one heat map for each landmark: 3×256×256 to 68×64×64."""
EnergyNetwork = Fan | LandmarkNetwork | EnsembleNetwork | DenseNetwork
"""What Deep Energies may have as N."""


class NetworkLandmarks(NamedTuple):
    """What the network sees in one picture."""

    points: Float[Array, "n 2"]
    """m̃: the landmarks in the picture's pixels, (0, 0) the centre of the top-left pixel."""
    heat_maps: Float[Array, "n m m"] | None
    """The network's answer on the crop; None from a dense network."""
    whitening: Float[Array, "n 2 2"] | None = None
    """Takes an error in the picture's pixels to one of unit variance; None from heat maps."""


def landmarks_of(
    network: HeatMapNetwork | DenseNetwork,
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
    return landmarks_in(network, crop_and_resize(picture, box, side, reduction), box, beta)


def landmarks_in(
    network: HeatMapNetwork | DenseNetwork, crop: Float[Array, "3 s s"], box: CropBox, beta: Scalar = BETA
) -> NetworkLandmarks:
    """`landmarks_of` of what a crop shows already, RGB in 0..1."""
    if isinstance(network, DenseNetwork):
        seen, side = network(crop), crop.shape[-1]
        return NetworkLandmarks(
            to_picture(seen.points, box, side), None, whitening_in_picture(seen.whitening, box, side)
        )
    heat_maps = network(crop)
    return NetworkLandmarks(to_picture(soft_argmax(heat_maps, beta), box, heat_maps.shape[-1]), heat_maps)
