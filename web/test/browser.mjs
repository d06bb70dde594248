// The player in a browser, as a person uses it, on a scene that `tcgs demo` made. Run:
//   npm ci --prefix web
//   TCGS=target/release/tcgs SCENE=tcgs-demo/scene.tcgs xvfb-run -a node --test web/test/browser.mjs
// SHOTS=FOLDER keeps pictures of the window. The tests need Debian's chromium, and a tcgs that contains the page. A software
// GPU takes about a second for a frame, so windows are small, and tests that fit any scene use a tiny one.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { pathToFileURL } from "node:url";

import { compare, drop, launch, plyOfSpheres, serve, settled, watchedPage } from "./support.mjs";

const { TCGS = "target/release/tcgs", SCENE = "tcgs-demo/scene.tcgs", SHOTS } = process.env;
const bytes = readFileSync(SCENE);
const TINY = new URL("../../testdata/bitstream/v1/room_default.tcgs", import.meta.url).pathname;
const ENGINE = new URL("engine.mjs", import.meta.url).pathname;
const EXACT = "quality=fixed&dpr=1&autoplay=0&trust=0";
/** Timeout of everything that waits: machines that run tests are slow and busy. */
const PATIENCE_MS = 240_000;

/** In `plain` WebGPU finds no graphics card. */
let browser, plain, server, tiny, scratch;

before(async () => {
  scratch = mkdtempSync(join(tmpdir(), "tcgs-web-"));
  if (SHOTS) mkdirSync(SHOTS, { recursive: true });
  const starts = [launch(), launch({ webgpu: false }), serve(TCGS, SCENE), serve(TCGS, TINY)];
  [browser, plain, server, tiny] = await Promise.all(starts);
});

after(async () => {
  await browser?.close();
  await plain?.close();
  server?.stop();
  tiny?.stop();
  rmSync(scratch, { recursive: true, force: true });
});

/**
 * Opens the page. An error in its scripts fails the test. `standIn`: with the stand-in for the engine, which is fast.
 * `prepare`: gets the browser's context before the page is opened. `webgpu`: whether it works; "missing": not even known.
 */
async function open(t, query = EXACT, { from = tiny, script, standIn = false, prepare, webgpu = true, ...options } = {}) {
  const viewport = { width: 480, height: 300 };
  const context = await (webgpu === true ? browser : plain).newContext({ viewport, colorScheme: "dark", reducedMotion: "reduce", ...options });
  context.setDefaultTimeout(PATIENCE_MS);
  await prepare?.(context);
  const page = await watchedPage(t, context);
  if (script) await page.addInitScript(script);
  if (webgpu === "missing") {
    await page.addInitScript(() => Object.defineProperty(Navigator.prototype, "gpu", { get: () => undefined }));
  }
  if (standIn) await page.route("**/engine*/tcgs_play.js", (route) => route.fulfill({ path: ENGINE, contentType: "text/javascript" }));
  await page.goto(`${from.address}${query.includes("html") ? query : `?${query}`}`);
  return page;
}

async function loaded(page) {
  await page.waitForSelector("body.has-scene");
  await settled(page);
  return page;
}

async function shot(page, name) {
  if (SHOTS) writeFileSync(join(SHOTS, `${name}.png`), await page.screenshot());
}

const frameNumber = (page) => page.textContent("#frame-number");

/** By the timeline: a software GPU would draw every timestep on the way of the keys. */
async function goTo(page, timestep) {
  await page.evaluate((value) => {
    const timeline = document.querySelector("#timeline");
    timeline.value = String(value);
    timeline.dispatchEvent(new Event("input", { bubbles: true }));
  }, timestep);
  return settled(page);
}

/** Waits until no message covers a part of the picture. */
const silent = (page) => page.waitForSelector("#toast:not(.shown)", { state: "attached" });

/** Pictures of `tcgs render`, one a frame, along a path in a file. */
function rendered(path, size, scene = SCENE) {
  const out = mkdtempSync(join(scratch, "frames-"));
  const options = ["--path", path, "--size", size, "--out", out, "--backend", "cpu"];
  execFileSync(TCGS, ["render", scene, ...options], { stdio: ["ignore", "ignore", "inherit"] });
  return (timestep) => readFileSync(join(out, `${String(timestep).padStart(6, "0")}.png`));
}

test("the scene shows, plays, and holds still when told", async (t) => {
  const page = await open(t, "quality=fixed&dpr=1&stats=1", { from: server, viewport: { width: 480, height: 300 } });
  await page.waitForSelector("body.has-scene");
  assert.equal(await page.getAttribute("#play", "aria-label"), "Pause", "it plays by itself");
  const first = await frameNumber(page);
  await page.waitForFunction((n) => document.querySelector("#frame-number").textContent !== n, first);
  await page.keyboard.press("Space");
  const still = await settled(page);
  await shot(page, "playing");
  assert.match(await page.textContent("#stat-drawn"), /^\d{1,3}(\u202f\d{3})*$/);
  assert.match(await page.textContent("#stat-bytes"), /^\d.* of \d/);
  assert.equal(await page.textContent("#stat-size"), "480 × 300");
  assert.match(await page.title(), /^capture /);
  await page.waitForTimeout(400);
  assert.ok((await compare(page, still, await settled(page))).near === 1, "paused is paused");
});

