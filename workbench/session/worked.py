"""Frames of a clip before and after infill and refinement."""

from dataclasses import dataclass, replace

import numpy as np

from workbench.config import Config
from workbench.session.metrics import metrics_of
from workbench.session.parts import Part
from workbench.tracking import FrameFit

AS_FITTED = "as fitted"


@dataclass(frozen=True, eq=False)
class Worked:
    """Frames of a clip before and after infill and refinement by one configuration."""

    name: str
    config: Config
    part: Part
    before: tuple[FrameFit, ...]
    after: tuple[FrameFit, ...]
    seconds: float

    def pair(self, frame: int) -> tuple[FrameFit, FrameFit] | None:
        """A frame before and after; None outside the part."""
        first, last = self.part
        return (self.before[frame - first], self.after[frame - first]) if first <= frame <= last else None

    @property
    def filled(self) -> tuple[int, ...]:
        """Frames that were filled by infill."""
        return tuple(fit.index for fit in self.after if fit.source == "filled")

    def numbers(self) -> dict[str, float]:
        """Number of filled frames, jitter of the pose in degrees, errors in % of the eye distance, seconds.

        `hidden_percent` covers filled frames that had landmarks, which infill did not use.
        """
        metrics = metrics_of(self.after)
        numbers = {"filled": float(len(self.filled)), "seconds": self.seconds}
        for name, of in (("jitter_deg", "jitter_deg"), ("error_percent", "all_68_percent_mean")):
            if of in metrics:
                numbers[name] = metrics[of]
        hidden = [
            replace(after, observed=before.observed, confidence=before.confidence).errors[2]
            for before, after in zip(self.before, self.after, strict=True)
            if after.source == "filled" and before.seen
        ]
        if hidden:
            numbers["hidden_percent"] = float(np.mean(hidden))
        return numbers


def name_of(config: Config) -> str:
    """The methods of a configuration in a few words."""
    infill, refinement = config.infill.method, config.refinement
    words = [] if infill == "none" else [infill]
    if refinement.method != "none":
        sweeps = f" ×{refinement.sweeps}" if refinement.sweeps > 1 else ""
        words.append(refinement.method + sweeps)
    if refinement.reestimate:
        words.append("re-estimated" + (f" ×{refinement.reestimate}" if refinement.reestimate > 1 else ""))
    return " + ".join(words) or AS_FITTED
