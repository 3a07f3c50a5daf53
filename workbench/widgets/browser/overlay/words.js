import { element } from "../shared/canvas.js";
import { gradientOf } from "../shared/colors.js";
import { takeFocus } from "../shared/focus.js";
import { clamp } from "../shared/numbers.js";

const HELP = {
  select: "scroll zoom · drag pan · double-click face · click select · M mute · ± weight",
  lasso: "draw around landmarks · Ctrl adds · Shift+drag pans · M mute · ± weight",
  move: "drag a ring · arrows nudge (Shift more) · R reset · scroll zoom",
};
const HELP_MORE = `Wheel: zoom. Drag the background, or drag with Shift or the middle or right button: pan.
Double-click: the face or the whole picture. Click: select; Ctrl or Shift adds; Escape: none.
M: mute or unmute. + and −: double or halve the weight. R: back to the detected position.
H: hide or show what is drawn over the picture.
Move tool: drag a ring, or arrow keys for 0.5 px (with Shift 5 px).`;

export function makePage(el, colors) {
  const root = element(el, "div", "fw-overlay"), stage = element(root, "div", "fw-stage");
  const picture = element(stage, "canvas", "fw-picture"), marks = element(stage, "canvas", "fw-marks");
  element(stage, "div", "fw-focus");
  const legend = element(stage, "div", "fw-legend"), banner = element(stage, "div", "fw-message");
  const hoverBox = element(stage, "div", "fw-hover"), help = element(root, "div", "fw-help");
  const legendTitle = element(legend, "div", ""), bar = element(legend, "div", "fw-bar");
  const numbers = element(legend, "div", "fw-numbers"), ends = ["", "", "fw-limit"].map((name) => element(numbers, "span", name));
  bar.style.background = gradientOf(colors);
  hoverBox.hidden = true;
  hoverBox.setAttribute("role", "status");
  help.title = HELP_MORE;
  takeFocus(stage);
  stage.setAttribute("role", "application");
  stage.setAttribute("aria-label", "Frame with landmarks. " + HELP_MORE);
  return { root, stage, picture, marks, legend, legendTitle, ends, banner, hoverBox, help, limit: ends[2] };
}

// `said`: {limit, unit, message, tool, legend} as texts and numbers; `width`: of the stage.
export function paintWords(page, said, width) {
  hide(page.legend, !said.legend || width < 240);
  say(page.legendTitle, "residual, " + said.unit);
  [0, said.limit / 2, said.limit].forEach((number, k) => say(page.ends[k], +number.toPrecision(3) + (k < 2 ? "" : "+")));
  say(page.banner, said.message);
  hide(page.banner, !said.message);
  say(page.help, HELP[said.tool]);
}

// Replacing a text by the same one would lay out the page again.
function say(element, text) {
  if (element.textContent !== String(text)) element.textContent = text;
}

export function hide(element, hidden) {
  if (element.hidden !== hidden) element.hidden = hidden;
}

export function short(value) {
  return Number.isFinite(value) ? value.toFixed(value >= 100 ? 0 : value >= 10 ? 1 : 2) : "–";
}

// The facts about a landmark, one per line.
export function factsOf(landmarks, i, group, unit) {
  const pixels = `${short(landmarks.distance(i))} px`, residual = `${short(landmarks.value(i))} ${unit} (${pixels})`;
  const weighs = landmarks.weight(i) ? `weight ${+landmarks.weight(i).toPrecision(3)}` : "muted";
  return [
    `group: ${group}`, `residual: ${unit === "px" ? pixels : residual}`,
    `confidence ${landmarks.confidence(i).toFixed(2)} · ${weighs}`,
  ];
}

export function paintHover({ stage, hoverBox }, titled, facts, [x, y]) {
  const title = document.createElement("b");
  title.textContent = titled;
  hoverBox.replaceChildren(title, "\n" + facts.join("\n"));
  const { offsetWidth: width, offsetHeight: height } = hoverBox;
  hoverBox.style.left = `${x + 16 + width > stage.clientWidth ? Math.max(x - 16 - width, 2) : x + 16}px`;
  hoverBox.style.top = `${clamp(y + 16, 2, Math.max(2, stage.clientHeight - height - 2))}px`;
}