test("the timeline scrubs", async (t) => {
  const page = await loaded(await open(t));
  const frames = (await frameNumber(page)).match(/^1 \/ (\d+)$/);
  assert.ok(frames, await frameNumber(page));
  const count = Number(frames[1]);
  const start = await settled(page);
  const { x, y, width, height } = await page.locator("#timeline").boundingBox();
  await page.mouse.move(x + 8, y + height / 2);
  await page.mouse.down();
  for (const share of [0.2, 0.5, 0.8]) await page.mouse.move(x + share * width, y + height / 2, { steps: 3 });
  await page.mouse.up();
  const late = await settled(page);
  const reached = Number((await frameNumber(page)).split(" ")[0]);
  assert.ok(reached > 0.7 * count && reached < 0.9 * count, `${reached} of ${count}`);
  assert.ok((await compare(page, late, start)).near < 0.998);
  await page.keyboard.press("Home");
  await page.keyboard.press(".");
  await page.keyboard.press(".");
  await page.keyboard.press(",");
  await settled(page);
  assert.equal(await frameNumber(page), `2 / ${count}`);
  await page.keyboard.press("End");
  await settled(page);
  assert.equal(await frameNumber(page), `${count} / ${count}`);
});

test("mouse and keys move the camera, and R brings it back", async (t) => {
  const page = await loaded(await open(t));
  await page.focus("#canvas");
  const home = await settled(page);
  const drag = async (button) => {
    await page.mouse.move(300, 150);
    await page.mouse.down({ button });
    await page.mouse.move(340, 170, { steps: 2 });
    await page.mouse.up({ button });
  };
  const holding = async (key, action) => {
    await page.keyboard.down(key);
    await action();
    await page.keyboard.up(key);
  };
  const hold = (key) => holding(key, () => page.waitForTimeout(300));
  const moves = {
    orbit: () => drag("left"),
    pan: () => drag("right"),
    look: () => holding("Alt", () => drag("left")),
    zoom: () => page.mouse.wheel(0, -300),
    fly: () => hold("w"),
    "orbit by keys": () => hold("ArrowLeft"),
    "pan by keys": () => holding("Shift", () => hold("ArrowLeft")),
    "zoom by keys": () => hold("+"),
  };
  let before = home;
  for (const [name, move] of Object.entries(moves)) {
    await move();
    const after = await settled(page);
    const { near } = await compare(page, after, before);
    assert.ok(near < 0.998, `${name} changes the picture: ${near} of it is the same`);
    before = after;
  }
  await page.keyboard.press("r");
  const { near } = await compare(page, await settled(page), home);
  assert.ok(near > 0.9999, `back: ${near}`);
});

test("an edge shows what no camera saw, and the camera is led back from there, unless key G switches both off", async (t) => {
  const page = await loaded(await open(t, "quality=fixed&dpr=1&autoplay=0", { from: server, viewport: { width: 240, height: 180 } }));
  const edge = () => page.evaluate(() => Number(document.querySelector("#edge").style.opacity));
  assert.equal(await edge(), 0);
  const lookFromAbove = async () => {
    await page.mouse.move(150, 20);
    await page.mouse.down();
    await page.mouse.move(150, 140, { steps: 3 });
    await settled(page);
    const shown = await edge();
    if (shown > 0) await shot(page, "edge");
    await page.mouse.up();
    return { shown, picture: await settled(page) };
  };
  const led = await lookFromAbove();
  assert.ok(led.shown > 0.3, `the edge is seen: ${led.shown}`);
  assert.equal(await edge(), 0, "after the drag the camera was led back");
  await page.keyboard.press("r");
  await page.keyboard.press("g");
  const left = await lookFromAbove();
  assert.equal(left.shown, 0);
  assert.ok((await compare(page, left.picture, led.picture)).near < 0.998);
  await page.keyboard.press("g");
  assert.ok((await compare(page, await settled(page), led.picture)).near > 0.95, "switched on again, it leads back to the same place");
});

test("a finger turns, two fingers zoom, on a phone on which everything fits", async (t) => {
  const phone = { viewport: { width: 360, height: 640 }, deviceScaleFactor: 2, hasTouch: true, isMobile: true };
  const page = await loaded(await open(t, EXACT, phone));
  await shot(page, "phone");
  const outside = await page.evaluate(() =>
    [...document.querySelectorAll("#dock button, #dock select")]
      .filter((control) => control.checkVisibility())
      .filter((control) => {
        const { left, right, top, bottom } = control.getBoundingClientRect();
        return left < 0 || right > innerWidth || top < 0 || bottom > innerHeight;
      })
      .map((control) => control.id),
  );
  assert.deepEqual(outside, []);
  const home = await settled(page);
  const session = await page.context().newCDPSession(page);
  const touch = async (...positions) => {
    const send = (type, touchPoints) => session.send("Input.dispatchTouchEvent", { type, touchPoints });
    await send("touchStart", positions[0]);
    for (const points of positions.slice(1)) await send("touchMove", points);
    await send("touchEnd", []);
  };
  await touch([{ x: 100, y: 300 }], [{ x: 130, y: 300 }], [{ x: 180, y: 310 }]);
  const turned = await settled(page);
  assert.ok((await compare(page, turned, home)).near < 0.998);
  const fingers = (apart) => [{ x: 180 - apart, y: 300, id: 1 }, { x: 180 + apart, y: 300, id: 2 }];
  await touch(fingers(30), fingers(45), fingers(70));
  assert.ok((await compare(page, await settled(page), turned)).near < 0.998);
  await page.tap("#views");
  await settled(page);
  await shot(page, "phone-views");
});

