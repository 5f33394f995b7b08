// The GLB of this page: only what our own writer makes.

function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

const ARRAYS = { 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
const WIDTHS = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT4: 16 };

/** Numbers of morph targets in a row of their texture. */
const MORPH_WIDTH = 4096;

class Model {
  constructor(bytes) {
    const head = new DataView(bytes.buffer, bytes.byteOffset);
    const length = head.getUint32(12, true);
    this.json = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + length)));
    this.bin = bytes.slice(28 + length);
    const { nodes, meshes, skins } = this.json;
    const shows = (mesh) => nodes.findIndex((n) => n.mesh === mesh);
    // Only what is no rigid part has morph targets: the last mesh.
    const last = shows(meshes.length - 1);
    const [skin] = skins || [{ joints: [1] }];
    // A mesh without a skin hangs on its node as on a single joint. The first node holds all others.
    this.joints = [...skin.joints, ...nodes.keys()].filter((n, k, all) => n > 0 && nodes[n].skin === undefined && all.indexOf(n) === k);
    const inverse = skins && this.array(skin.inverseBindMatrices);
    // Columns of 4 × 4 to rows of 3 × 4.
    const bound = (j) => Array.from({ length: 12 }, (_, i) => inverse[16 * j + 4 * (i % 4) + (i >> 2)]);
    this.inverse = this.joints.map((_, j) => (skins && j < skin.joints.length ? bound(j) : rigid([0, 0, 0, 1], [0, 0, 0])));
    /** All primitives, with the joint that they hang on where there is no skin. */
    this.primitives = meshes.flatMap((mesh, k) => mesh.primitives.map((p) => ({ ...p, joint: Math.max(this.joints.indexOf(shows(k)), 0) })));
    this.targets = (meshes[meshes.length - 1].weights || []).length;
    this.amounts = new Float32Array(Math.max(this.targets, 1));
    this.parent = new Map();
    this.joints.forEach((n) => (nodes[n].children || []).forEach((c) => this.parent.set(c, n)));
    this.tracks = new Map([...this.joints, last].map((n) => [n, {}]));
    const animation = this.json.animations[0];
    for (const { sampler, target } of animation.channels) {
      this.tracks.get(target.node)[target.path] = this.array(animation.samplers[sampler].output);
    }
    this.weights = this.tracks.get(last).weights;
    this.rows = new Float32Array(12 * this.joints.length);
    this.morphs();
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

  /** Calls `each` with the vertices that a target moves, and by how much: x, y, z at a place of an array. */
  moved(index, each) {
    const { sparse, bufferView, count } = this.json.accessors[index];
    if (bufferView !== undefined) {
      const offsets = this.array(index);
      for (let v = 0; v < count; v++) each(v, offsets, 3 * v);
    } else if (sparse) {
      const numbers = (view, Kind, length) => new Kind(this.view(view).buffer, this.view(view).byteOffset, length);
      const vertices = numbers(sparse.indices.bufferView, ARRAYS[sparse.indices.componentType], sparse.count);
      const offsets = numbers(sparse.values.bufferView, Float32Array, 3 * sparse.count);
      vertices.forEach((v, k) => each(v, offsets, 3 * k));
    }
  }

  /** Rows of four numbers per target for each vertex that some target moves; `slots`: per primitive, which of them is a vertex's, counted from 1. */
  morphs() {
    const { primitives } = this;
    const each = (act) => primitives.forEach((p, k) => (p.targets || []).forEach((t, m) => this.moved(t.POSITION, (v, from, at) => act(k, m, v, from, at))));
    let count = 0;
    this.slots = primitives.map((p) => new Uint32Array(this.json.accessors[p.attributes.POSITION].count));
    each((k, m, v) => (this.slots[k][v] = this.slots[k][v] || ++count));
    this.height = Math.max(1, Math.ceil((count * this.targets) / MORPH_WIDTH));
    this.offsets = new Float32Array(4 * (count ? MORPH_WIDTH : 1) * this.height);
    each((k, m, v, from, at) => {
      const row = 4 * ((this.slots[k][v] - 1) * this.targets + m);
      for (let c = 0; c < 3; c++) this.offsets[row + c] = from[at + c];
    });
  }

  /** Skinning matrices at a time in frames, into `rows`, and weights of targets, into `amounts`; between two keys as players interpolate. */
  pose(time) {
    const last = run.frames - 1;
    const f = Math.min(Math.floor(time), last), g = Math.min(f + 1, last), s = time - f;
    const world = new Map();
    this.joints.forEach((node, j) => {
      const { rotation: r, translation: t } = this.tracks.get(node);
      let q = [0, 0, 0, 1], place = this.json.nodes[node].translation || [0, 0, 0];
      if (r) {
        q = [0, 1, 2, 3].map((k) => r[4 * f + k] * (1 - s) + r[4 * g + k] * s);
        place = [0, 1, 2].map((k) => t[3 * f + k] * (1 - s) + t[3 * g + k] * s);
      }
      const size = Math.hypot(...q);
      const local = rigid(q.map((c) => c / size), place);
      const above = world.get(this.parent.get(node));
      const global = above ? multiply(above, local) : local;
      world.set(node, global);
      this.rows.set(multiply(global, this.inverse[j]), 12 * j);
    });
    for (let m = 0; m < this.targets; m++) {
      this.amounts[m] = this.weights[f * this.targets + m] * (1 - s) + this.weights[g * this.targets + m] * s;
    }
    const root = world.get(this.joints[0]);
    return [root[3], root[7], root[11]];
  }

  /** Calls `each` with every `step`-th vertex of the pose that is in `rows`. */
  sample(step, each) {
    this.primitives.forEach(({ attributes, joint }, part) => {
      const [p, joints, weights] = ["POSITION", "JOINTS_0", "WEIGHTS_0"].map((name) => name in attributes && this.array(attributes[name]));
      const one = weights instanceof Uint8Array ? 255 : 65535;
      for (let v = 0; v < p.length / 3; v += step) {
        const out = [0, 0, 0], q = [p[3 * v], p[3 * v + 1], p[3 * v + 2]];
        const slot = this.slots[part][v];
        for (let m = 0; slot && m < this.targets; m++) {
          for (let c = 0; c < 3; c++) q[c] += this.amounts[m] * this.offsets[4 * ((slot - 1) * this.targets + m) + c];
        }
        for (let k = 0; k < (joints ? 4 : 1); k++) {
          const w = joints ? weights[4 * v + k] / one : 1, m = 12 * (joints ? joints[4 * v + k] : joint);
          for (let r = 0; w > 0 && r < 3; r++) {
            const row = m + 4 * r;
            out[r] += w * (this.rows[row] * q[0] + this.rows[row + 1] * q[1] + this.rows[row + 2] * q[2] + this.rows[row + 3]);
          }
        }
        each(out);
      }
    });
  }
}

