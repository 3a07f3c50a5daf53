// Lines over a common x. They are drawn on one canvas; the cursor and the readout, which move often, on another.

const LEFT = 54, RIGHT = 12, TOP = 18, BOTTOM = 30; // pixels around the plot
const MOST_VALUES = 10; // lines of the readout
const DASHES = [[], [6, 3], [2, 2], [8, 3, 2, 3], [12, 4], [4, 6]];
const BORDERS = ["solid", "dashed", "dotted"];

// A copy: the view may start anywhere in a larger buffer, and floats must start at a multiple of four.
const bytesOf = (view) => view.buffer.slice(view.byteOffset, view.byteOffset + view.byteLength);
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

function element(parent, tag, name) {
  const made = document.createElement(tag);
  made.className = name;
  parent.append(made);
  return made;
}

// The drawing context of a canvas in CSS pixels, sharp on screens with more than one pixel per CSS pixel.
function cleared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
  return context;
}

function words(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const short = size === 0 || (size < 1e5 && size >= 1e-3);
  const text = short ? String(+value.toPrecision(4)) : value.toExponential(1).replace(".0e", "e").replace("e+", "e");
  return text.replaceAll("-", "−");
}

// Round numbers in [low, high], about `most` of them.
function linearTicks(low, high, most) {
  const rough = (high - low) / Math.max(most, 1), decade = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * decade).find((k) => k >= rough * 0.999);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-6); k * step <= high + step * 1e-6; k++) ticks.push(k * step);
  return ticks;
}

// Powers of ten between two exponents; where there is hardly one, also their double and fivefold.
function logTicks(low, high, most) {
  const step = Math.max(1, Math.ceil((high - low) / most)), ticks = [];
  const factors = high - low < 2 ? [1, 2, 5] : [1];
  for (let power = Math.floor(low); power <= high; power++) {
    if (((power % step) + step) % step) continue;
    for (const factor of factors) {
      const place = power + Math.log10(factor);
      if (place >= low - 1e-9 && place <= high + 1e-9) ticks.push(place);
    }
  }
  return ticks;
}

// Index of the value nearest to `wanted` in an ascending array.
function nearest(values, wanted) {
  let low = 0, high = values.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[middle] <= wanted) low = middle;
    else high = middle;
  }
  return Math.abs(values[high] - wanted) < Math.abs(values[low] - wanted) ? high : low;
}

