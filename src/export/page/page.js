"use strict";
// Plays the GLB that stands in this page: a skin of rigid joints whose matrices are all that changes from frame to frame.

const by = (id) => document.getElementById(id);
const run = JSON.parse(by("run").textContent);

// ---- vectors and matrices: arrays of 3, and 3 × 4 rows of rotation and offset ----

const add = (a, b, s = 1) => [a[0] + b[0] * s, a[1] + b[1] * s, a[2] + b[2] * s];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const norm = (a) => Math.hypot(a[0], a[1], a[2]);
const unit = (a) => add([0, 0, 0], a, 1 / (norm(a) || 1));

/** a · b, rigid motions as 12 numbers, row by row. */
function multiply(a, b) {
  const out = new Float64Array(12);
  for (let r = 0; r < 12; r += 4) {
    for (let c = 0; c < 4; c++) {
      out[r + c] = a[r] * b[c] + a[r + 1] * b[4 + c] + a[r + 2] * b[8 + c] + (c === 3 ? a[r + 3] : 0);
    }
  }
  return out;
}

function rigid([x, y, z, w], [a, b, c]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), a,
    2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), b,
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), c,
  ];
}

// ---- the GLB: only what our own writer makes ----

function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

const ARRAYS = { 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
const WIDTHS = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT4: 16 };

class Model {
  constructor(bytes) {
    const head = new DataView(bytes.buffer, bytes.byteOffset);
    const length = head.getUint32(12, true);
    this.json = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + length)));
    this.bin = bytes.slice(28 + length);
    const skin = this.json.skins[0];
    this.joints = skin.joints;
    const inverse = this.array(skin.inverseBindMatrices);
    // Columns of 4 × 4 to rows of 3 × 4.
    this.inverse = this.joints.map((_, j) => Array.from({ length: 12 }, (_, i) => inverse[16 * j + 4 * (i % 4) + (i >> 2)]));
    this.parent = new Map();
    this.joints.forEach((n) => (this.json.nodes[n].children || []).forEach((c) => this.parent.set(c, n)));
    this.tracks = new Map(this.joints.map((n) => [n, {}]));
    const animation = this.json.animations[0];
    for (const { sampler, target } of animation.channels) {
      this.tracks.get(target.node)[target.path] = this.array(animation.samplers[sampler].output);
    }
    this.rows = new Float32Array(12 * this.joints.length);
  }

  view(index) {
    const { byteOffset = 0, byteLength } = this.json.bufferViews[index];
    return this.bin.subarray(byteOffset, byteOffset + byteLength);
  }

  /** An accessor whose rows follow each other without gaps. */
  array(index) {
    const { bufferView, byteOffset = 0, componentType, count, type } = this.json.accessors[index];
    const view = this.view(bufferView);
    return new ARRAYS[componentType](view.buffer, view.byteOffset + byteOffset, count * WIDTHS[type]);
  }

  /** Skinning matrices at a time in frames, into `rows`; between two keys as players interpolate. */
  pose(time) {
    const last = run.frames - 1;
    const f = Math.min(Math.floor(time), last), g = Math.min(f + 1, last), s = time - f;
    const world = new Map();
    this.joints.forEach((node, j) => {
      const { rotation: r, translation: t } = this.tracks.get(node);
      const q = [0, 1, 2, 3].map((k) => r[4 * f + k] * (1 - s) + r[4 * g + k] * s);
      const size = Math.hypot(...q);
      const place = [0, 1, 2].map((k) => t[3 * f + k] * (1 - s) + t[3 * g + k] * s);
      const local = rigid(q.map((c) => c / size), place);
      const above = world.get(this.parent.get(node));
      const global = above ? multiply(above, local) : local;
      world.set(node, global);
      this.rows.set(multiply(global, this.inverse[j]), 12 * j);
    });
    const root = world.get(this.joints[0]);
    return [root[3], root[7], root[11]];
  }

  /** Calls `each` with every `step`-th vertex of the pose that is in `rows`. */
  sample(step, each) {
    for (const { attributes } of this.json.meshes[0].primitives) {
      const [p, joints, weights] = ["POSITION", "JOINTS_0", "WEIGHTS_0"].map((name) => this.array(attributes[name]));
      for (let v = 0; v < p.length / 3; v += step) {
        const out = [0, 0, 0];
        for (let k = 0; k < 4; k++) {
          const w = weights[4 * v + k] / 65535, m = 12 * joints[4 * v + k];
          for (let r = 0; w > 0 && r < 3; r++) {
            const row = m + 4 * r;
            out[r] += w * (this.rows[row] * p[3 * v] + this.rows[row + 1] * p[3 * v + 1] + this.rows[row + 2] * p[3 * v + 2] + this.rows[row + 3]);
          }
        }
        each(out);
      }
    }
  }
}

