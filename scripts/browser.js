// Opens pages of -o FILE.html from disk in a browser, as a reader does, and fails unless each plays: the first picture comes in time, the body moves,
// controls do what they say, and nothing is loaded from elsewhere nor said on the console. Pictures go beside each page.
const { pathToFileURL } = require("url");
const puppeteer = require("puppeteer-core");

const SECONDS = 10; // to the first picture

const wait = (ms) => new Promise((done) => setTimeout(done, ms));

async function check(browser, name, file) {
  const page = await browser.newPage();
  await page.setViewport({ width: 1280, height: 800 });
  const words = [];
  page.on("console", (m) => words.push(`console: ${m.text()}`));
  page.on("pageerror", (e) => words.push(`error: ${e.message}`));
  page.on("request", (r) => /^(file|data|blob):/.test(r.url()) || words.push(`asks for ${r.url()}`));
  const expect = (what, holds) => holds || words.push(`expected: ${what}`);
  const shot = (part) => page.screenshot({ path: file.replace(/\.html$/, "") + `.${name}.${part}.png` });
  const view = async () => Buffer.from(await (await page.$("#view")).screenshot()).toString("base64");
  const clock = () => page.$eval("#clock", (e) => e.textContent);

  const start = Date.now();
  await page.goto(pathToFileURL(file).href);
  const shown = page.waitForFunction(() => document.getElementById("clock").textContent !== "", { timeout: 60e3 });
  await shown.catch(async () => words.push(`no picture: ${await page.$eval("#message", (e) => e.textContent)}`));
  const seconds = (Date.now() - start) / 1000;
  expect(`the first picture within ${SECONDS} s, not ${seconds.toFixed(1)} s`, seconds < SECONDS);
  const first = await clock();
  await wait(1500);
  expect("the clock runs", (await clock()) !== first);

  await page.keyboard.press("Home");
  await wait(500);
  const still = await view();
  expect("a paused picture stands still", still === (await view()));
  await shot("start");
  const plot = await (await page.$("#plot")).boundingBox();
  await page.mouse.click(plot.x + plot.width * 0.6, plot.y + plot.height / 2);
  await wait(500);
  expect("another picture after a click into the plot", (await view()) !== still);
  for (const [key, part] of [["m", "markers"], ["w", "wireframe"], ["c", "residual"], ["s", "stretch"]]) {
    const before = await view();
    await page.keyboard.press(key);
    await wait(800);
    expect(`another picture after the key ${key}`, (await view()) !== before);
    await shot(part);
    if (key === "m" || key === "w") await page.keyboard.press(key);
  }
  const before = await view();
  await page.mouse.move(500, 300);
  await page.mouse.down();
  await page.mouse.move(700, 320, { steps: 4 });
  await page.mouse.up();
  await page.mouse.wheel({ deltaY: -300 });
  await wait(500);
  expect("another picture after a drag", (await view()) !== before);
  if (name === "chromium") await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: "dark" }]);
  await wait(800);
  await shot("turned");
  console.log(`${name}  ${file}: first picture after ${seconds.toFixed(1)} s, ${words.length === 0 ? "plays, console empty" : "FAILS"}`);
  words.forEach((w) => console.log(`  ${w}`));
  await page.close();
  return words.length === 0;
}

(async () => {
  const [name, executablePath, ...files] = process.argv.slice(2);
  const chromium = name === "chromium";
  const browser = await puppeteer.launch({
    browser: chromium ? "chrome" : "firefox",
    executablePath,
    // Firefox has WebGL on a display only, which may be a virtual one.
    headless: chromium,
    args: chromium ? ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"] : [],
    extraPrefsFirefox: { "webgl.force-enabled": true },
    protocolTimeout: 300e3,
  });
  let good = true;
  for (const file of files) good = (await check(browser, name, file)) && good;
  await browser.close();
  process.exitCode = good ? 0 : 1;
})();
