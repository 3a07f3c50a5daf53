"""A run as one HTML page that holds everything it shows: pictures, curves, worst frames with reasons, settings."""

import html
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

from workbench.config import Config, config_of_track, config_toml, differences, preset
from workbench.diagnosis import flag_frames
from workbench.diagnosis.records import FrameFlags
from workbench.export.report_charts import (
    data_address,
    line_chart,
    residual_picture,
    scale_gradient,
    strip_rows,
)
from workbench.export.summary import summary_of
from workbench.face import GAZE_NAMES, DressedHead, FaceModel
from workbench.files import atomic_path
from workbench.frames import Frames
from workbench.pictures import HeadPanel, OverlayParts, draw_overlay, side_by_side
from workbench.plots import close_up
from workbench.tracking import Track
from workbench.tracking.records import SOURCES, frame_errors

PICTURES = 6
"""Frames that are shown from all over the clip."""
WORST = 8
APART = 8
"""Frames between two of the worst: neighbours look alike."""
CURVES = 8
PICTURE_PX = 300
CANVAS = 235
"""Grey level where a frame has no picture."""
PARTS = OverlayParts(text=False, legend=False)
STYLE = Path(__file__).with_name("report.css")

Progress = Callable[[int, int], None]


def write_report(
    track: Track,
    model: FaceModel,
    path: str | Path,
    frames: Frames | None,
    title: str = "",
    progress: Progress | None = None,
    dressed: DressedHead | None = None,
) -> None:
    """Write the report of a track; `model` is drawn beside the pictures, `frames` are the input's, None for grey ones.

    `dressed` shows the default head as a character.

    The page needs no other file and no network, and follows the reader's light or dark setting.
    """
    config = config_of_track(track.meta)
    flags = flag_frames(track, config)
    worst = worst_frames(track, flags)
    shown = _spread(track)
    pictures = _pictures(track, model, frames, sorted({*worst, *shown}), progress, dressed)
    title = title or _name(track)
    body = [
        f"<h1>{html.escape(title)}</h1>",
        f'<p class="soft">{html.escape(_subtitle(track))}</p>',
        _cards(track, flags),
        "<h2>Pictures</h2>",
        _gallery(track, shown, pictures),
        "<h2>Errors</h2>",
        _errors(track, flags),
        "<h2>Worst frames</h2>",
        _worst(track, worst, flags, pictures),
        "<h2>Head pose</h2>",
        _pose(track, flags),
        "<h2>Expression</h2>",
        _expression(track, flags),
        "<h2>Settings</h2>",
        _settings(config),
        "<h2>Where this comes from</h2>",
        _origin(track),
    ]
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{STYLE.read_text(encoding='utf-8')}</style></head>\n<body>"
        + "\n".join(body)
        + "</body></html>\n"
    )
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def worst_frames(track: Track, flags: FrameFlags) -> list[int]:
    """Positions of the frames to look at first: those that stand out by severity, then those with the largest error.

    Of frames next to each other only the worst is taken. A frame that infill made has no error of its own: it is
    listed only where it stands out.
    """
    error = np.nan_to_num(frame_errors(track)[:, 2], nan=-1.0)
    apart = 1 if track.meta.get("stills") else APART
    chosen: list[int] = []
    for position in np.lexsort((-error, -flags.severity)).tolist():
        listed = track.found[position] and (flags.flagged[position] or error[position] >= 0.0)
        if listed and all(abs(position - other) >= apart for other in chosen):
            chosen.append(position)
        if len(chosen) == WORST:
            break
    return chosen


def _spread(track: Track) -> list[int]:
    found = np.flatnonzero(track.found)
    if not len(found):
        return []
    return sorted({int(found[k]) for k in np.linspace(0, len(found) - 1, PICTURES).round().astype(int)})