// ---- handles and their targets ----

const handles = {
  names: run.handles,
  paths: new Uint16Array(bytesOf(run.paths).buffer),
  /** Place of handle `h` (`what` 0) or of its target (1) at a frame; null where it is missing. */
  at(frame, h, what) {
    const i = 3 * ((2 * frame + what) * this.names.length + h);
    if (this.paths[i] === 65535) return null;
    return [0, 1, 2].map((k) => run.low[k] + this.paths[i + k] * run.step[k]);
  },
  /** In the unit of residuals. */
  residual(frame, h) {
    const hold = this.at(frame, h, 0), target = this.at(frame, h, 1);
    return target ? norm(add(hold, target, -1)) * run.perUnit : NaN;
  },
};

// ---- shaders ----

const SKIN_VERTEX = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D;
layout(location = 0) in vec3 position; layout(location = 1) in vec3 normal;
layout(location = 2) in uvec4 joints; layout(location = 3) in vec4 weights;
layout(location = 4) in vec2 uv; layout(location = 5) in vec4 color;
layout(location = 6) in uvec4 near; layout(location = 7) in vec4 share;
uniform sampler2D bones, residuals;
uniform mat4 camera; uniform mat3 turn; uniform vec3 middle;
out vec3 n, rest, posed; out vec2 st; out vec4 tint; out float residual;
void main() {
  vec4 r[3] = vec4[3](vec4(0), vec4(0), vec4(0));
  for (int k = 0; k < 4; k++)
    for (int i = 0; i < 3; i++) r[i] += weights[k] * texelFetch(bones, ivec2(i, int(joints[k])), 0);
  vec4 p = vec4(position, 1);
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

// ---- drawing ----

class Renderer {
  constructor(canvas, model) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: true, powerPreference: "high-performance" });
    if (!gl) throw new Error("This page needs WebGL 2, which this browser does not offer here.");
    Object.assign(this, { gl, canvas, model });
    this.skin = this.program(SKIN_VERTEX, SKIN_FRAGMENT);
    this.line = this.program(LINE_VERTEX, LINE_FRAGMENT);
    this.bones = this.table(gl.RGBA32F, 3, model.joints.length);
    this.residuals = this.table(gl.R32F, Math.max(handles.names.length, 1), 1);
    this.white = this.plain();
    this.views = new Map();
    this.images = new Map();
    this.parts = model.json.meshes[0].primitives.map((p) => this.part(p));
    this.lines = { vao: gl.createVertexArray(), buffer: gl.createBuffer() };
    gl.bindVertexArray(this.lines.vao);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.lines.buffer);
    [[0, 3, 0], [1, 4, 12]].forEach(([at, width, offset]) => {
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, width, gl.FLOAT, false, 28, offset);
    });
    gl.bindVertexArray(null);
  }

  program(vertex, fragment) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "shaders do not link");
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return { program, at: uniforms };
  }

  /** A texture of numbers. */
  table(format, width, height) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
    [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER].forEach((f) => gl.texParameteri(gl.TEXTURE_2D, f, gl.NEAREST));
    return { texture, width, height, kind: format === gl.R32F ? gl.RED : gl.RGBA };
  }

  fill({ texture, width, height, kind }, numbers) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, kind, gl.FLOAT, numbers);
  }

  plain() {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([255, 255, 255, 255]));
    [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER].forEach((f) => gl.texParameteri(gl.TEXTURE_2D, f, gl.NEAREST));
    return texture;
  }

  /** The buffer of a view: uploaded once, as it is in the file. */
  buffer(index, target) {
    const { gl } = this;
    if (!this.views.has(index)) {
      const buffer = gl.createBuffer();
      gl.bindBuffer(target, buffer);
      gl.bufferData(target, this.model.view(index), gl.STATIC_DRAW);
      this.views.set(index, buffer);
    }
    gl.bindBuffer(target, this.views.get(index));
  }

  part({ attributes, indices, material }) {
    const { gl, model } = this;
    const { accessors, materials = [] } = model.json;
    const vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    const bind = (at, name) => {
      const a = accessors[attributes[name]];
      if (!a) return;
      this.buffer(a.bufferView, gl.ARRAY_BUFFER);
      const { byteStride = 0 } = model.json.bufferViews[a.bufferView];
      gl.enableVertexAttribArray(at);
      if (name === "JOINTS_0") gl.vertexAttribIPointer(at, 4, a.componentType, byteStride, a.byteOffset || 0);
      else gl.vertexAttribPointer(at, WIDTHS[a.type], a.componentType, !!a.normalized, byteStride, a.byteOffset || 0);
    };
    ["POSITION", "NORMAL", "JOINTS_0", "WEIGHTS_0", "TEXCOORD_0", "COLOR_0"].forEach((name, at) => bind(at, name));
    const index = accessors[indices];
    this.buffer(index.bufferView, gl.ELEMENT_ARRAY_BUFFER);
    gl.bindVertexArray(null);
    const { pbrMetallicRoughness: surface = {}, alphaMode } = materials[material] || {};
    const base = surface.baseColorTexture && model.json.textures[surface.baseColorTexture.index].source;
    const factor = surface.baseColorFactor || [1, 1, 1, 1];
    const bare = base === undefined && !attributes.COLOR_0 && factor.every((c) => c === 1);
    return { vao, attributes, indices, count: index.count, type: index.componentType, base, clear: alphaMode === "BLEND", factor: bare ? [0.63, 0.59, 0.53, 1] : factor };
  }

  /** Decodes the images that are used; the scan is plain until they are there. */
  async decode() {
    const { gl, model } = this;
    for (const source of new Set(this.parts.map((p) => p.base).filter((b) => b !== undefined))) {
      const { bufferView, mimeType } = model.json.images[source];
      const blob = new Blob([model.view(bufferView)], { type: mimeType });
      const picture = await createImageBitmap(blob, { premultiplyAlpha: "none", colorSpaceConversion: "none" });
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE, picture);
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
      picture.close();
      this.images.set(source, texture);
    }
  }

  /** An array of rows of four as a vertex attribute of a part. */
  attribute(part, at, rows) {
    const { gl } = this;
    gl.bindVertexArray(part.vao);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, rows, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(at);
    if (rows instanceof Uint16Array) gl.vertexAttribIPointer(at, 4, gl.UNSIGNED_SHORT, 0, 0);
    else gl.vertexAttribPointer(at, 4, gl.UNSIGNED_BYTE, true, 0, 0);
    gl.bindVertexArray(null);
  }

  /** The four handles nearest to every vertex at rest, heavier the nearer; made when they are first shown. */
  shares() {
    if (this.shared || handles.names.length === 0) return;
    this.shared = true;
    for (const part of this.parts) {
      const p = this.model.array(part.attributes.POSITION);
      const near = new Uint16Array(4 * (p.length / 3)), share = new Uint8Array(near.length);
      for (let v = 0; v < p.length / 3; v++) {
        const best = [Infinity, Infinity, Infinity, Infinity], which = [0, 0, 0, 0];
        run.rest.forEach(([x, y, z], h) => {
          let d = (x - p[3 * v]) ** 2 + (y - p[3 * v + 1]) ** 2 + (z - p[3 * v + 2]) ** 2;
          for (let k = 0, w = h; k < 4; k++) {
            if (d < best[k]) [best[k], d, which[k], w] = [d, best[k], w, which[k]];
          }
        });
        const weight = best.map((d) => (d < Infinity ? 1 / (d + 1e-6 * run.diagonal ** 2) : 0));
        const sum = weight.reduce((a, b) => a + b);
        for (let k = 0; k < 4; k++) [near[4 * v + k], share[4 * v + k]] = [which[k], Math.round((255 * weight[k]) / sum)];
      }
      this.attribute(part, 6, near);
      this.attribute(part, 7, share);
    }
  }

  /** Edges of all triangles of a part, made when they are first shown. */
  edges(part) {
    if (!part.edges) {
      const { gl } = this;
      const t = this.model.array(part.indices);
      const lines = new Uint32Array(2 * t.length);
      for (let i = 0; i < t.length; i += 3) {
        for (let k = 0; k < 3; k++) [lines[2 * (i + k)], lines[2 * (i + k) + 1]] = [t[i + k], t[i + ((k + 1) % 3)]];
      }
      part.edges = gl.createBuffer();
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, part.edges);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, lines, gl.STATIC_DRAW);
    }
    return part.edges;
  }

  resize() {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(this.canvas.clientWidth * ratio), Math.round(this.canvas.clientHeight * ratio)];
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
  }

  draw(camera, state) {
    const { gl } = this;
    this.resize();
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...theme.paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    this.strokes(camera.matrix, state.floor, gl.LINES, 1, 1);

    gl.useProgram(this.skin.program);
    const at = this.skin.at;
    this.fill(this.bones, this.model.rows);
    [[this.bones.texture, at.bones, 0], [this.residuals.texture, at.residuals, 1]].forEach(([texture, place, slot]) => {
      gl.activeTexture(gl.TEXTURE0 + slot);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(place, slot);
    });
    gl.activeTexture(gl.TEXTURE2);
    gl.uniform1i(at.image, 2);
    gl.uniformMatrix4fv(at.camera, false, camera.matrix);
    gl.uniformMatrix3fv(at.turn, false, camera.turn);
    gl.uniform3fv(at.middle, run.centre);
    gl.uniform1i(at.mode, state.mode);
    gl.uniform1f(at.limit, state.mode === 3 ? STRETCH : state.limit);
    gl.uniform3fv(at.ink, theme.ink);
    gl.uniform1i(at.lines, 0);
    gl.vertexAttrib4f(5, 1, 1, 1, 1);
    gl.vertexAttribI4ui(6, 0, 0, 0, 0);
    gl.vertexAttrib4f(7, 0, 0, 0, 0);
    if (state.wire) {
      gl.enable(gl.POLYGON_OFFSET_FILL);
      gl.polygonOffset(1, 1);
    }
    for (const part of this.parts) {
      gl.bindTexture(gl.TEXTURE_2D, this.images.get(part.base) || this.white);
      gl.uniform4fv(at.factor, part.factor);
      gl.uniform1i(at.clear, part.clear ? 1 : 0);
      gl.bindVertexArray(part.vao);
      this.buffer(this.model.json.accessors[part.indices].bufferView, gl.ELEMENT_ARRAY_BUFFER);
      gl.drawElements(gl.TRIANGLES, part.count, part.type, 0);
    }
    gl.disable(gl.POLYGON_OFFSET_FILL);
    if (state.wire) {
      gl.uniform1i(at.lines, 1);
      for (const part of this.parts) {
        gl.bindVertexArray(part.vao);
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.edges(part));
        gl.drawElements(gl.LINES, 2 * part.count, gl.UNSIGNED_INT, 0);
      }
    }
    gl.bindVertexArray(null);
    gl.activeTexture(gl.TEXTURE0);
    if (state.markers) {
      // What the body hides is faint.
      for (const [compare, fade] of [[gl.GREATER, 0.35], [gl.LEQUAL, 1]]) {
        gl.depthFunc(compare);
        gl.depthMask(false);
        this.strokes(camera.matrix, state.gaps, gl.LINES, 1, fade);
        this.strokes(camera.matrix, state.targets, gl.POINTS, 9, fade);
        this.strokes(camera.matrix, state.holds, gl.POINTS, 6, fade);
      }
      gl.depthFunc(gl.LESS);
      gl.depthMask(true);
    }
  }

  /** Lines or points: rows of place and colour. */
  strokes(matrix, rows, kind, size, fade) {
    if (rows.length === 0) return;
    const { gl } = this;
    gl.useProgram(this.line.program);
    gl.uniformMatrix4fv(this.line.at.camera, false, matrix);
    gl.uniform1f(this.line.at.size, size * Math.min(devicePixelRatio || 1, 2));
    gl.uniform1f(this.line.at.fade, fade);
    gl.uniform1i(this.line.at.disc, kind === gl.POINTS ? 1 : 0);
    gl.bindVertexArray(this.lines.vao);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.lines.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(rows), gl.DYNAMIC_DRAW);
    gl.drawArrays(kind, 0, rows.length / 7);
    gl.bindVertexArray(null);
  }
}

