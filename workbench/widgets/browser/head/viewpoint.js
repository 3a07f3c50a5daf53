// Viewpoints of the head: the same as `viewpoint.py`, without asking the kernel.
import { added, cross, dot, rotated, scaled, unit } from "../drawing/vectors.js";
import { clamp } from "../shared/numbers.js";

const NEAREST_MM = 150, FURTHEST_MM = 6000; // distances from the target that zooming can reach
const STEEPEST = 0.995; // cosine between the line of sight and the up direction at which a drag stops tilting

// Eleven numbers, as in Python: position, target and up in the head frame, focal lengths in pixels.
export const viewpointOf = (numbers) => ({
  position: numbers.slice(0, 3), target: numbers.slice(3, 6), up: numbers.slice(6, 9), focal: numbers.slice(9),
});
export const numbersOf = ({ position, target, up, focal }) => [...position, ...target, ...up, ...focal];

// The pose for drawing a picture (width, height) from a viewpoint; see `makeScene`.
export function poseOf({ position, target, up, focal }, [width, height]) {
  const forward = unit(added(target, position, -1)), right = unit(cross(forward, up)), down = cross(forward, right);
  return {
    turn: [...right, ...down, ...forward], shift: [right, down, forward].map((axis) => -dot(axis, position)),
    pivot: [0, 0, 0], camera: [...focal, (width - 1) / 2, (height - 1) / 2], size: [width, height],
  };
}

// How much larger a picture of one size is drawn to fit into another.
export const stretchOf = ([width, height], [wide, high]) => Math.min(wide / width, high / height);

// A pose for a picture of another size: what was in view stays in view.
export function stretched({ camera, size, ...pose }, [wide, high]) {
  const [fx, fy] = camera, scale = stretchOf(size, [wide, high]);
  return { ...pose, camera: [fx * scale, fy * scale, (wide - 1) / 2, (high - 1) / 2], size: [wide, high] };
}

// The viewpoint turned about the target (radians) as if dragging the head: yaw image right, pitch down.
function orbited(viewpoint, yaw, pitch) {
  const { target, up } = viewpoint, away = rotated(added(viewpoint.position, target, -1), up, -yaw);
  const sight = unit(scaled(away, -1)), tilted = rotated(away, unit(cross(sight, up)), -pitch);
  // The up direction is kept, because the picture would flip past the pole.
  const steep = Math.abs(dot(unit(tilted), up)) > Math.max(STEEPEST, Math.abs(dot(sight, up)));
  return { ...viewpoint, position: added(target, steep ? away : tilted) };
}

function zoomed(viewpoint, factor) {
  const { position, target } = viewpoint, away = added(position, target, -1), distance = Math.hypot(...away);
  return { ...viewpoint, position: added(target, away, clamp(distance * factor, NEAREST_MM, FURTHEST_MM) / distance) };
}

// The viewpoint moved sideways so that the target moves by this many pixels in the picture.
function panned(viewpoint, [dx, dy]) {
  const { position, target, up, focal } = viewpoint, sight = added(target, position, -1);
  const right = unit(cross(sight, up)), down = cross(unit(sight), right), distance = Math.hypot(...sight);
  const by = added(scaled(right, (-distance * dx) / focal[0]), down, (-distance * dy) / focal[1]);
  return { ...viewpoint, position: added(position, by), target: added(target, by) };
}

// The viewpoint after a mouse movement (see `listenTo`) in a picture of this height; a reset returns to `front`.
export function moved(viewpoint, { turn = [0, 0], pan = [0, 0], zoom = 1, reset = false }, front, height) {
  const start = reset ? front : viewpoint, [yaw, pitch] = turn.map((pixels) => (Math.PI * pixels) / height);
  return panned(orbited(zoomed(start, zoom), yaw, pitch), pan);
}
