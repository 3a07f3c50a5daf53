"""What uses time, over whole tracks: infill, refinement and re-estimation as part of a run or on a stored track."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from workbench.config import Config, config_of_track
from workbench.errors import InputError
from workbench.export.sources import gone_pictures, reference_inputs, tracked_part, view_clips
from workbench.face import FaceModel
from workbench.frames import Frames, open_frames
from workbench.geometry import read_rig
from workbench.landmarks.files import is_landmark_file
from workbench.planning import plan_of
from workbench.tracking.flow_fitter import FlowFitter
from workbench.tracking.infill import infilled
from workbench.tracking.moments import Moment, moments
from workbench.tracking.records import FrameFit, Track, stack_fits
from workbench.tracking.reestimation import Reestimator
from workbench.tracking.refinement import refined

Step = Literal["infill", "refine", "reestimate"]
STEPS: tuple[Step, ...] = ("infill", "refine", "reestimate")
Progress = Callable[[str, int, int | None], None]


def wanted_steps(config: Config) -> tuple[Step, ...]:
    """What the configuration asks for in addition to fitting each frame."""
    asked = (config.infill.method != "none", config.refinement.method != "none", config.refinement.reestimate > 0)
    return tuple(step for step, wanted in zip(STEPS, asked, strict=True) if wanted)


def over_time(
    fits: Iterable[FrameFit],
    views: Sequence[Frames],
    model: FaceModel,
    config: Config,
    steps: Sequence[Step],
    progress: Progress = lambda step, done, total: None,
    total: int | None = None,
) -> Iterator[FrameFit]:
    """The fits after these steps by the configuration, as a stream: memory for a window of frames.

    `views` are the pictures of each view; none is enough for methods that look at none. Refinement and re-estimation
    alternate as often as the configuration says. Raises `InputError` for methods that need the pictures.
    """
    if not views and (need := needs_pictures(config, steps)):
        raise InputError(
            f"The method {need!r} needs the pictures, and there are none; name them (--clip), or choose another."
        )
    plan = plan_of(config, model.scheme)
    fitter = FlowFitter(model, plan)
    done = dict.fromkeys(STEPS, 0)

    def counted(step: Step) -> Callable[[FrameFit], None]:
        def advanced(fit: FrameFit) -> None:
            done[step] += 1
            progress(step, done[step], None)

        return advanced

    stream: Iterator[Moment] = moments(fits, views)
    if "infill" in steps:
        stream = infilled(fitter, stream, counted("infill"))
    for _ in range(max(1, config.refinement.reestimate)):
        if "refine" in steps:
            stream = refined(fitter, stream, counted("refine"))
        if "reestimate" in steps:
            stream = Reestimator(model, plan).stream(stream, counted("reestimate"))
    for count, moment in enumerate(stream, start=1):
        yield moment.fit
        progress("time", count, total)


def needs_pictures(config: Config, steps: Sequence[Step]) -> str:
    """The method of these steps that looks at the pictures; empty if none does."""
    if "infill" in steps and config.infill.method == "flow":
        return "flow"
    if "refine" in steps and config.refinement.method in ("plate", "hybrid"):
        return config.refinement.method
    return ""


def look_at_pictures(config: Config, steps: Sequence[Step]) -> bool:
    """Whether these steps look at the pictures where there are some, so that results differ without them."""
    renders = "reestimate" in steps and config.traits.renders
    lit = "refine" in steps and config.refinement.method == "self" and config.flow.renders != "exact"
    return renders or lit or bool(needs_pictures(config, steps))


def config_of(track_meta: Mapping[str, Any]) -> Config:
    """The configuration that a track was made with. Raises `InputError` for a track without one."""
    config = config_of_track(track_meta)
    if config is None:
        raise InputError("The track does not hold the configuration it was made with; run the tracking again.")
    return config


def views_of(
    meta: Mapping[str, Any],
    config: Config,
    pictures: Path | None = None,
    others: Mapping[str, Path] = MappingProxyType({}),
    needed: bool = True,
    drawn: bool = True,
) -> list[Frames]:
    """The pictures that a track was made from, in each view; empty for a track without those of every view.

    `pictures` and `others` (by the views' names) say where they are now. Where the track's own are neither `needed` nor
    `drawn`, they are left alone; a rig's tell how large its views are. Raises `InputError` for these, and for all
    that are `needed`, where they are not there; for a rig that is no longer there, for views that it does not have,
    and for a track of unrelated photos.
    """
    if meta.get("stills"):
        raise InputError("This track holds unrelated photos; infill and refinement need frames of a clip.")
    if config.camera.rig and not Path(config.camera.rig).exists():
        raise InputError(f"The rig of this track is no longer at {config.camera.rig}; name it with --rig.")
    names = read_rig(Path(config.camera.rig)).names if config.camera.rig else ("",)
    unknown = [name for name in others if name not in names[1:]]
    if unknown:
        raise InputError(f"The rig has no view {unknown[0]!r}; its other views are {', '.join(names[1:]) or 'none'}.")
    paths = _view_paths(meta, names)
    if pictures is not None:
        paths[0] = [pictures]
    for name, path in others.items():
        paths[names.index(name)] = [path]
    if not all(paths) or any(is_landmark_file(path) for group in paths for path in group):
        return []
    view_of = {path: name for name, group in zip(names, paths, strict=True) for path in group}
    given = [path for path in view_of if path == pictures or path in others.values()]
    if not (needed or drawn or given or config.camera.rig):
        return []
    gone = gone_pictures({}, given) | gone_pictures(meta, [path for path in view_of if path not in given])
    for path, told in gone.items():
        if needed or path in given:
            option = "--clip" if view_of[path] == names[0] else f"--view {view_of[path]}=CLIP"
            raise InputError(f"{told}; name them with {option}.")
    if gone:
        return []
    return [tracked_part(open_frames(group if len(group) > 1 else group[0]), meta) for group in paths]


def _view_paths(meta: Mapping[str, Any], names: Sequence[str]) -> list[list[Path]]:
    """The input files of each view; none where a track has none of it."""
    clips = view_clips(meta)
    return [reference_inputs(meta), *([clips[name]] if name in clips else [] for name in names[1:])]


def work_over(
    track: Track,
    views: Sequence[Frames],
    model: FaceModel,
    config: Config,
    steps: Sequence[Step] | None = None,
    progress: Progress = lambda step, done, total: None,
) -> Track:
    """A track in memory after these steps (default: all that the configuration asks for), as `over_time`."""
    wanted = wanted_steps(config) if steps is None else tuple(steps)
    fits = list(over_time((track[k] for k in range(len(track))), views, model, config, wanted, progress, len(track)))
    return Track(meta=worked_meta(track.meta, config, wanted), **stack_fits(fits))


def worked_meta(meta: Mapping[str, Any], config: Config, steps: Sequence[Step]) -> dict[str, Any]:
    """Metadata of a track after these steps."""
    stored = config.model_dump(mode="json")
    return {**meta, "config": stored, "steps": [*meta.get("steps", []), *steps]}
