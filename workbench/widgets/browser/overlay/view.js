// The frame with its landmarks: two stacked canvases, the picture below and the marks above it.
import { bytesOf } from "../shared/bytes.js";
import { cleared, roomOf } from "../shared/canvas.js";
import { handOn } from "../shared/carrying.js";
import { cssColors } from "../shared/colors.js";
import { follow, followSize } from "../shared/following.js";
import { keepHearing } from "../shared/hearing.js";
import { dragLimit } from "../shared/limit.js";
import { onDemand } from "../shared/painting.js";
import { hasWebGL } from "../shared/webgl.js";
import { listenToKeys } from "./keys.js";
import { indices, makeLandmarks } from "./landmarks.js";
import { paintLandmarks, paintLasso, paintWire } from "./marks.js";
import { brightened, makePicture, paintPictures } from "./pictures.js";
import { faceBox, fitted, makeView, wholeBox, zoomedAt } from "./places.js";
import { listenToRest } from "./rest.js";
import { listenToPointer } from "./tools.js";
import { factsOf, hide, makePage, paintHover, paintWords } from "./words.js";

const REDRAWN = ["layers", "layer_opacity", "unit", "selection", "subset", "tool", "message", "_scale"];

// The drawn state: size of the stage, position of the picture, landmarks, pictures, and the current pointer action.
function makeOverlay(model, el) {
  const scheme = model.get("_scheme"), colors = cssColors(new Uint8Array(bytesOf(scheme.colors)));
  const overlay = {
    scheme, colors, page: makePage(el, colors), view: makeView(model.get("at_face") ? "face" : "whole"),
    room: [0, 0], size: [0, 0], wire: [], ellipses: [], hovered: -1, pointer: null, gesture: null, bare: false,
    layer: (name) => Boolean(model.get("layers")[name]),
    draw: () => {},
  };
  const redraw = () => overlay.draw(true), { view } = overlay;
  overlay.landmarks = makeLandmarks(() => overlay.draw());
  overlay.pictures = { picture: makePicture(redraw), layer: makePicture(redraw), heat: makePicture(redraw) };

  // Returns whether that moves the picture.
  overlay.place = () => {
    const { landmarks, size } = overlay, face = view.mode === "face" && landmarks.found();
    if (!size[0] || (view.mode === "free" && !face)) return false;
    // Uses the kernel's positions, so that dragging a landmark does not move the view.
    const box = face ? faceBox(indices(landmarks).map(landmarks.detected)) : wholeBox(size);
    const placed = fitted(box, overlay.room), moved = Object.keys(placed).some((key) => placed[key] !== view[key]);
    Object.assign(view, placed);
    return moved;
  };

  overlay.zoom = (event, place) => {
    event.preventDefault();
    if (!overlay.size[0]) return;
    const lines = event.deltaMode === 1 ? 16 : 1, factor = Math.exp(-0.0015 * lines * event.deltaY);
    Object.assign(view, zoomedAt(view, place, factor, overlay.size, overlay.room), { mode: "free" });
    redraw();
  };
  return overlay;
}

