import { element } from "../shared/canvas.js";
import { takeFocus } from "../shared/focus.js";

// The canvas of a head, with width and height in CSS pixels, and a line below it for errors.
export function makePage(el, kind, width, height) {
  el.classList.add("fw-head3d", kind);
  const canvas = element(el, "canvas", ""), message = element(el, "div", "");
  Object.assign(canvas, { width, height });
  takeFocus(canvas);
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "3D head: drag or arrow keys turn it, wheel or + and - zoom, Home resets");
  canvas.style.cssText =
    `display:block; width:${width}px; max-width:100%; aspect-ratio:${width}/${height}; cursor:grab; touch-action:none`;
  message.style.cssText = "font-size:12px; color:var(--jp-error-color1, #b3261e)";
  return { canvas, message };
}

// Makes a canvas as large as its place in a column that its widgets share.
export function fillPlace(el, canvas) {
  el.classList.add("fw-fill");
  canvas.style.cssText += "; position:absolute; inset:0; width:100%; height:100%; aspect-ratio:auto";
}
