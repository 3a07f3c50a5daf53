// The browser's part of a live panel: its camera, the picture with the landmarks, and the avatar in WebGL.
// One object per widget and page holds the camera; each place where the widget is displayed has its own drawings.

const BEFORE_WEIGHTS = 16, MARK = 6; // layout of the numbers of a fit: see `pack_fit`
const FULL_SCALE = 4.0; // residual at the bright end of the colours, % of the outer-eye distance
const AHEAD = 2; // frames without an answer from the kernel: one on the way while one is fitted, never more
const KEPT = 6; // frames that wait for their fit
const JPEG_QUALITY = 0.85;
const SLOW_MS = 3000, SILENT_MS = 60000; // without an answer from the kernel
const BEAT_MS = 10000;
const GONE_MS = 1500; // a display that is moved within a notebook vanishes for a moment
const WINDOW_MS = 2000; // over which rates are counted
const LOG = 2000; // frames whose times are kept for whoever measures
const INK = "rgba(16, 18, 22, 0.7)";

// A copy: the view may start anywhere in a larger buffer, and floats must start at a multiple of four.
const bytesOf = (view) => view.buffer.slice(view.byteOffset, view.byteOffset + view.byteLength);
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];

function element(parent, tag, name) {
  const made = document.createElement(tag);
  made.className = name;
  parent.append(made);
  return made;
}

// ---- the camera -------------------------------------------------------------------------------------------------

const WHY = {
  NotAllowedError: "denied", SecurityError: "denied", NotFoundError: "absent", OverconstrainedError: "absent",
  NotReadableError: "busy", AbortError: "busy",
};

// Opens the browser's camera and hands out its newest frame whenever the kernel has few enough to answer.
function makeCamera(onFrame, onTrouble) {
  let stream = null, video = null, turn = 0, fresh = false, number = 0, answered = -1;
  let takeAgain = () => {};

  async function open([width, height]) {
    if (stream) return;
    const mine = ++turn;
    if (!navigator.mediaDevices?.getUserMedia) return onTrouble("insecure");
    try {
      const wanted = { width: { ideal: width }, height: { ideal: height }, frameRate: { ideal: 30 } };
      const opened = await navigator.mediaDevices.getUserMedia({ audio: false, video: wanted });
      if (mine !== turn) return opened.getTracks().forEach((track) => track.stop()); // stopped meanwhile
      stream = opened;
      stream.getVideoTracks()[0].addEventListener("ended", () => {
        if (mine === turn) close(), onTrouble("ended");
      });
      video = document.createElement("video");
      Object.assign(video, { muted: true, playsInline: true, srcObject: stream });
      await video.play();
    } catch (error) {
      if (mine !== turn) return;
      close();
      return onTrouble(WHY[error.name] || "failed", error.name);
    }
    if (mine !== turn) return;
    answered = number - 1;
    const scale = () => Math.min(1, width / video.videoWidth, height / video.videoHeight);
    const next = () => {
      if (mine !== turn) return;
      fresh = true;
      take(scale);
      video.requestVideoFrameCallback(next);
    };
    takeAgain = () => take(scale);
    video.requestVideoFrameCallback(next);
  }

  // Where the kernel is slower than the camera, frames are left out here and never queue up.
  function take(scale) {
    if (number - 1 - answered >= AHEAD || !fresh || !video.videoWidth) return;
    fresh = false;
    const grabbed = performance.now(), canvas = document.createElement("canvas");
    canvas.width = Math.round(video.videoWidth * scale());
    canvas.height = Math.round(video.videoHeight * scale());
    const context = canvas.getContext("2d", { alpha: false, willReadFrequently: true });
    context.drawImage(video, 0, 0, canvas.width, canvas.height);
    // At once: browsers encode blobs when they are idle, which took 30 ms here instead of 4.
    const text = atob(canvas.toDataURL("image/jpeg", JPEG_QUALITY).split(",")[1]);
    const bytes = Uint8Array.from(text, (letter) => letter.charCodeAt(0)).buffer;
    onFrame({ number: number++, grabbed, picture: canvas }, bytes);
  }

  function close() {
    turn++;
    stream?.getTracks().forEach((track) => track.stop());
    if (video) video.srcObject = null;
    stream = video = null;
  }

  // The kernel has answered this frame; those before it were left out.
  function release(done) {
    answered = Math.max(answered, done);
    if (stream) takeAgain();
  }

  const ended = () => stream?.getVideoTracks()[0].dispatchEvent(new Event("ended"));
  return { open, close, release, isOpen: () => Boolean(stream), unplug: ended };
}

