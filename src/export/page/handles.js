// Handles and their targets.

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

