// Lines over a common x. Lines are drawn on one canvas; cursor and readout, which move often, on another.
import { bytesOf } from "../shared/bytes.js";
import { element, makeStage } from "../shared/canvas.js";
import { follow, followSize, followTheme, listen } from "../shared/following.js";
import { keepHearing } from "../shared/hearing.js";
import { clamp } from "../shared/numbers.js";
import { onDemand } from "../shared/painting.js";
import { themeOf } from "../shared/theme.js";
import { makeColors } from "./colors.js";
import { afterClick, afterDouble, nameOf, paintKeys } from "./keys.js";
import { paintLines } from "./lines.js";
import { paintCursor, paintHover } from "./readout.js";
import { BOTTOM, LEFT, RIGHT, TOP, nearest, rangeOf, scaleOf } from "./scale.js";

function makePage(el) {
  const root = element(el, "div", "fw-chart"), top = element(root, "div", "fw-top");
  const title = element(top, "div", "fw-title"), keys = element(top, "div", "fw-keys");
  const { stage, drawn: lines, over, hoverBox } = makeStage(root, "fw-lines");
  return { root, top, title, keys, stage, lines, over, hoverBox };
}

// The drawn state: the data `sent` by Python, its `x` and `rows`, positions, colours, and the value under the mouse.
function makeChart(model) {
  const chart = { sent: null, x: null, rows: [], scale: null, theme: {}, palette: [], hover: null };
  chart.shown = (k) => !model.get("hidden").includes(chart.sent.names[k]);
  return chart;
}

function makePainting(model, page, chart) {
  const { root, stage } = page, colorOf = makeColors();
  let draws = 0;

  function paintAll() {
    const { sent } = chart, log = model.get("y_log");
    const width = Math.max(stage.clientWidth - LEFT - RIGHT, 1), height = Math.max(stage.clientHeight - TOP - BOTTOM, 1);
    chart.theme = themeOf(root);
    chart.scale = scaleOf(rangeOf(chart.x, chart.rows.filter((_, k) => chart.shown(k)), log), width, height, log);
    chart.palette = sent.colors.map((color) => colorOf(color, chart.theme));
    page.title.textContent = model.get("title");
    page.title.hidden = !page.title.textContent;
    page.top.hidden = page.title.hidden && !sent.names.length;
    paintKeys(page.keys, chart);
    stage.setAttribute("aria-label", `Chart ${model.get("title")}: ${sent.names.join(", ")}`);
    paintLines(page.lines, chart);
  }

  return onDemand((all) => {
    if (!stage.clientWidth) return false; // in a hidden tab
    if (all) paintAll();
    paintCursor(page.over, chart, model.get("cursor"));
    paintHover(page.hoverBox, stage, chart);
    const { range, width, height } = chart.scale;
    root.dataset.draws = String(++draws);
    root.dataset.state = JSON.stringify({ ...range, plot: [LEFT, TOP, width, height], count: chart.x.length });
    return true;
  });
}

// Handles mouse and keys in the plot.
function listenToPlot(model, { stage, over }, chart, draw) {
  function onMove(event) {
    if (!chart.x.length || !chart.scale) return;
    const box = over.getBoundingClientRect(), place = event.clientX - box.left;
    const inside = place >= LEFT - 8 && place <= LEFT + chart.scale.width + 8;
    chart.hover = inside ? { index: nearest(chart.x, chart.scale.fromX(place)), y: event.clientY - box.top } : null;
    draw();
  }

  function pick(index) {
    model.set("cursor", chart.x[index]);
    model.save_changes();
    model.send({ pick: chart.x[index] });
    draw();
  }

  function onDown(event) {
    if (event.button !== 0) return;
    event.preventDefault();
    stage.focus({ preventScroll: true });
    onMove(event);
    if (chart.hover) pick(chart.hover.index);
  }

  function onKey(event) {
    const { x } = chart, step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step || !x.length || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    const cursor = model.get("cursor");
    pick(cursor === null ? 0 : clamp(nearest(x, cursor) + step, 0, x.length - 1));
  }

  const onLeave = () => ((chart.hover = null), draw());
  listen(over, { pointerdown: onDown, pointermove: onMove, pointerleave: onLeave });
  listen(stage, { keydown: onKey });
}

function listenToKeys(model, keys, chart, draw) {
  function hide(after) {
    return (event) => {
      const name = nameOf(event);
      if (name === undefined) return;
      model.set("hidden", after(model.get("hidden"), name, chart.sent.names));
      model.save_changes();
      draw(true);
    };
  }
  listen(keys, { click: hide(afterClick), dblclick: hide(afterDouble) });
}

function render({ model, el }) {
  const page = makePage(el), chart = makeChart(model), painting = makePainting(model, page, chart);
  const draw = painting.ask, redraw = () => draw(true);

  function onSeries() {
    chart.sent = model.get("_series");
    const data = new Float32Array(bytesOf(chart.sent.data)), count = chart.sent.count;
    chart.x = data.subarray(0, count);
    chart.rows = chart.sent.names.map((_, k) => data.subarray((k + 1) * count, (k + 2) * count));
    chart.hover = chart.hover && chart.hover.index < count ? chart.hover : null;
    redraw();
  }

  function onSize() {
    page.stage.style.height = `${model.get("height_px")}px`;
    redraw();
  }

  listenToPlot(model, page, chart, draw);
  listenToKeys(model, page.keys, chart, draw);
  const stops = [
    follow(model, [
      ["change:_series", onSeries], ["change:cursor", () => draw()], ["change:height_px", onSize],
      ...["hidden", "y_log", "title"].map((name) => ["change:" + name, redraw]),
    ]),
    followSize(page.stage, onSize), followTheme(redraw), painting.stop, () => page.root.remove(),
  ];
  onSeries();
  onSize();
  return () => stops.forEach((stop) => stop());
}

export default { initialize: keepHearing, render };
