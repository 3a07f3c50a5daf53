import { listen } from "../shared/following.js";
import { clamp } from "../shared/numbers.js";

const STEP_PX = 24; // one press of an arrow key
const FARTHEST = 240; // limit for one wheel event
const KEYS = {
  ArrowLeft: { turn: [-STEP_PX, 0] }, ArrowRight: { turn: [STEP_PX, 0] },
  ArrowUp: { turn: [0, -STEP_PX] }, ArrowDown: { turn: [0, STEP_PX] },
  "+": { zoom: 0.9 }, "=": { zoom: 0.9 }, "-": { zoom: 1 / 0.9 }, _: { zoom: 1 / 0.9 }, Home: { reset: true },
};

// The midpoint of one or two pointers, and their distance.
export function spanOf([a, b = a]) {
  return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, length: Math.hypot(a.x - b.x, a.y - b.y) };
}

// Turns actions of mouse, fingers and keyboard into calls of `move`, with pixels or a zoom; `perPixel()` is the number of
// a view's pixels in one of the screen. One finger turns the head, two move and zoom it.
export function listenTo(canvas, perPixel, move) {
  const held = new Map(); // positions of the pressed pointers
  let panning = false;
  const placeOf = (event) => ({ x: event.clientX, y: event.clientY });
  function onDown(event) {
    if (held.size === 2) return;
    held.set(event.pointerId, placeOf(event));
    panning = event.button !== 0 || event.shiftKey;
    canvas.setPointerCapture(event.pointerId);
    canvas.style.cursor = "grabbing";
  }
  function onMove(event) {
    if (!held.has(event.pointerId)) return;
    const before = spanOf([...held.values()]), scale = perPixel();
    held.set(event.pointerId, placeOf(event));
    const now = spanOf([...held.values()]), by = [(now.x - before.x) * scale, (now.y - before.y) * scale];
    if (held.size === 2) move({ pan: by, zoom: now.length ? before.length / now.length : 1 });
    else if (by[0] || by[1]) move(panning ? { pan: by } : { turn: by });
  }
  function onUp(event) {
    held.delete(event.pointerId);
    if (!held.size) canvas.style.cursor = "grab";
  }
  function onWheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 16 : 1;
    move({ zoom: Math.exp(clamp(event.deltaY * lines, -FARTHEST, FARTHEST) * 0.0015) });
  }
  function onKey(event) {
    if (!KEYS[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation(); // the notebook uses these keys for commands
    move(KEYS[event.key]);
  }
  return listen(canvas, {
    pointerdown: onDown, pointermove: onMove, pointerup: onUp, pointercancel: onUp, wheel: onWheel, keydown: onKey,
    dblclick: () => move({ reset: true }), contextmenu: (event) => event.preventDefault(),
  }, { passive: false });
}
