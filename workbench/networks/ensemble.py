"""Two landmark networks as one: they err differently, so their mean mostly errs less than either."""

import equinox as eqx
from jaxtyping import Array, Float

from workbench.arrays import AnyArray
from workbench.networks.landmark_network import LandmarkNetwork


class EnsembleNetwork(eqx.Module):
    """The mean of two networks' heat maps; what a soft-argmax reads is the geometric mean of their probabilities."""

    first: LandmarkNetwork
    second: LandmarkNetwork

    def __call__(self, picture: Float[AnyArray, "3 h w"]) -> Float[Array, "n h4 w4"]:
        """Heat maps (68) of a quarter of the picture's size, RGB in 0..1."""
        return 0.5 * (self.first(picture) + self.second(picture))

    def confidence_of(self, heat_maps: Float[AnyArray, "n h w"]) -> Float[AnyArray, "n"]:
        """How likely each landmark is found, 0..1, by the calibration of the first: where the two differ, the mean's
        maps are wide."""
        return self.first.confidence_of(heat_maps)
