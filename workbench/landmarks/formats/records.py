"""What every landmark file is read into, and the checks that all layouts share."""

import shlex
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from workbench.errors import InputError
from workbench.landmarks.observations import Landmarks2D, scheme_of_faces
from workbench.landmarks.scheme import LandmarkScheme, face_size
from workbench.reading import reading, shortened

LARGEST_FRAME = 2**53
MOST_MISSING = 100_000
"""Frames in a row that a file leaves out: an hour of video; more is a damaged number."""
LARGEST_SIDE = 10**6
"""Pixels of a picture's side; more is a damaged number."""


@dataclass(frozen=True)
class LandmarkRecord:
    """The landmarks of one frame as a file holds them."""

    frame: int
    """0-based frame index."""
    name: str
    """The name of the frame, or of the file if it has none."""
    landmarks: Landmarks2D | None
    """None where the frame has no face."""
    image_size: tuple[int, int] | None
    """(width, height), or None where the file does not say (.pts without its picture)."""

    @property
    def size(self) -> tuple[int, int] | None:
        """(width, height) in pixels of the frame's picture: what its landmarks say, if it has any."""
        return self.image_size if self.landmarks is None else self.landmarks.image_size


def door(path: Path) -> AbstractContextManager[None]:
    """What goes wrong while landmarks are read becomes one `InputError`."""
    return reading(path, "landmarks", "export them again")


def checked_landmarks(where: str, points: object, confidence: object, size: tuple[int, int]) -> Landmarks2D:
    """Landmarks of a scheme's points, (points, 2) in pixels. Raises `InputError` that begins with the place in a file.

    `confidence` is None where the file has none: every point is certain then.
    """
    try:
        array = np.asarray(points, np.float64)
        certainty = np.ones(len(array)) if confidence is None else np.asarray(confidence, np.float64)
        landmarks = Landmarks2D(array, certainty, size)
        far = np.flatnonzero((np.abs(landmarks.points) > LARGEST_SIDE).any(axis=1))
        if far.size:
            raise InputError(f"landmark {far[0]} lies at {landmarks.points[far[0]].tolist()}: outside any picture")
        return landmarks
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    except (ValueError, TypeError, OverflowError) as error:
        told = shortened(error)
        raise InputError(f"{where}: the points are not pairs of numbers ({told}): write them as [x, y]") from error


def needed_size(path: Path, image_size: tuple[int, int] | None) -> tuple[int, int]:
    """The (width, height) that was given with a file. Raises `InputError` if none was."""
    if image_size is None:
        raise InputError(
            f"{path} does not say how large its pictures are: name the clip or photo as well, as in "
            f"`workbench track CLIP --landmarks {shlex.quote(str(path))}`"
        )
    return image_size


def scheme_of_records(records: Iterable[LandmarkRecord]) -> LandmarkScheme:
    """What the points of a file's first face are called; iBUG's 68 without a face."""
    return scheme_of_faces(record.landmarks for record in records)


def without_gaps(path: Path, records: Iterable[LandmarkRecord]) -> Iterator[LandmarkRecord]:
    """Records of a file with one for every frame from 0: frames that it leaves out have no face.

    Raises `InputError` where frames do not ascend, and where far too many are left out.
    """
    following = 0
    for record in records:
        absent = record.frame - following
        if absent < 0:
            raise InputError(
                f"{path}: frame indices must ascend, got {record.frame} after {following - 1}: sort the frames"
            )
        if absent > MOST_MISSING:
            raise InputError(f"{path}: {absent} frames are missing before frame {record.frame}: correct the number")
        for frame in range(following, record.frame):
            yield LandmarkRecord(frame, f"{path.stem}#{frame}", None, record.size)
        yield record
        following = record.frame + 1


def by_pictures(records: Iterable[LandmarkRecord], pictures: Sequence[str], first: int = 0) -> Iterator[LandmarkRecord]:
    """One record for each of these picture files from the `first` on, frame 0: the one that names it, else one without
    a face.

    As the records come where none names one of the pictures, where names (without their suffixes) repeat, and where
    they are numbers of which only some agree, as when one program counts from 0 and another from 1.
    """
    records, stems = list(records), [Path(picture).stem for picture in pictures]
    # Some layouts name pictures with their suffix, some without, and both names may have other dots.
    named = {name if (name := record.name) in stems else Path(name).stem: record for record in records}
    agreeing = len(named.keys() & set(stems))
    by_chance = agreeing < len(records) == len(pictures) and all(map(str.isdecimal, [*named, *stems]))
    if len(named) < len(records) or len(set(stems)) < len(stems) or agreeing == 0 or by_chance:
        yield from records
        return
    for frame, (picture, stem) in enumerate(zip(pictures[first:], stems[first:], strict=True)):
        if stem in named:
            yield replace(named[stem], frame=frame)
        else:
            yield LandmarkRecord(frame, picture, None, records[0].size)


def check_size(landmarks: Landmarks2D, size: tuple[int, int], picture: str) -> None:
    """Raise `InputError` if landmarks are of a picture of a different (width, height) from the `picture`'s."""
    if landmarks.image_size != size:
        of, this = ("{} × {}".format(*pixels) for pixels in (landmarks.image_size, size))
        raise InputError(
            f"The landmarks are of a picture of {of} pixels, {picture} has {this}; give the landmarks of {picture}."
        )


def largest_face(faces: Sequence[Landmarks2D]) -> Landmarks2D | None:
    """The largest of the faces of one frame, None where there is none."""
    return max(faces, key=lambda face: float(face_size(face.points)), default=None)


def whole_numbers(where: str, cells: Sequence[str]) -> list[int]:
    """Frame, width and height as numbers. Raises `InputError` for what they cannot be."""
    try:
        frame, width, height = (int(cell) for cell in cells)
    except ValueError:
        raise InputError(f"{where}: frame, width and height must be whole numbers, got {_listed(cells)}") from None
    if frame < 0 or width < 1 or height < 1:
        raise InputError(f"{where}: frame counts from 0, width and height from 1, got {_listed(cells)}")
    if frame > LARGEST_FRAME or max(width, height) > LARGEST_SIDE:
        raise InputError(f"{where}: frame, width and height are not those of a picture, got {_listed(cells)}")
    return [frame, width, height]


def cell_numbers(where: str, cells: Sequence[str], names: Sequence[str]) -> list[float]:
    """The numbers of a table's cells. Raises `InputError` that names the column of one that is none."""
    numbers = []
    for cell, name in zip(cells, names, strict=True):
        try:
            numbers.append(float(cell))
        except ValueError:
            raise InputError(f"{where}: {name} is {shortened(repr(cell))}, expected a number") from None
    return numbers


def _listed(cells: Sequence[str]) -> str:
    return shortened(",".join(cells))