def _pictures(
    track, model, frames: Frames | None, positions, progress, dressed: DressedHead | None
) -> dict[int, UInt8[np.ndarray, "h w 3"]]:
    """Overlay and head side by side, for some frames; a stream is read once."""
    made: dict[int, np.ndarray] = {}
    wanted = {int(track.index[position]): position for position in positions}
    if not wanted:
        return made
    stream = frames.iterate(min(wanted)) if frames is not None else None
    sources = {}
    for frame in stream or ():
        if frame.index in wanted:
            sources[wanted[frame.index]] = frame.picture
        if frame.index >= max(wanted):
            break
    with HeadPanel(model, (PICTURE_PX, PICTURE_PX), supersampling=2.0, dressed=dressed) as panel:
        for done, position in enumerate(positions, 1):
            fit = track[position]
            width, height = fit.image_size
            source = sources.get(position)
            picture = np.full((height, width, 3), CANVAS, np.uint8) if source is None else source
            overlay = draw_overlay(*close_up(picture, fit, PICTURE_PX), parts=PARTS)
            made[position] = side_by_side(overlay, panel.submit(fit).result()[0])
            if progress is not None:
                progress(done, len(positions))
    return made


def _cards(track: Track, flags: FrameFlags) -> str:
    summary = summary_of([track])
    inner = summary["reprojection_error"]["inner_51_percent_of_eye_distance"]["mean"]
    every = summary["reprojection_error"]["all_68_percent_of_eye_distance"]["mean"]
    solve = summary["milliseconds_per_frame"]["solve"]["p50"]
    filled = f", {summary['frames_filled']} of them filled" if summary["frames_filled"] else ""
    cards = [
        (f"{summary['frames_with_face']} of {summary['frames']}", f"frames with a face{filled}"),
        ("–" if inner is None else f"{inner:.2f} %", "error of the inner 51, of the eye distance"),
        ("–" if every is None else f"{every:.2f} %", "error of all 68"),
        (str(int(flags.flagged.sum())), "frames stand out"),
        ("–" if solve is None else f"{solve:.1f} ms", "median solve"),
        _camera(summary["camera"]),
    ]
    return '<div class="cards">{}</div>'.format(
        "".join(f'<div class="card"><b>{html.escape(a)}</b><span>{html.escape(b)}</span></div>' for a, b in cards)
    )


def _camera(camera: Mapping[str, Any]) -> tuple[str, str]:
    """The card of a summary's camera."""
    if camera["projection"] == "orthographic":
        return "parallel", "projection, no lens"
    return f"{camera['horizontal_fov_deg']:.0f}°", "field of view" + (", guessed" if camera["guessed"] else "")


def _gallery(track, positions, pictures) -> str:
    if not positions:
        return "<p>No frame has a face.</p>"
    made = []
    for position in positions:
        address = data_address(pictures[position])
        frame = int(track.index[position])
        made.append(f'<figure><img src="{address}" alt="frame {frame}"><figcaption>frame {frame}</figcaption></figure>')
    told = "Rings: detected; dots: the model, coloured by their distance; beside them the fitted head."
    return f'<div class="pictures">{"".join(made)}</div><p class="soft">{told}</p>'


def _errors(track: Track, flags: FrameFlags) -> str:
    errors = frame_errors(track)
    curves = {"inner 51": errors[:, 2], "all 68": errors[:, 3]}
    rows = "".join(f'<li style="flex:{count}">{html.escape(group)}</li>' for group, count in strip_rows(track))
    strip = data_address(residual_picture(track), ".png")
    grey = "no face, or filled from its neighbours" if _filled(track).any() else "no face"
    scale = f'0 <span class="scale" style="background:{scale_gradient()}"></span> 10 % and more'
    return (
        line_chart(track.index.astype(float), curves, "error, % of the eye distance", _marked(track, flags))
        + f'<div class="strip"><ol>{rows}</ol><img src="{strip}" alt="error of every landmark over the frames"></div>'
        + f'<p class="soft">Every landmark over the frames; grey: {grey}. {scale}</p>'
    )


