// What a sweep knows so far: a curve or a map on one canvas; the point under mouse or keys, which moves, on another.
import { BOTTOM, LEFT, TOP } from "../chart/scale.js";
import { bytesOf } from "../shared/bytes.js";
import { cleared, element, makeStage } from "../shared/canvas.js";
import { follow, followSize, followTheme, listen } from "../shared/following.js";
import { keepHearing } from "../shared/hearing.js";
import { onDemand } from "../shared/painting.js";
import { themeOf } from "../shared/theme.js";
import { RED, paintCurve } from "./curve.js";
import { paintMap } from "./map.js";
import { middleOf, neighbour, plotOf, pointAt, readSweep, someOf } from "./places.js";
import { factsOf } from "./words.js";

const EMPTY = "Choose a setting and run; two make a map.";

function makePage(el) {
  const root = element(el, "div", "fw-sweep"), { stage, drawn: plot, over, hoverBox } = makeStage(root, "fw-plot");
  return { root, stage, plot, over, hoverBox };
}

function paintAxis(context, sweep, plot, theme) {
  const [axis, second] = sweep.axes, bottom = TOP + plot.height;
  context.fillStyle = theme.muted;
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (const k of someOf(axis.values.length, plot.width, 56)) {
    context.fillText(axis.values[k], LEFT + middleOf(k, sweep.across, plot.width), bottom + 9);
  }
  context.fillText(axis.name, LEFT + plot.width / 2, bottom + 21);
  context.textAlign = "left";
  const measured = `${sweep.label}${sweep.unit ? `, ${sweep.unit}` : ""}`;
  context.fillText(second ? `${second.name}  ·  stronger: less ${measured}` : measured, 2, 8);
}

function paintAll(page, state) {
  const { sweep } = state, context = cleared(page.plot), theme = (state.theme = themeOf(page.root));
  context.font = `10px ${theme.font}`;
  state.plot = plotOf(page.stage.clientWidth, page.stage.clientHeight);
  page.stage.setAttribute("aria-label", sweep.kind ? `Sweep of ${sweep.axes.map((axis) => axis.name).join(" and ")}` : EMPTY);
  if (!sweep.kind) {
    context.fillStyle = theme.muted;
    context.textAlign = "center";
    context.font = `12px ${theme.font}`;
    return context.fillText(EMPTY, page.stage.clientWidth / 2, page.stage.clientHeight / 2);
  }
  state.place = (sweep.kind === "curve" ? paintCurve : paintMap)(context, sweep, state.plot, theme);
  paintAxis(context, sweep, state.plot, theme);
  if (sweep.least >= 0) paintRing(context, state.place(sweep.least), RED, 6.5);
}

function paintRing(context, [x, y], color, radius) {
  context.strokeStyle = color;
  context.lineWidth = 2;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.stroke();
}

function paintCursor(page, { sweep, place, at, theme }) {
  const { stage, hoverBox } = page, context = cleared(page.over);
  hoverBox.hidden = at === null;
  if (at === null) return;
  const lines = factsOf(sweep, at);
  paintRing(context, place(at), theme.ink, 5);
  hoverBox.textContent = lines.join("  ·  "); // one line above the plot, of which it covers nothing
  stage.setAttribute("aria-label", lines.join(", "));
}

function makePainting(page, state) {
  let draws = 0;
  return onDemand((all) => {
    if (!page.stage.clientWidth) return false; // in a hidden tab
    if (all) paintAll(page, state);
    paintCursor(page, state);
    const { sweep, plot } = state, box = [LEFT, TOP, plot.width, plot.height, BOTTOM];
    page.root.dataset.draws = String(++draws);
    page.root.dataset.state = JSON.stringify({ kind: sweep.kind, count: sweep.count, known: sweep.known, least: sweep.least, box });
    return true;
  });
}

// Mouse and keys choose a point; a click, Enter or the space bar takes it.
function listenToStage(model, { stage, over }, state, draw) {
  const go = (number) => { state.at = number; draw(); };
  const take = (number) => Number.isFinite(state.sweep.mean[number]) && model.send({ pick: number });
  function under(event) {
    const box = over.getBoundingClientRect(), x = event.clientX - box.left - LEFT, y = event.clientY - box.top - TOP;
    const inside = x >= 0 && x <= state.plot.width && y >= -TOP && y <= state.plot.height + BOTTOM;
    return state.sweep.kind && inside ? pointAt(state.sweep, state.plot, x, y) : null;
  }
  function onDown(event) {
    if (event.button !== 0) return;
    event.preventDefault();
    stage.focus({ preventScroll: true });
    go(under(event));
    if (state.at !== null) take(state.at);
  }
  function onKey(event) {
    if (!state.sweep.kind || event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = event.key.startsWith("Arrow"), enter = [" ", "Enter"].includes(event.key) && state.at !== null;
    if (!arrow && !enter) return;
    event.preventDefault();
    event.stopPropagation();
    if (enter) take(state.at);
    else go(state.at === null ? Math.max(state.sweep.least, 0) : neighbour(state.sweep, state.at, event.key));
  }
  listen(over, { pointerdown: onDown, pointermove: (event) => go(under(event)), pointerleave: () => go(null) });
  listen(stage, { keydown: onKey, blur: () => go(null) });
}

function render({ model, el }) {
  const page = makePage(el), state = { sweep: null, plot: null, place: null, theme: null, at: null };
  const painting = makePainting(page, state), draw = painting.ask, redraw = () => draw(true);

  function onSweep() {
    const sent = model.get("_sent");
    state.sweep = readSweep(sent, new Float32Array(sent.count ? bytesOf(sent.data) : 0));
    if (state.at >= sent.count) state.at = null;
    redraw();
  }
  function onSize() {
    page.stage.style.height = `${model.get("height_px")}px`;
    redraw();
  }
  listenToStage(model, page, state, draw);
  const stops = [
    follow(model, [["change:_sent", onSweep], ["change:height_px", onSize]]),
    followSize(page.stage, onSize), followTheme(redraw), painting.stop, () => page.root.remove(),
  ];
  onSweep();
  onSize();
  return () => stops.forEach((stop) => stop());
}

export default { initialize: keepHearing, render };
