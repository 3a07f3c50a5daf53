"""The two systems, one row each: what a stage of theirs can free, what they read, and what one can do with them.

Data alone, without JAX. Everything outside the energies and fitters asks these rows instead of a system's name.
"""

from dataclasses import dataclass

PARAMETER_BLOCKS = ("rotation", "translation", "expression", "identity", "jaw_open", "jaw", "scale")
"""What stages can free, in the order of a fit's parameters."""


@dataclass(frozen=True)
class System:
    """One published system."""

    title: str
    blocks: tuple[str, ...]
    """What its stages can free."""
    unread: tuple[str, ...]
    """Sections and keys of a configuration that it does not read."""
    real_time: bool
    """Whether a frame takes milliseconds: a camera can be followed, and a clip fitted after every change."""
    renders: bool
    """Whether it renders the face: N reads the photo's landmarks, a rig's views count together, frames need not wait
    for each other, and every stage has a picture."""
    diagnosed: bool
    """Whether the diagnosis of a frame can try changes to it."""

    def reads(self, path: str) -> bool:
        """Whether it reads a section or a key, as `deep` or `solver.method`."""
        return path not in self.unread and path.split(".")[0] not in self.unread


SYSTEMS = {
    "face-it": System(
        title="FACE IT!",
        blocks=("rotation", "translation", "expression"),
        unread=("deep",),
        real_time=True,
        renders=False,
        diagnosed=True,
    ),
    "deep-energies": System(
        title="Deep Energies",
        blocks=PARAMETER_BLOCKS,
        # It has a solver of its own.
        unread=("solver.method", "solver.tolerance"),
        real_time=False,
        renders=True,
        diagnosed=False,
    ),
}
