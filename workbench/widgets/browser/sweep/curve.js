import { paintGrid } from "../chart/lines.js";
import { LEFT, TOP, rangeOf, scaleOf } from "../chart/scale.js";
import { middleOf } from "./places.js";

export const BLUE = "#0072B2", RED = "#D55E00";

// The curve of the means, in the band that holds half of the frames. Returns where each point lies.
export function paintCurve(context, sweep, plot, theme) {
  const { mean, low, high, across } = sweep;
  const scale = scaleOf(rangeOf([0, 1], [mean, low, high], false), plot.width, plot.height, false);
  const there = [...mean.keys()].filter((k) => Number.isFinite(mean[k]));
  const x = (k) => LEFT + middleOf(k, across, plot.width);
  paintGrid(context, scale, theme);
  if (sweep.now !== null) paintNow(context, x(sweep.now), plot, theme);
  context.fillStyle = BLUE;
  context.globalAlpha = 0.22;
  context.beginPath();
  there.forEach((k) => context.lineTo(x(k), scale.toY(high[k])));
  there.reverse().forEach((k) => context.lineTo(x(k), scale.toY(low[k])));
  context.fill();
  context.globalAlpha = 1;
  context.strokeStyle = BLUE;
  context.lineWidth = 1.6;
  context.beginPath();
  there.forEach((k) => context.lineTo(x(k), scale.toY(mean[k])));
  context.stroke();
  for (const k of there) paintDot(context, x(k), scale.toY(mean[k]), 2.6);
  return (k) => [x(k), Number.isFinite(mean[k]) ? scale.toY(mean[k]) : TOP + plot.height / 2];
}

function paintDot(context, x, y, radius) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fill();
}

function paintNow(context, x, plot, theme) {
  context.fillStyle = theme.muted;
  for (let y = TOP; y < TOP + plot.height; y += 5) context.fillRect(Math.round(x), y, 1, 3);
  context.textAlign = x > LEFT + plot.width - 30 ? "right" : "left";
  context.fillText("now", x + (context.textAlign === "right" ? -3 : 3), TOP - 8);
}