function makePainting(model, overlay) {
  const { page, view, landmarks, pictures, scheme, layer } = overlay, { root, stage } = page;
  let draws = 0, told = "";

  function paintMarks() {
    const context = cleared(page.marks, overlay.room), { wire, gesture } = overlay;
    context.lineCap = context.lineJoin = "round";
    if (overlay.bare) return;
    if (layer("wire")) paintWire(context, wire, view.toScreen);
    if (landmarks.found()) {
      paintLandmarks(context, landmarks, view, {
        layer, colors: overlay.colors, limit: model.get("_scale"), lines: scheme.lines, hovered: overlay.hovered,
        chosen: new Set(model.get("selection")), subset: model.get("subset"), ellipses: overlay.ellipses,
      });
    }
    if (gesture?.kind === "lasso") paintLasso(context, gesture.path);
  }

  function paintTexts() {
    const { hovered, gesture } = overlay, tool = model.get("tool"), unit = model.get("unit");
    paintWords(page, {
      tool, unit, limit: model.get("_scale"), legend: landmarks.found() && !overlay.bare && ["model", "residuals", "arrows"].some(layer),
      message: model.get("message") || (model.get("_no_face") ? "no face in this frame" : ""),
    }, overlay.room[0]);
    const idle = tool === "lasso" ? "crosshair" : hovered < 0 ? "grab" : "pointer";
    stage.style.cursor = gesture?.kind === "pan" ? "grabbing" : idle;
    hide(page.hoverBox, hovered < 0 || hovered >= landmarks.count() || gesture !== null);
    if (page.hoverBox.hidden) return;
    const facts = factsOf(landmarks, hovered, scheme.groups[hovered], unit);
    paintHover(page, `${hovered} · ${scheme.names[hovered]}`, facts, overlay.pointer);
  }

  function tellState(asked) {
    root.dataset.draws = String(++draws);
    root.classList.toggle("fw-decoded", Boolean(pictures.picture.image()));
    root.dataset.state = JSON.stringify({
      scale: view.scale, x: view.x, y: view.y, mode: view.mode, room: overlay.room, size: overlay.size,
      found: landmarks.found(),
      hovered: overlay.hovered, scaleMax: model.get("_scale"), decoded: Boolean(pictures.picture.image()),
      ms: performance.now() - asked,
    });
    tellCrop();
  }

  // A head that is seen by the same camera shows the same part of the picture.
  function tellCrop() {
    const crop = [view.scale, view.x, view.y, ...overlay.room].join();
    if (crop === told) return;
    told = crop;
    root.dispatchEvent(new CustomEvent("fw-crop", { bubbles: true }));
  }

  return onDemand((all, asked) => {
    if (!overlay.room[0]) return false; // in a hidden tab
    // Landmarks are drawn together with their picture.
    if (pictures.picture.busy() && pictures.picture.image()) return false;
    if (all) {
      const overlaid = [layer("layer") ? pictures.layer.image() : null, model.get("layer_opacity")];
      const heat = [layer("heat") ? pictures.heat.image() : null, 1];
      page.picture.style.filter = layer("bright") ? brightened(pictures.picture.image()) : "";
      paintPictures(page.picture, overlay.room, view, overlay.size, [[pictures.picture.image(), 1], overlaid, heat]);
    }
    paintMarks();
    paintTexts();
    tellState(asked);
    return true;
  }, true);
}

// Messages to Python.
function makeSending(model, draw) {
  const event = (kind, points, x = null, y = null) => model.send({ kind, points, x, y });
  function selection(points, kind = "select") {
    model.set("selection", points);
    model.save_changes();
    event(kind, points);
    draw();
  }
  return { event, selection };
}

// Messages from Python.
function followModel(model, overlay, draw) {
  const { view, landmarks, pictures, page } = overlay, redraw = () => draw(true);
  let placedFor = "";

  function onFit() {
    landmarks.read(bytesOf(model.get("_fit")));
    draw(view.mode === "face" && !overlay.gesture && overlay.place());
  }

  function onPicture() {
    overlay.size = model.get("_size");
    pictures.picture.push(model.get("_picture"));
    landmarks.releaseAll(); // another frame
    if (placedFor !== overlay.size.join()) {
      placedFor = overlay.size.join();
      view.mode = model.get("at_face") ? "face" : "whole";
      overlay.place();
    }
    redraw();
  }

  function onShapes() {
    for (const name of ["wire", "ellipses"]) overlay[name] = new Float32Array(bytesOf(model.get("_" + name)));
    draw();
  }

  function onSize() {
    const height = model.get("height_px");
    page.root.classList.toggle("fw-fill", !height);
    page.stage.style.height = height ? `${height}px` : "";
    overlay.room = roomOf(page.stage);
    overlay.place();
    redraw();
  }

  const onLayer = () => pictures.layer.push(model.get("_layer")), onHeat = () => pictures.heat.push(model.get("_heat"));
  const unfollow = follow(model, [
    ["change:_picture", onPicture], ["change:_fits", onFit], ["change:_wire", onShapes], ["change:_ellipses", onShapes],
    ["change:_layer", onLayer], ["change:_heat", onHeat], ["change:height_px", onSize],
    ...REDRAWN.map((name) => ["change:" + name, redraw]),
  ]);
  const unfollowSize = followSize(page.stage, onSize);
  for (const begin of [onSize, onPicture, onLayer, onHeat, onShapes, onFit]) begin();
  return [unfollow, unfollowSize];
}

function render({ model, el }) {
  const overlay = makeOverlay(model, el), painting = makePainting(model, overlay);
  const draw = (overlay.draw = painting.ask), send = makeSending(model, draw);
  listenToPointer(overlay, model, send);
  listenToKeys(overlay, model, send);
  if (model.get("webgl") === null) {
    model.set("webgl", hasWebGL());
    model.save_changes();
  }
  const stops = [
    ...followModel(model, overlay, draw), painting.stop, listenToRest(overlay, model),
    dragLimit(overlay.page.limit, model, draw),
    ...Object.values(overlay.pictures).map((picture) => picture.close), () => overlay.page.root.remove(),
  ];
  return () => stops.forEach((stop) => stop());
}

export default { initialize: ({ model }) => { keepHearing({ model }); handOn(model); }, render };
