export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const scaled = (a, factor) => a.map((value) => value * factor);
export const unit = (a) => scaled(a, 1 / Math.hypot(...a));

export function added(a, b, factor = 1) {
  return a.map((value, k) => value + factor * b[k]);
}

// A vector rotated by an angle about a unit axis.
export function rotated(a, axis, angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return added(added(scaled(a, c), cross(axis, a), s), axis, dot(axis, a) * (1 - c));
}
