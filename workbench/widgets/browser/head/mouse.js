import { listen } from "../shared/following.js";
import { clamp } from "../shared/numbers.js";

const STEP_PX = 24; // one press of an arrow key
const FARTHEST = 240; // of one turn of the wheel
const KEYS = {
  ArrowLeft: { turn: [-STEP_PX, 0] }, ArrowRight: { turn: [STEP_PX, 0] },
  ArrowUp: { turn: [0, -STEP_PX] }, ArrowDown: { turn: [0, STEP_PX] },
  "+": { zoom: 0.9 }, "-": { zoom: 1 / 0.9 }, Home: { reset: true },
};

// What the mouse, a finger or the keyboard does to the head: calls `move` with pixels of a picture so wide, or a zoom.
export function listenTo(canvas, width, move) {
  let held = null;
  function onDown(event) {
    held = { id: event.pointerId, x: event.clientX, y: event.clientY, pan: event.button !== 0 || event.shiftKey };
    canvas.setPointerCapture(event.pointerId);
    canvas.style.cursor = "grabbing";
  }
  function onMove(event) {
    if (!held || held.id !== event.pointerId) return;
    const scale = width / canvas.getBoundingClientRect().width;
    const by = [(event.clientX - held.x) * scale, (event.clientY - held.y) * scale];
    Object.assign(held, { x: event.clientX, y: event.clientY });
    if (by[0] || by[1]) move(held.pan ? { pan: by } : { turn: by });
  }
  function onUp() {
    held = null;
    canvas.style.cursor = "grab";
  }
  function onWheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 16 : 1;
    move({ zoom: Math.exp(clamp(event.deltaY * lines, -FARTHEST, FARTHEST) * 0.0015) });
  }
  function onKey(event) {
    if (!KEYS[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation(); // the notebook has commands on these keys
    move(KEYS[event.key]);
  }
  return listen(canvas, {
    pointerdown: onDown, pointermove: onMove, pointerup: onUp, pointercancel: onUp, wheel: onWheel, keydown: onKey,
    dblclick: () => move({ reset: true }), contextmenu: (event) => event.preventDefault(),
  }, { passive: false });
}
