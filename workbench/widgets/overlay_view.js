// The frame with its landmarks: two stacked canvases, the picture below and the marks above it.
// Picture coordinates count from the centre of the top left pixel, so the picture covers -0.5 to width - 0.5.

const INK = "rgba(16, 18, 22, 0.75)", WHITE = "#ffffff", GREY = "#b4b8bf";
const CHOSEN = "#ff6ec7", SUBSET = "#7fe3ff", LINE = "rgba(150, 220, 235, 0.6)", WIRE = "rgba(210, 240, 245, 0.3)";
const COLUMNS = 8; // of the table of landmarks: observed x y, model x y, value, distance in px, confidence, weight
const REACH = 10; // screen pixels between the pointer and a landmark it means
const CLICK = 3; // screen pixels that a click may move
const DRAG_MS = 40; // between two "drag" messages
const DOUBLE_MS = 800; // at most between the clicks of a double-click
const TRUST_MS = 2000; // a moved landmark stays where the user put it until the kernel confirms, or this long
const HELP = {
  select: "scroll zoom · drag pan · double-click face · click select · M mute · ± weight",
  lasso: "draw around landmarks · Ctrl adds · Shift+drag pans · M mute · ± weight",
  move: "drag a ring · arrows nudge (Shift more) · R detector's place · scroll zoom",
};
const HELP_MORE = `Wheel: zoom. Drag on empty ground, with Shift, or with the middle or right button: pan.
Double-click: the face or the whole picture. Click: select; Ctrl or Shift adds; Escape: none.
M: mute or unmute. + and −: double or halve the weight. R: back to the detector's place.
Move tool: drag a ring, or arrow keys for 0.5 px (with Shift 5 px).`;

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

function insidePolygon(x, y, corners) {
  let inside = false;
  for (let i = 0, j = corners.length - 1; i < corners.length; j = i++) {
    const [xi, yi] = corners[i], [xj, yj] = corners[j];
    if (yi > y !== yj > y && x < ((xj - xi) * (y - yi)) / (yj - yi) + xi) inside = !inside;
  }
  return inside;
}

function short(value) {
  return Number.isFinite(value) ? value.toFixed(value >= 100 ? 0 : value >= 10 ? 1 : 2) : "–";
}

function hasWebGL() {
  const context = document.createElement("canvas").getContext("webgl2");
  // Browsers allow few contexts in a page: give this one back at once.
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return Boolean(context);
}

// Decodes pictures one at a time; of those that come meanwhile only the newest is decoded.
function decoder(done) {
  let busy = false, next = null;
  async function work(bytes) {
    busy = true;
    try {
      done(bytes.byteLength ? await createImageBitmap(new Blob([bytes])) : null);
    } catch {
      done(null);
    }
    busy = false;
    if (next) [bytes, next] = [next, null], work(bytes);
  }
  return { push: (bytes) => (busy ? (next = bytes) : work(bytes)), busy: () => busy };
}

