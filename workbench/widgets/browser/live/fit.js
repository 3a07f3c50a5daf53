import { bytesOf } from "../shared/bytes.js";
import { multiplied, orbit } from "../drawing/geometry.js";

const BEFORE_WEIGHTS = 16; // numbers of a fit before its weights: see `pack_fit`

// The numbers of a fit, by name.
export function readFit(content, buffer, shapes) {
  const numbers = new Float32Array(bytesOf(buffer));
  return {
    ...content, turn: numbers.subarray(0, 9), shift: numbers.subarray(9, 12), camera: numbers.subarray(12, 16),
    weights: numbers.subarray(BEFORE_WEIGHTS, BEFORE_WEIGHTS + shapes),
    marks: numbers.subarray(BEFORE_WEIGHTS + shapes),
  };
}

// The view of the avatar: as the camera sees it, turning in front of a fixed camera, or the expression alone.
// `turned`: yaw and pitch by which the user has turned it.
export function poseOf(fit, looking, turned, mesh) {
  const spin = orbit(...turned), front = {
    shift: mesh.translation.map((value, k) => value + mesh.pivot[k]), pivot: mesh.pivot,
    camera: [mesh.focal * 1000, mesh.focal * 1000, 499.5, 499.5], size: [1000, 1000],
  };
  if (!fit || looking === "expression") return { ...front, turn: spin };
  if (looking === "head") return { ...front, turn: multiplied(spin, fit.turn) };
  const centre = [0, 1, 2].map((k) => fit.shift[k] + fit.turn.slice(3 * k, 3 * k + 3)
    .reduce((sum, value, j) => sum + value * mesh.pivot[j], 0));
  return { turn: multiplied(spin, fit.turn), shift: centre, pivot: mesh.pivot, camera: fit.camera, size: fit.size };
}
