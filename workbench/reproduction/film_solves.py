"""The talking film solved by one camera and by two, then filled, refined and re-estimated, and its truth.

Every track is kept: an interrupted run continues after its last frame, and items of one folder solve the film once.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from workbench.config import Config, preset
from workbench.face import FaceModel, FaceParameters
from workbench.face.jaw import posed_vertices
from workbench.frames import Frames
from workbench.landmarks.scheme import lip_distance
from workbench.pipeline import Step, work_over
from workbench.planning import plan_of
from workbench.reproduction.gaps import FLOW, FilledGap, fill_gap, pictures_by_frame
from workbench.reproduction.stereo_film import AWAY_MM, AXES, FOV_DEG
from workbench.reproduction.study import NETWORK, Progress, Study
from workbench.reproduction.talking_film import TalkingFilm
from workbench.tracking import FrameContext, FrameFit, Track
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.flow_fitter import FlowFitter
from workbench.tracking.observation import Pictures
from workbench.tracking.records import stack_fits
from workbench.tracking.track_writer import TrackWriter

ONE, TWO = "one camera", "two cameras"
ONE_POINTS, TWO_POINTS = f"{ONE}, preselected points", f"{TWO}, preselected points"
PRESETS = {ONE: "deep", TWO: "deep", ONE_POINTS: "deep-points", TWO_POINTS: "deep-points"}
"""Preset of each series of solves."""
METHODS = ("averaging", "self", "plate", "hybrid")
MOUTH = "mouth, mm"
LOST_FILLED = {"infill": {"method": "flow"}}
BATCH = 4
"""Frames between two parts on disk."""


class MeasuredGap(NamedTuple):
    """A filled gap, and how far it is from what was rendered."""

    gap: FilledGap
    errors: Float[np.ndarray, "n 7"]
    """As `FilmSolve.errors`."""


@dataclass(frozen=True, eq=False)
class FilmSolve:
    """One series of solves of the film: each frame on its own, lost frames empty."""

    film: TalkingFilm
    head: FaceModel
    series: str
    config: Config
    track: Track
    study: Study

    @property
    def views(self) -> tuple[Frames, ...]:
        """The pictures that the series looks at."""
        return self.film.views if self.config.camera.rig else self.film.views[:1]

    @cached_property
    def pictures(self) -> list[Pictures]:
        """The same by frame."""
        return pictures_by_frame(self.views)

    def flow_fitter(self, **changes: Mapping[str, Any]) -> FlowFitter:
        """What places frames by flow; `changes` to the configuration as for `Config.changed`."""
        return FlowFitter(self.head, plan_of(self.config.changed(**changes)))

    def filled(self, frames: range, method: str = FLOW, **changes: Mapping[str, Any]) -> MeasuredGap:
        """Frames filled as if they had no fits, with errors and time; `changes` as for `flow_fitter`."""
        gap = fill_gap(self.flow_fitter(**changes), self.track, self.pictures, frames, method)
        return MeasuredGap(gap, self.errors(gap.fits))

    def worked(self, method: str = "none", reestimated: bool = False) -> Track:
        """The film with lost frames filled by flow, then refined by a method, then (B.1) with its expressions anew."""
        if reestimated:
            return self._after("reestimate", {}, self.worked(method), f"{method}, reestimated")
        if method == "none":
            return self._after("infill", LOST_FILLED, self.track, "infilled")
        return self._after("refine", {"refinement": {"method": method}}, self.worked(), method)

    def _after(self, step: Step, changes: Mapping[str, Any], before: Track, name: str) -> Track:
        config = self.config.changed(**changes)
        path, meta = track_path(self.study, f"{self.series}, {name}"), {**before.meta, "after": name}
        if (stored := stored_track(path, meta)) is not None:
            return stored

        def told(what: str, done: int, total: int | None) -> None:
            self.study.progress(f"{self.series}: {name}", done, total)

        made = replace(work_over(before, self.views, self.head, config, [step], told), meta=meta)
        made.save(path)
        return made

    @property
    def truth(self) -> Track:
        """What was rendered, as a track of perfect fits."""
        film, fitter = self.film, self.flow_fitter()
        like = next(self.track[k] for k in range(len(self.track)) if self.track.found[k])
        fits = []
        for k in range(len(film.motion)):
            placed = fitter.placed(replace(like, index=k, failure=""), film_parameters(film, k))
            fits.append(replace(placed, observed=placed.projected))
        return Track(meta=self.track.meta, **stack_fits(fits))

    def errors(self, fits: Track | Sequence[FrameFit]) -> Float[np.ndarray, "n 7"]:
        """Signed errors of `AXES` and `MOUTH`; NaN without a face."""
        return errors_of(self.film, self.head, [fits[k] for k in range(len(fits))])


def solved(film: TalkingFilm, head: FaceModel, series: str, study: Study) -> FilmSolve:
    """The film solved by a series of `PRESETS`: identity and cameras given, the colours from the first frame."""
    camera = {"fov_deg": FOV_DEG} if series.startswith(ONE) else {"rig": str(film.folder / "rig.toml")}
    config = preset(PRESETS[series]).changed(
        camera=camera, identity={"calibrate": False}, deep={"distance_mm": AWAY_MM, "network": NETWORK}
    )
    # Where the rig's file lies does not matter, but what is in it.
    settings = config.model_dump(mode="json") | {"camera": series, "film": list(map(str, film.timeline))}
    meta = {"expression_names": list(head.expression_names), "config": config.model_dump(mode="json")}
    meta["settings"] = sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()
    track = stored_track(track_path(study, series), meta)
    if track is None:
        track = _solve(film, head, config, track_path(study, series), meta, series, study.progress)
    return FilmSolve(film, head, series, config, track, study)


def stored_track(path: Path, meta: dict[str, Any]) -> Track | None:
    """The track at this path if it was made by the same settings (`settings` and `after` of `meta`), else None."""
    if not path.exists():
        return None
    stored = Track.load(path)
    same = all(stored.meta.get(name) == meta.get(name) for name in ("settings", "after"))
    return stored if same else None


def track_path(study: Study, name: str) -> Path:
    """Where a study keeps a track."""
    return study.folder / "tracks" / f"{name.replace(', ', '-').replace(' ', '_')}.npz"


def film_parameters(film: TalkingFilm, frame: int) -> FaceParameters:
    """What was rendered in a frame."""
    motion = film.motion
    return FaceParameters(
        motion.rotation[frame],
        motion.translation_mm[frame],
        motion.expression[frame],
        film.identity,
        np.zeros(6),
        np.ones(1),
    )


def errors_of(film: TalkingFilm, head: FaceModel, fits: Sequence[FrameFit]) -> Float[np.ndarray, "n 7"]:
    """`FilmSolve.errors` of any frames of the film."""
    person, rows = head.personal(film.identity), []
    for fit in fits:
        true = replace(fit, **_recorded(film_parameters(film, fit.index)))
        mouth = lips_apart_mm(person, fit) - lips_apart_mm(person, true)
        rows.append((*(fit.angles_deg - true.angles_deg), *(fit.translation - true.translation), mouth))
    return np.array(rows).reshape(-1, len(AXES) + 1)


def lips_apart_mm(person: FaceModel, fit: FrameFit) -> float:
    """Distance of the inner lips; NaN without a face. `person`: the head in this person's shape."""
    if not fit.found:
        return float("nan")
    return float(lip_distance(person.landmarks.of(posed_vertices(person, fit.expression, fit.jaw))))


def _recorded(parameters: FaceParameters) -> dict[str, np.ndarray]:
    names = ("rotation", "translation", "expression", "jaw")
    return {name: np.asarray(getattr(parameters, name), float) for name in names}


def _solve(
    film: TalkingFilm, head: FaceModel, config: Config, path: Path, meta: dict[str, Any], label: str, progress: Progress
) -> Track:
    observations = film.observations()
    if not config.camera.rig:
        observations = tuple(replace(one, others=()) for one in observations)
    fitter = DeepFitter(head, plan_of(config))
    context = FrameContext(0, film.identity, None, None, fitter.appearance(observations[:1], film.identity))
    writer = TrackWriter(path, meta, meta["settings"], resume=True)
    for observation in observations[len(writer) :]:
        progress(label, observation.index, len(observations))
        writer.add(fitter.fit(observation, context)[0])
        if observation.index % BATCH == BATCH - 1:
            writer.write_part({})
    writer.write_part({})
    writer.close()
    return Track.load(path)