// ---- camera ----

const FIELD = 0.55; // radians from bottom to top

class Camera {
  constructor(up) {
    this.up = unit(up);
    const front = Math.abs(this.up[1]) > 0.7 ? [0, 0, 1] : [0, -1, 0];
    this.right = unit(cross(this.up, front));
    this.front = cross(this.right, this.up);
  }

  /** Looks at a ball from the front, a little from the side and from above. */
  frame(target, radius) {
    Object.assign(this, { target, yaw: 0.5, pitch: 0.2, distance: (0.78 * radius) / Math.sin(FIELD / 2) });
  }

  axes() {
    const [c, s] = [Math.cos(this.yaw), Math.sin(this.yaw)];
    const flat = add(add([0, 0, 0], this.front, c), this.right, s);
    const toward = add(add([0, 0, 0], flat, Math.cos(this.pitch)), this.up, Math.sin(this.pitch));
    const right = add(add([0, 0, 0], this.right, c), this.front, -s);
    return { right, up: cross(toward, right), toward };
  }

  /** Matrices for a canvas of some width over height. */
  update(aspect) {
    const { right, up, toward } = this.axes();
    const distance = this.distance / Math.min(1, aspect);
    const eye = add(this.target, toward, distance);
    const near = distance / 50, far = distance * 4 + 20 * run.diagonal;
    const y = 1 / Math.tan(FIELD / 2), x = y / aspect;
    const a = (near + far) / (near - far), b = (2 * near * far) / (near - far);
    const rows = [right, up, toward].map((axis) => [...axis, -dot(axis, eye)]);
    this.turn = new Float32Array([0, 1, 2].flatMap((c) => [right[c], up[c], toward[c]]));
    this.matrix = new Float32Array([0, 1, 2, 3].flatMap((c) => [x * rows[0][c], y * rows[1][c], a * rows[2][c] + (c === 3 ? b : 0), -rows[2][c]]));
    this.perPixel = (2 * distance * Math.tan(FIELD / 2)) / by("view").clientHeight;
  }

