import { cleared, element } from "../shared/canvas.js";
import { clamp } from "../shared/numbers.js";
import { TOP } from "./scale.js";
import { words } from "./ticks.js";

const MOST_VALUES = 10; // lines of the readout

export function paintCursor(canvas, chart, cursor) {
  const context = cleared(canvas), { x, rows, scale, theme, palette, hover } = chart, { range, toX } = scale;
  if (!x.length) return;
  if (cursor !== null && cursor >= range.left && cursor <= range.right) {
    context.fillStyle = theme.ink;
    context.fillRect(Math.round(toX(cursor)) - 0.75, TOP - 3, 1.5, scale.height + 3);
  }
  if (!hover) return;
  context.fillStyle = theme.muted;
  context.fillRect(Math.round(toX(x[hover.index])), TOP, 1, scale.height);
  rows.forEach((row, k) => {
    if (!chart.shown(k) || !Number.isFinite(row[hover.index])) return;
    context.beginPath();
    context.arc(toX(x[hover.index]), scale.toY(row[hover.index]), 3, 0, 2 * Math.PI);
    context.fillStyle = palette[k];
    context.fill();
  });
}

// If there are many series, only those closest to the pointer are read out.
function readOut(seen, { rows, scale, hover }) {
  if (seen.length <= MOST_VALUES) return seen;
  const away = (k) => Math.abs(scale.toY(rows[k][hover.index]) - hover.y);
  return seen.filter((k) => Number.isFinite(away(k))).sort((a, b) => away(a) - away(b)).slice(0, MOST_VALUES);
}

export function paintHover(box, stage, chart) {
  const { x, rows, sent, palette, hover } = chart;
  box.hidden = !hover;
  if (!hover) return;
  const seen = rows.map((_, k) => k).filter(chart.shown), line = document.createElement("div");
  line.textContent = `${sent.x_label || "x"} ${words(x[hover.index])}`;
  const chosen = readOut(seen, chart);
  const entries = chosen.map((k) => {
    const entry = document.createElement("div"), sample = element(entry, "i", "");
    sample.style.background = palette[k];
    entry.append(sent.names[k]);
    element(entry, "b", "").textContent = words(rows[k][hover.index]);
    return entry;
  });
  box.replaceChildren(line, ...entries);
  const left = seen.length - chosen.length;
  if (left) element(box, "div", "").textContent = `and ${left} more`;
  const at = chart.scale.toX(x[hover.index]), wide = box.offsetWidth;
  box.style.left = `${at + 12 + wide > stage.clientWidth ? Math.max(at - 12 - wide, 0) : at + 12}px`;
  const tall = box.offsetHeight, lowest = Math.max(0, stage.clientHeight - tall);
  box.style.top = `${clamp(hover.y - tall / 2, -TOP, lowest)}px`;
}
