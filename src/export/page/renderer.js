// Drawing: all that does not change is uploaded once; per frame go matrices of joints and weights of morph targets.

class Renderer {
  constructor(canvas, model) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: true, powerPreference: "high-performance" });
    if (!gl) throw new Error("This page needs WebGL 2, which this browser does not offer here.");
    Object.assign(this, { gl, canvas, model });
    this.skin = this.program(SKIN_VERTEX, SKIN_FRAGMENT);
    this.line = this.program(LINE_VERTEX, LINE_FRAGMENT);
    this.bones = this.table(gl.RGBA32F, 3, model.joints.length);
    this.residuals = this.table(gl.R32F, Math.max(handles.names.length, 1), 1);
    this.offsets = this.table(gl.RGBA32F, model.offsets.length / 4 / model.height, model.height);
    this.fill(this.offsets, model.offsets);
    this.amounts = this.table(gl.R32F, model.amounts.length, 1);
    this.white = this.plain();
    this.views = new Map();
    this.images = new Map();
    this.parts = model.primitives.map((p, k) => this.part(p, model.slots[k]));
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

  part({ attributes, indices, material, joint }, slots) {
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
    if (model.targets) {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, slots, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(8);
      gl.vertexAttribIPointer(8, 1, gl.UNSIGNED_INT, 0, 0);
    }
    const index = accessors[indices];
    this.buffer(index.bufferView, gl.ELEMENT_ARRAY_BUFFER);
    gl.bindVertexArray(null);
    const { pbrMetallicRoughness: surface = {}, alphaMode } = materials[material] || {};
    const base = surface.baseColorTexture && model.json.textures[surface.baseColorTexture.index].source;
    const factor = surface.baseColorFactor || [1, 1, 1, 1];
    const bare = base === undefined && !attributes.COLOR_0 && factor.every((c) => c === 1);
    return { vao, attributes, indices, joint, count: index.count, type: index.componentType, base, clear: alphaMode === "BLEND", factor: bare ? [0.63, 0.59, 0.53, 1] : factor };
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
    if (this.model.targets) this.fill(this.amounts, this.model.amounts);
    [["bones", 0], ["residuals", 1], ["offsets", 3], ["amounts", 4]].forEach(([name, slot]) => {
      gl.activeTexture(gl.TEXTURE0 + slot);
      gl.bindTexture(gl.TEXTURE_2D, this[name].texture);
      gl.uniform1i(at[name], slot);
    });
    gl.uniform1i(at.targets, this.model.targets);
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
    gl.vertexAttrib4f(3, 1, 0, 0, 0);
    gl.vertexAttribI4ui(6, 0, 0, 0, 0);
    gl.vertexAttrib4f(7, 0, 0, 0, 0);
    gl.vertexAttribI4ui(8, 0, 0, 0, 0);
    if (state.wire) {
      gl.enable(gl.POLYGON_OFFSET_FILL);
      gl.polygonOffset(1, 1);
    }
    for (const part of this.parts) {
      gl.bindTexture(gl.TEXTURE_2D, this.images.get(part.base) || this.white);
      gl.uniform4fv(at.factor, part.factor);
      gl.uniform1i(at.clear, part.clear ? 1 : 0);
      gl.bindVertexArray(part.vao);
      gl.vertexAttribI4ui(2, part.joint, 0, 0, 0); // where there is no skin
      this.buffer(this.model.json.accessors[part.indices].bufferView, gl.ELEMENT_ARRAY_BUFFER);
      gl.drawElements(gl.TRIANGLES, part.count, part.type, 0);
    }
    gl.disable(gl.POLYGON_OFFSET_FILL);
    if (state.wire) {
      gl.uniform1i(at.lines, 1);
      for (const part of this.parts) {
        gl.bindVertexArray(part.vao);
        gl.vertexAttribI4ui(2, part.joint, 0, 0, 0);
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

