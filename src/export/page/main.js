// The page: state, controls, pointers.

const STRETCH = Math.log2(1.25);
const state = { time: 0, playing: false, speed: 1, mode: 0, wire: false, markers: false, follow: false, floor: [], targets: [], holds: [], gaps: [] };

/** Where the take goes: a box of the whole way, the size of the body, and the floor under it. */
function survey(model, up) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  let floor = Infinity, body = 0;
  const step = Math.max(1, Math.round(model.primitives.reduce((n, p) => n + model.json.accessors[p.attributes.POSITION].count, 0) / 4000));
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
