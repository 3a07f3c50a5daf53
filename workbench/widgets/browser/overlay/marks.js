import { errorUnit } from "../shared/faces.js";
import { clamp } from "../shared/numbers.js";
import { indices } from "./landmarks.js";

export const INK = "rgba(16, 18, 22, 0.75)", WHITE = "#ffffff", GREY = "#b4b8bf", CHOSEN = "#ff6ec7";
const SUBSET = "#7fe3ff", LINE = "rgba(150, 220, 235, 0.6)", DOUBT = "#ffd479", WIRE = "rgba(210, 240, 245, 0.3)";
const FEW = 68, CROWDED = 0.6; // more landmarks than these are drawn with marks of this size

export function outline(context, color, width) {
  context.strokeStyle = INK;
  context.lineWidth = width + Math.min(1.6, 0.6 + 0.6 * width);
  context.stroke();
  context.strokeStyle = color;
  context.lineWidth = width;
  context.stroke();
}

export function paintWire(context, wire, toScreen) {
  context.beginPath();
  for (let k = 0; k < wire.length; k += 4) {
    context.moveTo(...toScreen(wire[k], wire[k + 1]));
    context.lineTo(...toScreen(wire[k + 2], wire[k + 3]));
  }
  context.strokeStyle = WIRE;
  context.lineWidth = 0.8;
  context.stroke();
}

export function paintLasso(context, path) {
  context.beginPath();
  path.forEach(([x, y]) => context.lineTo(x, y));
  context.closePath();
  context.fillStyle = "rgba(255, 110, 199, 0.15)";
  context.fill();
  outline(context, CHOSEN, 1.5);
}

// The landmarks of a fit. `look`: {layer, colors, limit, lines, ellipses, chosen, subset, hovered}, as assembled in view.js.
export function paintLandmarks(context, landmarks, view, look) {
  const { layer } = look, { observed } = landmarks, { toScreen } = view;
  // Marks grow with the size of the face on the screen.
  const eyes = view.scale * errorUnit(observed);
  const all = indices(landmarks), crowd = all.length > FEW ? CROWDED : 1;
  const unit = crowd * clamp(Math.pow((eyes || 80) / 110, 0.7), 0.45, 2.6);
  const pen = { context, landmarks, toScreen, unit, circle: circleOf(context, toScreen) };
  pen.colorOf = (i) => {
    const share = Number.isFinite(landmarks.value(i)) ? landmarks.value(i) / look.limit : 1;
    return look.colors[Math.round(255 * clamp(share, 0, 1))];
  };
  if (layer("lines")) paintLines(pen, look.lines);
  if (layer("ellipses")) paintEllipses(pen, look.ellipses);
  paintRings(pen, look.subset, 6.5 * unit + 1);
  if (layer("residuals")) all.filter(landmarks.weight).forEach((i) => paintResidual(pen, i));
  if (layer("arrows")) all.filter(landmarks.weight).forEach((i) => paintArrow(pen, i));
  if (layer("observed")) all.forEach((i) => paintDetection(pen, i));
  if (layer("model")) all.forEach((i) => paintProjection(pen, i));
  for (const i of look.chosen) {
    pen.circle(observed(i), 6.0 * unit);
    outline(context, CHOSEN, 1.8);
  }
  if (look.hovered >= 0) {
    pen.circle(observed(look.hovered), 8.0 * unit);
    outline(context, WHITE, 1);
  }
  // Where there are none: to set a font, the browser looks up the page's style.
  if (look.chosen.size || layer("labels")) paintLabels(pen, look.chosen, layer("labels") ? all : []);
}

const circleOf = (context, toScreen) => ([x, y], radius) => {
  const [sx, sy] = toScreen(x, y);
  context.beginPath();
  context.arc(sx, sy, radius, 0, 2 * Math.PI);
};

function paintLines({ context, landmarks, toScreen, unit }, lines) {
  context.strokeStyle = LINE;
  context.lineWidth = 1.3 * unit;
  for (const line of lines) {
    context.beginPath();
    line.forEach((i) => context.lineTo(...toScreen(...landmarks.projected(i))));
    context.stroke();
  }
}

// `ellipses`: the corners of each landmark's, x and y in turn.
function paintEllipses({ context, landmarks, toScreen, unit }, ellipses) {
  const numbers = ellipses.length / landmarks.count();
  for (let first = 0; first < ellipses.length; first += numbers) {
    context.beginPath();
    for (let k = first; k < first + numbers; k += 2) context.lineTo(...toScreen(ellipses[k], ellipses[k + 1]));
    context.closePath();
    outline(context, landmarks.weight(first / numbers) ? DOUBT : GREY, 0.9 * unit);
  }
}

