import { cleared } from "../shared/canvas.js";
import { clamp } from "../shared/numbers.js";
import { FLAG_ROW, GUTTER, roundStep } from "./span.js";
import { FLAGGED, FOUND, NEW_SHOT, NOTHING, ROWS, STALE, columnFrames } from "./track.js";

const FLAG_COLOR = "#d55e00", MARK_COLOR = "#56b4e9", MARK_TINT = "rgba(86, 180, 233, 0.45)";

// The colours of residuals as pixels, from 0 to the end of the scale.
export function pixelTable(rgb) {
  const table = new Uint32Array(256), bytes = new Uint8Array(table.buffer);
  for (let k = 0; k < 255; k++) {
    const from = 3 * Math.round((k * 255) / 254);
    bytes.set([rgb[from], rgb[from + 1], rgb[from + 2], 255], 4 * k);
  }
  return table;
}

// The strip as pixels: the worst frame of each column for each landmark.
function stripPixels(track, columns, { from, to }, table) {
  const image = new ImageData(columns, ROWS), pixels = new Uint32Array(image.data.buffer);
  const worst = new Int16Array(ROWS);
  for (let column = 0; column < columns; column++) {
    const [start, end] = columnFrames(column, columns, from, to, track.count);
    worst.fill(-1);
    for (let k = start * ROWS; k < end * ROWS; k += ROWS) {
      for (let i = 0; i < ROWS; i++) {
        const code = track.codes[k + i];
        if (code !== NOTHING && code > worst[i]) worst[i] = code;
      }
    }
    for (let i = 0; i < ROWS; i++) if (worst[i] >= 0) pixels[i * columns + column] = table[worst[i]];
  }
  return image;
}

// A part of fewer pixels, as the two pupils', has no name: it would be written over its neighbour's.
const LEAST_NAMED_PX = 6;

// Everything but the cursor. `strip`: {track, rows, table, marked, loop, span, theme}.
export function paintStrip(canvas, { track, rows, table, marked, loop, span, theme }) {
  const context = cleared(canvas), width = span.width(), height = span.bottom() - FLAG_ROW;
  context.fillStyle = theme.ground;
  context.fillRect(GUTTER, FLAG_ROW, width, height);
  const lines = rows.map((row) => FLAG_ROW + (row.first / ROWS) * height);
  paintNames(context, rows, lines, height, theme);
  if (!track?.count) return;

  const columns = Math.max(1, Math.round(width * (window.devicePixelRatio || 1)));
  const small = new OffscreenCanvas(columns, ROWS);
  small.getContext("2d").putImageData(stripPixels(track, columns, span, table), 0, 0);
  context.imageSmoothingEnabled = false;
  context.drawImage(small, GUTTER, FLAG_ROW, width, height);
  context.fillStyle = "rgba(255, 255, 255, 0.55)";
  lines.slice(1).forEach((y) => context.fillRect(GUTTER, Math.round(y), width, 1));
  paintMarked(context, marked, track.first, span, height);
  paintLoop(context, loop, track.first, span, height, theme);
  paintFlags(context, track, span, columns, theme.muted, height);
  paintAxis(context, track.first, span, theme.muted);
}

function paintNames(context, rows, lines, height, { font, muted }) {
  context.font = `10px ${font}`;
  context.textBaseline = "middle";
  context.textAlign = "right";
  context.fillStyle = muted;
  context.fillText("flags", GUTTER - 6, FLAG_ROW / 2);
  rows.forEach((row, k) => {
    const tall = (row.count / ROWS) * height;
    if (tall >= LEAST_NAMED_PX) context.fillText(row.name, GUTTER - 6, lines[k] + tall / 2);
  });
}

