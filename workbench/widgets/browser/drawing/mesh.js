import { bytesOf } from "../shared/bytes.js";

const indicesOf = (view) => new Uint32Array(bytesOf(view));

export const floatsOf = (view) => new Float32Array(bytesOf(view));

// A mesh as sent by Python (`surface_message`). Vertices on a texture seam become several points.
export function readMesh(message) {
  const { triangles, drawn, order, uv, shown, wet, colors } = message;
  return {
    ...message, triangles: indicesOf(triangles), drawn: indicesOf(drawn), order: indicesOf(order),
    uv: floatsOf(uv), shown: floatsOf(shown), wet: new Uint8Array(bytesOf(wet)), colors: new Uint8Array(bytesOf(colors)),
  };
}

// A part that a character wears, as sent by Python (`worn_message`).
export function readPart(message) {
  const { anchors, weights, offsets, triangles, drawn, order, uv, shade } = message;
  return {
    ...message, anchors: indicesOf(anchors), weights: floatsOf(weights), offsets: floatsOf(offsets),
    triangles: indicesOf(triangles), drawn: indicesOf(drawn), order: indicesOf(order), uv: floatsOf(uv),
    shade: new Uint8Array(bytesOf(shade)),
  };
}

// Copies three numbers per vertex to three numbers per point.
export function spread(order, values, points) {
  for (let i = 0; i < order.length; i++) {
    for (let j = 0; j < 3; j++) points[3 * i + j] = values[3 * order[i] + j];
  }
  return points;
}

// Positions and normals of a mesh's points, from the positions of its vertices; `stamp` counts the changes.
export function makeShape(mesh) {
  const normals = new Float32Array(3 * mesh.vertices), count = 3 * mesh.order.length;
  const shape = { places: new Float32Array(count), normals: new Float32Array(count), vertices: null, stamp: 0 };
  shape.take = (places) => {
    shape.vertices = places;
    sumNormals(places, mesh.triangles, normals);
    spread(mesh.order, places, shape.places);
    spread(mesh.order, normals, shape.normals);
    shape.stamp++;
    return shape;
  };
  return shape;
}

// Vertex normals, not of unit length: the sum over adjacent triangles, weighted by area.
export function sumNormals(places, triangles, normals) {
  normals.fill(0);
  for (let t = 0; t < triangles.length; t += 3) {
    const a = 3 * triangles[t], b = 3 * triangles[t + 1], c = 3 * triangles[t + 2];
    const ux = places[b] - places[a], uy = places[b + 1] - places[a + 1], uz = places[b + 2] - places[a + 2];
    const vx = places[c] - places[a], vy = places[c + 1] - places[a + 1], vz = places[c + 2] - places[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    for (const corner of [a, b, c]) {
      normals[corner] += x;
      normals[corner + 1] += y;
      normals[corner + 2] += z;
    }
  }
}
