import { takeFocus } from "./focus.js";
import { listen } from "./following.js";
import { clamp } from "./numbers.js";

const PER_PIXEL = 0.012, PER_KEY = 0.12; // relative change of the end
const LEAST = 0.05, MOST = 1000;

// Lets the end of a view's colour scale be dragged at `handle`; a double click makes it automatic again. Python hears of
// it when the drag ends.
export function dragLimit(handle, model, draw) {
  let held = null;
  takeFocus(handle);
  handle.setAttribute("role", "slider");
  handle.setAttribute("aria-label", "end of the colour scale");
  handle.title = "end of the colour scale of picture, strip and head: drag; double click: automatic";

  function show(limit) {
    model.set("_scale", +clamp(limit, LEAST, MOST).toPrecision(3));
    draw();
  }
  function tell(limit) {
    model.set("scale_max", limit);
    model.save_changes();
  }
  return listen(handle, {
    pointerdown(event) {
      event.preventDefault();
      event.stopPropagation();
      handle.setPointerCapture(event.pointerId);
      held = { x: event.clientX, limit: model.get("_scale"), moved: false };
    },
    pointermove(event) {
      if (!held) return;
      held.moved ||= Math.abs(event.clientX - held.x) > 2;
      if (held.moved) show(held.limit * Math.exp(PER_PIXEL * (event.clientX - held.x)));
    },
    pointerup() {
      if (held?.moved) tell(model.get("_scale"));
      held = null;
    },
    dblclick(event) {
      event.stopPropagation();
      tell(0);
    },
    keydown(event) {
      const way = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
      if (!way) return;
      event.preventDefault();
      event.stopPropagation();
      show(model.get("_scale") * Math.exp(way * PER_KEY));
      tell(model.get("_scale"));
    },
  });
}