  project(p) {
    const m = this.matrix;
    const [x, y, w] = [0, 1, 3].map((r) => m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r]);
    const { clientWidth: width, clientHeight: height } = by("view");
    return [((x / w + 1) * width) / 2, ((1 - y / w) * height) / 2];
  }
}

// ---- colours of the page, for the canvases ----

const theme = {};
function readTheme() {
  const style = getComputedStyle(document.documentElement);
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
  for (const name of ["paper", "ink", "faint", "rule", "residual", "median", "volume", "worst", "grid"]) {
    theme["css_" + name] = style.getPropertyValue("--" + name).trim();
    theme[name] = rgb(theme["css_" + name]);
  }
}

// ---- plot of residual and volume; it is the timeline, too ----

const FLAGS = ["not solved", "folded", "no markers"];
const digits = (x) => (Math.abs(x) >= 100 ? x.toFixed(0) : x.toPrecision(3));

/** The highest peaks of the residual, none within a quarter of a second of a higher one. */
function worstFrames() {
  const reach = Math.ceil(run.rate / 4);
  const peak = (f) => run.max[f] > 0 && run.max.slice(Math.max(0, f - reach), f + reach + 1).every((r) => r <= run.max[f]);
  const order = run.max.map((_, f) => f).filter(peak).sort((a, b) => run.max[b] - run.max[a] || a - b);
  return order.filter((f, i) => order.slice(0, i).every((g) => Math.abs(f - g) > reach)).slice(0, 5);
}

