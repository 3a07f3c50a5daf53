import { floatsOf, makeShape, readPart } from "./mesh.js";
import { refill } from "./program.js";
import { loadPicture } from "./surface.js";

// Alpha from and up to which a pass draws; whether it blends, and whether what is behind it stays hidden.
const SOLID = { from: 0, below: 2, blends: false }, CUT = { from: 0.5, below: 2, blends: false };
const PASSES = {
  opaque: [SOLID], mask: [CUT], blend: [{ from: 0.004, below: 2, blends: true }],
  glint: [{ from: 0, below: 2, blends: true }], mixed: [CUT, { from: 0.02, below: 0.5, blends: true }],
};

// What a character wears, in one WebGL context; it follows the head's vertices and the person at rest.
export function makeWorn(gl, program, mesh, redraw) {
  const parts = mesh.worn.map((message) => makePart(gl, program, readPart(message), redraw));
  const passes = parts.flatMap((part) => PASSES[part.way].map((pass) => ({ part, pass })));
  // What is blended comes last, from the inside out as it is sent.
  passes.sort((a, b) => a.pass.blends - b.pass.blends);
  let person = null;

  function follow(head) {
    if (!person) return;
    const scale = distance(head, mesh.width) / distance(person.rest, mesh.width);
    for (const part of parts) part.follow(head, person, scale);
  }

  function draw() {
    for (const { part, pass } of passes) {
      if (!part.picture.ready) continue;
      gl.uniform1f(program.uniform("from_alpha"), pass.from);
      gl.uniform1f(program.uniform("below_alpha"), pass.below);
      gl.uniform1i(program.uniform("blends"), pass.blends ? 1 : 0);
      if (pass.blends) gl.enable(gl.BLEND);
      gl.depthMask(!pass.blends);
      part.draw();
      gl.depthMask(true);
      gl.disable(gl.BLEND);
    }
  }
  return {
    follow, draw,
    setPerson: ({ rest, growth }) => { person = { rest: floatsOf(rest), growth }; },
  };
}

function makePart(gl, program, part, redraw) {
  const points = part.order.length, vertexArray = gl.createVertexArray(), shape = makeShape(part);
  const places = new Float32Array(3 * part.vertices);
  gl.bindVertexArray(vertexArray);
  const place = program.attribute("place", 3, new Float32Array(3 * points), gl.DYNAMIC_DRAW);
  const normal = program.attribute("normal", 3, new Float32Array(3 * points), gl.DYNAMIC_DRAW);
  program.attribute("shade", 1, Uint8Array.from(part.order, (vertex) => part.shade[vertex]));
  program.attribute("uv", 2, part.uv);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, part.drawn, gl.STATIC_DRAW);
  gl.bindVertexArray(null);
  const picture = loadPicture(gl, part.picture, "image/webp", redraw);
  return {
    way: part.way, picture,
    follow(head, { rest, growth }, scale) {
      tied(part, part.still ? rest : head, part.still ? scale : 1, growth.map((size) => scale * size), places);
      shape.take(places);
      if (part.roundness) roundOff(shape, middleOf(head), part.roundness);
      refill(gl, place, shape.places);
      refill(gl, normal, shape.normals);
    },
    draw() {
      gl.bindTexture(gl.TEXTURE_2D, picture.texture);
      gl.uniform2fv(program.uniform("gloss"), part.shine);
      gl.uniform1i(program.uniform("glint"), part.way === "glint" ? 1 : 0);
      gl.bindVertexArray(vertexArray);
      gl.drawElements(gl.TRIANGLES, part.drawn.length, gl.UNSIGNED_INT, 0);
      gl.bindVertexArray(null);
    },
  };
}

// Vertices of a part: weighted vertices of the head, times `scale`, and the part's own offsets times `growth`.
export function tied({ anchors, weights, offsets }, head, scale, growth, places) {
  const count = places.length / 3, each = anchors.length / count;
  for (let i = 0; i < count; i++) {
    for (let axis = 0; axis < 3; axis++) {
      let sum = 0;
      for (let k = i * each; k < (i + 1) * each; k++) sum += weights[k] * head[3 * anchors[k] + axis];
      places[3 * i + axis] = scale * sum + growth[axis] * offsets[3 * i + axis];
    }
  }
  return places;
}

// Turns normals towards the direction from `middle`: cards of hair are lit as the ball that they cover.
function roundOff({ places, normals }, middle, share) {
  for (let i = 0; i < places.length; i += 3) {
    const out = [0, 1, 2].map((axis) => places[i + axis] - middle[axis]);
    const own = [normals[i], normals[i + 1], normals[i + 2]], length = Math.hypot(...own) || 1;
    const away = Math.hypot(...out) || 1, facing = out.reduce((sum, x, axis) => sum + x * own[axis], 0) < 0 ? -1 : 1;
    for (let axis = 0; axis < 3; axis++) {
      normals[i + axis] = (share * out[axis]) / away + ((1 - share) * facing * own[axis]) / length;
    }
  }
}

function middleOf(places) {
  const sum = [0, 0, 0], count = places.length / 3;
  for (let i = 0; i < places.length; i++) sum[i % 3] += places[i] / count;
  return sum;
}

function distance(places, [a, b]) {
  return Math.hypot(...[0, 1, 2].map((axis) => places[3 * a + axis] - places[3 * b + axis]));
}