/** The page's picture is that of `tcgs render`. @param {boolean} webgpu whether the browser has it */
async function agree(t, page, found, expected, what, { webgpu, covers }) {
  const { near, far, mean, covered } = await compare(page, found, expected);
  t.diagnostic(`${what}: ${mean.toFixed(3)} of 255 on average, ${(100 * far).toFixed(3)} % of the pixels off by more than 8, ${(100 * covered).toFixed(0)} % covered`);
  assert.ok(covered >= covers, `${what}: the scene covers ${covered}`);
  if (webgpu) assert.ok(near >= 0.99, `${what}: ${near} of the pixels within 3`);
  assert.ok(mean <= 1 && far <= 0.001, `${what}: ${mean} on average, ${far} far`);
}

for (const [renderer, webgpu] of Object.entries({ WebGPU: true, WebGL2: false })) {
  test(`what ${renderer} shows is what tcgs renders, at views and between them`, async (t) => {
    const options = { from: server, viewport: { width: 192, height: 144 }, webgpu };
    const page = await loaded(await open(t, `${EXACT}&controls=0`, options));
    // A path as a person makes it: views from three sides at three times, saved to a file.
    const turn = async (dx, dy) => {
      await page.mouse.move(96, 72);
      await page.mouse.down();
      await page.mouse.move(96 + dx, 72 + dy);
      await page.mouse.up();
    };
    await page.keyboard.press("k");
    await goTo(page, 6);
    await turn(50, 10);
    await page.keyboard.press("k");
    await goTo(page, 14);
    await turn(40, -25);
    await page.mouse.wheel(0, -120);
    await page.keyboard.press("k");
    const file = join(scratch, "camera-path.json");
    const download = page.waitForEvent("download");
    await page.evaluate(() => document.querySelector("#path-save").click());
    await (await download).saveAs(file);
    const path = JSON.parse(readFileSync(file, "utf8"));
    assert.deepEqual(path.cameras.map((camera) => camera.timestep), [0, 6, 14]);
    assert.deepEqual([path.cameras[0].width, path.cameras[0].height], [192, 144]);

    // A path that is dropped on the page is followed.
    await drop(page, "camera-path.json", readFileSync(file));
    await silent(page);
    const expected = rendered(file, "192x144");
    for (const timestep of [0, 3, 6, 20]) {
      const found = await goTo(page, timestep);
      if (SHOTS) writeFileSync(join(SHOTS, `path-${renderer}-${timestep}.png`), found);
      await agree(t, page, found, expected(timestep), `timestep ${timestep}`, { webgpu, covers: 0.5 });
    }

    // A still shows what the page shows.
    const still = page.waitForEvent("download");
    await page.keyboard.press("p");
    const saved = await still;
    assert.match(saved.suggestedFilename(), /-0021\.png$/);
    await saved.saveAs(join(scratch, "still.png"));
    await agree(t, page, readFileSync(join(scratch, "still.png")), expected(20), "the still", { webgpu, covers: 0.5 });
  });

  test(`Gaussians of another program that shine, come and go show in ${renderer} as tcgs renders them`, async (t) => {
    const folder = mkdtempSync(join(scratch, "plys-"));
    const counts = [500, 560, 530, 500];
    counts.forEach((count, timestep) => writeFileSync(join(folder, `${timestep}.ply`), plyOfSpheres(count, timestep)));
    const scene = join(scratch, `of-plys-${renderer}.tcgs`);
    execFileSync(TCGS, ["compress", folder, "--out", scene], { stdio: ["ignore", "ignore", "inherit"] });
    const server = await serve(TCGS, scene);
    t.after(() => server.stop());
    const options = { from: server, viewport: { width: 192, height: 144 }, webgpu };
    const page = await loaded(await open(t, `${EXACT}&controls=0`, options));
    await page.keyboard.press("k");
    await page.mouse.move(96, 72);
    await page.mouse.down();
    await page.mouse.move(176, 92);
    await page.mouse.up();
    await goTo(page, 3);
    await page.keyboard.press("k");
    const file = join(scratch, "around.json");
    const download = page.waitForEvent("download");
    await page.evaluate(() => document.querySelector("#path-save").click());
    await (await download).saveAs(file);
    await drop(page, "around.json", readFileSync(file));
    await silent(page);
    const expected = rendered(file, "192x144", scene);
    for (const timestep of [0, 1, 2, 3, 1]) {
      const found = await goTo(page, timestep);
      if (SHOTS) writeFileSync(join(SHOTS, `of-plys-${renderer}-${timestep}.png`), found);
      await agree(t, page, found, expected(timestep), `timestep ${timestep}`, { webgpu, covers: 0.2 });
    }
    // What moves and what comes, and from where it is seen, is to be seen.
    const { near } = await compare(page, expected(0), expected(3));
    assert.ok(near < 0.9, `timesteps 0 and 3: ${near} alike`);
  });
}

