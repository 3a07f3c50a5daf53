import { bytesOf } from "../shared/bytes.js";
import { element } from "../shared/canvas.js";
import { cssColors } from "../shared/colors.js";
import { follow, listen } from "../shared/following.js";
import { clamp } from "../shared/numbers.js";
import { makeAvatar } from "./avatar.js";
import { poseOf } from "./fit.js";
import { paintPicture } from "./marks.js";
import { recentOf, statusOf } from "./status.js";

const WRITTEN_MS = 250; // between two changes of the status line

function makePage(el) {
  const root = element(el, "div", "fw-live"), row = element(root, "div", "fw-row");
  const left = element(row, "div", "fw-stage fw-seen"), right = element(row, "div", "fw-stage fw-avatar");
  const picture = element(left, "canvas", "fw-picture"), head = element(right, "canvas", "fw-head");
  const message = element(left, "div", "fw-message"), note = element(right, "div", "fw-message");
  const lamp = element(left, "div", "fw-lamp"), status = element(root, "div", "fw-line");
  lamp.textContent = "● live";
  right.title = "Drag: turn the head. Double-click: reset.";
  message.setAttribute("role", "status");
  note.textContent = "This browser has no WebGL, so there is no avatar.";
  return { root, row, left, right, picture, head, message, note, lamp, status };
}

// Keeps canvases at screen resolution. Sizes are cached, because asking for them would redo the layout at every frame.
function followStages(stages, changed) {
  const boxes = new Map();
  const sizes = new ResizeObserver((entries) => {
    entries.forEach((entry) => boxes.set(entry.target, entry.contentRect));
    changed();
  });
  stages.forEach((stage) => sizes.observe(stage));
  // Sets a canvas to the size of its stage; returns whether it is visible.
  function fitted(canvas) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2), box = boxes.get(canvas.parentElement);
    if (!box) return false;
    const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    return width > 0 && height > 0;
  }
  return { fitted, stop: () => sizes.disconnect() };
}

// Dragging turns the head: yaw and pitch of `turned`.
function listenToDrags(stage, model, view, redraw) {
  let dragged = null;
  const end = () => { dragged = null; };
  listen(stage, {
    pointerdown: (event) => { dragged = [event.clientX, event.clientY]; stage.setPointerCapture(event.pointerId); },
    pointermove: (event) => {
      if (!dragged) return;
      const way = model.get("mirror") ? -1 : 1, [yaw, pitch] = view.turned;
      const [right, down] = [event.clientX - dragged[0], event.clientY - dragged[1]];
      view.turned = [yaw - (way * right) / 120, clamp(pitch + down / 120, -1.4, 1.4)];
      dragged = [event.clientX, event.clientY];
      redraw();
    },
    pointerup: end, pointercancel: end,
    dblclick: () => { view.turned = [0, 0]; redraw(); },
  });
}

// The texts over and below the pictures.
function makeWriting(model, { root, lamp, message, status }, isSlow) {
  let written = 0;
  function write(fit, log) {
    const now = performance.now(), running = model.get("running"), recent = recentOf(log, now);
    const said = model.get("message") || (isSlow() ? "The kernel is busy …" : "");
    lamp.hidden = !running || !recent.count;
    message.hidden = !said && !(running && recent.count && fit && !fit.found);
    const words = said || "no face";
    if (message.textContent !== words) message.textContent = words; // avoids a page layout at every frame
    message.classList.toggle("fw-alert", Boolean(said) && model.get("alert"));
    message.classList.toggle("fw-middle", !fit);
    if (now - written < WRITTEN_MS && running) return;
    written = now;
    const { rate, delay } = recent, found = Boolean(fit?.found);
    root.dataset.state = JSON.stringify({ rate, delay, running, found, said, count: log.length });
    if (!running || !recent.count || !fit) status.textContent = running ? "" : "stopped";
    else status.textContent = statusOf(fit, recent);
  }
  return { write, writeNow: (fit, log) => ((written = 0), write(fit, log)) };
}

// One display of the widget.
export function makeDisplay(model, el, mesh, head, isSlow, redraw) {
  const page = makePage(el), { root, left, right, picture } = page;
  const scheme = model.get("_scheme"), colors = cssColors(new Uint8Array(bytesOf(scheme.colors)));
  const avatar = makeAvatar(page.head, mesh, head, redraw), context = picture.getContext("2d", { alpha: false });
  const view = { turned: [0, 0], last: null, posed: null };
  const writing = makeWriting(model, page, isSlow), stages = followStages([left, right], redraw);
  page.note.hidden = Boolean(avatar);
  listenToDrags(right, model, view, redraw);

  function paint(fit) {
    view.last = fit;
    root.classList.toggle("fw-mirror", model.get("mirror"));
    if (stages.fitted(picture)) paintPicture(picture, context, fit, scheme.lines, colors);
    if (fit?.found) view.posed = fit; // without a face the head is unchanged
    if (avatar && stages.fitted(page.head)) avatar.draw(poseOf(view.posed, model.get("looking"), view.turned, mesh));
  }

  function onSize() {
    page.row.style.height = `${model.get("height_px")}px`;
    redraw();
  }
  const onWords = () => writing.writeNow(view.last, root.live?.log || []);
  const unfollow = follow(model, [
    ["change:height_px", onSize], ["change:mirror", redraw], ["change:looking", redraw],
    ["change:message", onWords], ["change:alert", onWords],
  ]);
  onSize();
  onWords();

  function close() {
    unfollow();
    stages.stop();
    avatar?.close();
    root.remove();
  }
  return { root, paint, write: writing.write, close };
}