// ---- the avatar -------------------------------------------------------------------------------------------------

const VERTEX = `#version 300 es
in vec3 place; in vec3 normal; in vec2 uv; in vec3 color; in float shown;
uniform mat4 projection; uniform mat3 turn; uniform vec3 shift, pivot;
out vec3 n, p; out vec2 at; out vec3 tint; out float keep;
void main() {
  p = turn * (place - pivot) + shift;
  n = turn * normal;
  at = uv; tint = color; keep = shown;
  gl_Position = projection * vec4(p, 1.0);
}`;
// A warm light from the upper left, a cool one from the right, and a rim from behind, in the camera's frame.
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 n, p; in vec2 at; in vec3 tint; in float keep;
uniform sampler2D skin; uniform bool textured;
out vec4 result;
float lit(vec3 m, vec3 from) { return max(dot(m, normalize(from)), 0.0); }
void main() {
  if (keep < 0.5) discard;
  vec3 m = normalize(n), sight = normalize(-p);
  vec3 albedo = textured ? texture(skin, at).rgb : tint;
  vec3 light = vec3(0.30) + 0.62 * lit(m, vec3(-0.55, -0.65, -1.0)) * vec3(1.0, 0.97, 0.92)
    + 0.28 * lit(m, vec3(0.9, -0.1, -0.8)) * vec3(0.86, 0.92, 1.0)
    + 0.22 * lit(m, vec3(0.5, -0.7, 0.9));
  float gloss = pow(lit(m, normalize(vec3(-0.55, -0.65, -1.0)) + sight), 24.0);
  result = vec4(albedo * light + 0.05 * gloss, 1.0);
}`;

function compiled(gl, kind, source) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  return shader;
}

// Morph targets and normals of one head; computed once a fit, however many displays draw it.
function makeHead(mesh) {
  const triangles = new Uint32Array(bytesOf(mesh.triangles)), order = new Uint32Array(bytesOf(mesh.order));
  const size = 3 * mesh.vertices, raw = new Int16Array(bytesOf(mesh.deltas));
  const deltas = mesh.steps.map((_, k) => raw.subarray(k * size, (k + 1) * size));
  const places = new Float32Array(size), normals = new Float32Array(size);
  const out = { places: new Float32Array(3 * order.length), normals: new Float32Array(3 * order.length), stamp: 0 };
  let neutral = null, factors = null;

  function setPerson(person) {
    neutral = new Float32Array(bytesOf(person.neutral));
    factors = person.factors;
  }

  function move(weights) {
    places.set(neutral);
    for (let k = 0; k < deltas.length; k++) {
      const factor = weights ? weights[k] * mesh.steps[k] * factors[k] : 0, delta = deltas[k];
      if (Math.abs(factor) < 1e-9) continue;
      for (let i = 0; i < size; i++) places[i] += factor * delta[i];
    }
    normals.fill(0);
    for (let t = 0; t < triangles.length; t += 3) {
      const a = 3 * triangles[t], b = 3 * triangles[t + 1], c = 3 * triangles[t + 2];
      const ux = places[b] - places[a], uy = places[b + 1] - places[a + 1], uz = places[b + 2] - places[a + 2];
      const vx = places[c] - places[a], vy = places[c + 1] - places[a + 1], vz = places[c + 2] - places[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      for (const corner of [a, b, c]) {
        normals[corner] += x;
        normals[corner + 1] += y;
        normals[corner + 2] += z;
      }
    }
    for (let i = 0; i < order.length; i++) {
      for (let j = 0; j < 3; j++) {
        out.places[3 * i + j] = places[3 * order[i] + j];
        out.normals[3 * i + j] = normals[3 * order[i] + j];
      }
    }
    out.stamp++;
  }
  return { move, setPerson, out };
}

// Column-major clip matrix of points in a camera's frame (+y down, +z away): u = fx·x/z + cx in a picture w × h.
function projectionOf([fx, fy, cx, cy], [w, h], [sx, sy]) {
  const near = 20, far = 20000, depth = (far + near) / (far - near);
  return new Float32Array([
    (2 * fx * sx) / w, 0, 0, 0,
    0, (-2 * fy * sy) / h, 0, 0,
    sx * ((2 * (cx + 0.5)) / w - 1), sy * (1 - (2 * (cy + 0.5)) / h), depth, 1,
    0, 0, (-2 * far * near) / (far - near), 0,
  ]);
}

function multiplied(a, b) {
  return Array.from({ length: 9 }, (_, k) => {
    const row = 3 * Math.floor(k / 3), column = k % 3;
    return a[row] * b[column] + a[row + 1] * b[3 + column] + a[row + 2] * b[6 + column];
  });
}
function orbit(yaw, pitch) {
  const [c, s, d, t] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return multiplied([1, 0, 0, 0, d, -t, 0, t, d], [c, 0, s, 0, 1, 0, -s, 0, c]);
}
const transposed = (m) => [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];

// Without a graphics card smooth edges cost as much as all the rest.
function drawsInSoftware() {
  const probe = document.createElement("canvas").getContext("webgl2");
  const told = probe?.getExtension("WEBGL_debug_renderer_info");
  const name = told ? probe.getParameter(told.UNMASKED_RENDERER_WEBGL) : "";
  probe?.getExtension("WEBGL_lose_context")?.loseContext(); // a browser keeps only some 16 of them
  return /swiftshader|llvmpipe|software/i.test(name);
}

function makeAvatar(canvas, mesh, head) {
  const gl = canvas.getContext("webgl2", { antialias: !drawsInSoftware() });
  if (!gl) return null;
  const program = gl.createProgram();
  gl.attachShader(program, compiled(gl, gl.VERTEX_SHADER, VERTEX));
  gl.attachShader(program, compiled(gl, gl.FRAGMENT_SHADER, FRAGMENT));
  gl.linkProgram(program);
  gl.useProgram(program);
  const points = mesh.order.byteLength / 4, textured = mesh.texture.byteLength > 0;
  const place = (name) => gl.getUniformLocation(program, name);
  const buffers = {};
  function attribute(name, size, data, kind = gl.FLOAT, usage = gl.STATIC_DRAW) {
    buffers[name] = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
    gl.bufferData(gl.ARRAY_BUFFER, data, usage);
    const index = gl.getAttribLocation(program, name);
    if (index < 0) return;
    gl.enableVertexAttribArray(index);
    gl.vertexAttribPointer(index, size, kind, kind !== gl.FLOAT, 0, 0);
  }
  attribute("place", 3, new Float32Array(3 * points), gl.FLOAT, gl.DYNAMIC_DRAW);
  attribute("normal", 3, new Float32Array(3 * points), gl.FLOAT, gl.DYNAMIC_DRAW);
  attribute("color", 3, new Uint8Array(bytesOf(mesh.colors)), gl.UNSIGNED_BYTE);
  attribute("shown", 1, new Float32Array(bytesOf(mesh.shown)));
  attribute("uv", 2, textured ? new Float32Array(bytesOf(mesh.uv)) : new Float32Array(2 * points));
  const drawn = new Uint32Array(bytesOf(mesh.drawn));
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, drawn, gl.STATIC_DRAW);
  gl.enable(gl.DEPTH_TEST);
  gl.enable(gl.CULL_FACE);
  let ready = false, stamp = -1;
  if (textured) {
    createImageBitmap(new Blob([bytesOf(mesh.texture)])).then((image) => {
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      image.close();
      ready = true;
    });
  }

  // `pose`: {turn (3 × 3, row by row), shift, pivot, camera, size}.
  function draw(pose) {
    if (stamp !== head.out.stamp) {
      for (const [name, data] of [["place", head.out.places], ["normal", head.out.normals]]) {
        gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
        gl.bufferSubData(gl.ARRAY_BUFFER, 0, data);
      }
      stamp = head.out.stamp;
    }
    const [width, height] = [canvas.width, canvas.height], [w, h] = pose.size;
    const fit = Math.min(width / w, height / h), stretch = [(fit * w) / width, (fit * h) / height];
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(place("projection"), false, projectionOf(pose.camera, pose.size, stretch));
    gl.uniformMatrix3fv(place("turn"), false, new Float32Array(transposed(pose.turn)));
    gl.uniform3fv(place("shift"), pose.shift);
    gl.uniform3fv(place("pivot"), pose.pivot);
    gl.uniform1i(place("textured"), textured && ready ? 1 : 0);
    gl.drawElements(gl.TRIANGLES, drawn.length, gl.UNSIGNED_INT, 0);
  }
  return { draw, close: () => gl.getExtension("WEBGL_lose_context")?.loseContext() };
}

// ---- the picture ------------------------------------------------------------------------------------------------

function paintMarks(context, fit, lines, colors, scale) {
  const at = (i, column) => fit.marks[MARK * i + column];
  const eyes = Math.hypot(at(36, 0) - at(45, 0), at(36, 1) - at(45, 1));
  const unit = clamp(Math.pow((scale * eyes || 80) / 110, 0.45), 0.6, 2.0) / scale;
  const colorOf = (i) => colors[Math.round(255 * clamp((100 * at(i, 4)) / eyes / FULL_SCALE, 0, 1))];
  context.lineCap = context.lineJoin = "round";
  context.strokeStyle = "rgba(160, 225, 240, 0.55)";
  context.lineWidth = 1.1 * unit;
  for (const line of lines) {
    context.beginPath();
    line.forEach((i) => context.lineTo(at(i, 2), at(i, 3)));
    context.stroke();
  }
  for (let i = 0; i < 68; i++) {
    context.beginPath();
    context.moveTo(at(i, 0), at(i, 1));
    context.lineTo(at(i, 2), at(i, 3));
    context.strokeStyle = INK;
    context.lineWidth = 2.8 * unit;
    context.stroke();
    context.strokeStyle = colorOf(i);
    context.lineWidth = 1.6 * unit;
    context.stroke();
  }
  for (let i = 0; i < 68; i++) {
    context.beginPath();
    context.arc(at(i, 2), at(i, 3), 2.1 * unit, 0, 2 * Math.PI);
    context.fillStyle = colorOf(i);
    context.strokeStyle = INK;
    context.lineWidth = 0.9 * unit;
    context.fill();
    context.stroke();
  }
}

// ---- the widget -------------------------------------------------------------------------------------------------

export default () => {
  const page = Math.random().toString(36).slice(2), waiting = new Map(), displays = new Set();
  let model = null, head = null, mesh = null, current = null, queued = null, frame = 0, shown = null;
  let sentAt = 0, heardAt = 0, beats = 0, leaving = 0, slow = false;
  const log = []; // {number, grabbed, drawn} of the newest frames
  function tell(content, buffers = []) {
    try {
      model.send({ ...content, page }, undefined, buffers);
    } catch {
      camera.close(); // the connection is gone, and with it whoever could ask for that
    }
  }

  const camera = makeCamera(
    (grab, bytes) => {
      waiting.set(grab.number, grab);
      while (waiting.size > KEPT) waiting.delete(waiting.keys().next().value);
      sentAt = performance.now();
      tell({ kind: "frame", number: grab.number, time: grab.grabbed, shown }, [bytes]);
      shown = null;
    },
    (why, detail = "") => tell({ kind: "trouble", why, detail }),
  );

  function onMessage(content, buffers) {
    heardAt = performance.now();
    if (content.kind === "call" && displays.size) tell({ kind: "here" });
    if (content.kind === "open" && content.page === page) {
      heardAt = sentAt = performance.now();
      waiting.clear();
      camera.open(content.size);
    }
    if (content.kind === "open" && content.page !== page) camera.close();
    if (content.kind === "close") camera.close();
    if (content.kind === "skip" || content.kind === "fit") camera.release(content.number);
    if (content.kind === "fit") onFit(content, buffers);
  }

  async function onFit(content, buffers) {
    const arrived = performance.now(), numbers = new Float32Array(bytesOf(buffers[0]));
    const weights = numbers.subarray(BEFORE_WEIGHTS, BEFORE_WEIGHTS + mesh.shapes);
    const fit = {
      ...content, weights, turn: numbers.subarray(0, 9), shift: numbers.subarray(9, 12),
      camera: numbers.subarray(12, 16), marks: numbers.subarray(BEFORE_WEIGHTS + mesh.shapes),
    };
    const grab = waiting.get(content.number);
    if (buffers[1]) {
      const picture = await createImageBitmap(new Blob([bytesOf(buffers[1])], { type: "image/jpeg" })).catch(() => null);
      Object.assign(fit, { picture, since: arrived, fromKernel: true });
    } else if (grab) {
      Object.assign(fit, { picture: grab.picture, since: grab.grabbed, fromKernel: false });
      for (const number of waiting.keys()) if (number <= content.number) waiting.delete(number);
    }
    queued = fit; // of fits that come between two drawings only the newest is drawn
    draw();
  }

  function draw() {
    if (!frame) frame = requestAnimationFrame(paint);
  }

  function paint() {
    frame = 0;
    const fit = queued;
    if (fit) {
      queued = null;
      current?.picture?.close?.();
      current = fit;
      if (fit.found) head.move(fit.weights);
    }
    for (const display of displays) display.paint(current, Boolean(fit));
    // The drawing counts as seen when the browser asks for the next one.
    if (fit) requestAnimationFrame(() => onShown(fit));
  }

  function onShown(fit) {
    const drawn = performance.now();
    log.push({ number: fit.number, grabbed: fit.since, drawn, found: fit.found });
    if (log.length > LOG) log.shift();
    const seen = { number: fit.number, ms: drawn - fit.since };
    if (fit.fromKernel) tell({ kind: "shown", ...seen });
    else shown = seen; // travels with the next frame
    for (const display of displays) display.write(fit, log);
  }

  function onRunning() {
    if (!model.get("running")) camera.close();
    for (const display of displays) display.write(current, log);
  }

  function onBeat() {
    if (!camera.isOpen()) return;
    const silent = sentAt > heardAt ? performance.now() - heardAt : 0;
    slow = silent > SLOW_MS;
    if (silent > SILENT_MS) camera.close(), tell({ kind: "trouble", why: "silent" });
    for (const display of displays) display.write(current, log);
  }

  // A kernel that has gone cannot ask for the camera's end.
  function onConnection() {
    camera.close();
  }

  function onPerson() {
    head.setPerson(model.get("_person"));
    head.move(current?.found ? current.weights : null);
    draw();
  }

  function onGone() {
    camera.close();
    if (displays.size || leaving) tell({ kind: "left" });
  }

  function initialize({ model: given }) {
    model = given;
    mesh = model.get("_mesh");
    head = makeHead(mesh);
    onPerson();
    model.on("msg:custom", onMessage);
    model.on("change:running", onRunning);
    model.on("change:_person", onPerson);
    model.on("comm_live_update", onConnection);
    window.addEventListener("pagehide", onGone);
    beats = setInterval(onBeat, 500);
    const alive = setInterval(() => displays.size && tell({ kind: "beat" }), BEAT_MS);
    return () => {
      camera.close();
      clearInterval(beats);
      clearInterval(alive);
      clearTimeout(leaving);
      cancelAnimationFrame(frame);
      window.removeEventListener("pagehide", onGone);
      model.off("msg:custom", onMessage);
      model.off("change:running", onRunning);
      model.off("change:_person", onPerson);
      model.off("comm_live_update", onConnection);
    };
  }

  function render({ model: own, el }) {
    const display = makeDisplay(own, el, mesh, head, () => slow, draw);
    display.root.live = { log, page, camera: camera.isOpen, unplug: camera.unplug }; // for whoever measures and tests
    displays.add(display);
    clearTimeout(leaving);
    leaving = 0;
    tell({ kind: "here" });
    draw();
    return () => {
      displays.delete(display);
      display.close();
      if (displays.size) return;
      leaving = setTimeout(() => {
        leaving = 0;
        camera.close();
        tell({ kind: "left" });
      }, GONE_MS);
    };
  }

  return { initialize, render };
};

// One place where the widget is displayed.
function makeDisplay(model, el, mesh, head, isSlow, redraw) {
  const root = element(el, "div", "fw-live"), row = element(root, "div", "fw-row");
  const left = element(row, "div", "fw-stage fw-seen"), right = element(row, "div", "fw-stage fw-avatar");
  const picture = element(left, "canvas", "fw-picture"), avatarCanvas = element(right, "canvas", "fw-head");
  const message = element(left, "div", "fw-message"), note = element(right, "div", "fw-message");
  const lamp = element(left, "div", "fw-lamp");
  const status = element(root, "div", "fw-line");
  lamp.textContent = "● live";
  right.title = "Drag: turn the head. Double-click: back.";
  message.setAttribute("role", "status");
  const scheme = model.get("_scheme"), table = new Uint8Array(bytesOf(scheme.colors));
  const colors = Array.from({ length: 256 }, (_, k) => `rgb(${table.slice(3 * k, 3 * k + 3).join()})`);
  const avatar = makeAvatar(avatarCanvas, mesh, head);
  note.hidden = Boolean(avatar);
  note.textContent = "This browser has no WebGL: there is no avatar.";
  let turned = [0, 0], last = null, posed = null, written = 0;
  const context = picture.getContext("2d", { alpha: false });

  // Sizes are kept: asking the page for them lays it out anew, at every frame.
  const boxes = new Map();
  function fitted(canvas) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2), box = boxes.get(canvas.parentElement);
    if (!box) return false;
    const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    return width > 0 && height > 0;
  }

  function paintPicture(fit) {
    if (!fitted(picture)) return;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = "#1b1d21";
    context.fillRect(0, 0, picture.width, picture.height);
    if (!fit) return;
    const [w, h] = fit.size, scale = Math.min(picture.width / w, picture.height / h);
    context.setTransform(scale, 0, 0, scale, (picture.width - scale * w) / 2, (picture.height - scale * h) / 2);
    if (fit.picture) context.drawImage(fit.picture, 0, 0, w, h);
    context.translate(0.5, 0.5); // landmarks count from the centre of the first pixel
    if (fit.found) paintMarks(context, fit, scheme.lines, colors, scale);
  }

  function poseOf(fit) {
    const looking = model.get("looking"), spin = orbit(...turned), front = {
      shift: mesh.translation.map((value, k) => value + mesh.pivot[k]), pivot: mesh.pivot,
      camera: [mesh.focal * 1000, mesh.focal * 1000, 499.5, 499.5], size: [1000, 1000],
    };
    if (!fit || looking === "expression") return { ...front, turn: spin };
    if (looking === "head") return { ...front, turn: multiplied(spin, fit.turn) };
    const centre = [0, 1, 2].map((k) => fit.shift[k] + fit.turn.slice(3 * k, 3 * k + 3)
      .reduce((sum, value, j) => sum + value * mesh.pivot[j], 0));
    return { turn: multiplied(spin, fit.turn), shift: centre, pivot: mesh.pivot, camera: fit.camera, size: fit.size };
  }

  function paint(fit) {
    last = fit;
    root.classList.toggle("fw-mirror", model.get("mirror"));
    paintPicture(fit);
    if (fit?.found) posed = fit; // without a face the head stays as it was
    if (avatar && fitted(avatarCanvas)) avatar.draw(poseOf(posed));
  }

  function write(fit, log) {
    const now = performance.now(), running = model.get("running");
    const recent = log.filter((entry) => now - entry.drawn < WINDOW_MS);
    const said = model.get("message") || (isSlow() ? "The kernel is busy …" : "");
    lamp.hidden = !running || !recent.length;
    message.hidden = !said && !(running && recent.length && fit && !fit.found);
    const words = said || "no face";
    if (message.textContent !== words) message.textContent = words; // else the page is laid out at every frame
    message.classList.toggle("fw-alert", Boolean(said) && model.get("alert"));
    message.classList.toggle("fw-middle", !fit);
    if (now - written < 250 && running) return;
    written = now;
    const rate = recent.length / (WINDOW_MS / 1000);
    const delay = recent.length ? median(recent.map((entry) => entry.drawn - entry.grabbed)) : NaN;
    root.dataset.state = JSON.stringify({ rate, delay, running, found: Boolean(fit?.found), said, count: log.length });
    if (!running || !recent.length || !fit) return void (status.textContent = running ? "" : "stopped");
    const [yaw, pitch, roll] = fit.angles || [];
    const sign = (value) => (value < 0 ? "−" : "+") + Math.abs(value).toFixed(0) + "°";
    const parts = [`${rate.toFixed(0)} updates/s`];
    if (!fit.fromKernel) parts.push(`${delay.toFixed(0)} ms camera to screen`);
    parts.push(`landmarks + fit ${fit.ms.toFixed(0)} ms`);
    if (fit.found) parts.push(`error ${fit.error.toFixed(1)} px`, `yaw ${sign(yaw)} pitch ${sign(pitch)} roll ${sign(roll)}`);
    status.textContent = parts.join("  ·  ");
  }

  let dragged = null;
  const listeners = {
    pointerdown: (event) => { dragged = [event.clientX, event.clientY]; right.setPointerCapture(event.pointerId); },
    pointermove: (event) => {
      if (!dragged) return;
      const way = model.get("mirror") ? -1 : 1;
      turned = [turned[0] - (way * (event.clientX - dragged[0])) / 120,
        clamp(turned[1] + (event.clientY - dragged[1]) / 120, -1.4, 1.4)];
      dragged = [event.clientX, event.clientY];
      redraw();
    },
    pointerup: () => { dragged = null; },
    pointercancel: () => { dragged = null; },
    dblclick: () => { turned = [0, 0]; redraw(); },
  };
  for (const [name, callback] of Object.entries(listeners)) right.addEventListener(name, callback);

  function onSize() {
    row.style.height = `${model.get("height_px")}px`;
    redraw();
  }
  const onWords = () => ((written = 0), write(last, root.live?.log || []));
  const watched = [["change:height_px", onSize], ["change:mirror", redraw], ["change:looking", redraw],
    ["change:message", onWords], ["change:alert", onWords]];
  watched.forEach(([name, callback]) => model.on(name, callback));
  const sizes = new ResizeObserver((entries) => {
    entries.forEach((entry) => boxes.set(entry.target, entry.contentRect));
    redraw();
  });
  sizes.observe(left);
  sizes.observe(right);
  onSize();
  onWords();

  return {
    root, paint, write,
    close() {
      watched.forEach(([name, callback]) => model.off(name, callback));
      sizes.disconnect();
      avatar?.close();
      root.remove();
    },
  };
}
