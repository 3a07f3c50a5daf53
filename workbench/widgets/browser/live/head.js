import { bytesOf } from "../shared/bytes.js";

// Morph targets and normals of one head; computed once a fit, however many displays draw it.
export function makeHead(mesh) {
  const triangles = new Uint32Array(bytesOf(mesh.triangles)), order = new Uint32Array(bytesOf(mesh.order));
  const size = 3 * mesh.vertices, raw = new Int16Array(bytesOf(mesh.deltas));
  const deltas = mesh.steps.map((_, k) => raw.subarray(k * size, (k + 1) * size));
  const places = new Float32Array(size), normals = new Float32Array(size);
  const out = { places: new Float32Array(3 * order.length), normals: new Float32Array(3 * order.length), stamp: 0 };
  let neutral = null, factors = null;

  function setPerson(person) {
    neutral = new Float32Array(bytesOf(person.neutral));
    factors = person.factors;
  }

  function move(weights) {
    places.set(neutral);
    for (let k = 0; k < deltas.length; k++) {
      const factor = weights ? weights[k] * mesh.steps[k] * factors[k] : 0, delta = deltas[k];
      if (Math.abs(factor) < 1e-9) continue;
      for (let i = 0; i < size; i++) places[i] += factor * delta[i];
    }
    sumNormals(places, triangles, normals);
    for (let i = 0; i < order.length; i++) {
      for (let j = 0; j < 3; j++) {
        out.places[3 * i + j] = places[3 * order[i] + j];
        out.normals[3 * i + j] = normals[3 * order[i] + j];
      }
    }
    out.stamp++;
  }
  return { move, setPerson, out };
}

// Normals of vertices, not of unit length: the sum over their triangles, each weighted by its area.
export function sumNormals(places, triangles, normals) {
  normals.fill(0);
  for (let t = 0; t < triangles.length; t += 3) {
    const a = 3 * triangles[t], b = 3 * triangles[t + 1], c = 3 * triangles[t + 2];
    const ux = places[b] - places[a], uy = places[b + 1] - places[a + 1], uz = places[b + 2] - places[a + 2];
    const vx = places[c] - places[a], vy = places[c + 1] - places[a + 1], vz = places[c + 2] - places[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    for (const corner of [a, b, c]) {
      normals[corner] += x;
      normals[corner + 1] += y;
      normals[corner + 2] += z;
    }
  }
}
