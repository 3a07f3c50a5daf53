import { cleared } from "../shared/canvas.js";
import { clamp } from "../shared/numbers.js";
import { AXIS, FLAG_ROW, GUTTER } from "./span.js";
import { FLAGGED, FOUND, NEW_SHOT, STALE } from "./track.js";

const HALO = "rgba(0, 0, 0, 0.75)";

// A line or, zoomed in, a frame around the column of the current frame, and its number below.
export function paintCursor(canvas, span, column, first, theme) {
  const context = cleared(canvas), wide = span.width() / span.length(), middle = span.toX(column + 0.5);
  if (column + 1 < span.from || column > span.to) return;
  const height = span.bottom() - FLAG_ROW;
  if (wide > 6) {
    for (const [color, thick] of [[HALO, 3], ["#fff", 1]]) {
      context.strokeStyle = color;
      context.lineWidth = thick;
      context.strokeRect(span.toX(column), FLAG_ROW, wide, height);
    }
  } else {
    const x = Math.round(middle);
    context.fillStyle = HALO;
    context.fillRect(x - 2, FLAG_ROW - 3, 4, height + 3);
    context.fillStyle = "#fff";
    context.fillRect(x - 1, FLAG_ROW - 3, 2, height + 3);
  }
  paintNumber(context, span, middle, String(column + first), theme);
}

// The frame number is on a plate below the line, over the axis.
function paintNumber(context, span, middle, text, { ink, paper, font }) {
  context.font = `600 10px ${font}`;
  const half = context.measureText(text).width / 2 + 4;
  const x = clamp(middle, GUTTER + half, GUTTER + span.width() - half);
  context.fillStyle = ink;
  context.fillRect(x - half, span.bottom() + 2, 2 * half, AXIS - 3);
  context.fillStyle = paper;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(text, x, span.bottom() + 10);
}

// The facts about a frame, one per line.
export function wordsOf(track, column, { names, unit, why, marked }) {
  const mark = track.marks[column], worst = track.worst[column], number = column + track.first;
  const words = [`frame ${number}`];
  words.push(
    mark & FOUND && Number.isFinite(track.largest[column])
      ? `worst: ${worst} ${names[worst]}\n${+track.largest[column].toPrecision(3)} ${unit}`
      : "no face",
  );
  if (mark & FLAGGED) words.push(why[column] ? `flagged: ${why[column]}` : "flagged");
  if (marked.some(([first, last]) => first <= number && number <= last)) words.push("marked as failed");
  if (mark & STALE) words.push("out of date: a detection or setting has changed");
  if (mark & NEW_SHOT) words.push("a new shot begins");
  return words;
}

export function placeHover(box, stage, x) {
  const wide = box.offsetWidth, fits = x + 14 + wide <= stage.clientWidth;
  box.style.left = `${fits ? x + 14 : Math.max(x - 14 - wide, 0)}px`;
  box.style.top = `${FLAG_ROW + 4}px`;
}
