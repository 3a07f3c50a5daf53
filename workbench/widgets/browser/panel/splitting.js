import { listen } from "../shared/following.js";
import { clamp } from "../shared/numbers.js";

const LEAST = 120, STEP = 24; // pixels

// A border of class fw-split resizes what stands before it: its width, or with fw-split-y its height.
export function moveBorders(page) {
  let held = null;

  function resize(border, change, from) {
    const before = border.previousElementSibling, along = border.classList.contains("fw-split-y") ? "Height" : "Width";
    const start = from ?? before[`offset${along}`], most = border.parentElement[`offset${along}`] - LEAST;
    before.style.flex = `0 0 ${Math.round(clamp(start + change, LEAST, Math.max(most, LEAST)))}px`;
    return start;
  }

  const borderOf = (event) => page.holds(event.target) && event.target.closest(".fw-split");
  const placeOf = (border, event) => (border.classList.contains("fw-split-y") ? event.clientY : event.clientX);

  function onDown(event) {
    const border = borderOf(event);
    if (!border || event.button !== 0) return;
    event.preventDefault();
    border.setPointerCapture(event.pointerId);
    held = { border, place: placeOf(border, event), from: resize(border, 0) };
  }

  function onKey(event) {
    const border = borderOf(event), steps = { ArrowLeft: -1, ArrowUp: -1, ArrowRight: 1, ArrowDown: 1 }[event.key];
    if (!border || !steps) return;
    event.preventDefault();
    resize(border, steps * STEP);
  }

  return listen(document, {
    pointerdown: onDown,
    pointermove: (event) => held && resize(held.border, placeOf(held.border, event) - held.place, held.from),
    pointerup: () => { held = null; },
    keydown: onKey,
    dblclick: (event) => borderOf(event) && (borderOf(event).previousElementSibling.style.flex = ""),
  });
}
