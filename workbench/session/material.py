"""The material for tuning: the landmarks of every frame, and its pictures, decoded on demand."""

import os
import threading
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from workbench.config import Config, Hashed
from workbench.errors import InputError
from workbench.frames import Frame, Frames, images_in_folder
from workbench.landmarks.observations import Landmarks2D, scheme_of_faces
from workbench.landmarks.scheme import LandmarkScheme
from workbench.pipeline import is_landmark_file, open_source
from workbench.session.opened_files import OpenedFiles
from workbench.tracking import FrameObservation

KEPT_BYTES = 256 << 20
"""Bytes of decoded pictures that a session keeps."""
FORWARD_FRAMES = 24
"""A frame that lies this little ahead is read by going on: seeking decodes from the key frame before it."""
CANVAS = 235
"""Grey level where a frame has no picture."""


class PictureStore:
    """Pictures by frame index, decoded on demand; the latest ones are cached. Thread-safe."""

    def __init__(
        self,
        frames: Frames | None,
        sizes: Sequence[tuple[int, int]],
        kept_bytes: int = KEPT_BYTES,
        given: Sequence[UInt8[np.ndarray, "h w 3"]] = (),
    ):
        """`sizes`: (width, height) of each frame, for blank pictures if `frames` is None or ends early.

        `given`: pictures already in memory, used instead of `frames`.
        """
        self._frames, self._sizes, self._kept_bytes, self._given = frames, sizes, kept_bytes, given
        self._kept: OrderedDict[int, np.ndarray] = OrderedDict()
        self._next, self._stream = 0, None
        self._lock = threading.Lock()

    @property
    def real(self) -> bool:
        """Whether there are actual pictures rather than only their sizes."""
        return self._frames is not None or bool(self._given)

    @property
    def frames(self) -> Frames | None:
        """The pictures as a stream."""
        return self._frames

    def __getitem__(self, index: int) -> UInt8[np.ndarray, "h w 3"]:
        with self._lock:
            if index not in self._kept:
                self._keep(index, self._read(index))
            self._kept.move_to_end(index)
            return self._kept[index]

    def _read(self, index: int) -> np.ndarray:
        if self._frames is None:
            return self._given[index] if index < len(self._given) else self._blank(index)
        if self._stream is None or not 0 <= index - self._next < FORWARD_FRAMES:
            self._stream, self._next = self._frames.iterate(index), index
        frame: Frame | None = None
        try:
            for _ in range(index - self._next + 1):
                frame = next(self._stream, None)
        except BaseException:
            self._stream = None  # it has ended with its error, but the picture may come back
            raise
        self._next = index + 1
        return self._blank(index) if frame is None else frame.picture

    def _blank(self, index: int) -> np.ndarray:
        width, height = self._sizes[index]
        return np.full((height, width, 3), CANVAS, np.uint8)

    def _keep(self, index: int, picture: np.ndarray) -> None:
        picture.setflags(write=False)
        self._kept[index] = picture
        while len(self._kept) > 1 and sum(kept.nbytes for kept in self._kept.values()) > self._kept_bytes:
            self._kept.popitem(last=False)


@dataclass(frozen=True, eq=False)
class Material:
    """A photo, photos, a clip or stored landmarks, with the landmarks of every frame."""

    name: str
    observations: tuple[FrameObservation, ...]
    pictures: PictureStore | None
    """None: for fits alone, which a panel cannot show."""
    stills: bool
    """Whether the frames are unrelated photos."""
    inputs: tuple[Path, ...] = ()
    landmark_file: Path | None = None
    part: tuple[int, int] | None = None
    """First and last frame of the inputs that these are, where not all of them; counted from 0 here all the same."""
    views: Mapping[str, Path] = field(default_factory=dict)
    """Clips of a rig's other cameras by the views' names."""
    undetected: frozenset[tuple[int, int]] = frozenset()
    """(frame, point) of landmarks that are known only where a user moved them."""
    tracked_rate: float | None = None
    """Frames per second of the pictures that a stored run was tracked on, which may be gone."""
    network: str | None = None
    """`deep.network` of a stored run of Deep Energies, whose landmarks are this network's answers; else None."""
    detector: str | None = None
    """What found the landmarks in the inputs; None: they are from a file, or found in a picture in memory."""
    opened: OpenedFiles | None = None
    """The inputs, the landmark file and the views as they were opened; None: as they are now."""

    def __post_init__(self) -> None:
        if self.opened is None:
            opened = OpenedFiles([*self.inputs, *self.views.values(), self.landmark_file])
            object.__setattr__(self, "opened", opened)

    @property
    def rate(self) -> float | None:
        """Frames per second; None if unknown."""
        frames = None if self.pictures is None else self.pictures.frames
        return getattr(frames, "rate", None) or self.tracked_rate

    @cached_property
    def shots(self) -> tuple[range, ...]:
        """The frames of each shot, as the tracker divides them."""
        starts = [k for k, item in enumerate(self.observations) if k == 0 or item.cut or self.stills]
        return tuple(range(*pair) for pair in zip(starts, [*starts[1:], len(self.observations)], strict=True))

    @cached_property
    def scheme(self) -> LandmarkScheme:
        """What the landmarks are called; iBUG's 68 if no frame has a face."""
        return scheme_of_faces(item.landmarks for item in self.observations)

    def check(self, frame: int) -> None:
        """Raises `InputError` for a frame outside the material."""
        count = len(self.observations)
        if not 0 <= frame < count:
            raise InputError(f"There is no frame {frame}; {self.name} has frames 0 to {count - 1}.")

    def sources(self) -> list[Hashed]:
        """Each input, as it was opened."""
        return [named for path in self.inputs if (named := self._named(path))]

    def landmark_source(self) -> Hashed | None:
        """The landmark file, as it was opened; None if the landmarks came from a detector."""
        return self._named(self.landmark_file)

    def _named(self, path: Path | None) -> Hashed | None:
        record = self.opened.record(path)
        return Hashed(str(path), record["sha256"]) if record else None


