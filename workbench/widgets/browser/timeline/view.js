// Landmark errors over the frames of a clip. The strip is one canvas; the cursor, which moves often, another.
import { bytesOf } from "../shared/bytes.js";
import { cleared, element } from "../shared/canvas.js";
import { cssColors, gradientOf } from "../shared/colors.js";
import { takeFocus } from "../shared/focus.js";
import { follow, followSize, followTheme } from "../shared/following.js";
import { keepHearing } from "../shared/hearing.js";
import { dragLimit } from "../shared/limit.js";
import { onDemand } from "../shared/painting.js";
import { themeOf } from "../shared/theme.js";
import { paintCursor, placeHover, wordsOf } from "./cursor.js";
import { HELP_MORE, listenTo } from "./mouse.js";
import { GUTTER, RIGHT, makeSpan } from "./span.js";
import { paintStrip, pixelTable } from "./strip.js";
import { putPart, readTrack } from "./track.js";

const HELP = "click go to frame · Shift drag a part · scroll zoom · N P flagged";

function makePage(el, rgb) {
  const root = element(el, "div", "fw-timeline"), stage = element(root, "div", "fw-stage");
  const strip = element(stage, "canvas", "fw-strip"), over = element(stage, "canvas", "fw-cursor");
  const hoverBox = element(stage, "div", "fw-hover"), below = element(root, "div", "fw-below");
  const help = element(below, "div", "fw-help"), scale = element(below, "div", "fw-scale");
  const zero = element(scale, "span", ""), bar = element(scale, "span", "fw-bar"), limit = element(scale, "span", "fw-limit");
  hoverBox.hidden = true;
  help.textContent = HELP;
  help.title = scale.title = HELP_MORE;
  takeFocus(stage);
  stage.setAttribute("role", "slider");
  stage.setAttribute("aria-label", "Frame. " + HELP_MORE);
  bar.style.background = gradientOf(cssColors(rgb));
  return { root, stage, strip, over, hoverBox, zero, limit };
}

function makePainting(model, page, clip) {
  const { root, stage, hoverBox } = page, scheme = model.get("_scheme");
  const table = pixelTable(new Uint8Array(bytesOf(scheme.colors)));
  let draws = 0;

  function paintPlace(theme) {
    const { track, span } = clip;
    if (!track?.count) return void cleared(page.over);
    const first = track.first, ends = { now: clip.current() + first, min: first, max: first + track.count - 1 };
    for (const [name, value] of Object.entries(ends)) stage.setAttribute(`aria-value${name}`, String(value));
    paintCursor(page.over, span, clip.current(), first, theme);
  }

  function paintHover() {
    hoverBox.hidden = !clip.hover || !clip.track?.count;
    if (hoverBox.hidden) return;
    const facts = {
      names: scheme.names, unit: model.get("unit"), why: model.get("_why"), marked: model.get("marked"),
    };
    hoverBox.textContent = wordsOf(clip.track, clip.hover.column, facts).join("\n");
    placeHover(hoverBox, stage, clip.hover.x);
  }

  return onDemand((all) => {
    if (!stage.clientWidth) return false; // in a hidden tab
    const theme = themeOf(root), { track, span } = clip;
    const [marked, loop] = [model.get("marked"), model.get("loop")];
    if (all) paintStrip(page.strip, { track, rows: scheme.rows, table, marked, loop, span, theme });
    paintPlace(theme);
    paintHover();
    page.zero.textContent = "0";
    page.limit.textContent = `${+model.get("_scale").toPrecision(3)}+ ${model.get("unit")}`;
    root.dataset.draws = String(++draws);
    const state = { from: span.from, to: span.to, gutter: GUTTER, right: RIGHT, count: track?.count ?? 0 };
    root.dataset.state = JSON.stringify(state);
    return true;
  });
}

// The drawn state: the track, the part in view, and the frame under the mouse.
function makeClip(model, stage) {
  const clip = { track: null, span: makeSpan(stage), hover: null, draw: () => {} };
  clip.current = () => model.get("frame") - clip.track.first;

  clip.zoomTo = (start, end) => {
    clip.span.set(start, end, clip.track.count);
    clip.tellView();
    clip.draw(true);
  };
  clip.reveal = (column) => {
    const half = clip.span.length() / 2;
    if (!clip.span.shows(column)) clip.zoomTo(column - half, column + half);
  };
  clip.tellView = () => {
    const { from, to } = clip.span, shown = [clip.track.first + Math.floor(from), clip.track.first + Math.ceil(to) - 1];
    if (shown.some((frame, k) => frame !== model.get("in_view")[k])) {
      model.set("in_view", shown);
      model.save_changes();
    }
  };
  return clip;
}

function render({ model, el }) {
  const page = makePage(el, new Uint8Array(bytesOf(model.get("_scheme").colors)));
  const clip = makeClip(model, page.stage), painting = makePainting(model, page, clip);
  const draw = (clip.draw = painting.ask), redraw = () => draw(true);

  function onTrack() {
    const sent = model.get("_track"), { track, span } = clip;
    clip.track = readTrack(sent);
    if (!track || track.count !== sent.count || track.first !== sent.first) {
      Object.assign(span, { from: 0, to: Math.max(sent.count, 1) });
      clip.hover = null;
      clip.tellView();
    }
    redraw();
  }

  function onPart(content, buffers) {
    if (content.kind !== "part" || !clip.track) return;
    putPart(clip.track, content, buffers);
    redraw();
  }

  function onFrame() {
    if (clip.track?.count) clip.reveal(clip.current());
    draw();
  }

  function onSize() {
    page.stage.style.height = `${model.get("height_px")}px`;
    redraw();
  }

  listenTo(page, model, clip);
  const stops = [
    follow(model, [
      ["change:_track", onTrack], ["change:frame", onFrame], ["change:_scale", redraw], ["change:unit", redraw],
      ["change:height_px", onSize], ["change:marked", redraw], ["change:loop", redraw], ["msg:custom", onPart],
    ]),
    followSize(page.stage, onSize), followTheme(redraw), painting.stop, dragLimit(page.limit, model, redraw), () => page.root.remove(),
  ];
  onSize();
  onTrack();
  askForTrack(model);
  return () => stops.forEach((stop) => stop());
}

const askForTrack = (model) => model.send({ kind: "shown" });

export default { initialize: ({ model }) => keepHearing({ model }, () => askForTrack(model)), render };
