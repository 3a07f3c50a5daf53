function compiled(gl, kind, source) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
    throw new Error(gl.getShaderInfoLog(shader));
  }
  return shader;
}

// A WebGL program with the locations of its uniforms and attributes.
export function makeProgram(gl, [vertex, fragment]) {
  const program = gl.createProgram(), places = {};
  gl.attachShader(program, compiled(gl, gl.VERTEX_SHADER, vertex));
  gl.attachShader(program, compiled(gl, gl.FRAGMENT_SHADER, fragment));
  gl.linkProgram(program);
  return {
    use: () => gl.useProgram(program),
    uniform: (name) => (places[name] ??= gl.getUniformLocation(program, name)),
    // The buffer of an attribute, filled with `data`; byte 255 means 1. `each`: one value per rod.
    attribute(name, size, data, usage = gl.STATIC_DRAW, each = false) {
      const buffer = gl.createBuffer(), index = gl.getAttribLocation(program, name);
      const kind = data instanceof Uint8Array ? gl.UNSIGNED_BYTE : gl.FLOAT;
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, usage);
      if (index >= 0) {
        gl.enableVertexAttribArray(index);
        gl.vertexAttribPointer(index, size, kind, kind !== gl.FLOAT, 0, 0);
        gl.vertexAttribDivisor(index, each ? 1 : 0);
      }
      return buffer;
    },
  };
}

export function refill(gl, buffer, data, usage = gl.DYNAMIC_DRAW) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, data, usage);
}
