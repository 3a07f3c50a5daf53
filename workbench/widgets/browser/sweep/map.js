import { LEFT, TOP } from "../chart/scale.js";
import { BLUE } from "./curve.js";
import { columnOf, middleOf, rowOf, someOf } from "./places.js";

const FAINT = 0.06, WIDE = 5; // means that differ by more than this factor are coloured by their logarithms

// A cell for each point, the stronger the less. Returns where each lies.
export function paintMap(context, sweep, plot, theme) {
  const share = sharesOf(sweep), wide = plot.width / sweep.across, tall = plot.height / sweep.up;
  const left = (k) => LEFT + columnOf(sweep, k) * wide, top = (k) => TOP + plot.height - (rowOf(sweep, k) + 1) * tall;
  sweep.mean.forEach((value, k) => {
    context.fillStyle = Number.isFinite(value) ? BLUE : theme.grid;
    context.globalAlpha = Number.isFinite(value) ? FAINT + (1 - FAINT) * (1 - share(value)) : 0.25;
    context.fillRect(left(k) + 0.5, top(k) + 0.5, wide - 1, tall - 1);
  });
  context.globalAlpha = 1;
  context.fillStyle = theme.muted;
  context.textAlign = "right";
  context.textBaseline = "middle";
  const names = sweep.axes[1].values;
  for (const k of someOf(names.length, plot.height, 14)) {
    context.fillText(names[k], LEFT - 5, TOP + plot.height - middleOf(k, sweep.up, plot.height));
  }
  return (k) => [left(k) + wide / 2, top(k) + tall / 2];
}

// From 0 at the least mean to 1 at the most.
export function sharesOf({ mean }) {
  const known = [...mean].filter(Number.isFinite), least = Math.min(...known), most = Math.max(...known);
  const scaled = least > 0 && most > WIDE * least ? Math.log : (value) => value;
  return (value) => (most > least ? (scaled(value) - scaled(least)) / (scaled(most) - scaled(least)) : 0);
}