class Plot {
  constructor(canvas) {
    Object.assign(this, { canvas, paper: document.createElement("canvas"), worst: worstFrames() });
  }

  x(frame) {
    return 4 + (frame / Math.max(run.frames - 1, 1)) * (this.width - 8);
  }

  frame(x) {
    return Math.max(0, Math.min(run.frames - 1, ((x - 4) / (this.width - 8)) * (run.frames - 1)));
  }

  /** What does not change from frame to frame. */
  prepare() {
    this.ratio = devicePixelRatio || 1;
    [this.width, this.height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    for (const c of [this.canvas, this.paper]) Object.assign(c, { width: this.width * this.ratio, height: this.height * this.ratio });
    const g = this.paper.getContext("2d");
    g.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    const [top, bottom] = [17, this.height - 8];
    const curve = (values, low, high) => {
      g.beginPath();
      values.forEach((v, f) => g.lineTo(this.x(f), bottom - ((v - low) / (high - low || 1)) * (bottom - top)));
    };
    g.strokeStyle = theme.css_rule;
    g.strokeRect(3.5, top - 0.5, this.width - 7, bottom - top + 1);
    g.font = "11px system-ui, sans-serif";
    if (run.max.length > 0) {
      const most = Math.max(...run.max, 1e-9);
      for (const [values, color] of [[run.max, theme.css_residual], [run.median, theme.css_median]]) {
        curve(values, 0, most);
        g.strokeStyle = color;
        g.stroke();
        g.lineTo(this.x(values.length - 1), bottom);
        g.lineTo(this.x(0), bottom);
        g.globalAlpha = 0.18;
        g.fillStyle = color;
        g.fill();
        g.globalAlpha = 1;
      }
      const [low, high] = [Math.min(...run.volume), Math.max(...run.volume)];
      const room = Math.max(0.02, high - low) * 0.1;
      curve(run.volume, low - room, high + room);
      g.strokeStyle = theme.css_volume;
      g.stroke();
      g.fillStyle = theme.css_residual;
      g.fillText(`residual: largest and median, up to ${digits(most)} ${run.unit}`, 4, 11);
      g.fillStyle = theme.css_volume;
      g.textAlign = "right";
      g.fillText(`volume ${(100 * low).toFixed(1)} to ${(100 * high).toFixed(1)} %`, this.width - 4, 11);
      g.textAlign = "left";
    }
    g.fillStyle = theme.css_worst;
    run.flags.forEach((flag, f) => flag && g.fillRect(this.x(f) - 0.75, bottom + 3, 1.5, 4));
    this.worst.forEach((f, rank) => {
      g.globalAlpha = rank === 0 ? 1 : 0.6;
      g.beginPath();
      [[0, 0], [-4, -6], [4, -6]].forEach(([dx, dy]) => g.lineTo(this.x(f) + dx, top + dy + 2));
      g.fill();
      g.fillRect(this.x(f) - 0.5, top, 1, bottom - top);
    });
    g.globalAlpha = 1;
  }

  draw(time) {
    if (this.canvas.clientWidth !== this.width || (devicePixelRatio || 1) !== this.ratio) this.prepare();
    if (this.paper.width === 0 || this.paper.height === 0) return; // a page that is not shown yet
    const g = this.canvas.getContext("2d");
    g.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    g.clearRect(0, 0, this.width, this.height);
    g.drawImage(this.paper, 0, 0, this.width, this.height);
    g.fillStyle = theme.css_ink;
    g.fillRect(this.x(time) - 1, 13, 2, this.height - 13);
  }

  /** The frame of a click: a worst one that is near, or the one that is there. */
  pick(x, snap) {
    const near = snap && this.worst.find((f) => Math.abs(this.x(f) - x) < 5);
    return near || near === 0 ? near : this.frame(x);
  }
}

// ---- the page ----

const STRETCH = Math.log2(1.25);
const state = { time: 0, playing: false, speed: 1, mode: 0, wire: false, markers: false, follow: false, floor: [], targets: [], holds: [], gaps: [] };

/** Where the take goes: a box of the whole way, the size of the body, and the floor under it. */
function survey(model, up) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  let floor = Infinity, body = 0;
  const step = Math.max(1, Math.round(model.json.meshes[0].primitives.reduce((n, p) => n + model.json.accessors[p.attributes.POSITION].count, 0) / 4000));
  const poses = Math.min(run.frames, 24);
  for (let i = 0; i < poses; i++) {
    const root = model.pose(Math.round((i * (run.frames - 1)) / Math.max(poses - 1, 1)));
    model.sample(step, (p) => {
      for (let k = 0; k < 3; k++) [low[k], high[k]] = [Math.min(low[k], p[k]), Math.max(high[k], p[k])];
      floor = Math.min(floor, dot(p, up));
      body = Math.max(body, norm(add(p, root, -1)));
    });
  }
  return { middle: add(low, high).map((x) => x / 2), radius: norm(add(high, low, -1)) / 2, floor, body };
}

