import { errorUnit } from "../shared/faces.js";
import { clamp } from "../shared/numbers.js";

const MARK = 6; // numbers of a landmark: see `pack_fit`
const FULL_SCALE = 4.0; // residual at the bright end of the colours, % of `errorUnit`
const INK = "rgba(16, 18, 22, 0.7)";

// The camera's picture with the landmarks of its fit, as large as the canvas allows.
export function paintPicture(canvas, context, fit, lines, colors) {
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.fillStyle = "#1b1d21";
  context.fillRect(0, 0, canvas.width, canvas.height);
  if (!fit) return;
  const [w, h] = fit.size, scale = Math.min(canvas.width / w, canvas.height / h);
  context.setTransform(scale, 0, 0, scale, (canvas.width - scale * w) / 2, (canvas.height - scale * h) / 2);
  if (fit.picture) context.drawImage(fit.picture, 0, 0, w, h);
  context.translate(0.5, 0.5); // landmark coordinates start at the centre of the first pixel
  if (fit.found) paintMarks(context, fit, lines, colors, scale);
}

function paintMarks(context, fit, lines, colors, scale) {
  const at = (i, column) => fit.marks[MARK * i + column];
  const eyes = errorUnit((i) => [at(i, 0), at(i, 1)]);
  const unit = clamp(Math.pow((scale * eyes || 80) / 110, 0.45), 0.6, 2.0) / scale;
  const colorOf = (i) => colors[Math.round(255 * clamp((100 * at(i, 4)) / eyes / FULL_SCALE, 0, 1))];
  context.lineCap = context.lineJoin = "round";
  context.strokeStyle = "rgba(160, 225, 240, 0.55)";
  context.lineWidth = 1.1 * unit;
  for (const line of lines) {
    context.beginPath();
    line.forEach((i) => context.lineTo(at(i, 2), at(i, 3)));
    context.stroke();
  }
  for (let i = 0; i < 68; i++) {
    context.beginPath();
    context.moveTo(at(i, 0), at(i, 1));
    context.lineTo(at(i, 2), at(i, 3));
    context.strokeStyle = INK;
    context.lineWidth = 2.8 * unit;
    context.stroke();
    context.strokeStyle = colorOf(i);
    context.lineWidth = 1.6 * unit;
    context.stroke();
  }
  for (let i = 0; i < 68; i++) {
    context.beginPath();
    context.arc(at(i, 2), at(i, 3), 2.1 * unit, 0, 2 * Math.PI);
    context.fillStyle = colorOf(i);
    context.strokeStyle = INK;
    context.lineWidth = 0.9 * unit;
    context.fill();
    context.stroke();
  }
}
