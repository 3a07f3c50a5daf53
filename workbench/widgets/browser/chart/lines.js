import { cleared } from "../shared/canvas.js";
import { clamp } from "../shared/numbers.js";
import { dashOf } from "./colors.js";
import { LEFT, TOP } from "./scale.js";
import { linearTicks, logTicks, words } from "./ticks.js";

// The axes and the lines of a chart; `chart` is the state that view.js keeps.
export function paintLines(canvas, chart) {
  const context = cleared(canvas), { scale, theme, sent, rows } = chart;
  context.font = `10px ${theme.font}`;
  context.fillStyle = theme.grid;
  for (const part of sent.shaded) {
    const [start, end] = part.map((value) => clamp(scale.toX(value), LEFT, scale.right));
    context.fillRect(start, TOP, Math.max(end - start, 1), scale.height);
  }
  if (!chart.x.length) return paintNothing(context, scale, theme);
  paintLevels(context, scale, theme);
  paintPlaces(context, scale, sent);
  paintStages(context, scale, sent);
  context.save();
  context.beginPath();
  context.rect(LEFT - 1, TOP - 1, scale.width + 2, scale.height + 2);
  context.clip();
  context.lineJoin = "round";
  rows.forEach((_, k) => chart.shown(k) && paintRow(context, chart, k));
  context.restore();
}

function paintNothing(context, scale, theme) {
  context.fillStyle = theme.muted;
  context.textAlign = "center";
  context.fillText("nothing to show yet", LEFT + scale.width / 2, TOP + scale.height / 2);
}

function paintLevels(context, scale, theme) {
  const { range, width, bottom } = scale;
  paintGrid(context, scale, theme);
  context.fillRect(LEFT, Math.round(bottom), width, 1);
  if (range.zeros) context.fillText("≤ 0", LEFT - 5, bottom);
}

// A line and a number for each level of the values.
export function paintGrid(context, { range, width, height, log, toLevel }, theme) {
  const ticks = (log ? logTicks : linearTicks)(range.low, range.high, Math.max(2, Math.floor(height / 28)));
  context.fillStyle = theme.muted;
  context.textBaseline = "middle";
  context.textAlign = "right";
  for (const tick of ticks) {
    const y = toLevel(tick);
    context.fillStyle = theme.grid;
    context.fillRect(LEFT, Math.round(y), width, 1);
    context.fillStyle = theme.muted;
    context.fillText(words(log ? +(10 ** tick).toPrecision(3) : +tick.toPrecision(10)), LEFT - 5, y);
  }
}

function paintPlaces(context, { range, width, bottom, toX }, sent) {
  context.textAlign = "center";
  for (const tick of linearTicks(range.left, range.right, Math.max(2, Math.floor(width / 70)))) {
    context.fillRect(Math.round(toX(tick)), bottom, 1, 3);
    context.fillText(words(+tick.toPrecision(10)), toX(tick), bottom + 9);
  }
  context.fillText(sent.x_label, LEFT + width / 2, bottom + 22);
}

// The label of the values, and the starts of stages.
function paintStages(context, { right, bottom, toX }, sent) {
  context.textAlign = "left";
  context.fillText(sent.y_label, 2, 8);
  let free = 4 + (sent.y_label ? context.measureText(sent.y_label).width + 12 : LEFT);
  for (const [place, label] of sent.marks) {
    const at = Math.round(toX(place));
    if (at < LEFT - 1 || at > right + 1) continue;
    context.globalAlpha = 0.6;
    for (let y = TOP; y < bottom; y += 5) context.fillRect(at, y, 1, 3);
    context.globalAlpha = 1;
    // A label without enough space is left out; its line stays.
    const wide = context.measureText(label).width, from = clamp(at, LEFT, right - wide);
    if (from < free) continue;
    context.fillText(label, from, 8);
    free = from + wide + 8;
  }
}

function paintRow(context, { x, rows, scale, palette }, k) {
  context.strokeStyle = context.fillStyle = palette[k];
  context.lineWidth = rows.length > 12 ? 1.1 : 1.6; // so that many lines stay distinct
  context.setLineDash(dashOf(k));
  context.beginPath();
  if (x.length > 2 * scale.width) traceDense(context, scale, x, rows[k]);
  else traceSparse(context, scale, x, rows[k]);
  context.stroke();
  context.setLineDash([]);
}

function traceSparse(context, { toX, toY }, x, row) {
  for (let j = 0, down = false; j < row.length; j++) {
    if (!Number.isFinite(row[j])) {
      down = false;
      continue;
    }
    const px = toX(x[j]), py = toY(row[j]);
    if (down) context.lineTo(px, py);
    else context.moveTo(px, py);
    if (!down && !Number.isFinite(row[j + 1])) context.fillRect(px - 1.5, py - 1.5, 3, 3); // alone between gaps
    down = true;
  }
}

// With more values than pixels, each pixel column gets a stroke from its smallest to its largest value.
function traceDense(context, { toX, toY }, x, row) {
  let j = 0, down = false;
  while (j < row.length) {
    const column = Math.floor(toX(x[j]));
    let low = Infinity, high = -Infinity, first = NaN, last = NaN;
    for (; j < row.length && Math.floor(toX(x[j])) === column; j++) {
      if (!Number.isFinite(row[j])) continue;
      if (row[j] < low) low = row[j];
      if (row[j] > high) high = row[j];
      if (Number.isNaN(first)) first = row[j];
      last = row[j];
    }
    if (low > high) {
      down = false;
      continue;
    }
    const px = column + 0.5;
    if (down) context.lineTo(px, toY(first));
    else context.moveTo(px, toY(first));
    context.lineTo(px, toY(low));
    context.lineTo(px, toY(high) - 0.5); // so that a flat stretch is still visible
    context.lineTo(px, toY(last));
    down = true;
  }
}
