"""A strip of landmark errors over all frames of a clip, to find bad frames and go to them."""

import threading
from collections.abc import Sequence

import anywidget
import numpy as np
import traitlets
from jaxtyping import Bool, Float, Int, Num, UInt8

from workbench.errors import InputError
from workbench.landmarks.scheme import IBUG68, POINT_COUNT, LandmarkScheme
from workbench.widgets.browser_program import browser_program, style_text
from workbench.widgets.overlay_view import SMALLEST_SCALE, automatic_scale, color_table, float_bytes

NOTHING = 255
"""Colour index of a frame without a face; 0 to 254 are colours."""
FLAGGED, STALE, FOUND, NEW_SHOT = 1, 2, 4, 8
"""Bits of a frame's mark."""
ROWS = 68
"""Of the strip: a point each, or the worst of a few neighbours of one part of the face."""


def strip_rows(scheme: LandmarkScheme) -> dict[str, list[Int[np.ndarray, "_"]]]:
    """The points of each of the strip's rows, by part of the face: as many rows for each part, so that all are read.

    Where a part has too few points for that, the rows are shared out by the number of points.
    """
    parts = scheme.parts
    sizes, alike = np.array([len(points) for points in parts.values()]), ROWS / len(parts)
    shares = np.full(len(parts), alike) if sizes.min() > alike else sizes * (ROWS / len(scheme))
    counts = np.diff(np.rint(np.cumsum([0.0, *shares]))).astype(int)
    return {
        name: np.array_split(np.array(points), count)
        for (name, points), count in zip(parts.items(), counts.tolist(), strict=True)
    }


def color_indices(values: Num[np.ndarray, "n rows"], scale: float) -> UInt8[np.ndarray, "n rows"]:
    """Colour index of every residual: 0 at zero, 254 at `scale` and above, `NOTHING` if it is not finite."""
    places = np.clip(np.where(np.isfinite(values), values, 0.0) / scale, 0.0, 1.0)
    return np.where(np.isfinite(values), np.rint(places * (NOTHING - 1)), NOTHING).astype(np.uint8)