test("credits show, frames come at their times, and a sound plays along", async (t) => {
  const file = (name, content) => {
    writeFileSync(join(scratch, name), content);
    return join(scratch, name);
  };
  const folder = mkdtempSync(join(scratch, "timed-"));
  for (let timestep = 0; timestep < 4; timestep++) writeFileSync(join(folder, `${timestep}.ply`), plyOfSpheres(300, timestep));
  const sound = join(scratch, "tone.opus");
  const tone = ["-f", "lavfi", "-i", "sine=frequency=440:duration=30", "-c:a", "libopus", "-b:a", "96k", sound];
  execFileSync("ffmpeg", ["-v", "error", "-y", ...tone]);
  const scene = join(scratch, "attached.tcgs");
  const credits = { licence: "CC-BY-4.0", authors: ["<b>A. Author</b>"], source: "https://example.org/capture" };
  const attached = [
    `credits=${file("credits.json", JSON.stringify(credits))}`,
    `times=${file("times.json", '{ "seconds": [0, 0.5, 20, 25] }')}`,
    `sound=${sound}`,
  ];
  // Sounds are longer than what comes with the start of a file.
  assert.ok(readFileSync(sound).length > 1 << 18);
  execFileSync(TCGS, ["compress", folder, "--out", scene, ...attached.flatMap((word) => ["--attach", word])]);
  const server = await serve(TCGS, scene);
  t.after(() => server.stop());
  const query = "quality=fixed&dpr=1&autoplay=0";
  const script = () => {
    const { play } = HTMLMediaElement.prototype;
    HTMLMediaElement.prototype.play = function () {
      window.audio = this;
      return play.call(this);
    };
  };
  const page = await loaded(await open(t, query, { from: server, viewport: { width: 320, height: 240 }, script }));
  assert.equal(await page.textContent("#credits"), "<b>A. Author</b> · CC-BY-4.0 · example.org");
  assert.equal(await page.getAttribute("#credits a", "href"), "https://example.org/capture");
  await page.waitForSelector("#mute:not([hidden])");
  await goTo(page, 2);
  assert.equal(await page.textContent("#seconds"), "20.00 s");
  await page.keyboard.press("Space");
  await page.waitForFunction(() => window.audio && !window.audio.paused && window.audio.currentTime >= 20);
  await page.keyboard.press("m");
  assert.ok(await page.evaluate(() => window.audio.muted));
  await page.keyboard.press("Space");
  await page.waitForFunction(() => window.audio.paused);
  await shot(page, "attached");
});

test("bad files are told apart, and a good one opens after them", async (t) => {
  const page = await open(t, `${EXACT}&src=missing.tcgs`);
  const failure = async (title) => {
    await page.waitForFunction(
      (text) => document.querySelector("#failure:not([hidden]) #failure-title")?.textContent === text,
      title,
    );
  };
  await failure("The scene could not be loaded");
  assert.ok(await page.isVisible("#failure-retry"));

  await drop(page, "holiday.tcgs", Buffer.from("not a scene at all, but some text"));
  await failure("This is not a .tcgs scene");
  await drop(page, "half.tcgs", bytes.subarray(0, bytes.length / 2));
  await failure("The scene is incomplete");
  const newer = Buffer.from(bytes);
  newer.writeUInt16LE(77, 4);
  await drop(page, "newer.tcgs", newer);
  await failure("The scene is newer than this player");
  const damaged = Buffer.from(bytes);
  for (let at = 4000; at < damaged.length; at += 1000) damaged[at] ^= 0x5a;
  await drop(page, "damaged.tcgs", damaged);
  await failure("The scene is damaged");
  await shot(page, "damaged");

  await drop(page, "scene.tcgs", bytes);
  await loaded(page);
  assert.ok(!(await page.isVisible("#failure")) && (await page.isVisible("#dock")));
});

test("a scene without antialiasing shows in WebGL2 as tcgs renders it", async (t) => {
  // A .4dgs file does not say that its splats are antialiased.
  const [plain, scene] = ["plain.4dgs", "plain.tcgs"].map((name) => join(scratch, name));
  execFileSync(TCGS, ["export", SCENE, "--frames", "0..10", "--to", plain], { stdio: "ignore" });
  execFileSync(TCGS, ["compress", plain, "--out", scene], { stdio: "ignore" });
  const server = await serve(TCGS, scene);
  t.after(() => server.stop());
  const options = { from: server, viewport: { width: 320, height: 240 }, webgpu: false };
  const page = await loaded(await open(t, `${EXACT}&controls=0`, options));
  await page.keyboard.press("k");
  const file = join(scratch, "plain.json");
  const download = page.waitForEvent("download");
  await page.evaluate(() => document.querySelector("#path-save").click());
  await (await download).saveAs(file);
  const expected = rendered(file, "320x240", scene);
  await silent(page);
  for (const timestep of [0, 9]) {
    await agree(t, page, await goTo(page, timestep), expected(timestep), `timestep ${timestep}`, { webgpu: false, covers: 0.9 });
  }
});

