import { words } from "../chart/ticks.js";
import { columnOf, rowOf } from "./places.js";

// The facts about a point.
export function factsOf(sweep, number) {
  const settings = sweep.axes.map((axis, k) => `${axis.name} ${axis.values[(k ? rowOf : columnOf)(sweep, number)]}`);
  if (!Number.isFinite(sweep.mean[number])) return [...settings, "not known yet"];
  const unit = sweep.unit ? ` ${sweep.unit.split(" ")[0]}` : ""; // of what, stands at the plot
  return [
    ...settings, `${sweep.label} ${words(sweep.mean[number])}${unit}`,
    `half the frames: ${words(sweep.low[number])} to ${words(sweep.high[number])}`,
    ...(number === sweep.least ? ["the least"] : []),
  ];
}
