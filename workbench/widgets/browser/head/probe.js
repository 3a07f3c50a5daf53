// Nothing to see, unless the browser lacks WebGL.
import { hasWebGL } from "../shared/webgl.js";

function render({ model, el }) {
  const missing = !hasWebGL();
  if (missing) {
    el.textContent = model.get("_note");
    el.style.cssText = "font-size:12px; color:var(--jp-error-color1, #b3261e)";
  }
  model.set("_missing", missing);
  model.save_changes();
}

export default { render };
