import { takeFocus } from "./focus.js";

export function element(parent, tag, name) {
  const made = document.createElement(tag);
  made.className = name;
  parent.append(made);
  return made;
}

// A plot in `root` that takes mouse and keys: a canvas, another one over it for what moves often, and a box of words.
export function makeStage(root, name) {
  const stage = element(root, "div", "fw-stage"), drawn = element(stage, "canvas", name);
  const over = element(stage, "canvas", "fw-cursor"), hoverBox = element(stage, "div", "fw-hover");
  hoverBox.hidden = true;
  takeFocus(stage);
  stage.setAttribute("role", "application");
  return { stage, drawn, over, hoverBox };
}

// The place of an element in CSS pixels, [0, 0] for one that is hidden. Asked after something else has changed, the page
// is laid out for the answer: what draws often keeps the one of `followSize`.
export const roomOf = (element) => [element.clientWidth, element.clientHeight];

// The drawing context of a canvas in CSS pixels, sharp on screens with more than one pixel per CSS pixel.
export function cleared(canvas, room = roomOf(canvas)) {
  const ratio = window.devicePixelRatio || 1, [width, height] = room.map((length) => Math.round(length * ratio));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, ...room);
  return context;
}