const renderer = async (page) => {
  if (!(await page.isVisible("#stats"))) await page.keyboard.press("i");
  // The next frame fills the statistics in.
  await page.waitForFunction(() => document.querySelector("#stat-renderer").textContent !== "");
  return page.textContent("#stat-renderer");
};
/** Paths of the modules of WebAssembly that a page asks for. */
const modules = (page) => {
  const asked = [];
  page.on("request", (request) => /engine/.test(request.url()) && asked.push(new URL(request.url()).pathname));
  return asked;
};
const said = (page, text) => page.waitForFunction((t) => document.querySelector("#toast").textContent.includes(t), text);

test("a page loads one renderer: the better one that works, or the one of its address", async (t) => {
  for (const [query, webgpu, name, folder] of [
    [EXACT, true, "WebGPU", "engine"],
    [EXACT, "missing", "WebGL2", "engine-webgl2"],
    [`${EXACT}&renderer=webgl2`, true, "WebGL2", "engine-webgl2"],
  ]) {
    const asked = [];
    const prepare = (context) => context.on("page", (page) => asked.push(modules(page)));
    const page = await loaded(await open(t, `${query}&stats=1`, { webgpu, prepare }));
    assert.equal(await renderer(page), name);
    assert.deepEqual([...new Set(asked[0].map((path) => path.split("/").at(-2)).filter((f) => f.startsWith("engine")))], [folder]);
    assert.equal(await page.textContent("#toast"), "", "nothing went wrong");
  }
  const page = await open(t, `${EXACT}&renderer=webgpu`, { webgpu: false });
  await page.waitForSelector("#failure[data-code=no-webgpu]:not([hidden])");
});

test("where WebGPU finds no graphics card, WebGL2 draws, and a line says so", async (t) => {
  const page = await open(t, EXACT, { webgpu: false });
  await said(page, "WebGPU finds no graphics card: drawing with WebGL2 now");
  await loaded(page);
  assert.equal(await renderer(page), "WebGL2");
});

test("a page that is one file opens from a disk, and loads nothing", async (t) => {
  const file = join(scratch, "scene.html");
  execFileSync(TCGS, ["export", TINY, "--to", file], { stdio: ["ignore", "ignore", "inherit"] });
  const expected = await settled(await loaded(await open(t, `${EXACT}&renderer=webgl2`, { webgpu: false })));
  const address = pathToFileURL(file).href;
  for (const webgpu of [true, false]) {
    const asked = [];
    const prepare = (context) => context.on("request", (request) => asked.push(request.url()));
    const page = await loaded(await open(t, `${EXACT}&stats=1`, { from: { address }, webgpu, prepare }));
    assert.equal(await page.textContent("#stat-renderer"), "WebGL2");
    assert.match(await page.title(), /^room/);
    assert.deepEqual(asked.filter((url) => !/^(blob|data):/.test(url)), [`${address}?${EXACT}&stats=1`]);
    await page.keyboard.press("i");
    const { near } = await compare(page, await settled(page), expected);
    assert.equal(near, 1);
    await shot(page, "one-file");
  }
});

test("a graphics card that is lost is not the end", async (t) => {
  const script = () => {
    const { requestDevice } = GPUAdapter.prototype;
    GPUAdapter.prototype.requestDevice = async function (...given) {
      return (window.device = await requestDevice.apply(this, given));
    };
  };
  const page = await loaded(await open(t, EXACT, { script }));
  await goTo(page, 3);
  await page.mouse.move(150, 120);
  await page.mouse.down();
  await page.mouse.move(230, 140);
  await page.mouse.up();
  const before = await settled(page);
  await page.evaluate(() => {
    window.device.destroy();
    window.dispatchEvent(new Event("resize"));
  });
  await page.keyboard.press("l");
  await said(page, "WebGPU has lost the graphics card: drawing with WebGL2 now");
  await page.waitForFunction(() => !document.querySelector("#toast").classList.contains("shown"));
  const { near } = await compare(page, await settled(page), before);
  assert.ok(near > 0.98, `the same view: ${near}`);
  assert.match(await frameNumber(page), /^4 /);
  assert.equal(await renderer(page), "WebGL2");
  // The new canvas hears the mouse.
  await page.mouse.move(150, 120);
  await page.mouse.down();
  await page.mouse.move(190, 140);
  await page.mouse.up();
  assert.ok((await compare(page, await settled(page), before)).near < 0.998);
});

test("a browser without WebGPU and WebGL2 is told so", async (t) => {
  const script = () => {
    const { getContext } = HTMLCanvasElement.prototype;
    HTMLCanvasElement.prototype.getContext = function (kind, ...given) {
      return kind === "webgl2" ? null : getContext.call(this, kind, ...given);
    };
  };
  const page = await open(t, EXACT, { script, webgpu: false });
  await page.waitForSelector("#failure:not([hidden])");
  assert.match(await page.textContent("#failure"), /cannot draw[\s\S]*WebGPU or WebGL2/);
});

