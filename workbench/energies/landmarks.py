"""E_pose and E_fit (FACE IT! Eqs. 8, 10) and E_1 (Deep Energies Eq. 2): model landmarks against observed ones."""

from jaxtyping import Array, Float

from workbench.energies.context import LandmarkErrors


def landmark_residual(errors: LandmarkErrors) -> Float[Array, "n"]:
    """√weight · (π(R·P_i + t) − p_i) in units of the view, so that its square sum is Eq. 8 or, with the pose of Eq. 8,
    Eq. 10. With landmarks that the network sees in a render it is Eq. 2 of Deep Energies."""
    return (errors.error * errors.root[..., None] / errors.unit).ravel()
