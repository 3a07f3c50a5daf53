import { bytesOf } from "../shared/bytes.js";
import { spread } from "./mesh.js";
import { refill } from "./program.js";

// A mesh in a WebGL context; positions and normals are empty until they are set.
export function makeSurface(gl, program, mesh) {
  const points = mesh.order.length, vertexArray = gl.createVertexArray(), colors = new Uint8Array(3 * points);
  gl.bindVertexArray(vertexArray);
  const place = program.attribute("place", 3, new Float32Array(3 * points), gl.DYNAMIC_DRAW);
  const normal = program.attribute("normal", 3, new Float32Array(3 * points), gl.DYNAMIC_DRAW);
  const color = program.attribute("color", 3, colors, gl.DYNAMIC_DRAW);
  program.attribute("shown", 1, spreadOnes(mesh.order, mesh.shown, new Float32Array(points)));
  program.attribute("wet", 1, spreadOnes(mesh.order, mesh.wet, new Uint8Array(points)));
  program.attribute("uv", 2, mesh.uv.length ? mesh.uv : new Float32Array(2 * points));
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.drawn, gl.STATIC_DRAW);
  gl.bindVertexArray(null);
  return {
    setShape(shape) {
      refill(gl, place, shape.places);
      refill(gl, normal, shape.normals);
    },
    // RGB per vertex.
    setColors: (values) => refill(gl, color, spread(mesh.order, values, colors)),
    // The first `count` triangles.
    draw(count) {
      gl.bindVertexArray(vertexArray);
      gl.drawElements(gl.TRIANGLES, 3 * count, gl.UNSIGNED_INT, 0);
      gl.bindVertexArray(null);
    },
  };
}

function spreadOnes(order, values, points) {
  for (let i = 0; i < order.length; i++) points[i] = values[order[i]];
  return points;
}

// Loads the texture and then calls `loaded`; a mesh without a texture keeps the colours of its points. `plain`: each pixel
// is taken from one of its two sizes; without a graphics card, mixing both takes a sixth of the time of a head.
export function loadTexture(gl, picture, loaded, plain) {
  return loadPicture(gl, picture, "image/jpeg", loaded, plain ? gl.LINEAR_MIPMAP_NEAREST : gl.LINEAR_MIPMAP_LINEAR);
}

// Loads a picture (RGBA; what is transparent keeps its colour) and then calls `loaded`; `shrunk`: how it is made smaller.
export function loadPicture(gl, picture, type, loaded, shrunk = gl.LINEAR_MIPMAP_LINEAR) {
  const made = { ready: false, texture: null };
  if (!picture.byteLength) return made;
  createImageBitmap(new Blob([bytesOf(picture)], { type }), { premultiplyAlpha: "none" }).then((image) => {
    made.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, shrunk);
    gl.texParameterf(gl.TEXTURE_2D, gl.TEXTURE_MAX_LOD, 1); // at coarser levels, skin would show at the hair's seams
    image.close();
    made.ready = true;
    loaded();
  });
  return made;
}
