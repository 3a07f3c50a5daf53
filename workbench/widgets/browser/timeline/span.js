import { clamp } from "../shared/numbers.js";

export const GUTTER = 48, RIGHT = 8, FLAG_ROW = 13, AXIS = 17; // pixels around the strip: labels, flags, frame numbers
const SHORTEST = 8; // fewest frames after zooming in

// The frames [from, to) in view in the strip, counted from the first of the track, and their positions.
export function makeSpan(stage) {
  const span = {
    from: 0, to: 1,
    width: () => Math.max(stage.clientWidth - GUTTER - RIGHT, 1),
    bottom: () => stage.clientHeight - AXIS,
    length: () => span.to - span.from,
    toX: (column) => GUTTER + ((column - span.from) / span.length()) * span.width(),
    toPlace: (x) => span.from + ((x - GUTTER) / span.width()) * span.length(),
    toColumn: (x, count) => clamp(Math.floor(span.toPlace(x)), 0, count - 1),
    shows: (column) => column >= span.from && column + 1 <= span.to,
    set: (start, end, count) => Object.assign(span, zoomed(start, end, count)),
  };
  return span;
}

// A part of a track of `count` frames, moved and stretched until it is inside and long enough.
export function zoomed(start, end, count) {
  const length = clamp(end - start, Math.min(SHORTEST, count), count), from = clamp(start, 0, count - length);
  return { from, to: from + length };
}

// The part after turning the wheel over a frame, which stays under the mouse.
export function zoomedAt({ from, to }, at, factor, count) {
  const length = to - from, next = clamp(length * factor, Math.min(SHORTEST, count), count);
  return [at - ((at - from) * next) / length, at + ((to - at) * next) / length];
}

// A round step of frame numbers for a span with at most `most` of them.
export function roundStep(length, most) {
  const rough = Math.max(length / Math.max(most, 1), 1), decade = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((k) => k * decade).find((step) => step >= rough);
}
