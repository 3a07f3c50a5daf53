"""What is known of a clip, found once and stored, so that every task of a sweep begins with landmarks."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from workbench import __version__
from workbench.config import Config
from workbench.errors import InputError
from workbench.face import FaceModel, in_scheme
from workbench.frames import image_names, open_frames
from workbench.landmarks.files import WITHOUT_FACE
from workbench.landmarks.observations import Landmarks2D, scheme_of_faces
from workbench.objectives import Truth, flow_of_pictures, lacking, objective, observed_clip, read_truth
from workbench.pipeline import is_landmark_file, open_source
from workbench.reading import content_hash
from workbench.sweeps.clips import SweptClip
from workbench.sweeps.second_camera import SecondCamera, arrays_of, second_of_arrays, seen_by_second
from workbench.sweeps.storage import Storage, anywhere, local_file, packed, unpacked
from workbench.tracking import FrameObservation

NO_FACES = "has no face in any frame; look at its pictures, or try another detector (landmarks.detector)."
FORMAT = 2
_COUNTED = (".csv", ".npz")
"""Files of landmarks and truths that count frames, and name no pictures."""
_TRUTHS = ("rotation", "translation", "expression", "surface", "labels")


@dataclass(frozen=True)
class ClipSource:
    """Where a clip comes from: paths or URLs."""

    clip: str
    """A video, a folder, a photo or a landmark file."""
    landmarks: str = ""
    """A file with the landmarks of the pictures; empty: the clip's own, or a detector's."""
    truth: str = ""
    """What is known of it (`objectives.read_truth`)."""
    stills: bool = False
    flow: bool = False
    """Whether an objective needs the motion of the pictures."""
    second: SecondCamera | None = None
    """Another camera, which only judges."""

    @property
    def places(self) -> tuple[str, ...]:
        """All that it is read from."""
        second = () if self.second is None else (self.second.clip, self.second.rig)
        return tuple(place for place in (self.clip, self.landmarks, self.truth, *second) if place)

    @property
    def anywhere(self) -> "ClipSource":
        """The same by names that hold in any folder."""
        return self._placed(anywhere)

    @property
    def local(self) -> "ClipSource":
        """The same by paths; what URLs name is fetched. Raises `InputError` if something cannot be fetched."""
        return self._placed(lambda place: str(local_file(place)) if place else "")

    def _placed(self, place_of: Callable[[str], str]) -> "ClipSource":
        second = self.second
        if second is not None:
            second = replace(second, clip=place_of(second.clip), rig=place_of(second.rig))
        here = {name: place_of(getattr(self, name)) for name in ("clip", "landmarks", "truth")}
        return replace(self, second=second, **here)

    @property
    def name(self) -> str:
        """Its name in tables."""
        return Path(self.clip).stem


def digest_of(source: ClipSource, config: Config, model: FaceModel) -> str:
    """SHA-256 of all that a clip's observations are made from, a `local` one's.

    Raises `InputError` for files that are not there.
    """
    files = [Path(place) for place in source.places]
    for file in files:
        if not file.exists():
            raise InputError(f"{file} does not exist; check the name and the folder.")
    detection = config.model_dump(mode="json", include={"landmarks": {"detector", "face"}})
    detection["landmarks"]["detector"] = _detector_of(source, config)
    landmarker = Path(config.landmarks.face_landmarker)
    read = {
        **asdict(source),
        "clip": "",
        "landmarks": bool(source.landmarks),
        "truth": bool(source.truth),
        "second": source.second and source.second.view,
        "files": [content_hash(file) for file in files],
        "detector": detection,
        "landmarker": content_hash(landmarker) if landmarker.is_file() else "",
        "model": model.fingerprint() if source.truth else "",
        "version": __version__,
        "format": FORMAT,
    }
    if names := _names_of_pictures(source):
        read["pictures"] = names
    return hashlib.sha256(json.dumps(read, sort_keys=True).encode()).hexdigest()


def _names_of_pictures(source: ClipSource) -> list[str]:
    """The names of a clip's pictures where a file may say by them which landmarks or labels are of which; else none."""
    clip, *files = (Path(place) for place in (source.clip, source.landmarks, source.truth) if place)
    if is_landmark_file(clip) or all(file.suffix.lower() in _COUNTED for file in files):
        return []
    return image_names(open_frames(clip))


def _detector_of(source: ClipSource, config: Config) -> str:
    """The detector that runs: what "auto" stands for here. As configured where files hold all landmarks."""
    seen = [*([] if source.landmarks else [source.clip]), *([] if source.second is None else [source.second.clip])]
    if all(is_landmark_file(Path(place)) for place in seen):
        return config.landmarks.detector
    from workbench.landmarks.detectors import chosen_detector  # here: it imports the detectors, which takes seconds

    return chosen_detector(config.landmarks.detector)


def observe(source: ClipSource, config: Config, model: FaceModel, digest: str = "") -> SweptClip:
    """Find the landmarks of every frame of a `local` clip, and what else the objectives need.

    Raises `InputError` for a clip that cannot be read, that has no face, or whose motion is asked for without pictures.
    """
    landmarks = Path(source.landmarks) if source.landmarks else None
    opened = open_source([Path(source.clip)], config, landmarks, keep_pictures=source.flow)
    stills = source.stills or opened.single_picture
    found, flow, before = [], [], None
    for observation in opened.observations(0, {}, stills):
        if source.flow:
            flow.append(_flow_since(before, observation))
            before = observation
        found.append(_without_picture(observation))
    if not any(observation.landmarks is not None for observation in found):
        raise InputError(_told_without_faces(source, config))
    flow = np.stack(flow) if flow and all(each is not None for each in flow) else None
    if source.flow and flow is None:
        raise lacking("flow")
    truth = Truth()
    if source.truth:
        indices = [observation.index for observation in found]
        scheme = scheme_of_faces(seen.landmarks for seen in found)
        names = image_names(opened.frames)
        truth = read_truth(source.truth, in_scheme(model, scheme), indices, found[0].image_size, names)
    second = None
    if source.second is not None:
        second = seen_by_second(source.second, config, len(found), found[0].image_size, stills)
    return SweptClip(source.name, digest, tuple(found), stills, truth, flow, second)


