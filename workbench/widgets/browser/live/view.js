// The browser's part of a live panel: its camera, the picture with the landmarks, and the avatar in WebGL.
// One object per widget and page holds the camera; each display of the widget draws for itself.
import { readMesh } from "../drawing/mesh.js";
import { bytesOf } from "../shared/bytes.js";
import { follow, listen } from "../shared/following.js";
import { keepHearing } from "../shared/hearing.js";
import { onDemand } from "../shared/painting.js";
import { makeCamera } from "./camera.js";
import { makeDisplay } from "./display.js";
import { readFit } from "./fit.js";
import { makeHead } from "./head.js";
import { makeLeaving } from "./leaving.js";
import { makeSilence } from "./silence.js";

const KEPT = 6; // frames waiting for their fit
const LOOK_MS = 500, BEAT_MS = 10000; // intervals of checking whether the kernel is silent, and of signs of life to it
const LOG = 2000; // frames whose times are kept for measurements

// The state of a widget in a page; `tell` sends a message to Python, which identifies the page by its name.
function makeLive() {
  const live = {
    page: Math.random().toString(36).slice(2), model: null, mesh: null, head: null, displays: new Set(),
    waiting: new Map(), // frames by number, until their fit arrives
    log: [], // {number, grabbed, drawn} of the latest frames
    current: null, shown: null, // the drawn fit, and its report in the next message
    silence: makeSilence(),
  };
  live.tell = (content, buffers = []) => {
    try {
      live.model.send({ ...content, page: live.page }, undefined, buffers);
    } catch {
      live.camera.close(); // the connection is gone, so nobody else can close it
    }
  };
  live.write = (fit) => live.displays.forEach((display) => display.write(fit, live.log));
  live.camera = makeCamera(
    (grab, bytes) => sendFrame(live, grab, bytes),
    (why, detail = "") => live.tell({ kind: "trouble", why, detail }),
  );
  live.leaving = makeLeaving(() => live.camera.close(), () => live.tell({ kind: "left" }));
  Object.assign(live, makeDrawing(live));
  return live;
}

function sendFrame(live, grab, bytes) {
  const { waiting } = live;
  waiting.set(grab.number, grab);
  while (waiting.size > KEPT) waiting.delete(waiting.keys().next().value);
  live.silence.onFrame(performance.now());
  // Pages of one camera count their milliseconds from different moments; another page may go on with a recording.
  const time = performance.timeOrigin + grab.grabbed;
  live.tell({ kind: "frame", number: grab.number, time, shown: live.shown }, [bytes]);
  live.shown = null;
}

// A fit with its picture, which was either sent along or kept here.
async function withPicture(live, fit, jpeg, arrived) {
  const grab = live.waiting.get(fit.number);
  if (jpeg) {
    const picture = await createImageBitmap(new Blob([bytesOf(jpeg)], { type: "image/jpeg" })).catch(() => null);
    Object.assign(fit, { picture, since: arrived, fromKernel: true });
  } else if (grab) {
    Object.assign(fit, { picture: grab.picture, since: grab.grabbed, fromKernel: false });
    for (const number of live.waiting.keys()) if (number <= fit.number) live.waiting.delete(number);
  }
  return fit;
}

// Draws fits in all displays; of those that arrive between two drawings only the latest.
function makeDrawing(live) {
  let queued = null;
  const painting = onDemand(() => {
    const fit = queued;
    queued = null;
    if (fit) {
      live.current?.picture?.close?.();
      live.current = fit;
      if (fit.found) live.head.move(fit.weights);
    }
    for (const display of live.displays) display.paint(live.current);
    // A drawing counts as shown when the browser requests the next one.
    if (fit) requestAnimationFrame(() => onShown(fit));
    return true;
  });

  function onShown(fit) {
    const drawn = performance.now(), seen = { number: fit.number, ms: drawn - fit.since };
    live.log.push({ number: fit.number, grabbed: fit.since, drawn, found: fit.found });
    if (live.log.length > LOG) live.log.shift();
    if (fit.fromKernel) live.tell({ kind: "shown", ...seen });
    else live.shown = seen; // sent with the next frame
    live.write(fit);
  }

  const draw = () => painting.ask();
  return { draw, show: (fit) => ((queued = fit), draw()), stopDrawing: painting.stop };
}

async function onMessage(live, content, buffers) {
  const { camera, tell } = live, { kind } = content, arrived = performance.now();
  live.silence.onAnswer();
  if (kind === "call" && live.displays.size) tell({ kind: "here" });
  if (kind === "open" && content.page === live.page) {
    live.waiting.clear();
    camera.open(content.size);
  }
  if (kind === "close" || (kind === "open" && content.page !== live.page)) camera.close();
  if (kind === "skip" || kind === "fit") camera.release(content.number);
  if (kind === "fit") {
    live.show(await withPicture(live, readFit(content, buffers[0], live.mesh.shapes), buffers[1], arrived));
  }
}

// Notices when the kernel is silent: sends it another frame from time to time, and finally closes the camera.
function onLook(live) {
  const { camera, silence } = live, now = performance.now();
  if (!camera.isOpen()) return;
  if (silence.isOver(now)) camera.close(), live.tell({ kind: "trouble", why: "silent" });
  else if (silence.isLost(now)) camera.forget();
  live.write(live.current);
}

function initialize(live, model) {
  const { camera, tell } = live, mesh = readMesh(model.get("_mesh")), head = makeHead(mesh);
  Object.assign(live, { model, mesh, head });

  function onPerson() {
    head.setPerson(model.get("_person"));
    head.move(live.current?.found ? live.current.weights : null);
    live.draw();
  }
  function onRunning() {
    if (!model.get("running")) camera.close();
    live.write(live.current);
  }
  function onGone() {
    camera.close();
    if (live.displays.size || live.leaving.isUnderWay()) tell({ kind: "left" });
  }

  onPerson();
  const stops = [
    follow(model, [
      ["msg:custom", (content, buffers) => onMessage(live, content, buffers)],
      ["change:running", onRunning], ["change:_person", onPerson],
      ["comm_live_update", () => camera.close()], // a kernel that has gone cannot close the camera itself
    ]),
    listen(window, { pagehide: onGone }), live.stopDrawing,
  ];
  const looks = setInterval(() => onLook(live), LOOK_MS);
  // A camera that was closed here, as when the connection to the kernel broke, is opened again by the kernel's answer.
  const beats = setInterval(() => live.displays.size && tell({ kind: "beat", closed: camera.isClosed() }), BEAT_MS);
  return () => {
    camera.close();
    clearInterval(looks);
    clearInterval(beats);
    live.leaving.stop();
    stops.forEach((stop) => stop());
  };
}

function render(live, model, el) {
  const { camera, displays, log, page } = live;
  const isSlow = () => camera.isOpen() && live.silence.isSlow(performance.now());
  const display = makeDisplay(model, el, live.mesh, live.head, isSlow, live.draw);
  display.root.live = { log, page, camera: camera.isOpen, unplug: camera.unplug }; // for measurements and tests
  displays.add(display);
  live.leaving.stop();
  live.tell({ kind: "here" });
  live.draw();
  return () => {
    displays.delete(display);
    display.close();
    if (!displays.size) live.leaving.start();
  };
}

export default () => {
  const live = makeLive();
  return {
    initialize: ({ model }) => {
      keepHearing({ model });
      return initialize(live, model);
    },
    render: ({ model, el }) => render(live, model, el),
  };
};
