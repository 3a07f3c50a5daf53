// Landmark errors over the frames of a clip. The strip is one canvas; the cursor, which moves often, another.

const GUTTER = 48, RIGHT = 8, FLAG_ROW = 13, AXIS = 17; // pixels around the strip: labels, flags, frame numbers
const POINTS = 68, NOTHING = 255;
const FLAGGED = 1, STALE = 2, FOUND = 4, NEW_SHOT = 8;
const SHORTEST = 8; // frames that zooming in leaves
const FLAG_COLOR = "#d55e00", MARK_COLOR = "#56b4e9", MARK_TINT = "rgba(86, 180, 233, 0.45)";
const CURSOR_HALO = "rgba(0, 0, 0, 0.75)";
const HELP = "click go to frame · scroll zoom · N P flagged";
const HELP_MORE = `Click or drag: go to a frame. Wheel: zoom in time; with Shift: along the clip.
Double-click: whole clip. Left and right: one frame, with Shift ten. Home, End. N, P: next and previous flagged frame.
Orange: flagged. Blue: marked as failed. Hatched: out of date. Vertical lines: a new shot. Blank: no face.`;

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

// For every pixel column the frames [start, end) in it; at least one, so that zooming in repeats frames.
function columnFrames(column, columns, from, to, count) {
  const start = Math.floor(from + ((to - from) * column) / columns);
  const end = Math.max(start + 1, Math.floor(from + ((to - from) * (column + 1)) / columns));
  return [clamp(start, 0, count - 1), clamp(end, 1, count)];
}

// The strip as pixels: the worst frame of each column for each landmark.
function stripPixels(track, columns, from, to, table) {
  const image = new ImageData(columns, POINTS), pixels = new Uint32Array(image.data.buffer);
  const worst = new Int16Array(POINTS);
  for (let column = 0; column < columns; column++) {
    const [start, end] = columnFrames(column, columns, from, to, track.count);
    worst.fill(-1);
    for (let k = start * POINTS; k < end * POINTS; k += POINTS) {
      for (let i = 0; i < POINTS; i++) {
        const code = track.codes[k + i];
        if (code !== NOTHING && code > worst[i]) worst[i] = code;
      }
    }
    for (let i = 0; i < POINTS; i++) if (worst[i] >= 0) pixels[i * columns + column] = table[worst[i]];
  }
  return image;
}

function roundStep(span, most) {
  const rough = Math.max(span / Math.max(most, 1), 1), decade = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((k) => k * decade).find((step) => step >= rough);
}

