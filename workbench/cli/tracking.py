"""`workbench track` and `workbench demo`."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

import workbench
from workbench.cli import screen
from workbench.config import DEFAULT_PRESET, PRESETS, Config, preset, read_config
from workbench.errors import ConfigError, InputError
from workbench.face.characters import lasting_name
from workbench.samples import sample

DEMO = {
    "astronaut": {"head": {"character": "sofia"}},
    "laugh": {"head": {"character": "ravi"}, "camera": {"fov_deg": 33.0}},
}
"""The bundled pictures; the clip's camera is known, the portrait's is guessed. Heads are drawn as similar people."""

TRACK_HELP = """Track faces: 68 landmarks, then head pose and 44 expression weights for every frame.

[bold]Examples[/bold]

  workbench track talk.mp4                          a video; results in out/talk

  workbench track portrait.jpg --out portrait       one photo

  workbench track photos/ --stills                  unrelated photos of a folder

  workbench track points.csv                        landmarks from a file, no detector

  workbench track talk.mp4 --detector dlib          dlib's landmarks, as in FACE IT!

  workbench track talk.mp4 --preset face-it         as published

  workbench track talk.mp4 --preset deep --frames 100-200 --workers 2

  workbench track talk.mp4 --preset deep --scheduler tcp://host:8786

  workbench track left.mp4 --preset deep --rig rig.toml --view right=right.mp4

  workbench track talk.mp4 --infill flow --refine hybrid

  workbench track talk.mp4 --config tuned.toml      your own configuration

  workbench track talk.mp4 --model flame.pkl        another face model

  workbench track talk.mp4 --character mei          the head in the film is a person

  workbench track talk.mp4 --resume                 continue an interrupted run
