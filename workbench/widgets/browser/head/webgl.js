// The head drawn in the browser: the widget brings all its data, and the kernel is told only the viewpoint.
import { floatsOf, makeShape, readMesh } from "../drawing/mesh.js";
import { makeScene } from "../drawing/scene.js";
import { makeStage } from "../drawing/stage.js";
import { bytesOf } from "../shared/bytes.js";
import { roomOf } from "../shared/canvas.js";
import { follow, followSize, listen } from "../shared/following.js";
import { keepHearing } from "../shared/hearing.js";
import { onDemand } from "../shared/painting.js";
import { drawsInSoftware } from "../shared/webgl.js";
import { cropOf, throughCrop } from "./crop.js";
import { listenTo } from "./mouse.js";
import { fillPlace, makePage } from "./page.js";
import { moved, numbersOf, poseOf, stretchOf, stretched, viewpointOf } from "./viewpoint.js";

const SHARPEST = 2; // drawn pixels per CSS pixel along an axis

// Applies changes of the model to a scene.
function makeFeeding(model, mesh) {
  const head = makeShape(mesh), ghost = makeShape(mesh);
  const feeds = {
    _person(scene) {
      const person = model.get("_person");
      if (!person.rest) return;
      scene.setPerson(person);
      if (head.vertices) scene.setHead(head);
    },
    _vertices: (scene) => scene.setHead(head.take(floatsOf(model.get("_vertices")))),
    _colors(scene) {
      const colors = model.get("_colors");
      scene.setColors(colors.byteLength ? new Uint8Array(bytesOf(colors)) : null);
    },
    _ghost(scene) {
      const { vertices, opacity, outline } = model.get("_ghost");
      scene.setGhost(vertices ? ghost.take(floatsOf(vertices)) : null, opacity, outline);
    },
    _points: (scene) => scene.setMarks("points", model.get("_points")),
    _segments: (scene) => scene.setMarks("segments", model.get("_segments")),
  };
  const names = Object.keys(feeds), stale = new Set();
  return {
    names, spoil: (name) => stale.add(name),
    feed(scene, fresh) {
      for (const name of fresh ? names : stale) feeds[name](scene);
      stale.clear();
    },
  };
}

// The resolution of the screen, which may change when the window moves.
function sharpen(canvas, [width, height]) {
  const ratio = Math.min(window.devicePixelRatio || 1, SHARPEST);
  const [wide, high] = [Math.round(ratio * width), Math.round(ratio * height)];
  if (canvas.width !== wide || canvas.height !== high) Object.assign(canvas, { width: wide, height: high });
}

function render({ model, el }) {
  const size = model.get("_size"), [width, height] = size, fills = model.get("_fills");
  const mesh = readMesh(model.get("_mesh"));
  const ground = [...mesh.ground.map((value) => value / 255), 1];
  const { canvas, message } = makePage(el, "fw-webgl", width, height), feeding = makeFeeding(model, mesh);
  // Without a graphics card, antialiasing costs as much as everything else.
  const plain = drawsInSoftware(), options = { alpha: false, antialias: !plain };
  const stage = makeStage(canvas, options, (gl) => makeScene(gl, mesh, ask, plain), ask);
  if (!stage) message.textContent = model.get("_note");
  if (fills) fillPlace(el, canvas);
  let room = [0, 0];
  const place = () => (fills ? room.map((length) => Math.max(length, 1)) : size);
  const painting = onDemand(() => {
    if (fills && !room[0]) return false; // in a hidden tab, and for a moment while the theme changes
    const now = place(), lens = model.get("_lens"), crop = lens.length ? cropOf(canvas) : null;
    sharpen(canvas, now);
    stage?.draw((scene, fresh) => {
      feeding.feed(scene, fresh);
      const pose = stretched(poseOf(viewpointOf(model.get("_viewpoint")), size), now);
      scene.draw(crop ? { ...pose, camera: throughCrop(lens, crop, now) } : pose, ground);
    });
    return true;
  }, true);
  function ask() {
    painting.ask();
  }
  function fill() {
    room = roomOf(canvas);
    ask();
  }
  function move(change) {
    const [now, front] = [model.get("_viewpoint"), model.get("_front")].map(viewpointOf);
    model.set("_viewpoint", numbersOf(moved(now, change, front, height)));
    model.save_changes();
  }
  const onChange = (name) => [`change:${name}`, () => { feeding.spoil(name); ask(); }];
  const stops = [
    listenTo(canvas, () => (fills ? 1 / stretchOf(size, place()) : width / canvas.clientWidth), move),
    painting.stop, () => stage?.close(), fills ? followSize(canvas, fill) : () => {},
    follow(model, [...feeding.names.map(onChange), ["change:_viewpoint", ask], ["change:_lens", ask]]),
    listen(document, { "fw-crop": () => model.get("_lens").length && ask() }),
  ];
  model.set("_missing", !stage);
  model.save_changes();
  ask();
  return () => stops.forEach((stop) => stop());
}

export default { initialize: keepHearing, render };
