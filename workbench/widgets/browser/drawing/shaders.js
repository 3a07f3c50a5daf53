const HEADER = "#version 300 es\nprecision highp float;\n";
// From the head's frame to the camera's and to the screen.
const PLACING = `${HEADER}
uniform mat4 projection; uniform mat3 turn; uniform vec3 shift, pivot;
out vec3 n, p, tint;
void show(vec3 place, vec3 normal, vec3 color) {
  p = turn * (place - pivot) + shift;
  n = turn * normal;
  tint = color;
  gl_Position = projection * vec4(p, 1.0);
}`;
// Distant lights in the camera's frame, on a surface with the normal m; the first one also has gloss.
const LIGHTS = `
uniform vec3 from[3], strength[3]; uniform float ambient;
vec3 lightOn(vec3 m) {
  vec3 seen = max(vec3(dot(m, from[0]), dot(m, from[1]), dot(m, from[2])), 0.0);
  return ambient + seen.x * strength[0] + seen.y * strength[1] + seen.z * strength[2];
}
float sparkOn(vec3 m, float exponent) { return pow(max(dot(reflect(normalize(p), m), from[0]), 0.0), exponent); }`;
// Light at every pixel; gloss has a strength and an exponent.
const LIGHTING = `${HEADER}
in vec3 n, p, tint;
uniform float opacity;
out vec4 result;
float spark;
${LIGHTS}
void light(vec3 albedo, vec2 gloss) {
  vec3 m = normalize(gl_FrontFacing ? n : -n);
  spark = sparkOn(m, gloss.y);
  result = vec4(albedo * lightOn(m) + gloss.x * spark * strength[0], opacity);
}`;

// A surface coloured by its points or by a picture, cut off where its opacity is less than a half.
export function surfaceShaders() {
  return [`${PLACING}
in vec3 place, normal, color; in vec2 uv; in float shown, wet;
out vec2 at, kind;
void main() {
  at = uv;
  kind = vec2(shown, wet);
  show(place, normal, color);
}`, `${LIGHTING}
in vec2 at, kind;
uniform sampler2D skin; uniform bool textured; uniform vec2 shine[2]; uniform float rim;
void main() {
  vec3 albedo = textured ? texture(skin, at).rgb : tint;
  if (kind.x < 0.5) discard;
  light(albedo, mix(shine[0], shine[1], kind.y));
  // Of a head with a rim, only what turns away from the camera is seen, unlit.
  if (rim > 0.0) result = vec4(tint, opacity * (1.0 - smoothstep(0.5 * rim, rim, abs(dot(normalize(n), normalize(p))))));
}`];
}

// The same surface, opaque and without a rim, with light at its points: without a graphics card, light at every pixel
// takes a third of the time of a head, whose triangles are a few pixels large.
export function plainSurfaceShaders() {
  return [`${PLACING}
in vec3 place, normal, color; in vec2 uv; in float shown, wet;
uniform bool textured, inside; uniform vec2 shine[2];
out vec4 lit; out vec3 at; // light and gloss; the place in the texture, and whether it is shown
${LIGHTS}
void main() {
  at = vec3(uv, shown);
  show(place, normal, color);
  vec3 m = normalize(inside && dot(n, p) > 0.0 ? -n : n);
  vec2 gloss = mix(shine[0], shine[1], wet);
  lit = vec4(textured ? lightOn(m) : tint * lightOn(m), gloss.x * sparkOn(m, gloss.y));
}`, `${HEADER}
in vec4 lit; in vec3 at;
uniform sampler2D skin; uniform bool textured; uniform vec3 strength[3];
out vec4 result;
void main() {
  if (at.z < 0.5) discard;
  vec3 albedo = textured ? texture(skin, at.xy).rgb : vec3(1.0);
  result = vec4(albedo * lit.rgb + lit.a * strength[0], 1.0);
}`];
}

// A part that a character wears, drawn where its alpha is in the pass's range. A glint hides what lies below it.
export function wornShaders() {
  return [`${PLACING}
in vec3 place, normal; in vec2 uv; in float shade;
out vec2 at;
void main() {
  at = uv;
  show(place, normal, vec3(shade));
}`, `${LIGHTING}
in vec2 at;
uniform sampler2D skin; uniform vec2 gloss; uniform float from_alpha, below_alpha; uniform bool blends, glint;
void main() {
  vec4 color = texture(skin, at);
  if (color.a < from_alpha || color.a >= below_alpha) discard;
  light(color.rgb * tint, gloss);
  if (blends) result.a *= color.a; // what is not blended is opaque, or the page would shine through
  if (glint) result = mix(result, vec4(1.0), clamp(2.0 * spark, 0.0, 1.0));
}`];
}

// Rods with round ends: each has a start and an end, which coincide for a ball.
export function rodShaders() {
  return [`${PLACING}
in vec4 corner; in vec3 start, end, color;
uniform float radius;
void main() {
  vec3 along = end - start, axis = length(along) > 1e-6 ? normalize(along) : vec3(0.0, 0.0, 1.0);
  vec3 side = normalize(cross(axis, abs(axis.x) < 0.7 ? vec3(1.0, 0.0, 0.0) : vec3(0.0, 1.0, 0.0)));
  vec3 outwards = mat3(side, cross(axis, side), axis) * corner.xyz;
  show(mix(start, end, corner.w) + radius * outwards, outwards, color);
}`, `${LIGHTING}
uniform vec2 shine[2];
void main() { light(tint, shine[0]); }`];
}
