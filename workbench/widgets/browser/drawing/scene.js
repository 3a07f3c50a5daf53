import { projectionOf, transposed } from "./geometry.js";
import { makeProgram } from "./program.js";
import { makeRods } from "./rods.js";
import { plainSurfaceShaders, rodShaders, surfaceShaders, wornShaders } from "./shaders.js";
import { loadTexture, makeSurface } from "./surface.js";
import { dot } from "./vectors.js";
import { makeWorn } from "./worn.js";

const RIM = 0.3; // the cosine to the line of sight up to which a surface belongs to the outline

// A head, a second translucent one, balls and rods in one WebGL context. `redraw` is called when the texture is loaded;
// `plain`: with cheaper light, for browsers that draw in software.
export function makeScene(gl, mesh, redraw, plain = false) {
  const surfaces = makeProgram(gl, surfaceShaders()), rods = makeProgram(gl, rodShaders());
  const skin = plain ? makeProgram(gl, plainSurfaceShaders()) : surfaces;
  const head = makeSurface(gl, skin, mesh), texture = loadTexture(gl, mesh.texture, redraw, plain);
  const marks = { points: makeRods(gl, rods), segments: makeRods(gl, rods) }, ghost = makeGhost(gl, surfaces, mesh);
  const cloth = mesh.worn.length ? makeProgram(gl, wornShaders()) : null;
  const worn = cloth && makeWorn(gl, cloth, mesh, redraw);
  let colored = false;
  head.setColors(mesh.colors);
  gl.enable(gl.DEPTH_TEST);
  gl.enable(gl.CULL_FACE);
  gl.depthFunc(gl.LEQUAL);
  gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);

  // `pose`: {turn (3 × 3, row by row), shift, pivot, camera, size}, see `projectionOf`; `ground`: RGBA, 0 to 1.
  function draw(pose, ground) {
    gl.viewport(0, 0, gl.canvas.width, gl.canvas.height);
    gl.clearColor(...ground);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    look(gl, rods, mesh, pose);
    marks.points.draw();
    marks.segments.draw();
    look(gl, skin, mesh, pose);
    const inside = seesInside(mesh.collar, pose);
    gl.uniform1i(skin.uniform("inside"), inside ? 1 : 0);
    gl.uniform1i(skin.uniform("textured"), texture.ready && !colored ? 1 : 0);
    gl.bindTexture(gl.TEXTURE_2D, texture.texture);
    if (inside) gl.disable(gl.CULL_FACE);
    head.draw(mesh.drawn.length / 3);
    if (worn) {
      gl.disable(gl.CULL_FACE); // cards have two sides
      look(gl, cloth, mesh, pose);
      worn.draw();
    }
    gl.enable(gl.CULL_FACE);
    ghost.draw(pose);
    // The device begins now, not when the page shows its next frame; without a fence it would wait for more to draw.
    gl.deleteSync(gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0));
    gl.flush();
  }

  function setHead(shape) {
    head.setShape(shape);
    worn?.follow(shape.vertices);
  }

  return {
    draw, setHead, setGhost: ghost.set, setPerson: (person) => worn?.setPerson(person),
    // RGB per vertex to replace the skin, or null.
    setColors(colors) {
      colored = Boolean(colors);
      head.setColors(colors ?? mesh.colors);
    },
    setMarks: (name, message) => marks[name].set(message),
  };
}

// The translucent head; its buffers are created when it is first used.
function makeGhost(gl, program, mesh) {
  let surface = null, opacity = 0, outlined = false;

  function set(shape, much, outline) {
    opacity = shape ? much : 0;
    outlined = Boolean(outline);
    if (!shape) return;
    surface ??= makeSurface(gl, program, mesh);
    const color = outlined ? mesh.outline : mesh.ghost;
    surface.setColors(Uint8Array.from({ length: mesh.colors.length }, (_, k) => color[k % 3]));
    surface.setShape(shape);
  }

  // Depth is drawn first, so that only the front surface is blended. An outline lies over the head.
  function draw(pose) {
    if (!opacity) return;
    look(gl, program, mesh, pose);
    if (outlined) gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.uniform1i(program.uniform("textured"), 0);
    gl.uniform1f(program.uniform("opacity"), opacity);
    gl.uniform1f(program.uniform("rim"), outlined ? RIM : 0);
    gl.colorMask(false, false, false, false);
    surface.draw(mesh.outer);
    gl.colorMask(true, true, true, true);
    gl.enable(gl.BLEND);
    surface.draw(mesh.outer);
    gl.disable(gl.BLEND);
    gl.uniform1f(program.uniform("rim"), 0);
  }
  return { set, draw };
}

// Shared uniforms of the programs for heads and rods, with the lights of the mesh.
function look(gl, program, mesh, pose) {
  const { width, height } = gl.canvas, [w, h] = pose.size, fit = Math.min(width / w, height / h);
  const stretch = [(fit * w) / width, (fit * h) / height];
  program.use();
  gl.uniformMatrix4fv(program.uniform("projection"), false, projectionOf(pose.camera, pose.size, stretch));
  gl.uniformMatrix3fv(program.uniform("turn"), false, new Float32Array(transposed(pose.turn)));
  gl.uniform3fv(program.uniform("shift"), pose.shift);
  gl.uniform3fv(program.uniform("pivot"), pose.pivot);
  gl.uniform3fv(program.uniform("from"), mesh.lights.from);
  gl.uniform3fv(program.uniform("strength"), mesh.lights.strength);
  gl.uniform1f(program.uniform("ambient"), mesh.lights.ambient);
  gl.uniform2fv(program.uniform("shine"), mesh.shine);
  gl.uniform1f(program.uniform("opacity"), 1);
}

// The inside of the head is visible only through the cut neck, from beyond the cutting plane (null: no cut).
export function seesInside(collar, { turn, shift, pivot }) {
  if (!collar) return false;
  const eye = [0, 1, 2].map((k) => pivot[k] - dot([turn[k], turn[3 + k], turn[6 + k]], shift));
  return dot(eye, collar) > collar[3];
}
