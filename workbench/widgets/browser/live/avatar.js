import { bytesOf } from "../shared/bytes.js";
import { drawsInSoftware } from "../shared/webgl.js";
import { projectionOf, transposed } from "./geometry.js";
import { linked } from "./shaders.js";

// The head in WebGL; null without it.
export function makeAvatar(canvas, mesh, head) {
  // Without a graphics card smooth edges cost as much as all the rest.
  const gl = canvas.getContext("webgl2", { antialias: !drawsInSoftware() });
  if (!gl) return null;
  const program = linked(gl), buffers = loadedBuffers(gl, program, mesh), texture = loadedTexture(gl, mesh.texture);
  const place = (name) => gl.getUniformLocation(program, name), count = mesh.drawn.byteLength / 4;
  gl.enable(gl.DEPTH_TEST);
  gl.enable(gl.CULL_FACE);
  let stamp = -1;

  function update() {
    for (const [name, data] of [["place", head.out.places], ["normal", head.out.normals]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
      gl.bufferSubData(gl.ARRAY_BUFFER, 0, data);
    }
    stamp = head.out.stamp;
  }

  // `pose`: {turn (3 × 3, row by row), shift, pivot, camera, size}.
  function draw(pose) {
    if (stamp !== head.out.stamp) update();
    const [width, height] = [canvas.width, canvas.height], [w, h] = pose.size;
    const fit = Math.min(width / w, height / h), stretch = [(fit * w) / width, (fit * h) / height];
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(place("projection"), false, projectionOf(pose.camera, pose.size, stretch));
    gl.uniformMatrix3fv(place("turn"), false, new Float32Array(transposed(pose.turn)));
    gl.uniform3fv(place("shift"), pose.shift);
    gl.uniform3fv(place("pivot"), pose.pivot);
    gl.uniform1i(place("textured"), texture.ready ? 1 : 0);
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
  }
  return { draw, close: () => gl.getExtension("WEBGL_lose_context")?.loseContext() };
}

// What is known of every point, in buffers of the program; places and normals are empty until the first fit.
function loadedBuffers(gl, program, mesh) {
  const points = mesh.order.byteLength / 4, buffers = {};
  function attribute(name, size, data, kind = gl.FLOAT, usage = gl.STATIC_DRAW) {
    buffers[name] = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
    gl.bufferData(gl.ARRAY_BUFFER, data, usage);
    const index = gl.getAttribLocation(program, name);
    if (index < 0) return;
    gl.enableVertexAttribArray(index);
    gl.vertexAttribPointer(index, size, kind, kind !== gl.FLOAT, 0, 0);
  }
  attribute("place", 3, new Float32Array(3 * points), gl.FLOAT, gl.DYNAMIC_DRAW);
  attribute("normal", 3, new Float32Array(3 * points), gl.FLOAT, gl.DYNAMIC_DRAW);
  attribute("color", 3, new Uint8Array(bytesOf(mesh.colors)), gl.UNSIGNED_BYTE);
  attribute("shown", 1, new Float32Array(bytesOf(mesh.shown)));
  attribute("uv", 2, mesh.texture.byteLength ? new Float32Array(bytesOf(mesh.uv)) : new Float32Array(2 * points));
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(bytesOf(mesh.drawn)), gl.STATIC_DRAW);
  return buffers;
}

// Says when the texture is there; a mesh without one stays as it is, in the colours of its points.
function loadedTexture(gl, picture) {
  const texture = { ready: false };
  if (picture.byteLength) {
    createImageBitmap(new Blob([bytesOf(picture)])).then((image) => {
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      image.close();
      texture.ready = true;
    });
  }
  return texture;
}