def _worst(track: Track, positions: list[int], flags: FrameFlags, pictures) -> str:
    if not positions:
        return "<p>No frame has a face.</p>"
    errors = frame_errors(track)
    rows = []
    for position in positions:
        frame = int(track.index[position])
        why = flags.text[position] or "does not stand out; one of the largest errors of this clip"
        if _filled(track)[position]:
            why += "; filled from its neighbours"
        elif np.isfinite(errors[position, 3]):
            why += f"; largest at {_largest_parts(track, position)}"
        severity = f"{flags.severity[position]:.2f}" if flags.flagged[position] else "–"
        rows.append(
            f'<tr><td><img src="{data_address(pictures[position])}" alt="frame {frame}"></td>'
            f'<td class="number">{frame}</td><td class="number">{_number(errors[position, 2])}</td>'
            f'<td class="number">{_number(errors[position, 3])}</td>'
            f'<td class="number">{severity}</td><td class="why">{html.escape(why)}</td></tr>'
        )
    heads = ("", "frame", "inner 51, %", "all 68, %", "severity", "why")
    header = "".join(f'<th class="{"number" if 0 < k < 5 else ""}">{head}</th>' for k, head in enumerate(heads))
    hint = "<p class='soft'><code>workbench diagnose RUN --frame N</code> tells what could be changed.</p>"
    return f'<div class="wide"><table><tr>{header}</tr>{"".join(rows)}</table></div>{hint}'


def _largest_parts(track: Track, position: int) -> str:
    """The two parts of the face with the largest mean errors."""
    fit = track[position]
    parts = fit.scheme.parts.items()
    means = {part: float(fit.residuals_percent[list(points)].mean()) for part, points in parts}
    worst = sorted(means, key=means.get, reverse=True)[:2]
    return " and ".join(f"{group} ({means[group]:.1f} %)" for group in worst)


def _pose(track: Track, flags: FrameFlags) -> str:
    frames = track.index.astype(float)
    angles = dict(zip(("yaw", "pitch", "roll"), track.angles_deg.T, strict=True))
    names = ("right", "down", "depth")
    if len(track) == 1:
        rows = [(f"{name}, degrees", _number(value)) for name, (value,) in angles.items()]
        rows += [(f"{name}, mm", _number(value)) for name, value in zip(names, track.translation[0], strict=True)]
        return _table(("", ""), rows)
    middle = np.nanmedian(track.translation, axis=0) if track.found.any() else np.zeros(3)
    places = {
        f"{name} − {value:.0f} mm": column - value
        for name, column, value in zip(names, track.translation.T, middle, strict=True)
    }
    return line_chart(frames, angles, "degrees", _marked(track, flags)) + line_chart(
        frames, places, "mm from the median"
    )


def _expression(track: Track, flags: FrameFlags) -> str:
    if not track.found.any():
        return "<p>No frame has a face.</p>"
    if not track.expression_names:
        return "<p>The model has no blendshapes.</p>"
    motion = np.nanstd(track.expression, axis=0)
    names = track.expression_names
    looks = [k for k, name in enumerate(names) if name in GAZE_NAMES]
    most = [k for k in np.argsort(-motion, kind="stable") if k not in looks][:CURVES]
    curves, gaze = ({names[k]: track.expression[:, k] for k in chosen} for chosen in (most, looks))
    low, high, mean = (made(track.expression, axis=0) for made in (np.nanmin, np.nanmax, np.nanmean))
    rows = [
        (name, f"{mean[k]:.3f}", f"{low[k]:.3f}", f"{high[k]:.3f}", f"{motion[k]:.3f}") for k, name in enumerate(names)
    ]
    table = _table(("blendshape", "mean", "least", "most", "deviation"), rows)
    frames, marked = track.index.astype(float), _marked(track, flags)
    return (
        line_chart(frames, curves, f"weight, the {len(most)} that move most", marked)
        + line_chart(frames, gaze, "weight of the eyes' units: where they look", marked)
        + f"<details><summary>All {len(names)} weights</summary>{table}</details>"
    )


