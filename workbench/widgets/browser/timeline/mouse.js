import { listen } from "../shared/following.js";
import { clamp } from "../shared/numbers.js";
import { GUTTER, zoomedAt } from "./span.js";
import { nextFlagged, worstOf } from "./track.js";

export const HELP_MORE = `Click or drag: go to a frame. Shift and drag: the part to play and to work on. Wheel: zoom in time; with Shift: along the clip.
Double-click: whole clip. Left and right: one frame, with Shift ten. Home, End. N, P: next and previous flagged frame.
Orange: flagged. Blue: marked as failed. Hatched: out of date. Vertical lines: a new shot. Blank: no face.`;

// Handles mouse and keys in the strip.
export function listenTo({ stage, over }, model, clip) {
  const go = (column) => goTo(model, clip, column);
  listen(stage, { keydown: (event) => onKey(event, clip, go) });
  listen(over, { wheel: (event) => onWheel(event, clip, over) }, { passive: false });
  listenToPointer(stage, over, clip, go, makePart(model, clip));
}

function goTo(model, clip, wanted) {
  const column = clamp(wanted, 0, clip.track.count - 1);
  clip.reveal(column);
  if (column !== clip.current()) {
    model.set("frame", column + clip.track.first);
    model.save_changes();
  }
  clip.draw();
}

// The part to play and to work on, from the frame where a drag begins to the one where it is.
function makePart(model, clip) {
  let anchor = null;
  const set = (part) => { model.set("loop", part); model.save_changes(); };
  return {
    begins: (column) => { anchor = column; set([]); },
    goes: (column) => {
      const ends = [Math.min(anchor, column), Math.max(anchor, column)];
      set(ends.map((end) => clamp(end, 0, clip.track.count - 1) + clip.track.first));
    },
    open: () => anchor !== null,
    ends: () => { anchor = null; },
  };
}

const xOf = (event, over) => event.clientX - over.getBoundingClientRect().left;

// A pixel with many frames represents the one that determines its colour.
function worstUnder(x, { track, span }) {
  const per = span.length() / span.width(), first = span.toColumn(x, track.count);
  return per <= 1 ? first : worstOf(track, first, per);
}

function listenToPointer(stage, over, clip, go, part) {
  let dragging = false;

  function onDown(event) {
    if (event.button !== 0 || !clip.track?.count) return;
    event.preventDefault();
    stage.focus({ preventScroll: true });
    over.setPointerCapture(event.pointerId);
    if (event.shiftKey) return part.begins(clip.span.toColumn(xOf(event, over), clip.track.count));
    dragging = true;
    // A click goes to the frame in the readout; dragging goes through all frames.
    go(worstUnder(xOf(event, over), clip));
  }

  function onMove(event) {
    const { track, span } = clip;
    if (!track?.count) return;
    const x = xOf(event, over), inside = x >= GUTTER && x <= GUTTER + span.width();
    if (part.open() && event.movementX) part.goes(span.toColumn(x, track.count));
    if (dragging && event.movementX) go(span.toColumn(x, track.count));
    clip.hover = inside ? { x, column: dragging ? clip.current() : worstUnder(x, clip) } : null;
    clip.draw();
  }

  const onUp = () => { dragging = false; part.ends(); };
  listen(over, {
    pointerdown: onDown, pointermove: onMove, pointerup: onUp, pointercancel: onUp,
    pointerleave: () => { clip.hover = null; clip.draw(); },
    dblclick: () => { if (clip.track?.count) clip.zoomTo(0, clip.track.count); },
  });
}

function onWheel(event, clip, over) {
  const { track, span } = clip;
  if (!track?.count) return;
  event.preventDefault();
  const lines = event.deltaMode === 1 ? 16 : 1, along = event.deltaX || (event.shiftKey ? event.deltaY : 0);
  if (along) {
    const from = span.from + (along * lines * span.length()) / span.width();
    return clip.zoomTo(from, from + span.length());
  }
  const at = span.toPlace(xOf(event, over));
  clip.zoomTo(...zoomedAt(span, at, Math.exp(0.0015 * lines * event.deltaY), track.count));
}

function onKey(event, clip, go) {
  const { track } = clip;
  if (event.ctrlKey || event.metaKey || event.altKey || !track?.count) return;
  const step = event.shiftKey ? 10 : 1, now = clip.current();
  const goal = {
    ArrowLeft: () => now - step, ArrowRight: () => now + step, Home: () => 0, End: () => track.count - 1,
    n: () => nextFlagged(track, now, 1), p: () => nextFlagged(track, now, -1),
  }[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!goal) return;
  event.preventDefault();
  event.stopPropagation();
  go(goal());
}
