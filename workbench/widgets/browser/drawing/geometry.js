// Column-major clip matrix of points in a camera's frame (+y down, +z away): u = fx·x/z + cx in a picture w × h.
export function projectionOf([fx, fy, cx, cy], [w, h], [sx, sy]) {
  const near = 20, far = 20000, depth = (far + near) / (far - near);
  return new Float32Array([
    (2 * fx * sx) / w, 0, 0, 0,
    0, (-2 * fy * sy) / h, 0, 0,
    sx * ((2 * (cx + 0.5)) / w - 1), sy * (1 - (2 * (cy + 0.5)) / h), depth, 1,
    0, 0, (-2 * far * near) / (far - near), 0,
  ]);
}

export function multiplied(a, b) {
  return Array.from({ length: 9 }, (_, k) => {
    const row = 3 * Math.floor(k / 3), column = k % 3;
    return a[row] * b[column] + a[row + 1] * b[3 + column] + a[row + 2] * b[6 + column];
  });
}

export function orbit(yaw, pitch) {
  const [c, s, d, t] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return multiplied([1, 0, 0, 0, d, -t, 0, t, d], [c, 0, s, 0, 1, 0, -s, 0, c]);
}
export const transposed = (m) => [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
