import { listen } from "../shared/following.js";
import { cancelGesture } from "./tools.js";

const KINDS = {
  m: "mute", M: "mute", "+": "weight_up", "=": "weight_up", "-": "weight_down", _: "weight_down", r: "reset", R: "reset",
};
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const STEP = 0.5, LONG_STEP = 5; // picture pixels

// Keyboard actions on the selected landmarks; a panel hands on its keys as events of the name "fw-key".
export function listenToKeys(overlay, model, send) {
  const { landmarks } = overlay;

  function nudge([x, y], step) {
    for (const i of model.get("selection")) {
      const [px, py] = landmarks.observed(i), place = [px + step * x, py + step * y];
      landmarks.drop(i, ...place);
      send.event("drop", [i], ...place);
    }
  }

  function acted(key, step = STEP) {
    const selection = model.get("selection"), kind = KINDS[key], arrow = ARROWS[key];
    if (key.toLowerCase() === "h") {
      overlay.bare = !overlay.bare;
    } else if (key === "Escape") {
      cancelGesture(overlay, send);
      if (selection.length) send.selection([]);
    } else if (kind && selection.length) {
      if (kind === "reset") selection.forEach(landmarks.release);
      send.event(kind, selection);
    } else if (arrow && model.get("tool") === "move" && landmarks.found()) {
      nudge(arrow, step);
    } else return false;
    return true;
  }

  listen(overlay.page.stage, {
    keydown(event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (!acted(event.key, event.shiftKey ? LONG_STEP : STEP)) return;
      event.preventDefault();
      event.stopPropagation();
      overlay.draw();
    },
  });
  listen(overlay.page.root, { "fw-key": ({ detail }) => acted(detail) && overlay.draw() });
}