def _told_without_faces(source: ClipSource, config: Config) -> str:
    """Why a clip without any face cannot be used."""
    file = source.clip if is_landmark_file(Path(source.clip)) else source.landmarks
    if file:
        return f"{file} {WITHOUT_FACE}; name another file."
    missed = config.landmarks.missed_face
    return f"{source.clip}: {missed}" if missed else f"{source.clip} {NO_FACES}"


def _flow_since(before: FrameObservation | None, now: FrameObservation) -> np.ndarray | None:
    """How far the picture moved at the landmarks since the frame before; None without a picture."""
    if now.picture is None:
        return None
    pair = [now] if before is None or before.picture is None else [before, now]
    return flow_of_pictures([each.picture for each in pair], observed_clip(pair))[-1]


def _without_picture(observation: FrameObservation) -> FrameObservation:
    return FrameObservation(
        observation.index, observation.landmarks, observation.image_size, observation.source, observation.cut
    )


def store_clip(storage: Storage, clip: SweptClip) -> None:
    """Write a clip under its digest. Raises `OutputError`."""
    storage.write(_name(clip.digest), packed_clip(clip))


def packed_clip(clip: SweptClip) -> bytes:
    """All that is known of a clip but its name and digest; the same bytes for the same clip."""
    observations, count = clip.observations, len(clip.scheme)
    faces = [observation.landmarks for observation in observations]
    arrays = {
        "index": np.array([observation.index for observation in observations]),
        "cut": np.array([observation.cut for observation in observations]),
        "image_size": np.array([observation.image_size for observation in observations]),
        "found": np.array([face is not None for face in faces]),
        "points": np.stack([np.zeros((count, 2)) if face is None else face.points for face in faces]),
        "confidence": np.stack([np.zeros(count) if face is None else face.confidence for face in faces]),
        "stills": np.array(clip.stills),
    }
    if any(face is not None and face.covariance is not None for face in faces):
        unknown = np.full((count, 2, 2), np.nan)
        covariances = [None if face is None else face.covariance for face in faces]
        arrays["covariance"] = np.stack([unknown if each is None else each for each in covariances])
    arrays |= {f"truth_{name}": part for name, part in zip(_TRUTHS, clip.truth, strict=True) if part is not None}
    if clip.flow is not None:
        arrays["flow"] = clip.flow
    if clip.second is not None:
        arrays |= arrays_of(clip.second)
    return packed(arrays)


def stored_clip(storage: Storage, digest: str, name: str) -> SweptClip | None:
    """The clip of a digest; None if it is not there, or torn."""
    content = storage.read(_name(digest))
    if content is None:
        return None
    arrays = unpacked(content)
    observations = tuple(
        FrameObservation(
            int(arrays["index"][k]),
            _stored_landmarks(arrays, k, size) if arrays["found"][k] else None,
            size,
            cut=bool(arrays["cut"][k]),
        )
        for k, size in enumerate((int(width), int(height)) for width, height in arrays["image_size"])
    )
    truth = Truth(*(arrays.get(f"truth_{part}") for part in _TRUTHS))
    second = second_of_arrays(arrays)
    return SweptClip(name, digest, observations, bool(arrays["stills"]), truth, arrays.get("flow"), second)


def _stored_landmarks(arrays: Mapping[str, np.ndarray], k: int, size: tuple[int, int]) -> Landmarks2D:
    covariance = arrays["covariance"][k] if "covariance" in arrays else None
    if covariance is not None and np.isnan(covariance).any():
        covariance = None
    return Landmarks2D(arrays["points"][k], arrays["confidence"][k], size, covariance)


def sources_of(
    clips: Sequence[str],
    landmarks: Sequence[str] = (),
    truths: Sequence[str] = (),
    stills: bool = False,
    flow: bool = False,
    views: Sequence[tuple[str, str]] = (),
    rig: str = "",
) -> tuple[ClipSource, ...]:
    """The sources of some clips; landmarks, truths and views are given for all of them in their order, or for none.

    `views` are names and clips of a second camera in the rig. Raises `InputError` for a different number of them, for
    views without a rig or a rig without views, and for no clip.
    """
    if not clips:
        raise InputError("There is nothing to sweep over; name a video, a photo or a landmark file.")
    for what, given in (("landmark files", landmarks), ("truths", truths), ("clips of a second camera", views)):
        if given and len(given) != len(clips):
            raise InputError(f"There are {len(clips)} clips and {len(given)} {what}; give one for each clip, in order.")
    if bool(views) != bool(rig):
        raise InputError("A second camera needs its clip and the rig of both; give --view and --rig.")
    return tuple(
        ClipSource(
            clip,
            landmarks[k] if landmarks else "",
            truths[k] if truths else "",
            stills,
            flow,
            SecondCamera(clip=views[k][1], view=views[k][0], rig=rig) if views else None,
        )
        for k, clip in enumerate(clips)
    )


def check_sources(sources: Sequence[ClipSource], objectives: Iterable[str]) -> None:
    """Raise `InputError` if an objective needs a truth or a second camera and a clip has none."""
    for name in objectives:
        needs = objective(name).needs
        if needs not in (None, "flow") and not all(
            source.second if needs == "second" else source.truth for source in sources
        ):
            raise lacking(name)


def _name(digest: str) -> str:
    return f"clips/{digest}.npz"
