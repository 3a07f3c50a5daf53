// What a sweep has sent, and which of its points lies where. Values are evenly spaced, whatever their scale.
import { BOTTOM, LEFT, RIGHT, TOP } from "../chart/scale.js";
import { clamp } from "../shared/numbers.js";

// The points of a message: sizes of the axes, means and quartiles, the number of the point with the least mean.
export function readSweep(sent, floats) {
  const count = sent.count, [mean, low, high] = [0, 1, 2].map((k) => floats.subarray(k * count, (k + 1) * count));
  let least = -1;
  mean.forEach((value, k) => { if (Number.isFinite(value) && (least < 0 || value < mean[least])) least = k; });
  const [across, up] = [0, 1].map((k) => sent.axes[k]?.values.length ?? 1);
  return { ...sent, mean, low, high, least, across, up, known: mean.filter(Number.isFinite).length };
}

export const plotOf = (width, height) => ({
  width: Math.max(width - LEFT - RIGHT, 1), height: Math.max(height - TOP - BOTTOM, 1),
});

// The middle of the k-th of `count` values on an axis of so many pixels: of a cell in a map, of a point on a curve.
export const middleOf = (k, count, pixels) => ((k + 0.5) / count) * pixels;

// The number of the point under a place in the plot; the second setting runs fastest, and its least is at the bottom.
export function pointAt(sweep, plot, x, y) {
  const under = (place, count, pixels) => clamp(Math.floor((place / pixels) * count), 0, count - 1);
  return under(x, sweep.across, plot.width) * sweep.up + under(plot.height - y, sweep.up, plot.height);
}

export const columnOf = (sweep, number) => Math.floor(number / sweep.up);
export const rowOf = (sweep, number) => number % sweep.up;

// The neighbour of a point by an arrow key; the point itself at an edge.
export function neighbour(sweep, number, key) {
  const right = { ArrowLeft: -1, ArrowRight: 1 }[key] ?? 0, above = { ArrowDown: -1, ArrowUp: 1 }[key] ?? 0;
  const column = clamp(columnOf(sweep, number) + right, 0, sweep.across - 1);
  return column * sweep.up + clamp(rowOf(sweep, number) + above, 0, sweep.up - 1);
}

// Which of `count` labels are written where there is room for one every `pixels`: the first, the last and some between.
export function someOf(count, room, pixels) {
  const most = Math.max(2, Math.floor(room / pixels)), step = Math.max(1, Math.ceil((count - 1) / (most - 1 || 1)));
  return Array.from({ length: count }, (_, k) => k).filter((k) => k % step === 0);
}
