// The camera.

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

