import { bytesOf } from "../shared/bytes.js";
import { clamp } from "../shared/numbers.js";

export const ROWS = 68, NOTHING = 255;
export const FLAGGED = 1, STALE = 2, FOUND = 4, NEW_SHOT = 8; // bits of a frame's mark

export function readTrack(sent) {
  return {
    first: sent.first, count: sent.count, codes: new Uint8Array(bytesOf(sent.codes)),
    largest: new Float32Array(bytesOf(sent.largest)), worst: new Uint16Array(bytesOf(sent.worst)),
    marks: new Uint8Array(bytesOf(sent.marks)),
  };
}

// Replaces some frames of a track with those of a message.
export function putPart(track, content, buffers) {
  content.names.forEach((name, k) => {
    const part = new track[name].constructor(bytesOf(buffers[k]));
    track[name].set(part, content.start * (name === "codes" ? ROWS : 1));
  });
}

// The frames [start, end) in each pixel column; at least one, so that zooming in repeats frames.
export function columnFrames(column, columns, from, to, count) {
  const start = Math.floor(from + ((to - from) * column) / columns);
  const end = Math.max(start + 1, Math.floor(from + ((to - from) * (column + 1)) / columns));
  return [clamp(start, 0, count - 1), clamp(end, 1, count)];
}

// The next flagged frame in a direction, around the ends; the frame itself if there is none.
export function nextFlagged({ count, marks }, from, step) {
  for (let steps = 1; steps <= count; steps++) {
    const column = (((from + step * steps) % count) + count) % count;
    if (marks[column] & FLAGGED) return column;
  }
  return from;
}

// The worst of `count` frames from `first` on (a pixel may cover fractions of frames), or a flagged one.
export function worstOf(track, first, count) {
  const rank = (k) => (track.largest[k] || 0) + (track.marks[k] & FLAGGED ? 1e6 : 0);
  let best = first;
  for (let k = first; k < Math.min(first + count, track.count); k++) if (rank(k) > rank(best)) best = k;
  return best;
}