function render({ model, el }) {
  const root = element(el, "div", "fw-timeline"), stage = element(root, "div", "fw-stage");
  const strip = element(stage, "canvas", "fw-strip"), over = element(stage, "canvas", "fw-cursor");
  const hoverBox = element(stage, "div", "fw-hover"), below = element(root, "div", "fw-below");
  const help = element(below, "div", "fw-help"), scale = element(below, "div", "fw-scale");
  const zero = element(scale, "span", ""), bar = element(scale, "span", "fw-bar"), limit = element(scale, "span", "");
  hoverBox.hidden = true;
  help.textContent = HELP;
  help.title = scale.title = HELP_MORE;
  stage.tabIndex = 0;
  stage.setAttribute("role", "slider");
  stage.setAttribute("aria-label", "Frame. " + HELP_MORE);
  root.dataset.lmSuppressShortcuts = "true"; // else JupyterLab takes N and P for itself

  const scheme = model.get("_scheme");
  const rgb = new Uint8Array(bytesOf(scheme.colors));
  const table = new Uint32Array(256), bytes = new Uint8Array(table.buffer);
  for (let k = 0; k < 255; k++) {
    const from = 3 * Math.round((k * 255) / 254);
    bytes.set([rgb[from], rgb[from + 1], rgb[from + 2], 255], 4 * k);
  }
  const stops = Array.from({ length: 16 }, (_, k) => `rgb(${rgb.slice(51 * k, 51 * k + 3).join()})`);
  bar.style.background = `linear-gradient(90deg, ${stops.join(", ")})`;

  let track = null, from = 0, to = 1, stale = true, frame = 0, draws = 0, hover = null, dragging = false;

  // ---- places -------------------------------------------------------------------------------------------------
  const width = () => Math.max(stage.clientWidth - GUTTER - RIGHT, 1);
  const bottom = () => stage.clientHeight - AXIS;
  const toX = (column) => GUTTER + ((column - from) / (to - from)) * width();
  const toColumn = (x) => clamp(Math.floor(from + ((x - GUTTER) / width()) * (to - from)), 0, track.count - 1);
  const current = () => model.get("frame") - track.first;

  function zoomTo(start, end) {
    const span = clamp(end - start, Math.min(SHORTEST, track.count), track.count);
    from = clamp(start, 0, track.count - span);
    to = from + span;
    tellView();
    draw(true);
  }

  function tellView() {
    const shown = [track.first + Math.floor(from), track.first + Math.ceil(to) - 1];
    if (shown.some((frame, k) => frame !== model.get("in_view")[k])) {
      model.set("in_view", shown);
      model.save_changes();
    }
  }

  // ---- drawing ------------------------------------------------------------------------------------------------
  function draw(all = false) {
    stale ||= all;
    frame ||= requestAnimationFrame(paint);
  }

  function paint() {
    frame = 0;
    if (!stage.clientWidth) return; // in a hidden tab
    const style = getComputedStyle(root);
    const ink = style.getPropertyValue("--jp-ui-font-color1").trim() || "#222";
    const muted = style.getPropertyValue("--jp-ui-font-color2").trim() || "#777";
    const ground = style.getPropertyValue("--jp-layout-color2").trim() || "#eee";
    if (stale) paintStrip(muted, ground, style.fontFamily);
    stale = false;
    paintCursor(ink, style.fontFamily);
    paintHover();
    zero.textContent = "0";
    limit.textContent = `${+model.get("_scale").toPrecision(3)}+ ${model.get("unit")}`;
    root.dataset.draws = String(++draws);
    root.dataset.state = JSON.stringify({ from, to, gutter: GUTTER, right: RIGHT, count: track?.count ?? 0 });
  }

  function paintStrip(muted, ground, font) {
    const context = cleared(strip), height = bottom() - FLAG_ROW;
    context.fillStyle = ground;
    context.fillRect(GUTTER, FLAG_ROW, width(), height);
    context.font = `10px ${font}`;
    context.textBaseline = "middle";
    context.textAlign = "right";
    context.fillStyle = muted;
    context.fillText("flags", GUTTER - 6, FLAG_ROW / 2);
    const lines = scheme.rows.map((row) => FLAG_ROW + (row.first / POINTS) * height);
    scheme.rows.forEach((row, k) => {
      context.fillText(row.name, GUTTER - 6, lines[k] + (row.count / POINTS / 2) * height);
    });
    if (!track?.count) return;

    const columns = Math.max(1, Math.round(width() * (window.devicePixelRatio || 1)));
    const small = new OffscreenCanvas(columns, POINTS);
    small.getContext("2d").putImageData(stripPixels(track, columns, from, to, table), 0, 0);
    context.imageSmoothingEnabled = false;
    context.drawImage(small, GUTTER, FLAG_ROW, width(), height);
    context.fillStyle = "rgba(255, 255, 255, 0.55)";
    lines.slice(1).forEach((y) => context.fillRect(GUTTER, Math.round(y), width(), 1));
    paintMarked(context, height);
    paintFlags(context, columns, muted, height);
    paintAxis(context, muted);
  }

  function paintMarked(context, height) {
    for (const [first, last] of model.get("marked")) {
      const left = Math.max(toX(first - track.first), GUTTER);
      const wide = Math.max(Math.min(toX(last + 1 - track.first), GUTTER + width()) - left, 0);
      if (!wide) continue;
      context.fillStyle = MARK_TINT;
      context.fillRect(left, FLAG_ROW, Math.max(wide, 1), height);
      context.fillStyle = MARK_COLOR;
      context.fillRect(left, FLAG_ROW - 4, Math.max(wide, 2), 4);
    }
  }

  // Flags, out-of-date frames and shots; of several frames in a column every mark is shown.
  function paintFlags(context, columns, muted, height) {
    const pixel = width() / columns;
    const hatch = context.createPattern(hatching(muted), "repeat");
    for (let column = 0; column < columns; column++) {
      const [start, end] = columnFrames(column, columns, from, to, track.count);
      let any = 0, all = 255, cut = false;
      for (let k = start; k < end; k++) {
        any |= track.marks[k];
        all &= track.marks[k];
        // A frame that is wider than a pixel starts its shot in its first column only.
        cut ||= Boolean(track.marks[k] & NEW_SHOT) && toX(k) > GUTTER + (column - 1) * pixel;
      }
      const x = GUTTER + column * pixel;
      if (any & STALE) {
        context.fillStyle = hatch;
        context.fillRect(x, 1, pixel, FLAG_ROW - 2);
        context.fillStyle = "rgba(128, 128, 128, 0.45)";
        context.fillRect(x, FLAG_ROW, pixel, height);
      }
      if (!(all & FOUND)) {
        context.fillStyle = muted;
        context.fillRect(x, FLAG_ROW - 4, Math.max(pixel, 1), 3);
      }
      if (any & FLAGGED) {
        context.fillStyle = FLAG_COLOR;
        context.fillRect(x, 1, Math.max(pixel, 2), FLAG_ROW - 3);
      }
      if (cut) {
        context.fillStyle = "rgba(0, 0, 0, 0.6)";
        context.fillRect(Math.round(x) - 1, FLAG_ROW, 3, height);
        context.fillStyle = "#fff";
        context.fillRect(Math.round(x), FLAG_ROW, 1, height);
        context.fillStyle = muted;
        context.fillRect(Math.round(x), 0, 1, FLAG_ROW);
      }
    }
  }

  function hatching(color) {
    const tile = new OffscreenCanvas(6, 6), context = tile.getContext("2d");
    context.strokeStyle = color;
    for (const shift of [-6, 0, 6]) {
      context.moveTo(shift, 6);
      context.lineTo(shift + 6, 0);
    }
    context.stroke();
    return tile;
  }

  function paintAxis(context, muted) {
    const step = roundStep(to - from, width() / 70), first = track.first;
    context.fillStyle = muted;
    context.textAlign = "center";
    for (let index = Math.ceil((from + first) / step) * step; index < to + first; index += step) {
      const x = toX(index - first + 0.5);
      context.fillRect(Math.round(x), bottom(), 1, 3);
      if (x < GUTTER + width() - 12) context.fillText(index, Math.max(x, GUTTER + 6), bottom() + 10);
    }
  }

  function paintCursor(ink, font) {
    const context = cleared(over);
    if (!track?.count) return;
    const column = current(), middle = toX(column + 0.5), wide = width() / (to - from);
    stage.setAttribute("aria-valuenow", String(column + track.first));
    stage.setAttribute("aria-valuemin", String(track.first));
    stage.setAttribute("aria-valuemax", String(track.first + track.count - 1));
    if (column + 1 < from || column > to) return;
    if (wide > 6) {
      context.strokeStyle = CURSOR_HALO;
      context.lineWidth = 3;
      context.strokeRect(toX(column), FLAG_ROW, wide, bottom() - FLAG_ROW);
      context.strokeStyle = "#fff";
      context.lineWidth = 1;
      context.strokeRect(toX(column), FLAG_ROW, wide, bottom() - FLAG_ROW);
    } else {
      const x = Math.round(middle);
      context.fillStyle = CURSOR_HALO;
      context.fillRect(x - 2, FLAG_ROW - 3, 4, bottom() - FLAG_ROW + 3);
      context.fillStyle = "#fff";
      context.fillRect(x - 1, FLAG_ROW - 3, 2, bottom() - FLAG_ROW + 3);
    }
    // The number of the frame stands on a plate below the line, over the axis.
    const text = String(column + track.first);
    context.font = `600 10px ${font}`;
    const half = context.measureText(text).width / 2 + 4, x = clamp(middle, GUTTER + half, GUTTER + width() - half);
    context.fillStyle = ink;
    context.fillRect(x - half, bottom() + 2, 2 * half, AXIS - 3);
    context.fillStyle = getComputedStyle(root).getPropertyValue("--jp-layout-color0").trim() || "#fff";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(text, x, bottom() + 10);
  }

  function paintHover() {
    hoverBox.hidden = !hover || !track?.count;
    if (hoverBox.hidden) return;
    // Where a pixel holds many frames, the readout is about the one that coloured it: the worst, or a flagged one.
    const column = hover.column, mark = track.marks[column], worst = track.worst[column];
    const words = [`frame ${column + track.first}`];
    words.push(
      mark & FOUND && Number.isFinite(track.largest[column])
        ? `worst: ${worst} ${scheme.names[worst]}\n${+track.largest[column].toPrecision(3)} ${model.get("unit")}`
        : "no face",
    );
    const why = model.get("_why")[column];
    if (mark & FLAGGED) words.push(why ? `flagged: ${why}` : "flagged");
    const number = column + track.first;
    if (model.get("marked").some(([first, last]) => first <= number && number <= last)) words.push("marked as failed");
    if (mark & STALE) words.push("out of date: a detection or setting has changed");
    if (mark & NEW_SHOT) words.push("a new shot begins");
    hoverBox.textContent = words.join("\n");
    const wide = hoverBox.offsetWidth, fits = hover.x + 14 + wide <= stage.clientWidth;
    hoverBox.style.left = `${fits ? hover.x + 14 : Math.max(hover.x - 14 - wide, 0)}px`;
    hoverBox.style.top = `${FLAG_ROW + 4}px`;
  }

  // ---- what the user does -------------------------------------------------------------------------------------
  function go(column) {
    column = clamp(column, 0, track.count - 1);
    if (column < from || column + 1 > to) zoomTo(column - (to - from) / 2, column + (to - from) / 2);
    if (column !== current()) {
      model.set("frame", column + track.first);
      model.save_changes();
    }
    draw();
  }

  function worstUnder(x) {
    const per = (to - from) / width();
    let best = toColumn(x);
    if (per <= 1) return best;
    const rank = (k) => (track.largest[k] || 0) + (track.marks[k] & FLAGGED ? 1e6 : 0);
    for (let k = best; k < Math.min(best + per, track.count); k++) if (rank(k) > rank(best)) best = k;
    return best;
  }

  const xOf = (event) => event.clientX - over.getBoundingClientRect().left;

  function onDown(event) {
    if (event.button !== 0 || !track?.count) return;
    event.preventDefault();
    stage.focus({ preventScroll: true });
    over.setPointerCapture(event.pointerId);
    dragging = true;
    // A click means what the readout shows; while dragging frames follow one another.
    go(worstUnder(xOf(event)));
  }

  function onMove(event) {
    if (!track?.count) return;
    const x = xOf(event);
    if (dragging && event.movementX) go(toColumn(x));
    hover = x >= GUTTER && x <= GUTTER + width() ? { x, column: dragging ? current() : worstUnder(x) } : null;
    draw();
  }

  const onUp = () => (dragging = false);
  const onLeave = () => ((hover = null), draw());
  const onDouble = () => track?.count && zoomTo(0, track.count);

  function onWheel(event) {
    if (!track?.count) return;
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 16 : 1, span = to - from;
    const along = event.deltaX || (event.shiftKey ? event.deltaY : 0);
    if (along) return zoomTo(from + (along * lines * span) / width(), from + (along * lines * span) / width() + span);
    const at = from + ((xOf(event) - GUTTER) / width()) * span;
    const next = clamp(span * Math.exp(0.0015 * lines * event.deltaY), Math.min(SHORTEST, track.count), track.count);
    zoomTo(at - ((at - from) * next) / span, at + ((to - at) * next) / span);
  }

  function nextFlagged(step) {
    let column = current() + step;
    while (column >= 0 && column < track.count && !(track.marks[column] & FLAGGED)) column += step;
    return column >= 0 && column < track.count ? column : current();
  }

  function onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !track?.count) return;
    const step = event.shiftKey ? 10 : 1;
    const goal = {
      ArrowLeft: () => current() - step, ArrowRight: () => current() + step, Home: () => 0, End: () => track.count - 1,
      n: () => nextFlagged(1), p: () => nextFlagged(-1), N: () => nextFlagged(1), P: () => nextFlagged(-1),
    }[event.key];
    if (!goal) return;
    event.preventDefault();
    event.stopPropagation();
    go(goal());
  }

  // ---- what Python sends --------------------------------------------------------------------------------------
  function onTrack() {
    const sent = model.get("_track"), resized = !track || track.count !== sent.count || track.first !== sent.first;
    track = {
      first: sent.first, count: sent.count, codes: new Uint8Array(bytesOf(sent.codes)),
      largest: new Float32Array(bytesOf(sent.largest)), worst: new Uint8Array(bytesOf(sent.worst)),
      marks: new Uint8Array(bytesOf(sent.marks)),
    };
    if (resized) {
      [from, to, hover] = [0, Math.max(track.count, 1), null];
      tellView();
    }
    draw(true);
  }

  function onPart(content, buffers) {
    if (content.kind !== "part" || !track) return;
    content.names.forEach((name, k) => {
      const part = new track[name].constructor(bytesOf(buffers[k]));
      track[name].set(part, content.start * (name === "codes" ? POINTS : 1));
    });
    draw(true);
  }

  function onFrame() {
    const column = track?.count ? current() : 0;
    if (track?.count && (column < from || column + 1 > to)) zoomTo(column - (to - from) / 2, column + (to - from) / 2);
    draw();
  }

  function onSize() {
    stage.style.height = `${model.get("height_px")}px`;
    draw(true);
  }

  const redraw = () => draw(true);
  const watched = [
    ["change:_track", onTrack], ["change:frame", onFrame], ["change:_scale", redraw], ["change:unit", redraw],
    ["change:height_px", onSize], ["change:marked", redraw], ["msg:custom", onPart],
  ];
  watched.forEach(([name, callback]) => model.on(name, callback));
  const listeners = {
    pointerdown: onDown, pointermove: onMove, pointerup: onUp, pointercancel: onUp, pointerleave: onLeave,
    dblclick: onDouble,
  };
  for (const [name, callback] of Object.entries(listeners)) over.addEventListener(name, callback);
  over.addEventListener("wheel", onWheel, { passive: false });
  stage.addEventListener("keydown", onKey);
  const sizes = new ResizeObserver(onSize);
  sizes.observe(stage);
  const theme = new MutationObserver(redraw); // JupyterLab tells its theme in attributes of the page's body
  theme.observe(document.body, { attributes: true });

  onSize();
  onTrack();
  model.send({ kind: "shown" });

  return () => {
    watched.forEach(([name, callback]) => model.off(name, callback));
    sizes.disconnect();
    theme.disconnect();
    cancelAnimationFrame(frame);
    root.remove();
  };
}

export default { render };