def worst_landmarks(values: Num[np.ndarray, "n points"]) -> tuple[Float[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """Largest residual of every frame and its landmark; NaN and 0 for a frame without residuals."""
    filled = np.where(np.isfinite(values), values, -np.inf)
    worst = filled.argmax(axis=1) if len(filled) else np.zeros(0, int)
    largest = filled[np.arange(len(filled)), worst]
    return np.where(np.isfinite(largest), largest, np.nan), worst


def frame_marks(
    flagged: Bool[np.ndarray, "n"],
    stale: Bool[np.ndarray, "n"],
    found: Bool[np.ndarray, "n"],
    shots: Int[np.ndarray, "n"],
) -> UInt8[np.ndarray, "n"]:
    """One byte of marks per frame; the first frame of each shot except the first has `NEW_SHOT`."""
    cuts = np.diff(shots, prepend=shots[:1]) != 0
    return (FLAGGED * flagged + STALE * stale + FOUND * found + NEW_SHOT * cuts).astype(np.uint8)


class TimelineView(anywidget.AnyWidget):
    """Coloured landmark errors over frames, with flags and shots above; a click goes to a frame.

    `frame` is the current frame, numbered from the `first_index` of the track, and follows mouse and keys. Setters may
    be called from any thread. If there are more frames than pixels, every pixel shows its worst frame, so that a
    single bad one is never hidden.
    """

    _esm = browser_program("timeline/view.js")
    _css = style_text("timeline/view.css")

    frame = traitlets.Int(0, help="the current frame").tag(sync=True)
    scale_max = traitlets.Float(0.0, min=0.0, help="end of the colour scale; 0: automatic").tag(sync=True)
    unit = traitlets.Unicode("px", help="unit of the residuals").tag(sync=True)
    height_px = traitlets.Int(150, min=100).tag(sync=True)
    marked = traitlets.List(help="first and last frame of each part that the user marked as failed").tag(sync=True)
    loop = traitlets.List(help="first and last frame of the part that is worked on; empty: the whole").tag(sync=True)
    in_view = traitlets.List([0, 0], help="first and last frame shown in the browser").tag(sync=True)
    _scale = traitlets.Float(SMALLEST_SCALE).tag(sync=True)
    _scheme = traitlets.Dict().tag(sync=True)
    _why = traitlets.Dict(help="why a frame is flagged, by its position in the track").tag(sync=True)
    # The trait is only a counter, and the track is in the message: this allows sending a part of a track alone, while
    # a browser that connects later still gets everything.
    _track = traitlets.Int(0).tag(sync=True, to_json=lambda _counter, view: view._packed())

    def __init__(self, height_px: int = 150, scheme: LandmarkScheme = IBUG68, **traits: object) -> None:
        self._lock = threading.RLock()
        self._first = 0
        self._values = np.zeros((0, len(scheme)), np.float32)
        chosen = strip_rows(scheme)
        self._rows = [points for rows in chosen.values() for points in rows]
        self._flagged, self._stale, self._found = (np.zeros(0, bool) for _ in range(3))
        self._shots = np.zeros(0, int)
        self._patched = False
        firsts = np.cumsum([0, *map(len, chosen.values())]).tolist()
        named = zip(chosen.items(), firsts[:-1], strict=True)
        rows = [{"name": name, "first": first, "count": len(rows)} for (name, rows), first in named]
        told = {"names": list(scheme.point_names), "rows": rows, "colors": color_table().tobytes()}
        super().__init__(height_px=height_px, _scheme=told, **traits)
        self.on_msg(self._on_message)
        self.observe(self._on_scale, "scale_max")

    def __repr__(self) -> str:
        return f"TimelineView({len(self._values)} frames from {self._first}, at {self.frame})"

    @property
    def scale(self) -> float:
        """Residual at the bright end of the colours, in `unit`."""
        return self._scale

    @property
    def flagged(self) -> tuple[int, ...]:
        """Indices of the flagged frames."""
        return tuple((self._first + np.flatnonzero(self._flagged)).tolist())

    def set_track(
        self,
        values: Num[np.ndarray, "..."],
        flagged: Bool[np.ndarray, "..."] | None = None,
        stale: Bool[np.ndarray, "..."] | None = None,
        found: Bool[np.ndarray, "..."] | None = None,
        shots: Int[np.ndarray, "..."] | None = None,
        first_index: int = 0,
        why: Sequence[str] = (),
    ) -> None:
        """Show residuals (frames, points) in `unit`, NaN without a face; the first frame is number `first_index`.

        The other arrays are (frames,); `why` is the reason for each flagged frame. `found` defaults to frames with any
        residual; without `shots` the clip is one shot. `frame` is kept if the track contains it. Raises `InputError`
        for arrays of different lengths.
        """
        values = self._checked_values(values)
        count = len(values)
        if len(why) not in (0, count):
            raise InputError(f"why must have one text for each of the {count} frames; got {len(why)}")
        shots = np.zeros(count, int) if shots is None else _per_frame("shots", shots, count, int)
        marks = [
            np.zeros(count, bool) if given is None else _per_frame(name, given, count, bool)
            for name, given in (("flagged", flagged), ("stale", stale))
        ]
        found = np.isfinite(values).any(axis=1) if found is None else _per_frame("found", found, count, bool)
        with self._lock:
            self._first, self._values, self._shots, self._found = int(first_index), values, shots, found
            self._flagged, self._stale = marks
            with self.hold_sync():
                self._why = {str(k): why[k] for k in np.flatnonzero(marks[0]).tolist()} if len(why) else {}
                self._scale = self._chosen_scale()
                self._send_all()
        # Outside the lock, because an observer of the frame may wait for another thread that needs this view.
        self.frame = int(np.clip(self.frame, first_index, first_index + max(count - 1, 0)))

    def update_frames(
        self,
        start: int,
        values: Num[np.ndarray, "..."],
        flagged: Bool[np.ndarray, "..."] | None = None,
        stale: Bool[np.ndarray, "..."] | None = None,
        found: Bool[np.ndarray, "..."] | None = None,
        shots: Int[np.ndarray, "..."] | None = None,
    ) -> None:
        """Replace frames from index `start` on; only these are sent, unless the automatic scale must grow.

        `flagged`, `stale` and `shots` are unchanged if not given; `found` follows the values. Raises `InputError` for
        frames outside the track.
        """
        values = self._checked_values(values)
        count = len(values)
        with self._lock:
            begin = start - self._first
            if begin < 0 or begin + count > len(self._values):
                last = self._first + len(self._values) - 1
                raise InputError(
                    f"frames {start} to {start + count - 1} are not all in the track {self._first} to {last}"
                )
            part = slice(begin, begin + count)
            new = {"_flagged": flagged, "_stale": stale, "_shots": shots}
            new["_found"] = np.isfinite(values).any(axis=1) if found is None else found
            for name, given in new.items():
                if given is not None:
                    kind = getattr(self, name).dtype.type
                    getattr(self, name)[part] = _per_frame(name.removeprefix("_"), given, count, kind)
            self._values[part] = values
            if self.scale_max == 0 and automatic_scale(values) > self._scale and self._chosen_scale() != self._scale:
                with self.hold_sync():
                    self._scale = self._chosen_scale()
                    self._send_all()
                return
            self._patched = True
            # The frame after the part may now begin a shot, or no longer do so.
            part = slice(begin, min(begin + count + 1, len(self._values)))
            arrays = self._arrays(part)
            self.send({"kind": "part", "start": begin, "names": list(arrays)}, buffers=list(arrays.values()))

    def _checked_values(self, values: Num[np.ndarray, "..."]) -> Float[np.ndarray, "n points"]:
        points = self._values.shape[1]
        if np.ndim(values) != 2 or np.shape(values)[1] != points:
            raise InputError(f"residuals of a track must have shape (frames, {points}); got {np.shape(values)}")
        return np.array(values, np.float32)

    def _by_rows(self, values: Float[np.ndarray, "n points"]) -> Float[np.ndarray, "n rows"]:
        """The largest residual of each row's points."""
        if values.shape[1] == POINT_COUNT:
            return values
        return np.stack([values[:, points].max(axis=1) for points in self._rows], axis=1)

    def _arrays(self, part: slice) -> dict[str, bytes]:
        values = self._values[part]
        largest, worst = worst_landmarks(values)
        marks = frame_marks(self._flagged, self._stale, self._found, self._shots)[part]
        return {
            "codes": color_indices(self._by_rows(values), self._scale).tobytes(),
            "largest": float_bytes(largest),
            "worst": worst.astype("<u2").tobytes(),
            "marks": marks.tobytes(),
        }

    def _packed(self) -> dict[str, object]:
        with self._lock:
            return {"first": self._first, "count": len(self._values), **self._arrays(slice(None))}

    def _send_all(self) -> None:
        self._patched = False
        self._track += 1

    def _chosen_scale(self) -> float:
        return self.scale_max if self.scale_max > 0 else automatic_scale(self._values)

    def _on_scale(self, _change: object) -> None:
        with self._lock, self.hold_sync():
            self._scale = self._chosen_scale()
            self._send_all()

    def _on_message(self, _widget: object, content: object, _buffers: object) -> None:
        # A second display of the view in the same page has only the last complete track.
        with self._lock:
            if isinstance(content, dict) and content.get("kind") == "shown" and self._patched:
                self._send_all()


def _per_frame(name: str, given: np.ndarray, count: int, kind: type) -> np.ndarray:
    if np.shape(given) != (count,):
        raise InputError(f"{name} must have one entry for each of the {count} frames; got shape {np.shape(given)}")
    return np.array(given, kind)