/** A grid on the floor, half a body wide. */
function grid({ right, front, up }, { middle, radius, floor }) {
  const cell = run.diagonal / 4;
  const count = Math.min(60, Math.ceil((1.6 * radius) / cell));
  const centre = add(middle, up, floor - dot(middle, up));
  const rows = [];
  for (let i = -count; i <= count; i++) {
    for (const [a, b] of [[right, front], [front, right]]) {
      for (const end of [-count, count]) rows.push(...add(add(centre, a, i * cell), b, end * cell), ...theme.grid, 0.5);
    }
  }
  return rows;
}

function start() {
  readTheme();
  by("summary").append(...run.summary.map((text, i) => Object.assign(document.createElement(i ? "div" : "b"), { textContent: text })));
  const model = new Model(bytesOf(by("glb").textContent));
  const view = by("view"), plot = new Plot(by("plot"));
  const renderer = new Renderer(view, model);
  const camera = new Camera(run.up);
  const way = survey(model, camera.up);
  let asked = 0, before = 0, base = [0, 0, 0], residuals = new Float32Array(Math.max(handles.names.length, 1));
  state.limit = Math.max(...run.max, 1e-9);
  state.follow = way.radius > 1.6 * way.body;
  state.floor = grid(camera, way);

  const redraw = () => {
    if (!asked) asked = requestAnimationFrame(tick);
  };
  const frameNow = () => Math.round(state.time);

  function reset() {
    base = model.pose(state.time);
    camera.frame(state.follow ? base : way.middle, state.follow ? 1.2 * way.body : way.radius);
    redraw();
  }

  function overlay(frame) {
    Object.assign(state, { targets: [], holds: [], gaps: [] });
    handles.names.forEach((_, h) => {
      const hold = handles.at(frame, h, 0), target = handles.at(frame, h, 1);
      residuals[h] = target ? norm(add(hold, target, -1)) * run.perUnit : 0;
      if (!target) return;
      state.targets.push(...target, ...theme.worst, 0.9);
      state.holds.push(...hold, ...theme.volume, 1);
      state.gaps.push(...hold, ...theme.worst, 1, ...target, ...theme.worst, 1);
    });
  }

  function tick(now) {
    asked = 0;
    if (state.playing) {
      state.time += Math.min(now - before, 250) * 0.001 * run.rate * state.speed;
      if (state.time > run.frames - 1) state.time %= Math.max(run.frames - 1, 1);
    }
    before = now;
    const root = model.pose(state.time);
    if (state.follow) camera.target = add(camera.target, add(root, base, -1));
    base = root;
    overlay(frameNow());
    if (state.mode === 2) {
      renderer.shares();
      renderer.fill(renderer.residuals, residuals);
    }
    camera.update(view.clientWidth / Math.max(view.clientHeight, 1));
    renderer.draw(camera, state);
    plot.draw(state.time);
    const f = frameNow();
    const numbers = run.max.length ? ` · ${digits(run.max[f])} ${run.unit}${run.worst[f] === null ? "" : " " + handles.names[run.worst[f]]} · ${(100 * run.volume[f]).toFixed(1)} %` : "";
    const flags = FLAGS.filter((_, bit) => (run.flags[f] >> bit) & 1).map((text) => " · " + text).join("");
    by("clock").textContent = `frame ${run.first + f} · ${(f / run.rate).toFixed(2)} s${numbers}${flags}`;
    if (state.playing) redraw();
  }

  // Controls: every setting goes through `set`, so that buttons and keys agree.
  function set(change) {
    Object.assign(state, change);
    state.time = Math.max(0, Math.min(run.frames - 1, state.time));
    by("play").textContent = state.playing ? "pause" : "play";
    by("speed").value = state.speed;
    by("surface").value = state.mode;
    for (const name of ["wire", "markers", "follow"]) by(name).setAttribute("aria-pressed", state[name]);
    const legend = by("legend"), [left, bar, right] = legend.children;
    legend.hidden = state.mode < 2;
    left.textContent = state.mode === 2 ? "0" : "pressed to 80 %";
    right.textContent = state.mode === 2 ? `${digits(state.limit)} ${run.unit}` : "stretched to 125 %";
    bar.style.background = state.mode === 2 ? "linear-gradient(90deg, #d0cac1, #fbce5a, #cc2626)" : "linear-gradient(90deg, #2662cc, #d0cac1, #cc2626)";
    redraw();
  }
  const speeds = [...by("speed").options].map((o) => +o.value);
  const faster = (by) => set({ speed: speeds[Math.max(0, Math.min(speeds.length - 1, speeds.indexOf(state.speed) + by))] });
  const toggle = (name) => set({ [name]: !state[name] });
  const mode = (m) => set({ mode: state.mode === m ? 0 : m });
  const go = (time) => set({ time, playing: false });
  by("play").onclick = () => toggle("playing");
  by("speed").onchange = (e) => set({ speed: +e.target.value });
  by("surface").onchange = (e) => set({ mode: +e.target.value });
  for (const name of ["wire", "markers"]) by(name).onclick = () => toggle(name);
  by("follow").onclick = () => toggle("follow");
  by("reset").onclick = reset;
  const keys = {
    " ": () => toggle("playing"), arrowleft: (e) => go(frameNow() - (e.shiftKey ? 10 : 1)), arrowright: (e) => go(frameNow() + (e.shiftKey ? 10 : 1)),
    home: () => go(0), end: () => go(run.frames - 1), w: () => toggle("wire"), m: () => toggle("markers"), f: () => toggle("follow"),
    t: () => mode(1), c: () => mode(2), s: () => mode(3), r: reset, "+": () => faster(1), "=": () => faster(1), "-": () => faster(-1),
  };
  addEventListener("keydown", (e) => {
    const act = keys[e.key.toLowerCase()];
    if (!act || e.ctrlKey || e.metaKey || e.altKey || e.target.tagName === "SELECT") return;
    e.preventDefault();
    act(e);
  });

  // The camera: one pointer turns or moves, two move and zoom.
  const pointers = new Map();
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, size: Math.hypot(a.x - b.x, a.y - b.y) };
  };
  const pan = (dx, dy) => {
    const { right, up } = camera.axes();
    camera.target = add(add(camera.target, right, -dx * camera.perPixel), up, dy * camera.perPixel);
  };
  const zoom = (factor) => {
    camera.distance = Math.max(run.diagonal / 50, Math.min(run.diagonal * 100, camera.distance * factor));
  };
  view.onpointerdown = (e) => {
    view.setPointerCapture(e.pointerId);
    pointers.set(e.pointerId, { x: e.clientX, y: e.clientY, moves: e.button > 0 || e.shiftKey });
  };
  view.onpointerup = view.onpointercancel = (e) => pointers.delete(e.pointerId);
  view.onpointermove = (e) => {
    const pointer = pointers.get(e.pointerId);
    if (!pointer) return point(e);
    const old = pointers.size > 1 && spread();
    const [dx, dy] = [e.clientX - pointer.x, e.clientY - pointer.y];
    Object.assign(pointer, { x: e.clientX, y: e.clientY });
    if (old) {
      const now = spread();
      pan(now.x - old.x, now.y - old.y);
      zoom(old.size / Math.max(now.size, 1));
    } else if (pointer.moves) {
      pan(dx, dy);
    } else {
      camera.yaw -= dx * 0.008;
      camera.pitch = Math.max(-1.55, Math.min(1.55, camera.pitch + dy * 0.008));
    }
    redraw();
  };
  view.oncontextmenu = (e) => e.preventDefault();
  view.addEventListener("wheel", (e) => {
    e.preventDefault();
    zoom(Math.exp(Math.sign(e.deltaY) * Math.min(Math.abs(e.deltaY) * (e.deltaMode ? 20 : 1), 120) * 0.0015));
    redraw();
  }, { passive: false });

  /** The name of the marker under the pointer. */
  function point(e) {
    let near = 12, text = "";
    if (state.markers) {
      handles.names.forEach((name, h) => {
        const target = handles.at(frameNow(), h, 1);
        const [x, y] = target ? camera.project(target) : [Infinity, Infinity];
        const distance = Math.hypot(x - e.offsetX, y - e.offsetY);
        if (distance < near) [near, text] = [distance, `${name} · ${digits(handles.residual(frameNow(), h))} ${run.unit}`];
      });
    }
    Object.assign(by("tip"), { hidden: !text, textContent: text });
    Object.assign(by("tip").style, { left: `${e.offsetX + 14}px`, top: `${e.offsetY + 10}px` });
  }
  view.onpointerleave = () => (by("tip").hidden = true);

  plot.canvas.onpointerdown = (e) => {
    plot.canvas.setPointerCapture(e.pointerId);
    go(plot.pick(e.offsetX, true));
  };
  plot.canvas.onpointermove = (e) => e.buttons && go(plot.pick(e.offsetX, false));

  addEventListener("resize", redraw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    readTheme();
    state.floor = grid(camera, way);
    plot.prepare();
    redraw();
  });

  // `#frame=210` in the address opens the page at that frame.
  const place = () => {
    const frame = /^#frame=(-?\d+)$/.exec(location.hash);
    if (frame) go(+frame[1] - run.first);
    return !!frame;
  };
  addEventListener("hashchange", place);
  reset();
  if (!place()) set({ playing: run.frames > 1 && !matchMedia("(prefers-reduced-motion: reduce)").matches });
  by("message").textContent = "";
  renderer.decode().then(redraw, (e) => (by("message").textContent = `A texture cannot be read: ${e.message}`));
}

// The page with its words is there before the work begins.
requestAnimationFrame(() => setTimeout(() => {
  try {
    start();
  } catch (e) {
    by("message").textContent = e.message;
    throw e;
  }
}));