function paintMarked(context, marked, firstOfTrack, span, height) {
  for (const [first, last] of marked) {
    const left = Math.max(span.toX(first - firstOfTrack), GUTTER);
    const wide = Math.max(Math.min(span.toX(last + 1 - firstOfTrack), GUTTER + span.width()) - left, 0);
    if (!wide) continue;
    context.fillStyle = MARK_TINT;
    context.fillRect(left, FLAG_ROW, Math.max(wide, 1), height);
    context.fillStyle = MARK_COLOR;
    context.fillRect(left, FLAG_ROW - 4, Math.max(wide, 2), 4);
  }
}

// What is outside the part that is worked on is pale, and its ends are marked.
function paintLoop(context, loop, firstOfTrack, span, height, { ground, ink }) {
  if (loop.length < 2) return;
  const left = GUTTER, right = GUTTER + span.width();
  const [from, to] = [loop[0], loop[1] + 1].map((frame) => clamp(span.toX(frame - firstOfTrack), left, right));
  context.globalAlpha = 0.72;
  context.fillStyle = ground;
  context.fillRect(left, FLAG_ROW, from - left, height);
  context.fillRect(to, FLAG_ROW, right - to, height);
  context.globalAlpha = 1;
  context.fillStyle = ink;
  context.fillRect(from - 1, FLAG_ROW, 2, height);
  context.fillRect(to - 1, FLAG_ROW, 2, height);
}

// Flags, out-of-date frames and shots; a column with several frames shows all their marks.
function paintFlags(context, track, span, columns, muted, height) {
  const pixel = span.width() / columns, hatch = context.createPattern(hatching(muted), "repeat");
  for (let column = 0; column < columns; column++) {
    const [start, end] = columnFrames(column, columns, span.from, span.to, track.count);
    let any = 0, all = 255, cut = false;
    for (let k = start; k < end; k++) {
      any |= track.marks[k];
      all &= track.marks[k];
      // Of a frame wider than a pixel, only the first column starts the shot.
      cut ||= Boolean(track.marks[k] & NEW_SHOT) && span.toX(k) > GUTTER + (column - 1) * pixel;
    }
    const x = GUTTER + column * pixel;
    if (any & STALE) {
      context.fillStyle = hatch;
      context.fillRect(x, 1, pixel, FLAG_ROW - 2);
      context.fillStyle = "rgba(128, 128, 128, 0.45)";
      context.fillRect(x, FLAG_ROW, pixel, height);
    }
    if (!(all & FOUND)) {
      context.fillStyle = muted;
      context.fillRect(x, FLAG_ROW - 4, Math.max(pixel, 1), 3);
    }
    if (any & FLAGGED) {
      context.fillStyle = FLAG_COLOR;
      context.fillRect(x, 1, Math.max(pixel, 2), FLAG_ROW - 3);
    }
    if (cut) paintCut(context, Math.round(x), muted, height);
  }
}

function paintCut(context, x, muted, height) {
  context.fillStyle = "rgba(0, 0, 0, 0.6)";
  context.fillRect(x - 1, FLAG_ROW, 3, height);
  context.fillStyle = "#fff";
  context.fillRect(x, FLAG_ROW, 1, height);
  context.fillStyle = muted;
  context.fillRect(x, 0, 1, FLAG_ROW);
}

function hatching(color) {
  const tile = new OffscreenCanvas(6, 6), context = tile.getContext("2d");
  context.strokeStyle = color;
  for (const shift of [-6, 0, 6]) {
    context.moveTo(shift, 6);
    context.lineTo(shift + 6, 0);
  }
  context.stroke();
  return tile;
}

function paintAxis(context, first, span, muted) {
  const width = span.width(), bottom = span.bottom(), step = roundStep(span.length(), width / 70);
  context.fillStyle = muted;
  context.textAlign = "center";
  for (let index = Math.ceil((span.from + first) / step) * step; index < span.to + first; index += step) {
    const x = span.toX(index - first + 0.5);
    context.fillRect(Math.round(x), bottom, 1, 3);
    if (x < GUTTER + width - 12) context.fillText(index, Math.max(x, GUTTER + 6), bottom + 10);
  }
}
