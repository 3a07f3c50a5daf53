"""The numbers that steer the landmark tracker."""

from dataclasses import dataclass

from workbench.errors import ConfigError


@dataclass(frozen=True)
class TrackerOptions:
    """Numbers that steer the tracker. Lengths named `_sides` are in sides of the face box (about the face's width)."""

    face: tuple[float, float] | None = None
    """A point (x, y) in pixels: follow the face there instead of the largest. Until one is found, none is followed; at
    later cuts the face nearest to the point is taken."""
    check_interval: int = 45
    """Frames between checks: the face is aligned again, as if just detected, and lost if that finds no face there."""
    retry_interval: int = 5
    """Frames between thorough searches while no face is found, doubled after each in vain up to 16 times this. A
    shot starts with a full search, and a quick one is made at every frame."""
    patience: int = 5
    """Frames that flow alone bridges where the predictor fails, as when a hand passes; doubtful fits are checked again
    after as many."""
    accept_confidence: float = 0.3
    """Sureness (`turned_faces.sureness`) from which a newly aligned face is believed."""
    sure_confidence: float = 0.5
    """Sureness below which a quickly found face is compared with those of a thorough search."""
    keep_confidence: float = 0.1
    """Sureness below which a followed face is lost."""
    cut_correlation: float = 0.5
    """Correlation of consecutive thumbnails below which the shot has changed."""
    flow_window: int = 13
    """Side of the Lucas-Kanade window, in pixels of a crop whose face box has 128."""
    round_trip_sides: float = 0.02
    """Largest distance between a point and itself carried forward and back."""
    flow_noise_sides: float = 0.003
    """Standard deviation by which flow misplaces a point from one frame to the next."""
    predictor_noise_sides: float = 0.006
    """Standard deviation of the predictor from frame to frame; its measured scatter is added."""
    surprise: float = 3.0
    """Deviations beyond which predictor and flow contradict each other; then the predictor is followed faster."""
    smallest_visible: float = 0.6
    """Part of the inner 51 points that must lie inside the picture."""
    largest_deviation_sides: float = 0.1
    """Mean deviation from an average face beyond which a shape is no face."""

    def __post_init__(self) -> None:
        for name in ("check_interval", "retry_interval", "flow_window"):
            if getattr(self, name) < 1:
                raise ConfigError(f"tracker option {name} must be at least 1, got {getattr(self, name)}")
        for name in ("accept_confidence", "sure_confidence", "keep_confidence", "cut_correlation", "smallest_visible"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"tracker option {name} must be in 0..1, got {getattr(self, name)}")
        for name in ("round_trip_sides", "flow_noise_sides", "predictor_noise_sides", "surprise"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"tracker option {name} must be positive, got {getattr(self, name)}")


ACCEPT_CONFIDENCE = {"network": 0.25, "network+pupils": 0.25, "dense": 0.25}
"""Of these detectors, whose brows and jaws are rightly less sure than the rest. In boxes without a face their sureness
is below 0.03 in 99 of 100 cases."""


def options_for(detector: str, face: tuple[float, float] | None = None) -> TrackerOptions:
    """For following a face through a video with the detector of this name; `face` as in `TrackerOptions`."""
    least = ACCEPT_CONFIDENCE.get(detector, TrackerOptions.accept_confidence)
    return TrackerOptions(face=face, accept_confidence=least)