Progress = Callable[[str, int, int | None], None]
Cancelled = Callable[[], bool]


def stored_track(path: str | Path, folders: bool = True) -> Path | None:
    """The file of the track that a path names, itself or (with `folders`) by its run's folder; None for none."""
    path = Path(path)
    if path.suffix.lower() == ".npz":
        return path
    track = path / "track.npz"
    return track if folders and (_is_track(track) or _should_be_track(track)) else None


def _is_track(path: Path) -> bool:
    """Whether a file looks like a track, and not like other arrays beside photos."""
    try:
        with zipfile.ZipFile(path) as archive:
            return "meta.npy" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def _should_be_track(path: Path) -> bool:
    """Whether a file is missing or damaged in the folder of a run: reading the track then says what is wrong."""
    if zipfile.is_zipfile(path):
        return False
    results = [os.path.isfile(path.with_name(name)) for name in ("config.toml", "summary.json")]
    if os.path.lexists(path):
        return any(results) or not _holds_pictures(path.parent)
    return all(results) and not _holds_pictures(path.parent)


def _holds_pictures(folder: Path) -> bool:
    """Whether there are pictures beside those that a run draws."""
    from workbench.pipeline.output_folder import FILES  # here: other folders do without what writes tracks

    try:
        return any(path.name not in FILES for path in images_in_folder(folder))
    except InputError:
        return False


def load_material(
    inputs: str | Path | Sequence[str | Path],
    config: Config,
    landmarks: str | Path | None = None,
    stills: bool = False,
    progress: Progress | None = None,
    seen: Callable[[FrameObservation], None] | None = None,
) -> Material:
    """Open pictures, a video or a landmark file as `workbench track` does, and find the landmarks of every frame.

    `landmarks` is a file with the landmarks of the pictures, used instead of a detector. `progress(step, done, total)`
    and `seen(observation)` are called after each frame. Raises `InputError` for unusable inputs.
    """
    paths = [Path(path) for path in ([inputs] if isinstance(inputs, str | Path) else inputs)]
    if not paths:
        raise InputError("There is nothing to tune on; give a photo, a folder, a video or a landmark file.")
    if paths[0].suffix.lower() == ".toml" and os.path.isfile(paths[0]):
        raise InputError(
            f"{paths[0]} holds settings and no frames; open a photo or clip and load them with session.use(read_config"
            "(FILE)), or open a run that `workbench track --config` made with them."
        )
    file = None if landmarks is None else Path(landmarks)
    source = open_source(paths, config, file)
    opened = OpenedFiles([*paths, file])
    stills = stills or source.single_picture
    found = []
    for observation in source.observations(0, {}, stills):
        found.append(observation)
        if seen is not None:
            seen(observation)
        if progress is not None:
            progress("landmarks", len(found), source.count)
    if not found:
        raise InputError(f"{paths[0]} contains no frame to tune on; check that it plays.")
    frames = None if is_landmark_file(paths[0]) else source.frames
    sizes = [observation.image_size for observation in found]
    name, store = source.frames.name, PictureStore(frames, sizes)
    return Material(name, tuple(found), store, stills, tuple(paths), file, detector=source.detector, opened=opened)


def material_of_photo(picture: UInt8[np.ndarray, "h w 3"], landmarks: Landmarks2D, name: str = "photo") -> Material:
    """The material of a picture in memory with its landmarks."""
    observation = FrameObservation(0, landmarks, landmarks.image_size)
    store = PictureStore(None, [landmarks.image_size], given=[np.array(picture)])
    return Material(name, (observation,), store, stills=True)
