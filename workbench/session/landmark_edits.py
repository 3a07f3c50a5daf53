"""Configurations with edited landmarks: other weights, or positions set by the user."""

from collections.abc import Iterable, Mapping, Set

from workbench.config import Config
from workbench.errors import ConfigError, InputError
from workbench.landmarks.scheme import LandmarkScheme
from workbench.tracking import FrameObservation

LEAST_FACTOR = 1.0 / 64
"""What doubling the weight of a muted landmark starts from."""


def weighed(config: Config, points: Iterable[int], factor: float | int) -> Config:
    """The configuration with this factor on single landmarks in every stage; 0 mutes, 1 leaves as configured."""
    stored = dict(config.landmarks.weights)
    for point in points:
        stored.pop(str(point), None)
        stored[str(point)] = float(factor)
    # A point that no group entry covers needs no entry for a factor of 1.
    groups = {name: value for name, value in stored.items() if not name.isdigit()}
    singles = {name: value for name, value in stored.items() if name.isdigit() and (value != 1.0 or groups)}
    return _with_landmarks(config, "weights", groups | singles)


def unmuted(config: Config, points: Iterable[int], scheme: LandmarkScheme) -> Config:
    """The configuration with single landmarks as their groups have them; at full weight where these are muted."""
    points = tuple(points)
    stored = {name: value for name, value in config.landmarks.weights.items() if name not in map(str, points)}
    grouped = _with_landmarks(config, "weights", stored)
    factors = grouped.point_weights(scheme)
    return weighed(grouped, [point for point in points if factors[point] == 0.0], 1.0)


def rescaled(config: Config, points: Iterable[int], step: float, scheme: LandmarkScheme) -> Config:
    """The configuration with the factor of each of these landmarks multiplied; a muted one begins at `LEAST_FACTOR`."""
    factors = config.point_weights(scheme)
    for point in points:
        config = weighed(config, (point,), max(factors[point], LEAST_FACTOR) * step)
    return config


def moved(config: Config, frame: int, places: Mapping[int, tuple[float, float]]) -> Config:
    """The configuration with corrected detections in one frame: position in pixels by point number."""
    stored = {key: dict(points) for key, points in config.landmarks.moved.items()}
    stored.setdefault(str(frame), {}).update({str(point): (float(x), float(y)) for point, (x, y) in places.items()})
    return _with_landmarks(config, "moved", stored)


def check_movable(observation: FrameObservation, point: int) -> None:
    """Raise `InputError` unless a frame has this landmark."""
    if observation.landmarks is None:
        raise InputError(f"Frame {observation.index} has no landmarks to move.")
    count = len(observation.landmarks.points)
    if not 0 <= point < count:
        raise InputError(f"There is no landmark {point}; this clip has 0 to {count - 1}.")


def put_back(
    config: Config, frame: int, points: Iterable[int], undetected: Set[tuple[int, int]] = frozenset()
) -> Config:
    """The configuration with points of a frame back at their detected positions.

    Those among the `undetected`, (frame, point), stay; raises `InputError` if all do.
    """
    stored, wanted = {key: dict(places) for key, places in config.landmarks.moved.items()}, list(points)
    known = [point for point in wanted if (frame, point) not in undetected]
    if wanted and not known:
        raise InputError(
            f"The track holds landmark {wanted[0]} of frame {frame} where it was moved, not where it was detected; "
            "open the clip itself to put it back."
        )
    for point in known:
        stored.get(str(frame), {}).pop(str(point), None)
    return _with_landmarks(config, "moved", {key: places for key, places in stored.items() if places})


def with_subset(config: Config, name: str, points: Iterable[int]) -> Config:
    """The configuration with a named set of landmarks.

    Raises `ConfigError` for an empty set, the name of a group, and a comma, which separates groups in a text.
    """
    points = tuple(sorted({int(point) for point in points}))
    if not points:
        raise ConfigError("A landmark subset needs at least one point; select some first.")
    if "," in name:
        raise ConfigError(f"A subset cannot be called {name!r}: a comma separates groups; leave it out.")
    return config.changed(subsets={name: points})


def _with_landmarks(config: Config, key: str, value: dict) -> Config:
    return config.changed(landmarks={**config.landmarks.model_dump(), key: value})
