import { listen } from "../shared/following.js";

// A canvas with a scene that `build(gl)` makes, anew when the browser has taken its WebGL context and gives it back;
// null without WebGL2. Each scene is drawn by `paint(scene, fresh)`: whether it is a new one, with nothing set yet.
export function makeStage(canvas, options, build, redraw) {
  const gl = canvas.getContext("webgl2", options);
  if (!gl) return null;
  let scene = gl.isContextLost() ? null : build(gl), fresh = true;
  const unlisten = listen(canvas, {
    webglcontextlost: (event) => { event.preventDefault(); scene = null; }, // else it never comes back
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
