"""What Deep Energies is run on: N(F*) in place of a detector's landmarks, and several cameras."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from types import MappingProxyType

import numpy as np

from workbench.config import Config
from workbench.errors import InputError
from workbench.frames import Frames
from workbench.geometry import read_rig
from workbench.landmarks.observations import Landmarks2D, of_ibug68
from workbench.landmarks.scheme import IBUG68
from workbench.landmarks.surroundings import seen_around
from workbench.pipeline.picture_source import PictureSource
from workbench.pipeline.sources import FileSource, open_source
from workbench.tracking import FrameObservation
from workbench.tracking.deep_target import energy_network, network_scheme, photo_landmarks
from workbench.tracking.observation import PicturePair

SAME_RATE = 1.01
"""Ratio of two clips' mean frame rates up to which they are taken for one rate: 29.97 and 30 differ by less."""


class DeepSource:
    """Another source's frames with N(F*) in place of the detector's landmarks."""

    def __init__(self, source: PictureSource | FileSource, config: Config):
        self._source = source
        self._network = energy_network(config.deep.network)
        self.frames, self.image_size, self.detector = source.frames, source.image_size, source.detector
        self.count, self.single_picture = source.count, source.single_picture
        self.views, self.scheme = source.views, network_scheme(config.deep.network)
        self._without_pictures, self._renders = False, config.deep.energy != "points"

    def notes(self) -> list[str]:
        given = "Without pictures the given landmarks stand for what the network would see in them."
        return [*self._source.notes(), *([given] if self._without_pictures else [])]

    def observations(self, start: int, state: dict[str, np.ndarray], stills: bool) -> Iterator[FrameObservation]:
        for observation in self._source.observations(start, state, stills):
            landmarks = self._target(observation.picture, observation.landmarks)
            around = seen_around(observation.picture if self._renders else None, landmarks)
            yield replace(observation, landmarks=landmarks, surroundings=(around,))

    def state(self) -> dict[str, np.ndarray]:
        return self._source.state()

    def _target(self, picture: np.ndarray | None, landmarks: Landmarks2D | None) -> Landmarks2D | None:
        if landmarks is None:
            return None
        if picture is None:
            self._without_pictures = True
            return of_ibug68(landmarks) if self.scheme is IBUG68 else landmarks
        return photo_landmarks(self._network, picture, landmarks)


class RigSource:
    """Clips of one performance from several cameras, frame by frame; pictures are those of the first view."""

    def __init__(self, sources: Sequence["DeepSource"], names: Sequence[str]):
        self._sources, self._names = sources, names
        reference = sources[0]
        self.frames, self.image_size, self.detector = reference.frames, reference.image_size, reference.detector
        counts = [source.count for source in sources if source.count is not None]
        self.count = min(counts) if counts else None
        self.single_picture = all(source.single_picture for source in sources)
        self.views, self.scheme = [source.frames for source in sources], reference.scheme

    def notes(self) -> list[str]:
        counts = {name: source.count for name, source in zip(self._names, self._sources, strict=True)}
        unequal = len({count for count in counts.values() if count is not None}) > 1
        listed = ", ".join(f"{name}: {count}" for name, count in counts.items())
        uneven = [f"The views have different numbers of frames ({listed}); the shortest counts."] if unequal else []
        notes = dict.fromkeys(note for source in self._sources for note in source.notes())
        return [*notes, *uneven, *_notes_on_rates(dict(zip(self._names, self.views, strict=True)))]

    def observations(self, start: int, state: dict[str, np.ndarray], stills: bool) -> Iterator[FrameObservation]:
        streams = [source.observations(start, {}, stills) for source in self._sources]
        # Not strict: the shortest clip ends the run.
        for reference, *others in zip(*streams, strict=False):
            motion = _joined([reference.motion, *(other.motion for other in others)])
            around = tuple(chain(reference.surroundings, *(other.surroundings for other in others)))
            landmarks = tuple(other.landmarks for other in others)
            yield replace(reference, others=landmarks, surroundings=around, motion=motion)

    def state(self) -> dict[str, np.ndarray]:
        return {}


def _notes_on_rates(views: Mapping[str, Frames | None]) -> list[str]:
    """One sentence where videos have different frame rates; none where they have the same."""
    rates = {name: view.rate for name, view in views.items() if view is not None and view.kind == "video" and view.rate}
    if not rates or max(rates.values()) <= SAME_RATE * min(rates.values()):
        return []
    listed = ", ".join(f"{name}: {rate:.4g}" for name, rate in rates.items())
    return [
        f"The views have different frame rates ({listed} frames/s), and frames are matched by number: convert the "
        "clips to one rate first."
    ]


def _joined(motions: Sequence[PicturePair | None]) -> PicturePair | None:
    """The pairs of all views as one; None where a view has none."""
    if any(motion is None for motion in motions):
        return None
    return PicturePair(*(tuple(chain(*pictures)) for pictures in zip(*motions, strict=True)))


def open_deep_source(
    paths: list[Path],
    config: Config,
    landmarks: Path | None,
    frames: tuple[int, int] | None = None,
    views: Mapping[str, Path] = MappingProxyType({}),
) -> DeepSource | RigSource:
    """The source of a Deep Energies run; `views` are the clips of a rig's other cameras by the views' names.

    Raises `InputError` for views that the rig does not have or that are missing, and for clips that are not scaled
    copies of what it was calibrated with.
    """
    reference = open_source(paths, config, landmarks, frames, keep_pictures=True)
    if not config.camera.rig:
        if views:
            raise InputError("Clips of several views need their calibration; name the rig file (camera.rig, --rig).")
        return DeepSource(reference, config)
    rig = read_rig(config.camera.rig)
    names = rig.names
    unknown = [name for name in views if name not in names[1:]]
    missing = [name for name in names[1:] if name not in views]
    if unknown or missing:
        what = f"has no view {unknown[0]!r}" if unknown else f"needs the clip of its view {missing[0]!r}"
        raise InputError(
            f"The rig {what}; the input is its first view {names[0]!r}, and the others ({', '.join(names[1:])}) are "
            "given as --view NAME=CLIP."
        )
    config_elsewhere = config.changed(landmarks={"face": None})  # a pixel of the first view
    others = [open_source([views[name]], config_elsewhere, None, frames, keep_pictures=True) for name in names[1:]]
    sources = [DeepSource(source, config) for source in (reference, *others)]
    rig.resized([source.image_size for source in sources])
    return RigSource(sources, names)