"""

INPUT, FIT, DEEP, RESULTS = "Input", "Fit", "Deep Energies", "Results"
"""Groups of options."""
OUT_HELP = "Folder for the results (default: out/NAME)."
STILLS_HELP = "Unrelated photos: nothing links one to the next."
GIVEN_HELP = "Take the landmarks of a file (or a folder of .pts) instead of a detector's."
FOV_HELP = "Field of view over the longer side, degrees."
PRESET_HELP = f"One of: {', '.join(PRESETS)} (default: {DEFAULT_PRESET})."
IDENTITY_HELP = "Calibrate the subject's face shape first."
PICTURES_HELP = "Write the overlay video or pictures."
RESUME_HELP = "Continue an interrupted run."
DETECTOR_HELP = (
    "auto (network), network, network+pupils (68 points and the pupils), dense (377 points), dlib, dlib+network, "
    "dlib-hog, dlib-cnn or mediapipe."
)
LANDMARKER_HELP = "MediaPipe's model face_landmarker.task, for --detector mediapipe."
MODEL_HELP = "Face model: FLAME, Basel, GNM, ICT-FaceKit, .glb, OBJ folder (default: the default head)."
ENERGY_HELP = "deep (network on the render), points (on the mesh) or mixed."
NETWORK_HELP = (
    "What looks at photo and render: ensemble, heat-maps, landmarks (68 points), dense (377), or a weights file."
)
FRAMES_HELP = "Only frames A-B (or one frame); the results are numbered from the part's start."
WORKERS_HELP = "Processes on this machine that fit frames: a Dask cluster if Dask is installed, else a pool."
SCHEDULER_HELP = "Address of a Dask scheduler whose workers fit frames, for example tcp://host:8786."
RIG_HELP = "Calibration of several cameras; INPUT is its first view."
VIEW_HELP = "Clip of another view of the rig as NAME=CLIP; may be given more than once."
INFILL_HELP = "Fill failed frames: flow, linear or spline (none: leave them)."
REFINE_HELP = "Stabilise the result: averaging, self, plate or hybrid (none: leave it)."
NO_FACE = (
    "No face was found in any frame; look at the pictures, try another --detector, or enlarge or turn the pictures so "
    "that the face is upright and at least 60 pixels wide."
)
CHARACTER_HELP = "Character that the 3D head is drawn as: a ready one such as mei, or the file or folder of your own."
OVERWRITE_HELP = "Replace what an earlier run left in the folder."
FACE_HELP = (
    "Pixel X,Y inside the face to follow, in the first frame that shows it; a photo without a face there has none."
)


def track(
    inputs: Annotated[list[Path], typer.Argument(help="Photos, a folder, a video, or landmark files.")],
    frames: Annotated[str | None, typer.Option(help=FRAMES_HELP, rich_help_panel=INPUT)] = None,
    stills: Annotated[bool, typer.Option("--stills", help=STILLS_HELP, rich_help_panel=INPUT)] = False,
    detector: Annotated[str | None, typer.Option(help=DETECTOR_HELP, rich_help_panel=INPUT)] = None,
    face_landmarker: Annotated[Path | None, typer.Option(help=LANDMARKER_HELP, rich_help_panel=INPUT)] = None,
    face: Annotated[str | None, typer.Option(help=FACE_HELP, rich_help_panel=INPUT)] = None,
    landmarks: Annotated[Path | None, typer.Option(help=GIVEN_HELP, rich_help_panel=INPUT)] = None,
    fov: Annotated[float | None, typer.Option(help=FOV_HELP, rich_help_panel=INPUT)] = None,
    preset_name: Annotated[str | None, typer.Option("--preset", help=PRESET_HELP, rich_help_panel=FIT)] = None,
    config: Annotated[Path | None, typer.Option(help="Configuration file (TOML).", rich_help_panel=FIT)] = None,
    model: Annotated[Path | None, typer.Option(help=MODEL_HELP, rich_help_panel=FIT)] = None,
    identity: Annotated[
        bool | None, typer.Option("--identity/--no-identity", help=IDENTITY_HELP, rich_help_panel=FIT)
    ] = None,
    infill: Annotated[str | None, typer.Option(help=INFILL_HELP, rich_help_panel=FIT)] = None,
    refine: Annotated[str | None, typer.Option(help=REFINE_HELP, rich_help_panel=FIT)] = None,
    energy: Annotated[str | None, typer.Option(help=ENERGY_HELP, rich_help_panel=DEEP)] = None,
    network: Annotated[str | None, typer.Option(help=NETWORK_HELP, rich_help_panel=DEEP)] = None,
    rig: Annotated[Path | None, typer.Option(help=RIG_HELP, rich_help_panel=DEEP)] = None,
    view: Annotated[list[str] | None, typer.Option(help=VIEW_HELP, rich_help_panel=DEEP)] = None,
    workers: Annotated[int, typer.Option(min=1, max=64, help=WORKERS_HELP, rich_help_panel=DEEP)] = 1,
    scheduler: Annotated[str | None, typer.Option(help=SCHEDULER_HELP, rich_help_panel=DEEP)] = None,
    out: Annotated[Path | None, typer.Option(help=OUT_HELP, rich_help_panel=RESULTS)] = None,
    pictures: Annotated[bool, typer.Option(help=PICTURES_HELP, rich_help_panel=RESULTS)] = True,
    character: Annotated[str | None, typer.Option(help=CHARACTER_HELP, rich_help_panel=RESULTS)] = None,
    resume: Annotated[bool, typer.Option("--resume", help=RESUME_HELP, rich_help_panel=RESULTS)] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help=OVERWRITE_HELP, rich_help_panel=RESULTS)] = False,
) -> None:
    """Track faces in pictures, a video or landmark files."""
    settings = _configuration(config, preset_name, detector, fov, face, identity, energy, network, rig, infill, refine)
    if character is not None:
        settings = settings.changed(head={"character": lasting_name(character)})
    if face_landmarker is not None:
        settings = with_landmarker(settings, face_landmarker)
    folder = out or Path("out") / (_name(inputs[0]) or "run")
    workbench.pipeline.check_inputs_kept(folder, [path for path in (config, model) if path is not None])
    if not settings.traits.renders and (workers > 1 or scheduler):
        raise InputError("--workers and --scheduler belong to Deep Energies; add --preset deep.")
    with screen.at_work(workers, scheduler) as staff:
        _run(
            inputs,
            folder,
            settings,
            model,
            stills=stills,
            pictures=pictures,
            resume=resume,
            overwrite=overwrite,
            landmarks=landmarks,
            frames=frame_range(frames),
            views=named_views(view or []),
            workers=staff,
        )


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("demo_out"),
    pictures: Annotated[bool, typer.Option(help="Write the overlay video and picture.")] = True,
) -> None:
    """Find and track the faces of the bundled portrait and clip: a minute or two."""
    for name, changes in DEMO.items():
        screen.console.print(f"[bold]{name}[/bold]")
        config = preset(DEFAULT_PRESET).changed(**changes)
        _run([sample(name)], out / name, config, pictures=pictures, overwrite=True)
    screen.console.print(f"\n{_next_steps(out, pictures)}", soft_wrap=True)


def _next_steps(out: Path, pictures: bool) -> str:
    """The last line of the demo."""
    clip, portrait = out / "laugh", out / "astronaut"
    look = f"Look at {clip / 'overlay.mp4'} and {portrait / 'overlay.png'}. " if pictures else ""
    command = shlex.join(["workbench", "diagnose", str(clip)])
    return escape(f"{look}Why a frame is bad: {command}. To tune it in the browser: workbench lab.")


def _name(given: Path) -> str:
    """What a run is called: a folder has no suffix, and `..` a name of its own."""
    return given.resolve().name if given.is_dir() else given.stem


def _configuration(config, preset_name, detector, fov, face, identity, energy, network, rig, infill, refine) -> Config:
    base = base_config(config, preset_name)
    landmarks, camera = {}, {}
    if detector is not None:
        landmarks["detector"] = detector
    if face is not None:
        landmarks["face"] = wanted_face(face)
    if fov is not None:
        if rig is not None or base.camera.rig:
            raise ConfigError("--fov has no effect with a rig, whose file holds the lenses; leave one of them out.")
        camera = {"fov_deg": fov, "fov_known": True, "matrix": None}
        if base.camera.matrix is not None:
            camera["distortion"] = []  # of the measured lens
    if rig is not None:
        camera["rig"] = str(rig)
    deep = {name: value for name, value in (("energy", energy), ("network", network)) if value is not None}
    if deep and not base.traits.reads("deep"):
        raise ConfigError(f"--{next(iter(deep))} belongs to Deep Energies; add --preset deep.")
    changes = {
        "deep": deep,
        "landmarks": landmarks,
        "camera": camera,
        "identity": {} if identity is None else {"calibrate": identity},
        "infill": {} if infill is None else {"method": infill},
        "refinement": {} if refine is None else {"method": refine},
    }
    return base.changed(**changes)


def base_config(config: Path | None, preset_name: str | None) -> Config:
    """The configuration of --config or --preset, else the default one; raises `ConfigError` for both."""
    if config is not None and preset_name is not None:
        raise ConfigError("Give --config or --preset, not both; a configuration file names its preset itself.")
    return read_config(config) if config is not None else preset(preset_name or DEFAULT_PRESET)


def frame_range(text: str | None) -> tuple[int, int] | None:
    """First and last frame of A-B, or A alone; None where it is left out. Raises `ConfigError` for anything else."""
    if text is None:
        return None
    first, dash, last = text.partition("-")
    last = last if dash else first
    if not (first.isdigit() and last.isdigit() and int(first) <= int(last)):
        raise ConfigError(f"A part of a clip is its first and last frame as A-B, got {text!r}; for example 100-200.")
    return int(first), int(last)


def named_views(texts: list[str]) -> dict[str, Path]:
    """Clips by the names of their views; raises `ConfigError` for anything but NAME=CLIP, and a name given twice."""
    clips: dict[str, Path] = {}
    for name, path in map(named_view, texts):
        if name in clips:
            raise ConfigError(f"The view {name!r} is given twice, as {clips[name]} and as {path}; name each view once.")
        clips[name] = Path(path)
    return clips


def named_view(text: str) -> tuple[str, str]:
    """The name of a view, and path or URL of its clip; raises `ConfigError` for anything but NAME=CLIP."""
    name, sign, place = text.partition("=")
    if not (name and sign and place):
        raise ConfigError(f"A view is given as NAME=CLIP, got {text!r}; for example right=right.mp4.")
    return name, place


def with_landmarker(config: Config, path: Path) -> Config:
    """The configuration with the file of `--face-landmarker`; raises `ConfigError` where no detector reads it."""
    if config.landmarks.detector != "mediapipe":
        raise ConfigError("--face-landmarker belongs to the detector mediapipe; add --detector mediapipe.")
    return config.changed(landmarks={"face_landmarker": str(path)})


def wanted_face(text: str | None) -> tuple[float, float] | None:
    """The point that `--face` names, None where it is left out; raises `ConfigError` for anything but X,Y."""
    if text is None:
        return None
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"A face is chosen by a point X,Y in pixels, got {text!r}; for example 320,180.") from None
    return x, y


def track_file(run: Path) -> Path:
    """The track of a run: of its folder, or the file itself."""
    return run / "track.npz" if run.is_dir() else run


def face_model(path: Path | None):
    """The face model of a file or folder, the default head for None."""
    return workbench.load_default_head() if path is None else workbench.load_face_model(path)


def _run(inputs, folder, config, model_path: Path | None = None, **options) -> None:
    model = face_model(model_path)
    with screen.progress_bar() as progress:
        try:
            result = workbench.pipeline.track(inputs, folder, model, config, progress=progress, **options)
        except KeyboardInterrupt:
            kept = "finished parts are kept; --resume continues from there"
            kept_any = workbench.pipeline.keeps_frames(folder)
            screen.errors.print(f"[yellow]interrupted[/yellow]: {kept if kept_any else 'nothing was finished yet'}")
            raise typer.Exit(130) from None
    print_result(result)
    if not result.summary["frames_with_face"]:
        detected = result.summary["detector"]
        missed = config.landmarks.missed_face or NO_FACE
        in_file = f"The landmark file {workbench.landmarks.files.WITHOUT_FACE}; look at the file, or name another."
        screen.print_error(missed if detected else in_file)
        raise typer.Exit(1)


def print_result(result) -> None:
    """The table of a finished run."""
    summary = result.summary
    error = summary["reprojection_error"]
    inner, every = error["inner_51_percent_of_eye_distance"], error["all_68_percent_of_eye_distance"]
    times = summary["milliseconds_per_frame"]
    table = Table(show_header=False, box=None)
    faces = f"{summary['frames_with_face']} of {summary['frames']} with a face, {summary['shots']} shot(s)"
    table.add_row("[bold]frames[/bold]", faces)
    if summary["frames_failed"]:
        listed = ", ".join(f"{count} × {reason}" for reason, count in summary["frames_failed"].items())
        table.add_row("[bold]failed[/bold]", f"{listed}")
    if summary["frames_filled"]:
        table.add_row("[bold]filled[/bold]", f"{summary['frames_filled']} frames from their neighbours")
    table.add_row("[bold]landmarks[/bold]", f"by {summary['detector']}" if summary["detector"] else "from a file")
    if summary["frames_with_face"]:
        table.add_row(
            "[bold]error[/bold]",
            f"inner 51: {inner['mean']:.2f} % (p95 {inner['p95']:.2f} %), all 68: {every['mean']:.2f} % "
            f"(p95 {every['p95']:.2f} %) of the eye distance",
        )
        spent = ", ".join(f"{name} {value['p50']:.1f} ms" for name, value in times.items())
        rate = f"; {summary['frames_per_second']:.3g} frames/s" if summary["frames_per_second"] else ""
        table.add_row("[bold]time[/bold]", f"median {spent}{rate}")
    table.add_row("[bold]camera[/bold]", _camera(summary["camera"]))
    told = workbench.pipeline.OUTPUTS | workbench.pipeline.DEEP_OUTPUTS | workbench.pipeline.TIME_OUTPUTS
    for path in _named(result.files):
        key = "overlay.mp4" if "overlay" in path.name or path.parent.name == "overlay" else path.name
        key = "stages" if path.parent.name == "stages" else key
        table.add_row("", f"{escape(str(path))}  [dim]{told.get(key, '')}[/dim]")
    screen.console.print(table)
    for note in result.notes:
        screen.console.print(f"[yellow]note:[/yellow] {escape(note)}")
    print_licence_notice(summary["detector"])


def _camera(camera: Mapping[str, Any]) -> str:
    """A summary's camera in words."""
    if camera["projection"] == "orthographic":
        return "parallel projection, no lens"
    kind = "guessed, --fov changes it" if camera["guessed"] else "as given"
    return f"focal length {camera['focal_px'][0]:.0f} px, {camera['horizontal_fov_deg']:.0f}° horizontally ({kind})"


def _named(files: Sequence[Path]) -> list[Path]:
    """The files worth a line: all tables, and the first picture of each folder of pictures."""
    parents, kept = set(), []
    for path in files:
        if path.parent.name in ("stages", "overlay"):
            if path.parent in parents:
                continue
            parents.add(path.parent)
        kept.append(path)
    return kept


def print_licence_notice(detector: str | None) -> None:
    """Tell, once, what users of dlib's landmarks must know; nothing where another detector ran, or none."""
    if detector is None or not detector.startswith("dlib"):
        return
    notice = workbench.landmarks.dlib_detector.licence_notice_once()
    if notice:
        screen.console.print(f"[dim]{notice}[/dim]")