def _settings(config: Config | None) -> str:
    if config is None:
        return "<p>The track does not say how it was made.</p>"
    changed = differences(preset(config.preset), config)
    if changed:
        rows = [
            ("landmarks", "", item.moved_points)
            if item.moved_points
            else (item.path, _text(item.before), _text(item.after))
            for item in changed
        ]
        told = _table(("setting", f"preset {config.preset}", "this run"), rows, numbers=False)
    else:
        told = f"<p>The preset <b>{html.escape(config.preset)}</b> without a change.</p>"
    told_of = config.model_dump(mode="json")
    moved = {frame: f"{len(points)} points" for frame, points in config.landmarks.moved.items()}
    flat = _flat(told_of | {"landmarks": told_of["landmarks"] | {"moved": moved}})
    return (
        told
        + f"<details><summary>All settings</summary>{_table(('setting', 'value'), flat, numbers=False)}</details>"
        + f"<details><summary>As a file for --config</summary><pre>{html.escape(config_toml(config))}</pre></details>"
    )


def _origin(track: Track) -> str:
    meta = track.meta
    rows = [("input", f"{item['path']}  sha256 {item['sha256'][:16]}…") for item in meta.get("inputs", [])]
    if meta.get("landmarks"):
        rows.append(("landmarks", f"{meta['landmarks']['path']}  sha256 {meta['landmarks']['sha256'][:16]}…"))
    if "detector" in meta:  # a session on a picture in memory cannot say
        rows.append(("detector", meta["detector"] or "none: landmarks from a file"))
    if meta.get("model"):
        rows.append(("model", f"{meta['model']['name']}  sha256 {meta['model']['sha256'][:16]}…"))
    rows += [(name, str(version)) for name, version in meta.get("versions", {}).items()]
    return _table(("", ""), rows, numbers=False)


def _subtitle(track: Track) -> str:
    rate = track.meta.get("rate")
    shots = len(np.unique(track.shot))
    seconds = (
        f", {len(track) / rate:.1f} s at {rate:g} frames per second" if rate and not track.meta.get("stills") else ""
    )
    return f"{len(track)} frames{seconds}, {shots} shot{'' if shots == 1 else 's'}"


def _name(track: Track) -> str:
    inputs = track.meta.get("inputs", [])
    return Path(inputs[0]["path"]).name if inputs else "Track"


def _marked(track: Track, flags: FrameFlags) -> dict[int, str]:
    """The frames that stand out, and why."""
    return {int(track.index[k]): flags.text[k] for k in np.flatnonzero(flags.flagged)}


def _filled(track: Track) -> Bool[np.ndarray, "n"]:
    """Frames that infill made."""
    return track.source == SOURCES.index("filled")


def _number(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "–"


def _table(heads: Iterable[str], rows: Iterable[Iterable[Any]], numbers: bool = True) -> str:
    def cells(kind: str, row: Iterable[Any]) -> str:
        return "".join(
            f"<{kind}{' class=number' if numbers and k else ''}>{html.escape(str(cell))}</{kind}>"
            for k, cell in enumerate(row)
        )

    lines = [cells("th", heads)] if any(heads) else []
    lines += [cells("td", row) for row in rows]
    return '<div class="wide"><table>{}</table></div>'.format("".join(f"<tr>{line}</tr>" for line in lines))


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Settings by their dotted names."""
    rows = []
    for name, value in values.items():
        if isinstance(value, Mapping) and value:
            rows += _flat(value, f"{prefix}{name}.")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            for entry in value:
                rows += _flat(entry, f"{prefix}{name}.{entry.get('name', '')}.")
        else:
            rows.append((f"{prefix}{name}", _text(value)))
    return rows


def _text(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:g}" if isinstance(value, float) else str(value)
