import { element } from "../shared/canvas.js";

// The keys of a panel: what the help shows, and what is done, by each key of a row or by all of them.
export const KEYS = [
  ["space", " ", "play or pause", "play"],
  [",  .", ",.", "one frame back, forward", "back forth"],
  ["N  P", "np", "next, previous flagged frame", "next previous"],
  ["I  O", "io", "first, last frame of the part: here", "in out"],
  ["F", "f", "fill this frame from its neighbours", "fill"],
  ["H", "h", "hide or show everything over the picture", "overlay"],
  ["V", "v", "the head: as the camera sees it, from the front, free", "view"],
  ["M  +  −  R", "m+-r=_", "selected landmarks: mute, weigh more or less, back to the detection", "overlay"],
  ["W", "w", "why this frame?", "why"],
  ["S", "s", "keep a snapshot", "keep"],
  ["E", "e", "save and export", "export"],
  ["/", "/", "search the settings", "search"],
  ["?", "?", "this list", "help"],
];
const MORE = [
  ["Ctrl Z,  Ctrl Y", "undo, redo"],
  ["Shift drag", "in the strip: the part to play and to work on"],
  ["Delete", "on a slider: back to the start (or double click)"],
  ["arrows", "slider, strip, head or moved landmark, whichever has the focus"],
  ["Esc", "clears the selection, closes this list"],
];

// What a key does; undefined for others.
export function actionOf(key) {
  for (const [, letters, , actions] of KEYS) {
    const at = letters.indexOf(key.length === 1 ? key.toLowerCase() : "none");
    const each = actions.split(" ");
    if (at >= 0) return each[Math.min(at, each.length - 1)];
  }
  return undefined;
}

export function makeHelp(el) {
  const box = element(el, "div", "fw-help-box"), table = element(box, "table", "");
  for (const [keys, told] of [...KEYS.map(([shown, , words]) => [shown, words]), ...MORE]) {
    const row = element(table, "tr", "");
    element(row, "th", "").textContent = keys;
    element(row, "td", "").textContent = told;
  }
  box.hidden = true;
  box.setAttribute("role", "dialog");
  box.setAttribute("aria-label", "Keys");
  box.addEventListener("click", () => { box.hidden = true; });
  // Whether it was open.
  function close() {
    const open = !box.hidden;
    box.hidden = true;
    return open;
  }
  return { toggle: () => { box.hidden = !box.hidden; }, close };
}
