import { listen } from "../shared/following.js";
import { hit, indices, insidePolygon } from "./landmarks.js";

const CLICK = 3; // largest motion of a click in screen pixels
const DRAG_MS = 40; // between two "drag" messages
const DOUBLE_MS = 800; // longest time between the clicks of a double-click

const merged = (points, others) => [...new Set([...points, ...others])].sort((a, b) => a - b);
const without = (points, point) => points.filter((other) => other !== point);

// Pointer actions: `overlay` is the state kept by view.js, `send` sends messages to Python.
export function listenToPointer(overlay, model, send) {
  const { stage, marks } = overlay.page, { landmarks, view, draw } = overlay;
  let dropped = { points: [], at: -Infinity };

  function onDown(event) {
    if (overlay.gesture) return;
    stage.focus({ preventScroll: true });
    event.preventDefault();
    marks.setPointerCapture(event.pointerId);
    overlay.gesture = begun(overlay, model.get("tool"), event, placeOf(event, marks));
    draw();
  }

  function onMove(event) {
    const [x, y] = (overlay.pointer = placeOf(event, marks)), { gesture } = overlay;
    if (!gesture) overlay.hovered = meant(overlay, [x, y], model.get("tool") === "move");
    else {
      gesture.moved ||= Math.hypot(x - gesture.start[0], y - gesture.start[1]) > CLICK;
      if (gesture.kind === "lasso") gesture.path.push([x, y]);
      if (gesture.kind === "pan" && gesture.moved) pan(overlay, [x, y]);
      if (gesture.kind === "drag" && gesture.moved) drag(overlay, [x, y], "drag", send);
    }
    draw();
  }

  function onUp(event) {
    if (!overlay.gesture) return;
    const place = placeOf(event, marks), adds = event.ctrlKey || event.metaKey || event.shiftKey;
    const before = model.get("selection"), done = overlay.gesture;
    if (done.kind === "drag" && done.moved) drag(overlay, place, "drop", send);
    overlay.gesture = null;
    if (done.kind === "lasso" && done.moved) {
      const inside = indices(landmarks).filter((i) => insidePolygon(view.toScreen(...landmarks.observed(i)), done.path));
      send.selection(adds ? merged(before, inside) : inside, "lasso");
    } else if (!done.moved && done.button === 0) click(meant(overlay, place), before, adds);
    draw();
  }

  function click(index, before, adds) {
    if (index < 0) {
      if (adds || !before.length) return;
      dropped = { points: before, at: performance.now() };
      send.selection([]);
    } else if (!adds) send.selection([index]);
    else send.selection(before.includes(index) ? without(before, index) : merged(before, [index]));
  }

  function onDouble(event) {
    if (event.button !== 0) return;
    // The first click of a double-click has cleared the selection unintentionally.
    const undone = performance.now() - dropped.at < DOUBLE_MS && !model.get("selection").length;
    if (undone) send.selection(dropped.points);
    view.mode = view.mode === "whole" && landmarks.found() ? "face" : "whole";
    overlay.place();
    draw(true);
  }

  listen(marks, {
    pointerdown: onDown, pointermove: onMove, pointerup: onUp, pointercancel: () => cancelGesture(overlay, send),
    pointerleave: () => { overlay.hovered = -1; draw(); },
    dblclick: onDouble,
    contextmenu: (event) => { event.preventDefault(); event.stopPropagation(); }, // the right button pans
  });
  listen(marks, { wheel: (event) => overlay.zoom(event, placeOf(event, marks)) }, { passive: false });
}

function placeOf(event, marks) {
  const box = marks.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

// The landmark under the pointer; with `rings` only detections count, because only they can be moved.
function meant({ landmarks, view, layer }, place, rings = false) {
  return hit(landmarks, view.toScreen, place, { observed: layer("observed") || rings, model: !rings && layer("model") });
}

function begun(overlay, tool, event, [x, y]) {
  const { landmarks, view } = overlay, plain = event.button === 0 && !event.shiftKey;
  const gesture = { kind: "pan", start: [x, y], from: [view.x, view.y], moved: false, button: event.button };
  if (plain && tool === "lasso") return { ...gesture, kind: "lasso", path: [[x, y]] };
  const index = plain && tool === "move" ? meant(overlay, [x, y], true) : -1;
  if (index < 0) return gesture;
  const [px, py] = landmarks.observed(index), [cx, cy] = view.toPicture(x, y);
  // The ring keeps its offset from the pointer, so that grabbing does not move it.
  return { ...gesture, kind: "drag", index, offset: [px - cx, py - cy], held: [px, py], sent: 0 };
}

function pan({ view, gesture, draw }, [x, y]) {
  view.mode = "free";
  view.x = gesture.from[0] + x - gesture.start[0];
  view.y = gesture.from[1] + y - gesture.start[1];
  draw(true);
}

function drag({ view, landmarks, gesture, draw }, place, kind, send) {
  const [px, py] = view.toPicture(...place), [dx, dy] = gesture.offset, now = performance.now();
  if (kind === "drop") landmarks.drop(gesture.index, px + dx, py + dy);
  else landmarks.hold(gesture.index, px + dx, py + dy);
  draw();
  if (kind === "drag" && now - gesture.sent < DRAG_MS) return;
  gesture.sent = now;
  send.event(kind, [gesture.index], px + dx, py + dy);
}

// Leaves a gesture; a landmark that Python has already moved goes back to where it was grabbed.
export function cancelGesture(overlay, send) {
  const { gesture, landmarks } = overlay;
  if (gesture?.kind === "drag") {
    landmarks.release(gesture.index);
    if (gesture.sent) {
      landmarks.drop(gesture.index, ...gesture.held);
      send.event("cancel", [gesture.index], ...gesture.held);
    }
  }
  overlay.gesture = null;
  overlay.draw();
}