test("a slow device draws fewer pixels while things move, all of them at rest", async (t) => {
  const slow = () => {
    const next = window.requestAnimationFrame.bind(window);
    const share = () => document.querySelector("#canvas").width / 1000;
    window.requestAnimationFrame = (draw) => next((now) => setTimeout(draw, 60 * share() ** 2, now));
  };
  for (const [query, script] of [["", undefined], ["&renderer=webgl2", slow]]) {
    const page = await open(t, `stats=1&dpr=1${query}`, { viewport: { width: 1000, height: 600 }, script });
    await page.waitForFunction(() => parseInt(document.querySelector("#stat-size").textContent) < 900);
    await page.evaluate(() => {
      const canvas = document.querySelector("#canvas");
      window.widths = [];
      const note = () => window.widths.push(canvas.width);
      new MutationObserver(note).observe(canvas, { attributes: true, attributeFilter: ["width"] });
    });
    await page.keyboard.press("Space");
    await page.waitForFunction(() => document.querySelector("#stat-size").textContent === "1000 × 600");
    await settled(page);
    const widths = await page.evaluate(() => window.widths);
    const sharp = widths.slice(widths.indexOf(1000));
    // Without the script nobody knows when the number of pixels changes before the pause.
    if (script) assert.ok(sharp.length > 0 && sharp.every((width) => width === 1000), `once sharp it stays sharp: ${widths}`);
  }
});

test("another page embeds the player and speaks with it", async (t) => {
  const page = await open(t, "example.html", { viewport: { width: 600, height: 500 } });
  await page.waitForFunction(() => /^frame /.test(document.querySelector("#said").textContent));
  const result = await page.evaluate(async () => {
    const { player } = window;
    const events = [];
    for (const name of ["pause", "timestep", "error"]) player.addEventListener(name, ({ detail }) => events.push([name, detail]));
    const until = async (check) => {
      for (let i = 0; i < 2000; i++) {
        if (check(await player.state())) return true;
        await new Promise((resolve) => setTimeout(resolve, 50));
      }
      return false;
    };
    await player.pause();
    const paused = await until((state) => !state.playing);
    await player.seek(5);
    const sought = await until((state) => state.timestep === 5);
    const info = await player.info();
    const camera = await player.camera();
    camera.cameraFromWorld[3] += 0.125;
    await player.setCamera(camera);
    const moved = await player.camera();
    const wrong = await player.setCamera({ fx: 1 }).then(() => "accepted", ({ code, text }) => `${code}: ${text}`);
    const missing = await player.load("missing.tcgs").then(() => "loaded", (error) => error.code);
    return { events, paused, sought, info, shift: moved.cameraFromWorld[3] - camera.cameraFromWorld[3], wrong, missing };
  });
  assert.ok(result.paused && result.sought);
  assert.ok(result.events.some(([name]) => name === "pause"));
  assert.ok(result.events.some(([name, detail]) => name === "timestep" && detail.timestep === 5));
  assert.ok(result.events.some(([name, detail]) => name === "error" && detail.code === "network"));
  assert.ok(result.info.numGaussians > 0 && result.info.numTimesteps > 5);
  assert.ok(Math.abs(result.shift) < 1e-9);
  assert.match(result.wrong, /^bad-camera: A camera needs width/);
  assert.equal(result.missing, "network");
});

test("an element opens what its attribute names, and passes events on", async (t) => {
  const page = await open(t, "example.html", { standIn: true });
  const heard = await page.evaluate(async () => {
    const element = document.createElement("tcgs-player");
    Object.assign(element, { id: "second", title: "A room" });
    element.setAttribute("src", "scene.tcgs");
    element.setAttribute("controls", "false");
    const next = (name) => new Promise((resolve) => element.addEventListener(name, ({ detail }) => resolve(detail), { once: true }));
    const loaded = next("load");
    document.body.append(element);
    const { numTimesteps } = await loaded;
    const again = next("load");
    element.setAttribute("src", "other.tcgs");
    await again;
    const { width, height } = element.getBoundingClientRect();
    const { title } = element.player.frame;
    element.remove();
    return { numTimesteps, shape: width / height, title, left: element.player };
  });
  assert.ok(heard.numTimesteps > 0 && Math.abs(heard.shape - 16 / 9) < 0.01);
  assert.deepEqual([heard.title, heard.left], ["A room", null]);
});

test("three.js shows a scene that moves", async (t) => {
  const page = await open(t, "example.html", { standIn: true });
  // Everything of the package, as a server of it would give it.
  const type = { html: "text/html", js: "text/javascript", wasm: "application/wasm", tcgs: "application/octet-stream" };
  await page.route("http://package.test/**", (route) => {
    const { pathname } = new URL(route.request().url());
    const path = pathname.endsWith("scene.tcgs") ? SCENE : new URL(`..${pathname}`, import.meta.url).pathname;
    return route.fulfill({ path, contentType: type[path.split(".").pop()] });
  });
  await page.goto("http://package.test/examples/three.html");
  const said = () => page.textContent("#said");
  await page.waitForFunction(() => /^frame /.test(document.querySelector("#said").textContent));
  const first = await said();
  await page.waitForFunction((text) => document.querySelector("#said").textContent !== text, first);
  if (SHOTS) await page.screenshot({ path: join(SHOTS, "three.png") });
  const lit = await page.evaluate(() => {
    const canvas = document.querySelector("canvas");
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
    return data.filter((value, i) => i % 4 === 0 && Math.abs(value - data[0]) > 30).length / (data.length / 4);
  });
  assert.ok(lit > 0.1, `${lit} of the picture differs from its corner`);
});

