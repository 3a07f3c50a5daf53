"""The observations for a fit: detections with manual corrections, or landmarks from the energy's own network."""

from dataclasses import replace
from pathlib import Path

from workbench.config import Config
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.surroundings import Surroundings, seen_around
from workbench.session.material import Material
from workbench.tracking import FrameObservation
from workbench.tracking.deep_target import energy_network, photo_landmarks
from workbench.tracking.fitting import corrected
from workbench.tracking.observation import motion_of


class ObservedFrames:
    """Observations by frame and configuration; what Deep Energies takes from a photo is cached."""

    def __init__(self, material: Material) -> None:
        self._material = material
        self._targets: dict[tuple[int, str], tuple[Landmarks2D, Surroundings]] = {}

    def observation(self, frame: int, config: Config, pictured: bool = False) -> FrameObservation:
        """A frame with its moved detections. Raises `InputError` outside the material.

        `pictured`: include the picture if the system renders and there is one.
        """
        self._material.check(frame)
        return corrected(self._detected(frame, config, pictured), config.moved_points(frame))

    def linked_observation(self, frame: int, config: Config) -> FrameObservation:
        """A frame as it is fitted: with the pictures that its flow is found in, if a term needs them."""
        observation, pictures = self.observation(frame, config), self._material.pictures
        if not (config.compares_pictures and pictures.real and frame) or self._material.stills:
            return observation
        return replace(observation, motion=motion_of(pictures[frame - 1], pictures[frame]))

    def _detected(self, frame: int, config: Config, pictured: bool) -> FrameObservation:
        """A frame as the system needs it: Deep Energies runs its own network on the photo, N(F*), unless a run did."""
        observation, pictures = self._material.observations[frame], self._material.pictures
        if not config.traits.renders or observation.landmarks is None or not pictures.real:
            return observation
        picture, key = pictures[frame], (frame, config.deep.network)
        if key not in self._targets:
            seen = observation.landmarks
            if not _same_network(config.deep.network, self._material.network):
                seen = photo_landmarks(energy_network(config.deep.network), picture, seen)
            self._targets[key] = seen, seen_around(picture, seen)
        landmarks, around = self._targets[key]
        return replace(observation, landmarks=landmarks, surroundings=(around,), picture=picture if pictured else None)


def _same_network(one: str, other: str | None) -> bool:
    """Whether two names of `deep.network` mean one network: words, or files under whatever name."""
    return other is not None and (one == other or Path(one).absolute() == Path(other).absolute())
