// Plays GLBs with three.js in headless Chromium and compares the vertices that it evaluates with the PC2 of the same run.
//
//   NODE_PATH=…/node_modules node viewer.js CHROMIUM FOLDER FRAMES NAME.glb …
//
// FOLDER holds a.pc2 and the GLBs, written with --source-index; p.glb, if given, has a p.pc2. three and puppeteer-core are installed. Prints a row per
// GLB: whether it opens, the frames compared, the worst difference, how far a vertex is half a frame after them from the mean of its neighbours in time, in
// percent of the diagonal, seconds. Fails where one does not open, a vertex is farther off than 1 % between keys, a picture does not move, or the
// console is not empty. Pictures go beside each GLB.
const fs = require("fs");
const http = require("http");
const path = require("path");
const puppeteer = require("puppeteer-core");

const [chromium, folder, count, ...names] = process.argv.slice(2);
const three = path.resolve(require.resolve("three"), "../..");

const PAGE = `<!doctype html><meta charset="utf-8"><style>body{margin:0}</style><canvas width="640" height="640"></canvas>
<script type="importmap">{"imports":{"three":"/three/build/three.module.js"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "/three/examples/jsm/loaders/GLTFLoader.js";
const renderer = new THREE.WebGLRenderer({ canvas: document.querySelector("canvas"), antialias: true, preserveDrawingBuffer: true });
renderer.setClearColor(0x20242a);
const scene = new THREE.Scene();
scene.add(new THREE.HemisphereLight(0xffffff, 0x404040, 3));
const camera = new THREE.PerspectiveCamera(35, 1, 0.01, 1e5);
window.load = async (url) => {
  const gltf = await new GLTFLoader().loadAsync(url);
  scene.add(gltf.scene);
  const mixer = new THREE.AnimationMixer(gltf.scene);
  mixer.clipAction(gltf.animations[0]).play();
  const meshes = [];
  gltf.scene.traverse((o) => o.isMesh && meshes.push(o));
  const show = (time) => {
    mixer.setTime(time);
    scene.updateMatrixWorld(true);
    meshes.forEach((m) => m.isSkinnedMesh && m.skeleton.update());
  };
  show(0);
  const box = new THREE.Box3().setFromObject(gltf.scene, true);
  const middle = box.getCenter(new THREE.Vector3()), size = box.getSize(new THREE.Vector3()).length();
  camera.position.copy(middle).add(new THREE.Vector3(0.35, 0.2, 1.7).multiplyScalar(size));
  camera.lookAt(middle);
  window.draw = (time) => { show(time); renderer.render(scene, camera); };
  // Number in the scan and place of every vertex.
  window.vertices = (time) => {
    show(time);
    const out = [];
    const p = new THREE.Vector3();
    for (const mesh of meshes) {
      const source = mesh.geometry.getAttribute("_source_index");
      for (let v = 0; v < source.count; v++) {
        mesh.getVertexPosition(v, p);
        p.applyMatrix4(mesh.matrixWorld);
        out.push(source.getX(v), p.x, p.y, p.z);
      }
    }
    return out;
  };
  return gltf.animations[0].duration;
};
window.ready = true;
</script>`;

const server = http.createServer((request, response) => {
  const url = decodeURIComponent(request.url);
  const send = (type, body) => response.writeHead(200, { "content-type": type }).end(body);
  try {
    if (url === "/") return send("text/html", PAGE);
    if (url === "/favicon.ico") return response.writeHead(204).end();
    if (url.startsWith("/three/")) return send("text/javascript", fs.readFileSync(path.join(three, url.slice(7))));
    return send("model/gltf-binary", fs.readFileSync(path.join(folder, path.basename(url))));
  } catch (e) {
    response.writeHead(404).end(e.message);
  }
});

function readPc2(name) {
  const bytes = fs.readFileSync(path.join(folder, name));
  const [points, samples] = [bytes.readInt32LE(16), bytes.readInt32LE(28)];
  const at = (frame, v) => [0, 1, 2].map((k) => bytes.readFloatLE(32 + 12 * (frame * points + v) + 4 * k));
  const [low, high] = [Array(3).fill(Infinity), Array(3).fill(-Infinity)];
  for (let v = 0; v < points; v++) at(0, v).forEach((x, k) => ([low[k], high[k]] = [Math.min(low[k], x), Math.max(high[k], x)]));
  return { at, samples, diagonal: Math.hypot(...high.map((x, k) => x - low[k])) };
}

async function check(browser, name) {
  const { at, samples, diagonal } = readPc2(name === "p.glb" ? "p.pc2" : "a.pc2");
  const page = await browser.newPage();
  const words = [];
  page.on("console", (m) => words.push(m.text()));
  page.on("pageerror", (e) => words.push(e.message));
  const start = Date.now();
  await page.goto(`http://localhost:${server.address().port}/`);
  await page.waitForFunction("window.ready", { timeout: 60e3 });
  const duration = await page.evaluate((url) => window.load(url), "/" + name);
  const frames = Array.from({ length: +count }, (_, i) => Math.round((i * (samples - 1)) / (count - 1)));
  // A hair before the end, where the clip would begin anew.
  const seen = (frame) => page.evaluate((t) => window.vertices(t), Math.min((frame * duration) / (samples - 1), duration * (1 - 1e-7)));
  let [worst, between] = [0, 0];
  for (const frame of frames) {
    let rows = await seen(frame);
    for (let i = 0; i < rows.length; i += 4) {
      const p = at(frame, rows[i]);
      for (let k = 0; k < 3; k++) worst = Math.max(worst, Math.abs(rows[i + 1 + k] - p[k]));
    }
    if (frame + 1 >= samples) continue;
    rows = await seen(frame + 0.5);
    for (let i = 0; i < rows.length; i += 4) {
      const [p, q] = [at(frame, rows[i]), at(frame + 1, rows[i])];
      between = Math.max(between, Math.hypot(...p.map((x, k) => rows[i + 1 + k] - (x + q[k]) / 2)) / diagonal);
    }
  }
  if (between > 0.01) words.push("a vertex strays between two keys");
  const shots = [];
  for (const share of [0, 0.5]) {
    await page.evaluate((t) => window.draw(t), share * duration);
    const file = path.join(folder, name.replace(/\.glb$/, `.three.${shots.length + 1}.png`));
    shots.push(Buffer.from(await (await page.$("canvas")).screenshot({ path: file })).toString("base64"));
  }
  if (shots[0] === shots[1]) words.push("the picture does not move");
  const seconds = (Date.now() - start) / 1000;
  console.log(`${name.padEnd(16)} three.js ${words.length ? "FAILS" : "yes"}  ${frames.length} frames  ${worst.toPrecision(3)}  between keys ${(100 * between).toFixed(3)} %  ${seconds.toFixed(1)} s`);
  words.forEach((w) => console.log("  " + w));
  await page.close();
  return words.length === 0;
}

server.listen(0, async () => {
  const args = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"];
  const browser = await puppeteer.launch({ browser: "chrome", executablePath: chromium, headless: true, args, protocolTimeout: 300e3 });
  let good = true;
  for (const name of names) {
    good = await check(browser, name).catch((e) => (console.log(`${name.padEnd(16)} three.js no: ${e.message}`), false)) && good;
  }
  await browser.close();
  server.close();
  process.exitCode = good ? 0 : 1;
});
