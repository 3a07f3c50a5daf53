"""Configurations in which single landmarks count otherwise, or lie where a user put them."""

from collections.abc import Iterable, Mapping

from workbench.config import Config
from workbench.errors import ConfigError


def weighed(config: Config, points: Iterable[int], factor: float | int) -> Config:
    """With this factor of single landmarks in every stage; 0 mutes, 1 is as configured."""
    stored = dict(config.landmarks.weights)
    for point in points:
        stored.pop(str(point), None)
        stored[str(point)] = float(factor)
    # A point that only its own entry touches needs none for a factor of one.
    groups = {name: value for name, value in stored.items() if not name.isdigit()}
    singles = {name: value for name, value in stored.items() if name.isdigit() and (value != 1.0 or groups)}
    return _with_landmarks(config, "weights", groups | singles)


def moved(config: Config, frame: int, places: Mapping[int, tuple[float, float]]) -> Config:
    """With detections of one frame put where they belong: pixels by point."""
    stored = {key: dict(points) for key, points in config.landmarks.moved.items()}
    stored.setdefault(str(frame), {}).update({str(point): (float(x), float(y)) for point, (x, y) in places.items()})
    return _with_landmarks(config, "moved", stored)


def put_back(config: Config, frame: int, points: Iterable[int]) -> Config:
    """With points of a frame at the places that the detector gave them."""
    stored = {key: dict(places) for key, places in config.landmarks.moved.items()}
    for point in points:
        stored.get(str(frame), {}).pop(str(point), None)
    return _with_landmarks(config, "moved", {key: places for key, places in stored.items() if places})


def with_subset(config: Config, name: str, points: Iterable[int]) -> Config:
    """With a named set of landmarks. Raises `ConfigError` for an empty one or a group's name."""
    points = tuple(sorted({int(point) for point in points}))
    if not points:
        raise ConfigError("A landmark subset needs at least one point; select some first.")
    return config.changed(subsets={name: points})


def _with_landmarks(config: Config, key: str, value: dict) -> Config:
    return config.changed(landmarks={**config.landmarks.model_dump(), key: value})
