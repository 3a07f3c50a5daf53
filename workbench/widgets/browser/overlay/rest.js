import { follow, listen } from "../shared/following.js";

const REST_MS = 2500;

// The class fw-rest while nobody points at the picture and nothing changes: the marks fade, so that the face is seen.
export function listenToRest(overlay, model) {
  const { root, stage } = overlay.page;
  let timer = 0, inside = false;

  function wake() {
    root.classList.remove("fw-rest");
    clearTimeout(timer);
    if (!inside) timer = setTimeout(() => root.classList.toggle("fw-rest", !model.get("selection").length), REST_MS);
  }
  const stops = [
    listen(stage, { pointerenter: () => { inside = true; wake(); }, pointerleave: () => { inside = false; wake(); } }),
    follow(model, ["_fits", "selection", "layers", "_scale"].map((name) => [`change:${name}`, wake])),
    () => clearTimeout(timer),
  ];
  wake();
  return () => stops.forEach((stop) => stop());
}
