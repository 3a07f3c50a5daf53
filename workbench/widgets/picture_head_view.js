// Shows the newest picture of the head and sends what the mouse, a finger or the keyboard does to it.
// At most one movement is under way: the next one waits for its picture and takes along all that happened meanwhile.

const ANSWER_MS = 600; // after this long without an answer the next movement is sent anyway
const STEP_PX = 24; // one press of an arrow key
const NOTHING = { turn: [0, 0], pan: [0, 0], zoom: 1, reset: false };

function render({ model, el }) {
  const [width, height] = model.get("_size");
  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width, height, tabIndex: 0 });
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "Head in 3D: drag or arrow keys turn it, wheel or + and - zoom, Home resets");
  canvas.style.cssText =
    `display:block; width:${width}px; max-width:100%; aspect-ratio:${width}/${height}; cursor:grab; touch-action:none`;
  const message = document.createElement("div");
  message.style.cssText = "font-size:12px; color:var(--jp-error-color1, #b3261e)";
  el.classList.add("fw-head3d");
  el.append(canvas, message);
  const context = canvas.getContext("2d");

  let newest = 0;
  async function draw() {
    const view = model.get("_jpeg");
    const number = ++newest;
    if (!view || !view.byteLength) return;
    // The view shares its buffer with the rest of the message.
    const bytes = new Uint8Array(view.buffer, view.byteOffset, view.byteLength).slice();
    const picture = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
    if (number === newest) context.drawImage(picture, 0, 0, width, height);
    picture.close();
  }

  let waiting = { ...NOTHING };
  let pending = false;
  let sent = Date.now(); // ascends over reloads of the page, and differs between two displays
  let timer = null;
  function send() {
    if (!pending || timer !== null) return;
    sent += 1;
    model.send({ kind: "move", number: sent, ...waiting });
    waiting = { ...NOTHING };
    pending = false;
    timer = setTimeout(answered, ANSWER_MS);
  }
  function answered() {
    clearTimeout(timer);
    timer = null;
    send();
  }
  function onDone() {
    if (model.get("_done") >= sent) answered();
  }
  function move(change) {
    const add = (a, b) => (b ? [a[0] + b[0], a[1] + b[1]] : a);
    waiting = change.reset
      ? { ...NOTHING, reset: true }
      : {
          turn: add(waiting.turn, change.turn),
          pan: add(waiting.pan, change.pan),
          zoom: waiting.zoom * (change.zoom || 1),
          reset: waiting.reset,
        };
    pending = true;
    send();
  }

  let held = null;
  function onDown(event) {
    held = { id: event.pointerId, x: event.clientX, y: event.clientY, pan: event.button !== 0 || event.shiftKey };
    canvas.setPointerCapture(event.pointerId);
    canvas.style.cursor = "grabbing";
  }
  function onMove(event) {
    if (!held || held.id !== event.pointerId) return;
    const scale = width / canvas.getBoundingClientRect().width;
    const by = [(event.clientX - held.x) * scale, (event.clientY - held.y) * scale];
    Object.assign(held, { x: event.clientX, y: event.clientY });
    if (by[0] || by[1]) move(held.pan ? { pan: by } : { turn: by });
  }
  function onUp() {
    held = null;
    canvas.style.cursor = "grab";
  }
  function onWheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 16 : 1;
    move({ zoom: Math.exp(Math.max(-240, Math.min(240, event.deltaY * lines)) * 0.0015) });
  }
  const KEYS = {
    ArrowLeft: { turn: [-STEP_PX, 0] }, ArrowRight: { turn: [STEP_PX, 0] },
    ArrowUp: { turn: [0, -STEP_PX] }, ArrowDown: { turn: [0, STEP_PX] },
    "+": { zoom: 0.9 }, "-": { zoom: 1 / 0.9 }, Home: { reset: true },
  };
  function onKey(event) {
    if (!KEYS[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation(); // the notebook has commands on these keys
    move(KEYS[event.key]);
  }
  const onReset = () => move({ reset: true });
  const onMenu = (event) => event.preventDefault();
  const onMessage = () => { message.textContent = model.get("_message"); };

  const listeners = [
    ["pointerdown", onDown], ["pointermove", onMove], ["pointerup", onUp], ["pointercancel", onUp],
    ["wheel", onWheel], ["dblclick", onReset], ["contextmenu", onMenu], ["keydown", onKey],
  ];
  for (const [name, listener] of listeners) canvas.addEventListener(name, listener, { passive: false });
  model.on("change:_jpeg", draw);
  model.on("change:_done", onDone);
  model.on("change:_message", onMessage);
  draw();
  onMessage();

  return () => {
    clearTimeout(timer);
    newest += 1;
    for (const [name, listener] of listeners) canvas.removeEventListener(name, listener);
    model.off("change:_jpeg", draw);
    model.off("change:_done", onDone);
    model.off("change:_message", onMessage);
  };
}

export default { render };