function render({ model, el }) {
  const root = element(el, "div", "fw-overlay");
  const stage = element(root, "div", "fw-stage");
  const picture = element(stage, "canvas", "fw-picture"), marks = element(stage, "canvas", "fw-marks");
  element(stage, "div", "fw-focus");
  const legend = element(stage, "div", "fw-legend"), banner = element(stage, "div", "fw-message");
  const hoverBox = element(stage, "div", "fw-hover");
  const help = element(root, "div", "fw-help");
  const legendTitle = element(legend, "div", ""), bar = element(legend, "div", "fw-bar");
  const numbers = element(legend, "div", "fw-numbers");
  const ends = [0, 1, 2].map(() => element(numbers, "span", ""));
  hoverBox.hidden = true;
  hoverBox.setAttribute("role", "status");
  help.title = HELP_MORE;
  stage.tabIndex = 0;
  stage.setAttribute("role", "application");
  stage.setAttribute("aria-label", "Frame with landmarks. " + HELP_MORE);
  root.dataset.lmSuppressShortcuts = "true"; // else JupyterLab takes M and R for itself

  const scheme = model.get("_scheme");
  const table = new Uint8Array(bytesOf(scheme.colors));
  const colors = Array.from({ length: 256 }, (_, k) => `rgb(${table.slice(3 * k, 3 * k + 3).join()})`);
  bar.style.background = `linear-gradient(90deg, ${colors.filter((_, k) => k % 17 === 0).join(", ")})`;

  const view = { scale: 1, x: 0, y: 0, mode: model.get("at_face") ? "face" : "whole" };
  const moved = new Map(); // landmark -> {x, y, until}: where the user put it, until the kernel sends it back
  let fit = null, wire = null, bitmap = null, layerBitmap = null, heatBitmap = null, size = [0, 0];
  let hovered = -1, pointer = null, gesture = null, draws = 0, asked = 0, stalePicture = true, placedFor = "";
  let dropped = { points: [], at: -Infinity };

  // ---- places -------------------------------------------------------------------------------------------------
  const toScreen = (x, y) => [view.scale * x + view.x, view.scale * y + view.y];
  const toPicture = (x, y) => [(x - view.x) / view.scale, (y - view.y) / view.scale];
  const observed = (i) => (moved.has(i) ? [moved.get(i).x, moved.get(i).y] : [fit[COLUMNS * i], fit[COLUMNS * i + 1]]);
  const projected = (i) => [fit[COLUMNS * i + 2], fit[COLUMNS * i + 3]];
  const value = (i) => fit[COLUMNS * i + 4], weight = (i) => fit[COLUMNS * i + 7];
  const count = () => (fit ? fit.length / COLUMNS : 0);
  const layer = (name) => Boolean(model.get("layers")[name]);

  function show(left, top, right, bottom) {
    const [width, height] = [stage.clientWidth, stage.clientHeight];
    view.scale = Math.min(width / Math.max(right - left, 1), height / Math.max(bottom - top, 1));
    view.x = width / 2 - (view.scale * (left + right)) / 2;
    view.y = height / 2 - (view.scale * (top + bottom)) / 2;
  }

  function place() {
    if (!size[0]) return;
    if (view.mode === "face" && fit) {
      // The places in the kernel: a landmark under the mouse must not move the view.
      const places = Array.from({ length: count() }, (_, i) => [fit[COLUMNS * i], fit[COLUMNS * i + 1]])
        .filter(([x]) => Number.isFinite(x));
      const xs = places.map(([x]) => x), ys = places.map(([, y]) => y);
      const margin = 0.3 * (Math.max(...xs) - Math.min(...xs));
      show(Math.min(...xs) - margin, Math.min(...ys) - margin, Math.max(...xs) + margin, Math.max(...ys) + margin);
    } else if (view.mode !== "free") {
      show(-0.5, -0.5, size[0] - 0.5, size[1] - 0.5);
    }
  }

  // The landmark under the pointer; with `rings` only detections count, because only they can be moved.
  function hit(x, y, rings = false) {
    let best = -1, least = REACH;
    for (let i = 0; i < count(); i++) {
      const places = [layer("observed") || rings ? observed(i) : null, !rings && layer("model") ? projected(i) : null];
      for (const spot of places.filter(Boolean)) {
        const [sx, sy] = toScreen(...spot), distance = Math.hypot(sx - x, sy - y);
        if (distance < least) [best, least] = [i, distance];
      }
    }
    return best;
  }

  // ---- drawing ------------------------------------------------------------------------------------------------
  let frame = 0;
  function draw(pictureToo = false) {
    stalePicture ||= pictureToo;
    if (frame) return;
    asked = performance.now();
    frame = requestAnimationFrame(paint);
  }

  function paint() {
    frame = 0;
    if (!stage.clientWidth) return; // in a hidden tab
    // Landmarks wait for the picture that they belong to.
    if (pictures.busy() && bitmap) return;
    if (stalePicture) paintPicture();
    stalePicture = false;
    paintMarks();
    paintWords();
    root.dataset.draws = String(++draws);
    root.dataset.state = JSON.stringify({
      scale: view.scale, x: view.x, y: view.y, mode: view.mode, size, found: Boolean(fit), hovered,
      scaleMax: model.get("_scale"), decoded: Boolean(bitmap), ms: performance.now() - asked,
    });
  }

  function paintPicture() {
    const context = cleared(picture);
    if (!size[0]) return;
    const box = [...toScreen(-0.5, -0.5), view.scale * size[0], view.scale * size[1]];
    context.imageSmoothingQuality = "medium";
    const overlaid = [layer("layer") ? layerBitmap : null, model.get("layer_opacity")];
    for (const [image, opacity] of [[bitmap, 1], overlaid, [layer("heat") ? heatBitmap : null, 1]]) {
      if (!image) continue;
      // From six screen pixels a picture pixel on, the pixels themselves are what one wants to see.
      context.imageSmoothingEnabled = (view.scale * size[0]) / image.width < 6;
      context.globalAlpha = opacity;
      context.drawImage(image, ...box);
    }
  }

  function paintMarks() {
    const context = cleared(marks);
    context.lineCap = context.lineJoin = "round";
    if (wire && layer("wire")) paintWire(context);
    if (fit) paintLandmarks(context);
    if (gesture?.kind === "lasso") {
      context.beginPath();
      gesture.path.forEach(([x, y]) => context.lineTo(x, y));
      context.closePath();
      context.fillStyle = "rgba(255, 110, 199, 0.15)";
      context.fill();
      outline(context, CHOSEN, 1.5);
    }
  }

  function outline(context, color, width) {
    context.strokeStyle = INK;
    context.lineWidth = width + Math.min(1.6, 0.6 + 0.6 * width);
    context.stroke();
    context.strokeStyle = color;
    context.lineWidth = width;
    context.stroke();
  }

  function paintWire(context) {
    context.beginPath();
    for (let k = 0; k < wire.length; k += 4) {
      context.moveTo(...toScreen(wire[k], wire[k + 1]));
      context.lineTo(...toScreen(wire[k + 2], wire[k + 3]));
    }
    context.strokeStyle = WIRE;
    context.lineWidth = 0.8;
    context.stroke();
  }

  function paintLandmarks(context) {
    const limit = model.get("_scale"), chosen = new Set(model.get("selection")), subset = model.get("subset");
    const colorOf = (i) => colors[Math.round(255 * clamp(Number.isFinite(value(i)) ? value(i) / limit : 1, 0, 1))];
    // Marks grow gently with the face on the screen, here measured between the outer corners of the eyes.
    const eyes = view.scale * Math.hypot(observed(36)[0] - observed(45)[0], observed(36)[1] - observed(45)[1]);
    const unit = clamp(Math.pow((eyes || 80) / 110, 0.45), 0.55, 2.2);
    const all = Array.from({ length: count() }, (_, i) => i);
    const circle = ([x, y], radius) => {
      const [sx, sy] = toScreen(x, y);
      context.beginPath();
      context.arc(sx, sy, radius, 0, 2 * Math.PI);
    };

    if (layer("lines")) {
      context.strokeStyle = LINE;
      context.lineWidth = 1.3 * unit;
      for (const line of scheme.lines) {
        context.beginPath();
        line.forEach((i) => context.lineTo(...toScreen(...projected(i))));
        context.stroke();
      }
    }
    for (const i of subset) {
      circle(observed(i), 6.5 * unit + 1);
      context.strokeStyle = SUBSET;
      context.lineWidth = 1.2;
      context.stroke();
    }
    if (layer("residuals")) {
      for (const i of all) {
        if (!weight(i)) continue;
        context.beginPath();
        context.moveTo(...toScreen(...observed(i)));
        context.lineTo(...toScreen(...projected(i)));
        outline(context, colorOf(i), 1.7 * unit);
      }
    }
    for (const i of all) {
      const guessed = fit[COLUMNS * i + 6] < 0.5, mute = !weight(i);
      if (layer("observed")) {
        const radius = (guessed ? 2.2 : 3.6) * unit;
        circle(observed(i), radius);
        outline(context, mute ? GREY : WHITE, unit);
        if (mute) {
          const [x, y] = toScreen(...observed(i)), arm = radius * 1.1;
          context.beginPath();
          context.moveTo(x - arm, y - arm), context.lineTo(x + arm, y + arm);
          context.moveTo(x - arm, y + arm), context.lineTo(x + arm, y - arm);
          outline(context, GREY, unit);
        }
      }
    }
    if (layer("model")) {
      for (const i of all) {
        circle(projected(i), 2.0 * unit);
        if (weight(i)) {
          context.fillStyle = colorOf(i);
          context.strokeStyle = INK;
          context.lineWidth = 0.9 * unit;
          context.fill();
          context.stroke();
        } else outline(context, GREY, 0.8 * unit);
      }
    }
    for (const i of chosen) {
      circle(observed(i), 6.0 * unit);
      outline(context, CHOSEN, 1.8);
    }
    if (hovered >= 0) {
      circle(observed(hovered), 8.0 * unit);
      outline(context, WHITE, 1);
    }
    paintLabels(context, chosen, layer("labels") ? all : [], unit);
  }

  // Numbers stand on the outer side of their landmark. One that would cover another is left out until zooming in
  // makes room; those of selected landmarks come first.
  function paintLabels(context, chosen, all, unit) {
    const size = clamp(Math.round(10 * unit), 10, 13), taken = [];
    const middle = [observed(30), observed(51)].map((spot) => toScreen(...spot)); // nose tip and upper lip
    context.font = `${size}px system-ui, sans-serif`;
    context.textBaseline = "middle";
    context.textAlign = "center";
    for (const i of [...chosen, ...all.filter((i) => !chosen.has(i))]) {
      const [x, y] = toScreen(...observed(i)), [mx, my] = i < 48 ? middle[0] : middle[1];
      const away = Math.hypot(x - mx, y - my), far = 6 * unit + 8;
      const [dx, dy] = away > 1 ? [(x - mx) / away, (y - my) / away] : [0.7, -0.7];
      const [left, top] = [x + far * dx, y + far * dy];
      if (taken.some(([a, b]) => Math.abs(a - left) < 1.25 * size && Math.abs(b - top) < 0.95 * size)) continue;
      taken.push([left, top]);
      context.strokeStyle = INK;
      context.lineWidth = 3;
      context.strokeText(i, left, top);
      context.fillStyle = chosen.has(i) ? CHOSEN : WHITE;
      context.fillText(i, left, top);
    }
  }

  function paintWords() {
    const limit = model.get("_scale"), words = model.get("message");
    legend.hidden = !fit || !(layer("model") || layer("residuals")) || stage.clientWidth < 240;
    legendTitle.textContent = "residual, " + model.get("unit");
    [0, limit / 2, limit].forEach((number, k) => (ends[k].textContent = String(+number.toPrecision(3))));
    ends[2].textContent += "+";
    banner.textContent = words || (model.get("_no_face") ? "no face in this frame" : "");
    banner.hidden = !banner.textContent;
    help.textContent = HELP[model.get("tool")];
    const idle = model.get("tool") === "lasso" ? "crosshair" : hovered < 0 ? "grab" : "pointer";
    stage.style.cursor = gesture?.kind === "pan" ? "grabbing" : idle;
    hoverBox.hidden = hovered < 0 || hovered >= count() || gesture !== null;
    if (!hoverBox.hidden) paintHover(model.get("unit"));
  }

  function paintHover(unit) {
    const [distance, confidence] = [fit[COLUMNS * hovered + 5], fit[COLUMNS * hovered + 6]];
    const title = document.createElement("b");
    title.textContent = `${hovered} · ${scheme.names[hovered]}`;
    const pixels = `${short(distance)} px`, residual = `${short(value(hovered))} ${unit} (${pixels})`;
    const facts = [`group: ${scheme.groups[hovered]}`, `residual: ${unit === "px" ? pixels : residual}`];
    const weighs = weight(hovered) ? `weight ${+weight(hovered).toPrecision(3)}` : "muted";
    facts.push(`confidence ${confidence.toFixed(2)} · ${weighs}`);
    hoverBox.replaceChildren(title, "\n" + facts.join("\n"));
    const { offsetWidth: width, offsetHeight: height } = hoverBox, [x, y] = pointer;
    hoverBox.style.left = `${x + 16 + width > stage.clientWidth ? Math.max(x - 16 - width, 2) : x + 16}px`;
    hoverBox.style.top = `${clamp(y + 16, 2, Math.max(2, stage.clientHeight - height - 2))}px`;
  }

  // ---- what the user does -------------------------------------------------------------------------------------
  const emit = (kind, points, x = null, y = null) => model.send({ kind, points, x, y });

  function select(points, kind = "select") {
    model.set("selection", points);
    model.save_changes();
    emit(kind, points);
    draw();
  }

  function put(index, x, y, kind) {
    const until = performance.now() + TRUST_MS;
    moved.set(index, { x, y, until: kind === "drop" ? until : Infinity });
    if (kind === "drop") {
      setTimeout(() => moved.get(index)?.until === until && (moved.delete(index), draw()), TRUST_MS);
    }
    draw();
  }

  const local = (event) => {
    const box = marks.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };

  function onDown(event) {
    if (gesture) return;
    stage.focus({ preventScroll: true });
    event.preventDefault();
    marks.setPointerCapture(event.pointerId);
    const [x, y] = local(event), tool = model.get("tool"), plain = event.button === 0 && !event.shiftKey;
    const index = hit(x, y, tool === "move");
    gesture = { kind: "pan", start: [x, y], from: [view.x, view.y], moved: false, button: event.button };
    if (plain && tool === "lasso") Object.assign(gesture, { kind: "lasso", path: [[x, y]] });
    if (plain && tool === "move" && index >= 0) {
      const [px, py] = observed(index), [cx, cy] = toPicture(x, y);
      // The ring keeps its distance from the pointer, so that grabbing it does not move it.
      Object.assign(gesture, { kind: "drag", index, offset: [px - cx, py - cy], sent: 0 });
    }
    draw();
  }

  function onMove(event) {
    const [x, y] = (pointer = local(event));
    if (!gesture) {
      hovered = hit(x, y, model.get("tool") === "move");
      draw();
      return;
    }
    gesture.moved ||= Math.hypot(x - gesture.start[0], y - gesture.start[1]) > CLICK;
    if (gesture.kind === "lasso") gesture.path.push([x, y]);
    if (gesture.kind === "pan" && gesture.moved) {
      view.mode = "free";
      view.x = gesture.from[0] + x - gesture.start[0];
      view.y = gesture.from[1] + y - gesture.start[1];
      draw(true);
    }
    if (gesture.kind === "drag" && gesture.moved) dragTo(x, y, "drag");
    draw();
  }

  function dragTo(x, y, kind) {
    const [px, py] = toPicture(x, y), [dx, dy] = gesture.offset, now = performance.now();
    put(gesture.index, px + dx, py + dy, kind);
    if (kind === "drag" && now - gesture.sent < DRAG_MS) return;
    gesture.sent = now;
    emit(kind, [gesture.index], px + dx, py + dy);
  }

  function onUp(event) {
    if (!gesture) return;
    const [x, y] = local(event), adds = event.ctrlKey || event.metaKey || event.shiftKey;
    const before = model.get("selection"), done = gesture;
    if (done.kind === "drag" && done.moved) dragTo(x, y, "drop");
    gesture = null;
    if (done.kind === "lasso" && done.moved) {
      const inside = [...Array(count()).keys()].filter((i) => insidePolygon(...toScreen(...observed(i)), done.path));
      select(adds ? [...new Set([...before, ...inside])].sort((a, b) => a - b) : inside, "lasso");
    } else if (!done.moved && done.button === 0) {
      const index = hit(x, y);
      if (index < 0) {
        if (!adds && before.length) {
          dropped = { points: before, at: performance.now() };
          select([]);
        }
      } else if (!adds) select([index]);
      else if (before.includes(index)) select(before.filter((i) => i !== index));
      else select([...before, index].sort((a, b) => a - b));
    }
    draw();
  }

  function onCancel() {
    if (gesture?.kind === "drag") moved.delete(gesture.index);
    gesture = null;
    draw();
  }

  function onLeave() {
    hovered = -1;
    draw();
  }

  function onWheel(event) {
    event.preventDefault();
    if (!size[0]) return;
    const [x, y] = local(event), lines = event.deltaMode === 1 ? 16 : 1;
    const whole = Math.min(stage.clientWidth / size[0], stage.clientHeight / size[1]);
    const scale = clamp(view.scale * Math.exp(-0.0015 * lines * event.deltaY), 0.5 * whole, Math.max(60, 4 * whole));
    view.x = x - ((x - view.x) * scale) / view.scale;
    view.y = y - ((y - view.y) * scale) / view.scale;
    Object.assign(view, { scale, mode: "free" });
    draw(true);
  }

  function onDouble(event) {
    if (event.button !== 0) return;
    // Its first click has taken the selection away, which was not meant.
    if (performance.now() - dropped.at < DOUBLE_MS && !model.get("selection").length) select(dropped.points);
    view.mode = view.mode === "whole" && fit ? "face" : "whole";
    place();
    draw(true);
  }

  function onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const selection = model.get("selection"), step = event.shiftKey ? 5 : 0.5;
    const arrows = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    const kind = { m: "mute", M: "mute", "+": "weight_up", "=": "weight_up", "-": "weight_down", _: "weight_down",
      r: "reset", R: "reset" }[event.key];
    if (event.key === "Escape") {
      onCancel();
      if (selection.length) select([]);
    } else if (kind && selection.length) {
      if (kind === "reset") selection.forEach((i) => moved.delete(i));
      emit(kind, selection);
    } else if (arrows[event.key] && model.get("tool") === "move" && fit) {
      for (const i of selection) {
        const [x, y] = observed(i), [dx, dy] = arrows[event.key];
        put(i, x + dx, y + dy, "drop");
        emit("drop", [i], x + dx, y + dy);
      }
    } else return;
    event.preventDefault();
    event.stopPropagation();
    draw();
  }

  // ---- what Python sends --------------------------------------------------------------------------------------
  const pictures = decoder((image) => {
    bitmap?.close();
    bitmap = image;
    draw(true);
  });
  const layers = decoder((image) => {
    layerBitmap?.close();
    layerBitmap = image;
    draw(true);
  });

  const heats = decoder((image) => {
    heatBitmap?.close();
    heatBitmap = image;
    draw(true);
  });

  function onFit() {
    const bytes = bytesOf(model.get("_fit"));
    fit = bytes.byteLength ? new Float32Array(bytes) : null;
    for (const [i, spot] of moved) {
      const confirmed = fit && Math.hypot(fit[COLUMNS * i] - spot.x, fit[COLUMNS * i + 1] - spot.y) < 0.05;
      if (confirmed && spot.until < Infinity) moved.delete(i);
    }
    if (view.mode === "face" && !gesture) place();
    draw(view.mode === "face");
  }

  function onPicture() {
    size = model.get("_size");
    pictures.push(bytesOf(model.get("_picture")));
    moved.clear(); // another frame
    if (placedFor !== size.join()) {
      placedFor = size.join();
      view.mode = model.get("at_face") ? "face" : "whole";
      place();
    }
    draw(true);
  }

  function onWire() {
    wire = new Float32Array(bytesOf(model.get("_wire")));
    draw();
  }

  function onSize() {
    stage.style.height = `${model.get("height_px")}px`;
    place();
    draw(true);
  }

  const onLayer = () => layers.push(bytesOf(model.get("_layer")));
  const onHeat = () => heats.push(bytesOf(model.get("_heat")));
  const redraw = () => draw(true);
  const watched = [
    ["change:_picture", onPicture], ["change:_fits", onFit], ["change:_wire", onWire],
    ["change:_layer", onLayer], ["change:_heat", onHeat], ["change:height_px", onSize],
    ...["layers", "layer_opacity", "unit", "selection", "subset", "tool", "message", "_scale"].map(
      (name) => ["change:" + name, redraw],
    ),
  ];
  watched.forEach(([name, callback]) => model.on(name, callback));
  const listeners = {
    pointerdown: onDown, pointermove: onMove, pointerup: onUp, pointercancel: onCancel, pointerleave: onLeave,
    dblclick: onDouble,
    contextmenu: (event) => { event.preventDefault(); event.stopPropagation(); }, // the right button pans
  };
  for (const [name, callback] of Object.entries(listeners)) marks.addEventListener(name, callback);
  marks.addEventListener("wheel", onWheel, { passive: false });
  stage.addEventListener("keydown", onKey);
  const sizes = new ResizeObserver(onSize);
  sizes.observe(stage);

  if (model.get("webgl") === null) {
    model.set("webgl", hasWebGL());
    model.save_changes();
  }
  onSize();
  onPicture();
  onLayer();
  onHeat();
  onWire();
  onFit();

  return () => {
    watched.forEach(([name, callback]) => model.off(name, callback));
    sizes.disconnect();
    cancelAnimationFrame(frame);
    bitmap?.close();
    layerBitmap?.close();
    heatBitmap?.close();
    root.remove();
  };
}

export default { render };
