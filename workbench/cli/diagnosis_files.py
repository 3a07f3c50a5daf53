"""Flags and diagnoses as records of what is printed, written as JSON and CSV."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import workbench
from workbench.files import atomic_path

FLAG_COLUMNS = ("frame", "severity", "why")
REASON_COLUMNS = (
    *("rank", "code", "title", "evidence", "change", "measure", "before_percent", "after_percent", "score"),
)


def flags_record(track: "workbench.Track", flags: "workbench.diagnosis.FrameFlags") -> dict[str, Any]:
    """The frames of a track that stand out, worst first."""
    order = np.argsort(-flags.severity, kind="stable")
    flagged = [
        {"frame": int(track.index[k]), "severity": float(flags.severity[k]), "why": flags.text[k]}
        for k in order
        if flags.flagged[k]
    ]
    return {"frames": len(track), "frames_with_face": int(track.found.sum()), "flagged": flagged}


def diagnosis_record(
    diagnosis: "workbench.diagnosis.Diagnosis", names: Sequence[str], frames: int, pictures: bool
) -> dict[str, Any]:
    """All that was found about one frame of a clip of `frames`; `pictures`: whether they were looked at."""
    pixels, inner, every = diagnosis.fit.errors
    return {
        "frame": diagnosis.fit.index,
        "frames": frames,
        "pictures": pictures,
        "flagged": diagnosis.flag,
        "summary": diagnosis.summary,
        "error": {"all_68_px": pixels, "inner_51_percent": inner, "all_68_percent": every},
        "reasons": [_reason(reason) for reason in diagnosis.reasons],
        "leave_group_out": [_pull(pull) for pull in diagnosis.leave_group_out],
        "uncertainty": _uncertainty(diagnosis.uncertainty, names, diagnosis.fit.expression),
    }


def reason_rows(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The reasons of a `diagnosis_record` as rows of `REASON_COLUMNS`."""
    rows = []
    for rank, reason in enumerate(record["reasons"], 1):
        label = "" if reason["change"] is None else reason["change"]["label"]
        rows.append({**{name: reason.get(name) for name in REASON_COLUMNS}, "rank": rank, "change": label})
    return rows


def write_json(record: Mapping[str, Any], path: Path) -> None:
    """Write a record, completely or not at all; numbers that are not finite become null."""
    text = json.dumps(_plain(record), indent=2, ensure_ascii=False, allow_nan=False)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def write_csv(rows: Iterable[Mapping[str, Any]], columns: Sequence[str], path: Path) -> None:
    """Write rows with a header, completely or not at all."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, columns)
        writer.writeheader()
        writer.writerows(rows)


def _reason(reason: "workbench.diagnosis.Reason") -> dict[str, Any]:
    names = ("code", "title", "evidence", "score", "measure", "before_percent", "after_percent", "numbers")
    return {
        **{name: getattr(reason, name) for name in names},
        "change": None if reason.change is None else _change(reason.change),
    }


def _change(change: "workbench.diagnosis.Change") -> dict[str, Any]:
    names = ("label", "config", "landmarks", "limits", "calibrate")
    return {name: getattr(change, name) for name in names}


def _pull(pull: "workbench.diagnosis.GroupPull") -> dict[str, Any]:
    names = ("group", "rotation_deg", "translation_mm", "distance_percent", "offset_percent")
    errors = ("error_with_percent", "error_without_percent")
    return {**{name: getattr(pull, name) for name in (*names, *errors)}, "weights": dict(pull.weights)}


def _uncertainty(
    found: "workbench.diagnosis.Uncertainty", names: Sequence[str], expression: np.ndarray
) -> dict[str, Any]:
    columns = zip(names, expression, found.weights, found.on_bound, strict=True)
    return {
        "noise_percent": found.noise_percent,
        "condition": found.condition,
        "rotation_deg": found.rotation_deg,
        "translation_mm": found.translation_mm,
        "weights": {
            name: {"value": value, "deviation": deviation, "on_bound": on_bound}
            for name, value, deviation, on_bound in columns
        },
        "pairs": found.pairs,
    }


def _plain(value: Any) -> Any:
    """Dictionaries, lists, text and finite numbers only: what JSON can hold; None for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
