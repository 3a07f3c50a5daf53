import { makeScene } from "../drawing/scene.js";
import { makeStage } from "../drawing/stage.js";
import { drawsInSoftware } from "../shared/webgl.js";

const GROUND = [0, 0, 0, 0]; // the page's background shows through

// The head in WebGL; null without WebGL.
export function makeAvatar(canvas, mesh, head, redraw) {
  // Without a graphics card, antialiasing costs as much as everything else.
  const plain = drawsInSoftware(), options = { antialias: !plain };
  const stage = makeStage(canvas, options, (gl) => makeScene(gl, mesh, redraw, plain), redraw);
  if (!stage) return null;
  let stamp = -1, person = null;

  function draw(pose) {
    stage.draw((scene, fresh) => {
      if (fresh || person !== head.person()) scene.setPerson(person = head.person());
      if (fresh || stamp !== head.shape.stamp) scene.setHead(head.shape);
      stamp = head.shape.stamp;
      scene.draw(pose, GROUND);
    });
  }
  return { draw, close: stage.close };
}
