import { floatsOf, makeShape } from "../drawing/mesh.js";
import { bytesOf } from "../shared/bytes.js";

// Morph targets of one head; its shape is computed once per fit, however many displays draw it.
export function makeHead(mesh) {
  const size = 3 * mesh.vertices, raw = new Int16Array(bytesOf(mesh.deltas));
  const deltas = mesh.steps.map((_, k) => raw.subarray(k * size, (k + 1) * size));
  const places = new Float32Array(size), shape = makeShape(mesh);
  let neutral = null, factors = null, person = null;

  function setPerson(message) {
    neutral = floatsOf(message.neutral);
    factors = message.factors;
    person = { rest: message.neutral, growth: message.growth };
  }

  function move(weights) {
    places.set(neutral);
    for (let k = 0; k < deltas.length; k++) {
      const factor = weights ? weights[k] * mesh.steps[k] * factors[k] : 0, delta = deltas[k];
      if (Math.abs(factor) < 1e-9) continue;
      for (let i = 0; i < size; i++) places[i] += factor * delta[i];
    }
    shape.take(places);
  }
  return { move, setPerson, shape, person: () => person };
}
