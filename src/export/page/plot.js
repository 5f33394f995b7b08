// Colours of the page for the canvases, and the plot of residual, volume and weights of examples; it is the timeline, too.

const theme = {};
function readTheme() {
  const style = getComputedStyle(document.documentElement);
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
  for (const name of ["paper", "ink", "faint", "rule", "residual", "median", "volume", "worst", "grid"]) {
    theme["css_" + name] = style.getPropertyValue("--" + name).trim();
    theme[name] = rgb(theme["css_" + name]);
  }
}

/** Height of the panel with the weights of examples. */
const WEIGHTS = 64;
/** Neighbours in the list are far apart in colour. */
const hue = (example) => `hsl(${(200 + 137.5 * example) % 360} 62% ${matchMedia("(prefers-color-scheme: dark)").matches ? 68 : 40}%)`;

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
    this.panel = run.examples.length && run.weights[0].length ? WEIGHTS : 0;
    canvas.style.height = `${canvas.clientHeight + this.panel}px`;
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
    const [top, bottom] = [17, this.height - this.panel - 8];
    const curve = (values, low, high, [top, bottom]) => {
      g.beginPath();
      values.forEach((v, f) => g.lineTo(this.x(f), bottom - ((v - low) / (high - low || 1)) * (bottom - top)));
    };
    const frame = ([top, bottom]) => {
      g.strokeStyle = theme.css_rule;
      g.strokeRect(3.5, top - 0.5, this.width - 7, bottom - top + 1);
    };
    frame([top, bottom]);
    g.font = this.font = "11px system-ui, sans-serif";
    if (this.panel) {
      const rows = [bottom + 27, this.height - 4];
      const low = run.weights.reduce((a, line) => line.reduce((x, w) => Math.min(x, w), a), 0);
      const high = run.weights.reduce((a, line) => line.reduce((x, w) => Math.max(x, w), a), 1);
      frame(rows);
      for (const level of [0, 1]) {
        curve([level, level], low, high, rows);
        g.lineTo(this.width - 4, rows[1] - ((level - low) / (high - low)) * (rows[1] - rows[0]));
        g.stroke();
      }
      run.weights.forEach((line, example) => {
        curve(line, low, high, rows);
        g.strokeStyle = hue(example);
        g.stroke();
      });
      this.names = rows[0] - 5;
    }
    if (run.max.length > 0) {
      const most = Math.max(...run.max, 1e-9);
      for (const [values, color] of [[run.max, theme.css_residual], [run.median, theme.css_median]]) {
        curve(values, 0, most, [top, bottom]);
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
      curve(run.volume, low - room, high + room, [top, bottom]);
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
    if (this.panel) this.weights(g, Math.round(time));
    g.fillStyle = theme.css_ink;
    g.fillRect(this.x(time) - 1, 13, 2, this.height - this.panel - 13);
    if (this.panel) g.fillRect(this.x(time) - 1, this.names + 2, 2, this.height - this.names - 2);
  }

  /** Names of the examples in the colours of their lines, with the weights of a frame; as many as there is room for. */
  weights(g, frame) {
    g.font = this.font;
    let x = 4;
    for (const [example, file] of run.examples.entries()) {
      const name = file.replace(/\.(obj|ply|off|stl|gltf|glb)(\.gz|\.zip)?$/i, "");
      const text = `${name} ${run.weights[example][frame].toFixed(2)}`;
      // The same room for every weight, so that names stand still.
      const room = g.measureText(`${name} −0.00`).width + 14;
      const more = `and ${run.examples.length - example} more`;
      const fits = x + room + (example + 1 < run.examples.length ? g.measureText(more).width : 0) < this.width;
      g.fillStyle = fits ? hue(example) : theme.css_ink;
      g.fillText(fits ? text : more, x, this.names);
      if (!fits) break;
      x += room;
    }
  }

  /** The frame of a click: a worst one that is near, or the one that is there. */
  pick(x, snap) {
    const near = snap && this.worst.find((f) => Math.abs(this.x(f) - x) < 5);
    return near || near === 0 ? near : this.frame(x);
  }
}