test("help opens and closes, menus and themes work, everything has a name", async (t) => {
  const page = await loaded(await open(t, EXACT, { viewport: { width: 800, height: 560 } }));
  const nameless = await page.evaluate(() =>
    [...document.querySelectorAll("button, input, select")]
      .filter((control) => !control.getAttribute("aria-label") && !control.textContent.trim() && !control.labels?.length)
      .map((control) => control.outerHTML),
  );
  assert.deepEqual(nameless, []);
  await page.keyboard.press("h");
  assert.ok(await page.isVisible("#help"));
  await settled(page);
  await shot(page, "help");
  await page.keyboard.press("Escape");
  assert.ok(!(await page.isVisible("#help")));
  await page.click("#more");
  await page.click("text=Light");
  await settled(page);
  await shot(page, "light");
  assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), "light");
  await page.click("#toggle-stats");
  assert.ok(await page.isVisible("#stats"));
  await page.reload();
  await loaded(page);
  assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), "light", "a choice is remembered");
});

test("without a scene the page says what to do", async (t) => {
  const page = await open(t);
  // The page as on a host that names no scene.
  await page.route(`${tiny.address}?bare&${EXACT}`, async (route) => {
    const response = await route.fetch();
    await route.fulfill({ response, body: (await response.text()).replace('content="/scene.tcgs"', 'content=""') });
  });
  await page.goto(`${tiny.address}?bare&${EXACT}`);
  await page.waitForSelector("#welcome:not([hidden])");
  await shot(page, "welcome");
  await page.fill("#link", `${tiny.address}scene.tcgs`);
  await page.click("#link-form button");
  await loaded(page);
});

test("addresses that are none, or are oddly written, leave a page that works", async (t) => {
  const page = await open(t, `${EXACT}&src=http://[`, { standIn: true });
  await page.waitForSelector("#failure:not([hidden])");
  assert.equal(await page.textContent("#failure-title"), "The scene could not be loaded");
  await page.goto(`${tiny.address}?${EXACT}&src=x/100%25.tcgs`);
  await loaded(page);
  assert.ok(await page.isVisible("#dock"));
  assert.equal(await page.textContent("#name"), "100%.tcgs");
});

test("a path that no camera can follow is left, and the scene stays", async (t) => {
  const page = await loaded(await open(t, EXACT, { standIn: true }));
  const said = (text) => page.waitForFunction((t) => document.querySelector("#toast").textContent.includes(t), text);
  const dropPath = (...matrices) => {
    const numbers = { width: 480, height: 300, fx: 300, fy: 300, cx: 240, cy: 150 };
    const cameras = matrices.map((cameraFromWorld, i) => ({ timestep: 8 * i, ...numbers, cameraFromWorld }));
    return drop(page, "path.json", Buffer.from(JSON.stringify({ format: "tcgs-camera-path", version: 1, cameras })));
  };
  await dropPath([2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 3, 0, 0, 0, 1]);
  await said("rotation");
  // Halfway between two opposite directions there is no camera.
  await dropPath([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1], [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 3, 0, 0, 0, 1]);
  await said("Following");
  await page.evaluate(() => {
    const timeline = document.querySelector("#timeline");
    timeline.value = "4";
    timeline.dispatchEvent(new Event("input"));
  });
  await said("breaks off");
  await settled(page);
  assert.ok(await page.isVisible("#dock"));
  assert.equal(await page.getAttribute("#path-follow", "aria-pressed"), "false");
});

test("a picture has the size that it had when it was taken, and one that fails is told", async (t) => {
  const page = await loaded(await open(t, EXACT, { standIn: true }));
  const start = async () => {
    await page.evaluate(() => {
      window.given.picture = new Promise((...ends) => ([window.given.finish, window.given.fail] = ends));
    });
    await page.keyboard.press("p");
  };
  await start();
  await page.setViewportSize({ width: 500, height: 320 });
  await settled(page);
  const download = page.waitForEvent("download");
  await page.evaluate(() => window.given.finish());
  assert.equal((await download).suggestedFilename(), "scene-0001.png");
  assert.match(await page.textContent("#toast"), /480 × 300/);
  await start();
  await page.evaluate(() => window.given.fail(new Error("another scene was opened")));
  await page.waitForFunction(() => /^No picture.*another scene/.test(document.querySelector("#toast").textContent));
});

test("the timeline plays on when it is let go, and tells of each scene anew", async (t) => {
  const page = await loaded(await open(t, EXACT, { standIn: true }));
  assert.equal(await frameNumber(page), "1 / 24");
  await page.keyboard.press("Space");
  await page.waitForSelector("#play[aria-label=Pause]");
  const { x, y, height } = await page.locator("#timeline").boundingBox();
  // A click on the thumb, which moves nothing.
  await page.mouse.move(x + height / 2, y + height / 2);
  await page.mouse.down();
  await page.waitForSelector("#play[aria-label=Play]");
  await page.mouse.up();
  await page.waitForSelector("#play[aria-label=Pause]");
  await page.keyboard.press("Space");
  await page.waitForSelector("#play[aria-label=Play]");
  await page.evaluate(() => (window.given.timesteps = 7));
  await drop(page, "other.tcgs", Buffer.from("another scene"));
  await page.waitForFunction(() => document.querySelector("#frame-number").textContent === "1 / 7");
});

