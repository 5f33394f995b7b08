// Shaders: the skin with its morph targets, and lines and points.

const SKIN_VERTEX = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D;
layout(location = 0) in vec3 position; layout(location = 1) in vec3 normal;
layout(location = 2) in uvec4 joints; layout(location = 3) in vec4 weights;
layout(location = 4) in vec2 uv; layout(location = 5) in vec4 color;
layout(location = 6) in uvec4 near; layout(location = 7) in vec4 share;
layout(location = 8) in uint slot;
uniform sampler2D bones, residuals, offsets, amounts;
uniform int targets;
uniform mat4 camera; uniform mat3 turn; uniform vec3 middle;
out vec3 n, rest, posed; out vec2 st; out vec4 tint; out float residual;
void main() {
  vec4 r[3] = vec4[3](vec4(0), vec4(0), vec4(0));
  for (int k = 0; k < 4; k++)
    for (int i = 0; i < 3; i++) r[i] += weights[k] * texelFetch(bones, ivec2(i, int(joints[k])), 0);
  vec4 p = vec4(position, 1);
  for (int m = 0; slot > 0u && m < targets; m++) {
    float amount = texelFetch(amounts, ivec2(m, 0), 0).r;
    int at = (int(slot) - 1) * targets + m;
    if (amount != 0.0) p.xyz += amount * texelFetch(offsets, ivec2(at & 4095, at >> 12), 0).xyz;
  }
  vec3 q = vec3(dot(r[0], p), dot(r[1], p), dot(r[2], p));
  n = turn * vec3(dot(r[0].xyz, normal), dot(r[1].xyz, normal), dot(r[2].xyz, normal));
  rest = position - middle; posed = q - middle; st = uv; tint = color; residual = 0.0;
  for (int k = 0; k < 4; k++) residual += share[k] * texelFetch(residuals, ivec2(int(near[k]), 0), 0).r;
  gl_Position = camera * vec4(q, 1);
}`;

const SKIN_FRAGMENT = `#version 300 es
precision highp float;
in vec3 n, rest, posed; in vec2 st; in vec4 tint; in float residual;
uniform sampler2D image; uniform vec4 factor; uniform int mode; uniform bool lines, clear; uniform float limit; uniform vec3 ink;
out vec4 color;
float lamp(vec3 n, vec3 d, float wrap) { return max((dot(n, d) + wrap) / (1.0 + wrap), 0.0); }
// The principal stretch that is farther from 1, as a binary logarithm, from how rest and pose change across the screen.
float stretch() {
  vec3 a = dFdx(rest), b = dFdy(rest), c = dFdx(posed), d = dFdy(posed);
  vec3 g = vec3(dot(a, a), dot(a, b), dot(b, b)), h = vec3(dot(c, c), dot(c, d), dot(d, d));
  float det = max(g.x * g.z - g.y * g.y, 1e-30);
  float mean = 0.5 * (g.z * h.x - 2.0 * g.y * h.y + g.x * h.z) / det;
  float root = sqrt(max(mean * mean - (h.x * h.z - h.y * h.y) / det, 0.0));
  float more = 0.5 * log2(max(mean + root, 1e-6)), less = 0.5 * log2(max(mean - root, 1e-6));
  return abs(more) > abs(less) ? more : less;
}
void main() {
  if (lines) { color = vec4(ink, 0.55); return; }
  vec3 base = vec3(0.63, 0.59, 0.53);
  vec4 look = factor * tint * texture(image, st);
  if (clear && look.a < 0.5) discard;
  if (mode == 0) base = look.rgb;
  if (mode == 2) { float t = clamp(residual / limit, 0.0, 1.0); base = mix(mix(base, vec3(0.95, 0.62, 0.1), min(2.0 * t, 1.0)), vec3(0.6, 0.02, 0.02), max(2.0 * t - 1.0, 0.0)); }
  if (mode == 3) { float t = clamp(stretch() / limit, -1.0, 1.0); base = t > 0.0 ? mix(base, vec3(0.6, 0.02, 0.02), t) : mix(base, vec3(0.02, 0.12, 0.6), -t); }
  vec3 m = normalize(n); if (m.z < 0.0) m = -m;
  float light = 0.13 + 0.11 * m.y + 0.86 * lamp(m, vec3(-0.42, 0.62, 0.66), 0.25) + 0.22 * lamp(m, vec3(0.80, 0.10, 0.59), 0.35);
  color = vec4(pow(min(base * light, vec3(1)), vec3(1.0 / 2.2)), 1);
}`;

const LINE_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 position; layout(location = 1) in vec4 color;
uniform mat4 camera; uniform float size, fade;
out vec4 tint;
void main() { tint = vec4(color.rgb, color.a * fade); gl_Position = camera * vec4(position, 1); gl_PointSize = size; }`;

const LINE_FRAGMENT = `#version 300 es
precision highp float;
in vec4 tint; uniform bool disc; out vec4 color;
void main() { if (disc && length(gl_PointCoord - 0.5) > 0.5) discard; color = tint; }`;