function paintRings({ context, landmarks, circle }, points, radius) {
  for (const i of points) {
    circle(landmarks.observed(i), radius);
    context.strokeStyle = SUBSET;
    context.lineWidth = 1.2;
    context.stroke();
  }
}

function paintResidual({ context, landmarks, toScreen, unit, colorOf }, i) {
  context.beginPath();
  context.moveTo(...toScreen(...landmarks.observed(i)));
  context.lineTo(...toScreen(...landmarks.projected(i)));
  outline(context, colorOf(i), 1.7 * unit);
}

const LONGER = 4, HEAD = 5; // how much longer arrows are than residuals, and the size of their heads

// From the model's landmark towards the detection, longer than it is, with a head at its end.
function paintArrow({ context, landmarks, toScreen, unit, colorOf }, i) {
  const [x, y] = toScreen(...landmarks.projected(i)), [ox, oy] = toScreen(...landmarks.observed(i));
  const [dx, dy] = [LONGER * (ox - x), LONGER * (oy - y)], length = Math.hypot(dx, dy);
  if (!(length > 1)) return;
  const [ux, uy] = [dx / length, dy / length], head = Math.min(HEAD * unit, 0.5 * length);
  const [tx, ty] = [x + dx, y + dy], side = 0.5 * head;
  context.beginPath();
  context.moveTo(x, y), context.lineTo(tx, ty);
  context.moveTo(tx - head * ux - side * uy, ty - head * uy + side * ux), context.lineTo(tx, ty);
  context.lineTo(tx - head * ux + side * uy, ty - head * uy - side * ux);
  outline(context, colorOf(i), 1.8 * unit);
}

// A ring, small if the detector's confidence is low, crossed out if muted.
function paintDetection({ context, landmarks, toScreen, unit, circle }, i) {
  const guessed = landmarks.confidence(i) < 0.5, mute = !landmarks.weight(i), radius = (guessed ? 2.2 : 3.6) * unit;
  circle(landmarks.observed(i), radius);
  outline(context, mute ? GREY : WHITE, unit);
  if (!mute) return;
  const [x, y] = toScreen(...landmarks.observed(i)), arm = radius * 1.1;
  context.beginPath();
  context.moveTo(x - arm, y - arm), context.lineTo(x + arm, y + arm);
  context.moveTo(x - arm, y + arm), context.lineTo(x + arm, y - arm);
  outline(context, GREY, unit);
}

function paintProjection({ context, landmarks, unit, circle, colorOf }, i) {
  circle(landmarks.projected(i), 2.0 * unit);
  if (!landmarks.weight(i)) return outline(context, GREY, 0.8 * unit);
  context.fillStyle = colorOf(i);
  context.strokeStyle = INK;
  context.lineWidth = 0.9 * unit;
  context.fill();
  context.stroke();
}

// Numbers are on the outer side of their landmark. One that would cover another is left out until zooming in makes
// space; selected landmarks come first.
function paintLabels({ context, landmarks, toScreen, unit }, chosen, all) {
  const { observed } = landmarks, size = clamp(Math.round(10 * unit), 10, 13), taken = [];
  const middle = [observed(30), observed(51)].map((spot) => toScreen(...spot)); // nose tip and upper lip
  context.font = `${size}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  context.textAlign = "center";
  for (const i of [...chosen, ...all.filter((i) => !chosen.has(i))]) {
    const [x, y] = toScreen(...observed(i)), [mx, my] = i < 48 ? middle[0] : middle[1];
    const away = Math.hypot(x - mx, y - my), far = 6 * unit + 8;
    const [dx, dy] = away > 1 ? [(x - mx) / away, (y - my) / away] : [0.7, -0.7];
    const [left, top] = [x + far * dx, y + far * dy];
    if (taken.some(([a, b]) => Math.abs(a - left) < 1.25 * size && Math.abs(b - top) < 0.95 * size)) continue;
    taken.push([left, top]);
    context.strokeStyle = INK;
    context.lineWidth = 3;
    context.strokeText(i, left, top);
    context.fillStyle = chosen.has(i) ? CHOSEN : WHITE;
    context.fillText(i, left, top);
  }
}
