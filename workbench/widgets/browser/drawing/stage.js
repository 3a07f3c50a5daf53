import { listen } from "../shared/following.js";

// A canvas with a scene made by `build(gl)`, and made again when the browser restores a lost WebGL context; null
// without WebGL2. A scene is drawn by `paint(scene, fresh)`; `fresh`: it is new and nothing has been set yet.
export function makeStage(canvas, options, build, redraw) {
  const gl = canvas.getContext("webgl2", options);
  if (!gl) return null;
  let scene = gl.isContextLost() ? null : build(gl), fresh = true;
  const unlisten = listen(canvas, {
    webglcontextlost: (event) => { event.preventDefault(); scene = null; }, // otherwise it is never restored
    webglcontextrestored: () => { [scene, fresh] = [build(gl), true]; redraw(); },
  });
  return {
    draw(paint) {
      if (!scene) return;
      paint(scene, fresh);
      fresh = false;
    },
    close() {
      unlisten();
      gl.getExtension("WEBGL_lose_context")?.loseContext();
    },
  };
}