function render({ model, el }) {
  const root = element(el, "div", "fw-chart"), top = element(root, "div", "fw-top");
  const title = element(top, "div", "fw-title"), keys = element(top, "div", "fw-keys");
  const stage = element(root, "div", "fw-stage");
  const lines = element(stage, "canvas", "fw-lines"), over = element(stage, "canvas", "fw-cursor");
  const hoverBox = element(stage, "div", "fw-hover");
  hoverBox.hidden = true;
  stage.tabIndex = 0;
  stage.setAttribute("role", "application");
  root.dataset.lmSuppressShortcuts = "true";

  let sent = null, x = null, rows = [], range = null, plot = { width: 1, height: 1, log: false };
  let frame = 0, stale = true, draws = 0, hover = null, theme = {};

  // Measured once for each drawing: asking the page for every point would take most of the time.
  const width = () => plot.width, height = () => plot.height, log = () => plot.log;
  const shown = (k) => !model.get("hidden").includes(sent.names[k]);
  const toX = (value) => LEFT + ((value - range.left) / (range.right - range.left)) * width();
  const fromX = (place) => range.left + ((place - LEFT) / width()) * (range.right - range.left);
  // Zero has no logarithm: it lies on the lower edge.
  const level = (value) => (log() ? (value > 0 ? Math.max(Math.log10(value), range.low) : range.low) : value);
  const toY = (value) => TOP + height() * (1 - (level(value) - range.low) / (range.high - range.low));

  function measure() {
    let low = Infinity, high = -Infinity, zeros = false;
    plot = {
      width: Math.max(stage.clientWidth - LEFT - RIGHT, 1), height: Math.max(stage.clientHeight - TOP - BOTTOM, 1),
      log: model.get("y_log"),
    };
    rows.forEach((row, k) => {
      if (!shown(k)) return;
      for (const value of row) {
        if (log() && value <= 0) zeros = true;
        if (!Number.isFinite(value) || (log() && value <= 0)) continue;
        if (value < low) low = value;
        if (value > high) high = value;
      }
    });
    if (low > high) [low, high] = log() ? [0.1, 1] : [0, 1];
    if (log()) {
      [low, high] = [Math.log10(low), Math.log10(high)];
      low = Math.max(low, high - 14); // beyond that there is rounding, not information
    }
    const room = high - low || Math.abs(high) * 0.1 || 1;
    const first = x.length ? x[0] : 0, last = x.length ? x[x.length - 1] : 1, half = first === last ? 0.5 : 0;
    range = {
      low: low - (zeros ? 0.15 : 0.06) * room, high: high + 0.06 * room, left: first - half, right: last + half, zeros,
    };
  }

  // ---- drawing ------------------------------------------------------------------------------------------------
  function draw(all = false) {
    stale ||= all;
    frame ||= requestAnimationFrame(paint);
  }

  function paint() {
    frame = 0;
    if (!stage.clientWidth) return; // in a hidden tab
    if (stale) {
      const style = getComputedStyle(root);
      const read = (name, otherwise) => style.getPropertyValue(name).trim() || otherwise;
      theme = {
        ink: read("--jp-ui-font-color1", "#222"), muted: read("--jp-ui-font-color2", "#777"),
        grid: read("--jp-border-color2", "#ddd"), font: style.fontFamily, ground: read("--jp-layout-color0", "#fff"),
      };
      measure();
      paintKeys();
      paintLines();
    }
    stale = false;
    paintCursor();
    paintHover();
    root.dataset.draws = String(++draws);
    root.dataset.state = JSON.stringify({ ...range, plot: [LEFT, TOP, width(), height()], count: x.length });
  }

  const swatch = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true }), known = new Map();
  function lightness(color) {
    if (!known.has(color)) {
      swatch.fillStyle = color;
      swatch.fillRect(0, 0, 1, 1);
      const [red, green, blue] = swatch.getImageData(0, 0, 1, 1).data;
      known.set(color, (0.2126 * red + 0.7152 * green + 0.0722 * blue) / 255);
    }
    return known.get(color);
  }

  // A colour that the ground would swallow (yellow on white) is darkened or lightened a little.
  function colorOf(k) {
    const color = sent.colors[k] === "ink" ? theme.ink : sent.colors[k];
    const seen = Math.abs(lightness(color) - lightness(theme.ground)) > 0.2;
    return seen ? color : `color-mix(in srgb, ${color} 70%, ${theme.ink})`;
  }

  const dash = (k) => Math.floor(k / 8) % DASHES.length;
  let palette = [];

  function paintKeys() {
    palette = sent.names.map((_, k) => colorOf(k));
    title.textContent = model.get("title");
    title.hidden = !title.textContent;
    top.hidden = title.hidden && !sent.names.length;
    const there = [...keys.children].map((key) => key.dataset.name);
    if (there.length !== sent.names.length || there.some((name, k) => name !== sent.names[k])) {
      keys.replaceChildren(...sent.names.map((name) => {
        const key = document.createElement("button");
        key.className = "fw-key";
        key.dataset.name = name;
        key.title = "click: show or hide; double-click: only this one, or all";
        key.append(document.createElement("i"), name);
        return key;
      }));
    }
    sent.names.forEach((_, k) => {
      const key = keys.children[k];
      key.setAttribute("aria-pressed", String(shown(k)));
      key.firstChild.style.borderTopColor = palette[k];
      key.firstChild.style.borderTopStyle = BORDERS[dash(k) % BORDERS.length];
    });
  }

  function paintLines() {
    const context = cleared(lines), right = LEFT + width(), bottom = TOP + height();
    context.font = `10px ${theme.font}`;
    stage.setAttribute("aria-label", `Chart ${model.get("title")}: ${sent.names.join(", ")}`);
    if (sent.selected) {
      const [start, end] = sent.selected.map((value) => clamp(toX(value), LEFT, right));
      context.fillStyle = theme.grid;
      context.fillRect(start, TOP, Math.max(end - start, 1), height());
    }
    paintAxes(context, right, bottom);
    context.save();
    context.beginPath();
    context.rect(LEFT - 1, TOP - 1, width() + 2, height() + 2);
    context.clip();
    context.lineJoin = "round";
    rows.forEach((row, k) => shown(k) && paintRow(context, row, k));
    context.restore();
    if (!x.length) {
      context.fillStyle = theme.muted;
      context.textAlign = "center";
      context.fillText("nothing to show yet", LEFT + width() / 2, TOP + height() / 2);
    }
  }

  function paintAxes(context, right, bottom) {
    const ticks = (log() ? logTicks : linearTicks)(range.low, range.high, Math.max(2, Math.floor(height() / 28)));
    context.fillStyle = theme.muted;
    context.textBaseline = "middle";
    context.textAlign = "right";
    for (const tick of ticks) {
      const y = TOP + height() * (1 - (tick - range.low) / (range.high - range.low));
      context.fillStyle = theme.grid;
      context.fillRect(LEFT, Math.round(y), width(), 1);
      context.fillStyle = theme.muted;
      context.fillText(words(log() ? +(10 ** tick).toPrecision(3) : +tick.toPrecision(10)), LEFT - 5, y);
    }
    context.fillRect(LEFT, Math.round(bottom), width(), 1);
    if (range.zeros) context.fillText("≤ 0", LEFT - 5, bottom);
    if (!x.length) return;
    context.textAlign = "center";
    for (const tick of linearTicks(range.left, range.right, Math.max(2, Math.floor(width() / 70)))) {
      context.fillRect(Math.round(toX(tick)), bottom, 1, 3);
      context.fillText(words(+tick.toPrecision(10)), toX(tick), bottom + 9);
    }
    context.fillText(sent.x_label, LEFT + width() / 2, bottom + 22);
    context.textAlign = "left";
    context.fillText(sent.y_label, 2, 8);
    let free = 4 + (sent.y_label ? context.measureText(sent.y_label).width + 12 : LEFT);
    for (const [place, label] of sent.marks) {
      const at = Math.round(toX(place));
      if (at < LEFT - 1 || at > right + 1) continue;
      context.globalAlpha = 0.6;
      for (let y = TOP; y < bottom; y += 5) context.fillRect(at, y, 1, 3);
      context.globalAlpha = 1;
      // A label without room is left out; its line stays.
      const wide = context.measureText(label).width, from = clamp(at, LEFT, right - wide);
      if (from < free) continue;
      context.fillText(label, from, 8);
      free = from + wide + 8;
    }
  }

  function paintRow(context, row, k) {
    context.strokeStyle = context.fillStyle = palette[k];
    context.lineWidth = rows.length > 12 ? 1.1 : 1.6; // many lines must not become one surface
    context.setLineDash(DASHES[dash(k)]);
    context.beginPath();
    if (x.length > 2 * width()) traceDense(context, row);
    else traceSparse(context, row);
    context.stroke();
    context.setLineDash([]);
  }

  function traceSparse(context, row) {
    for (let j = 0, down = false; j < row.length; j++) {
      if (!Number.isFinite(row[j])) {
        down = false;
        continue;
      }
      const px = toX(x[j]), py = toY(row[j]);
      if (down) context.lineTo(px, py);
      else context.moveTo(px, py);
      if (!down && !Number.isFinite(row[j + 1])) context.fillRect(px - 1.5, py - 1.5, 3, 3); // alone between gaps
      down = true;
    }
  }

  // More values than pixels: each pixel column gets a stroke from its least to its largest value.
  function traceDense(context, row) {
    let j = 0, down = false;
    while (j < row.length) {
      const column = Math.floor(toX(x[j]));
      let low = Infinity, high = -Infinity, first = NaN, last = NaN;
      for (; j < row.length && Math.floor(toX(x[j])) === column; j++) {
        if (!Number.isFinite(row[j])) continue;
        if (row[j] < low) low = row[j];
        if (row[j] > high) high = row[j];
        if (Number.isNaN(first)) first = row[j];
        last = row[j];
      }
      if (low > high) {
        down = false;
        continue;
      }
      const px = column + 0.5;
      if (down) context.lineTo(px, toY(first));
      else context.moveTo(px, toY(first));
      context.lineTo(px, toY(low));
      context.lineTo(px, toY(high) - 0.5); // a level stretch is still a stroke
      context.lineTo(px, toY(last));
      down = true;
    }
  }

  function paintCursor() {
    const context = cleared(over), cursor = model.get("cursor");
    if (!x.length) return;
    if (cursor !== null && cursor >= range.left && cursor <= range.right) {
      context.fillStyle = theme.ink;
      context.fillRect(Math.round(toX(cursor)) - 0.75, TOP - 3, 1.5, height() + 3);
    }
    if (!hover) return;
    context.fillStyle = theme.muted;
    context.fillRect(Math.round(toX(x[hover.index])), TOP, 1, height());
    rows.forEach((row, k) => {
      if (!shown(k) || !Number.isFinite(row[hover.index])) return;
      context.beginPath();
      context.arc(toX(x[hover.index]), toY(row[hover.index]), 3, 0, 2 * Math.PI);
      context.fillStyle = palette[k];
      context.fill();
    });
  }

  function paintHover() {
    hoverBox.hidden = !hover;
    if (!hover) return;
    const seen = rows.map((_, k) => k).filter(shown), line = document.createElement("div");
    line.textContent = `${sent.x_label || "x"} ${words(x[hover.index])}`;
    // Of many series those nearest to the pointer are read out.
    const away = (k) => Math.abs(toY(rows[k][hover.index]) - hover.y);
    const chosen = seen.length <= MOST_VALUES ? seen
      : seen.filter((k) => Number.isFinite(away(k))).sort((a, b) => away(a) - away(b)).slice(0, MOST_VALUES);
    const entries = chosen.map((k) => {
      const entry = document.createElement("div"), sample = element(entry, "i", "");
      sample.style.background = palette[k];
      entry.append(sent.names[k]);
      element(entry, "b", "").textContent = words(rows[k][hover.index]);
      return entry;
    });
    hoverBox.replaceChildren(line, ...entries);
    const left = seen.length - chosen.length;
    if (left) element(hoverBox, "div", "").textContent = `and ${left} more`;
    const at = toX(x[hover.index]), wide = hoverBox.offsetWidth;
    hoverBox.style.left = `${at + 12 + wide > stage.clientWidth ? Math.max(at - 12 - wide, 0) : at + 12}px`;
    const tall = hoverBox.offsetHeight, lowest = Math.max(0, stage.clientHeight - tall);
    hoverBox.style.top = `${clamp(hover.y - tall / 2, -TOP, lowest)}px`;
  }

  // ---- what the user does -------------------------------------------------------------------------------------
  function onMove(event) {
    if (!x.length || !range) return;
    const box = over.getBoundingClientRect(), place = event.clientX - box.left;
    const inside = place >= LEFT - 8 && place <= LEFT + width() + 8;
    hover = inside ? { index: nearest(x, fromX(place)), y: event.clientY - box.top } : null;
    draw();
  }

  function pick(index) {
    model.set("cursor", x[index]);
    model.save_changes();
    model.send({ pick: x[index] });
    draw();
  }

  function onDown(event) {
    if (event.button !== 0) return;
    event.preventDefault();
    stage.focus({ preventScroll: true });
    onMove(event);
    if (hover) pick(hover.index);
  }

  function onKey(event) {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step || !x.length || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    const cursor = model.get("cursor");
    pick(cursor === null ? 0 : clamp(nearest(x, cursor) + step, 0, x.length - 1));
  }

  function hide(names) {
    model.set("hidden", names);
    model.save_changes();
    draw(true);
  }

  const nameOf = (event) => event.target.closest(".fw-key")?.dataset.name;

  function onKeyClick(event) {
    const name = nameOf(event), hidden = model.get("hidden");
    if (name !== undefined) hide(hidden.includes(name) ? hidden.filter((other) => other !== name) : [...hidden, name]);
  }

  function onKeyDouble(event) {
    const name = nameOf(event);
    if (name === undefined) return;
    const others = sent.names.filter((other) => other !== name), hidden = model.get("hidden");
    hide(others.every((other) => hidden.includes(other)) ? [] : others);
  }

  // ---- what Python sends --------------------------------------------------------------------------------------
  function onSeries() {
    sent = model.get("_series");
    const data = new Float32Array(bytesOf(sent.data)), count = sent.count;
    x = data.subarray(0, count);
    rows = sent.names.map((_, k) => data.subarray((k + 1) * count, (k + 2) * count));
    hover = hover && hover.index < count ? hover : null;
    draw(true);
  }

  function onSize() {
    stage.style.height = `${model.get("height_px")}px`;
    draw(true);
  }

  const redraw = () => draw(true), cursorOnly = () => draw(), onLeave = () => ((hover = null), draw());
  const watched = [
    ["change:_series", onSeries], ["change:cursor", cursorOnly], ["change:height_px", onSize],
    ...["hidden", "y_log", "title"].map((name) => ["change:" + name, redraw]),
  ];
  watched.forEach(([name, callback]) => model.on(name, callback));
  const listeners = { pointerdown: onDown, pointermove: onMove, pointerleave: onLeave };
  for (const [name, callback] of Object.entries(listeners)) over.addEventListener(name, callback);
  stage.addEventListener("keydown", onKey);
  keys.addEventListener("click", onKeyClick);
  keys.addEventListener("dblclick", onKeyDouble);
  const sizes = new ResizeObserver(onSize);
  sizes.observe(stage);
  const themes = new MutationObserver(redraw); // JupyterLab tells its theme in attributes of the page's body
  themes.observe(document.body, { attributes: true });

  onSeries();
  onSize();

  return () => {
    watched.forEach(([name, callback]) => model.off(name, callback));
    sizes.disconnect();
    themes.disconnect();
    cancelAnimationFrame(frame);
    root.remove();
  };
}

export default { render };
