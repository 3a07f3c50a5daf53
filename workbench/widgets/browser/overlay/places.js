import { clamp } from "../shared/numbers.js";

// The position of the picture on the screen. Picture coordinates start at the centre of the top left pixel, so the
// picture covers -0.5 to width - 0.5. `mode`: "face", "whole", or "free" once the user has moved it.
export function makeView(mode) {
  const view = { scale: 1, x: 0, y: 0, mode };
  view.toScreen = (x, y) => [view.scale * x + view.x, view.scale * y + view.y];
  view.toPicture = (x, y) => [(x - view.x) / view.scale, (y - view.y) / view.scale];
  return view;
}

// Scale and shift for which a box of the picture fills a stage.
export function fitted([left, top, right, bottom], [width, height]) {
  const scale = Math.min(width / Math.max(right - left, 1), height / Math.max(bottom - top, 1));
  return { scale, x: width / 2 - (scale * (left + right)) / 2, y: height / 2 - (scale * (top + bottom)) / 2 };
}

export const wholeBox = ([width, height]) => [-0.5, -0.5, width - 0.5, height - 0.5];

// The bounding box of the face with a margin: a part of its width, on a profile of its height.
export function faceBox(places) {
  const there = places.filter(([x]) => Number.isFinite(x)), xs = there.map(([x]) => x), ys = there.map(([, y]) => y);
  const left = Math.min(...xs), right = Math.max(...xs), top = Math.min(...ys), bottom = Math.max(...ys);
  const margin = 0.3 * Math.max(right - left, 0.75 * (bottom - top));
  return [left - margin, top - margin, right + margin, bottom + margin];
}

// The view after turning the wheel; the point under the pointer stays fixed.
export function zoomedAt(view, [x, y], factor, size, [width, height]) {
  const whole = Math.min(width / size[0], height / size[1]);
  const scale = clamp(view.scale * factor, 0.5 * whole, Math.max(60, 4 * whole));
  return { scale, x: x - ((x - view.x) * scale) / view.scale, y: y - ((y - view.y) * scale) / view.scale };
}
