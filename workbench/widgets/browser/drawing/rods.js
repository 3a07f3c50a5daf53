import { bytesOf } from "../shared/bytes.js";
import { floatsOf } from "./mesh.js";

const SIDES = 12, RINGS = 4; // of a half ball

// A ball around z, cut at its equator: corners (x, y, z, end of the rod) and triangles.
export function roundEnds() {
  const corners = [], triangles = [];
  for (const end of [0, 1]) {
    for (let ring = 0; ring <= RINGS; ring++) {
      const tilt = (Math.PI / 2) * (end ? ring / RINGS : ring / RINGS - 1);
      for (let side = 0; side < SIDES; side++) {
        const turn = (2 * Math.PI * side) / SIDES, radius = Math.cos(tilt);
        corners.push(radius * Math.cos(turn), radius * Math.sin(turn), Math.sin(tilt), end);
      }
    }
  }
  for (let ring = 0; ring <= 2 * RINGS; ring++) {
    for (let side = 0; side < SIDES; side++) {
      const a = ring * SIDES + side, b = ring * SIDES + ((side + 1) % SIDES);
      triangles.push(a, b, b + SIDES, a, b + SIDES, a + SIDES);
    }
  }
  return { corners: new Float32Array(corners), triangles: new Uint16Array(triangles) };
}

// Balls and rods as sent by Python (`rods_message`); an empty message shows none.
export function makeRods(gl, program) {
  const { corners, triangles } = roundEnds();
  const index = gl.createBuffer();
  let vertexArray = null, count = 0, radius = 0, buffers = [];

  function set(message) {
    buffers.forEach((buffer) => gl.deleteBuffer(buffer));
    gl.deleteVertexArray(vertexArray);
    [vertexArray, count, buffers] = [null, 0, []];
    if (!message.ends) return;
    const ends = floatsOf(message.ends);
    const half = (end) => ends.filter((_, k) => Math.floor(k / 3) % 2 === end);
    count = ends.length / 6;
    radius = message.mm / 2;
    vertexArray = gl.createVertexArray();
    gl.bindVertexArray(vertexArray);
    buffers = [
      program.attribute("corner", 4, corners), program.attribute("start", 3, half(0), gl.STATIC_DRAW, true),
      program.attribute("end", 3, half(1), gl.STATIC_DRAW, true),
      program.attribute("color", 3, new Uint8Array(bytesOf(message.colors)), gl.STATIC_DRAW, true),
    ];
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, index);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
  }

  function draw() {
    if (!count) return;
    gl.uniform1f(program.uniform("radius"), radius);
    gl.bindVertexArray(vertexArray);
    gl.drawElementsInstanced(gl.TRIANGLES, triangles.length, gl.UNSIGNED_SHORT, 0, count);
    gl.bindVertexArray(null);
  }
  return { set, draw };
}
