const VERTEX = `#version 300 es
in vec3 place; in vec3 normal; in vec2 uv; in vec3 color; in float shown;
uniform mat4 projection; uniform mat3 turn; uniform vec3 shift, pivot;
out vec3 n, p; out vec2 at; out vec3 tint; out float keep;
void main() {
  p = turn * (place - pivot) + shift;
  n = turn * normal;
  at = uv; tint = color; keep = shown;
  gl_Position = projection * vec4(p, 1.0);
}`;
// A warm light from the upper left, a cool one from the right, and a rim from behind, in the camera's frame.
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 n, p; in vec2 at; in vec3 tint; in float keep;
uniform sampler2D skin; uniform bool textured;
out vec4 result;
float lit(vec3 m, vec3 from) { return max(dot(m, normalize(from)), 0.0); }
void main() {
  if (keep < 0.5) discard;
  vec3 m = normalize(n), sight = normalize(-p);
  vec3 albedo = textured ? texture(skin, at).rgb : tint;
  vec3 light = vec3(0.30) + 0.62 * lit(m, vec3(-0.55, -0.65, -1.0)) * vec3(1.0, 0.97, 0.92)
    + 0.28 * lit(m, vec3(0.9, -0.1, -0.8)) * vec3(0.86, 0.92, 1.0)
    + 0.22 * lit(m, vec3(0.5, -0.7, 0.9));
  float gloss = pow(lit(m, normalize(vec3(-0.55, -0.65, -1.0)) + sight), 24.0);
  result = vec4(albedo * light + 0.05 * gloss, 1.0);
}`;

function compiled(gl, kind, source) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  return shader;
}

export function linked(gl) {
  const program = gl.createProgram();
  gl.attachShader(program, compiled(gl, gl.VERTEX_SHADER, VERTEX));
  gl.attachShader(program, compiled(gl, gl.FRAGMENT_SHADER, FRAGMENT));
  gl.linkProgram(program);
  gl.useProgram(program);
  return program;
}
