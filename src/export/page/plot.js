// Colours of the page for the canvases, and the plot of residual and volume; it is the timeline, too.

const theme = {};
function readTheme() {
  const style = getComputedStyle(document.documentElement);
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
  for (const name of ["paper", "ink", "faint", "rule", "residual", "median", "volume", "worst", "grid"]) {
    theme["css_" + name] = style.getPropertyValue("--" + name).trim();
    theme[name] = rgb(theme["css_" + name]);
  }
}

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