test("in the narrowest windows all controls of playback are within reach", async (t) => {
  const page = await open(t, EXACT, { standIn: true, viewport: { width: 280, height: 480 }, hasTouch: true, isMobile: true });
  await page.waitForSelector("body.has-scene");
  // As of a scene with a sound.
  await page.evaluate(() => (document.querySelector("#mute").hidden = false));
  const boxes = await page.$$eval("#dock button, #dock select", (all) =>
    all.filter((control) => control.checkVisibility()).map((control) => [control.id, control.getBoundingClientRect().toJSON()]),
  );
  assert.equal(boxes.length, 7);
  const outside = boxes.filter(([, { left, right, bottom }]) => left < 12 || right > 268 || bottom > 480);
  assert.deepEqual(outside, []);
  const overlaps = boxes.flatMap(([a, p], i) =>
    boxes.slice(i + 1).filter(([, q]) => p.left < q.right && q.left < p.right && p.top < q.bottom && q.top < p.bottom).map(([b]) => [a, b]),
  );
  assert.deepEqual(overlaps, []);
  await shot(page, "narrow");
});

test("cameras of a capture are drawn where they are, and key C hides them", async (t) => {
  const numbers = { width: 480, height: 300, fx: 300, fy: 300, cx: 240, cy: 150 };
  const at = (x, z) => ({ ...numbers, cameraFromWorld: [1, 0, 0, -x, 0, 1, 0, 0, 0, 0, 1, -z, 0, 0, 0, 1] });
  const image = "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' width='16' height='10'/%3E";
  // One where the viewer is, one a unit to the right, one behind the viewer.
  const cameras = [at(0, 0), at(1, 0), at(0, -2)].map((camera, i) => ({ ...camera, name: `cam${i}`, image }));
  const file = { depth: 1, start: at(0, 0), cameras };
  const give = (body) => (context) => context.route("**/cameras.json", (route) => route.fulfill({ json: body }));
  const shown = async (body) => {
    const page = await open(t, `${EXACT}&cameras=cameras.json`, { standIn: true, prepare: give(body) });
    await page.waitForSelector("body.has-scene");
    return page;
  };
  const page = await shown(file);
  await page.waitForSelector("#frusta[data-cameras='3']");
  await settled(page);
  const boxes = await page.evaluate(() =>
    [...document.querySelectorAll("#frusta img")].map((image) => {
      const { left, top, width, height } = image.getBoundingClientRect();
      return image.hidden ? null : [left, top, width, height].map(Math.round);
    }),
  );
  assert.deepEqual(boxes, [[0, 0, 480, 300], [300, 0, 480, 300], null]);
  assert.deepEqual(await page.$$eval("#frusta img", (all) => all.map((image) => image.classList.contains("through"))), [true, false, false]);
  // The left side of the second one's image, and its apex far outside on the right.
  const ink = () =>
    page.evaluate(() => {
      const { data } = document.querySelector("#frusta-lines").getContext("2d").getImageData(299, 100, 3, 1);
      return Math.max(...data);
    });
  assert.ok((await ink()) > 100, "lines");
  await page.keyboard.press("c");
  assert.equal(await page.locator("#frusta img:not([hidden])").count(), 0, "without images");
  assert.ok((await ink()) > 100, "lines");
  await page.keyboard.press("c");
  assert.ok(await page.isHidden("#frusta"));
  await page.keyboard.press("c");
  assert.equal(await page.locator("#frusta img:not([hidden])").count(), 2);
  // They are of the scene that was opened first.
  await drop(page, "other.tcgs", Buffer.from("another scene"));
  await page.waitForSelector("#frusta[data-cameras='0']", { state: "attached" });
  assert.ok(await page.isHidden("#toggle-frusta"));

  const wrong = await shown({ cameras: [{ name: "no camera" }] });
  await wrong.waitForFunction(() => /cannot be shown/.test(document.querySelector("#toast").textContent));
});

test("tcgs view shows a capture: its points, and its cameras with their images", async (t) => {
  const capture = await serve(TCGS, join(dirname(SCENE), "capture"));
  t.after(() => capture.stop());
  const page = await open(t, EXACT, { from: capture });
  await page.waitForSelector("#frusta:not([data-cameras='0'])");
  await loaded(page);
  await shot(page, "capture");
  const images = await page.$$eval("#frusta img", (all) => all.map((image) => [image.complete, image.naturalWidth > 0]));
  assert.ok(images.length > 8 && images.every(([complete, decoded]) => complete && decoded), JSON.stringify(images));
  const count = await page.locator("#cameras button").count();
  assert.equal(count, images.length, "each camera is a view");
  const inside = await page.evaluate(() =>
    [...document.querySelectorAll("#frusta img:not([hidden])")].filter((image) => {
      const { left, top, right, bottom } = image.getBoundingClientRect();
      return right > 0 && bottom > 0 && left < innerWidth && top < innerHeight;
    }).length,
  );
  assert.equal(inside, images.length, "all are in sight");
});
