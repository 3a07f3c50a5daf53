import { listen } from "../shared/following.js";

const PREFIX = "fw-knob--";
const LATER_MS = 300; // the clicks of a double click move the slider, and its values arrive before this

// The path of the knob that an element belongs to; null for others.
function pathOf(node) {
  const knob = node.closest(".fw-knob");
  const name = knob && [...knob.classList].find((word) => word.startsWith(PREFIX));
  return name ? name.slice(PREFIX.length) : null;
}

// A double click on a slider, or Delete on its handle, sets the knob back to the start.
export function listenToResets(page) {
  function reset(event, within) {
    if (!page.holds(event.target) || !event.target.closest(within)) return;
    const path = pathOf(event.target);
    if (path) setTimeout(() => page.tell("reset", path), LATER_MS);
  }
  return listen(document, {
    dblclick: (event) => reset(event, ".slider, .noUi-target, .widget-label"),
    keydown: (event) => ["Delete", "Backspace"].includes(event.key) && reset(event, ".noUi-handle"),
  });
}
