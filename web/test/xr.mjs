// The player in a headset, which npm's iwer emulates in Chromium: a window shows the pictures of both eyes side by side. Run as
// browser.mjs.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";

import { compare, launch, serve, settled, watchedPage } from "./support.mjs";

const { TCGS = "target/release/tcgs", SCENE = "tcgs-demo/scene.tcgs", SHOTS } = process.env;
const IWER = new URL("../node_modules/iwer/build/iwer.min.js", import.meta.url).pathname;
const PATIENCE_MS = 120_000;
/** Distance of the eyes, metres; the height of the head. */
const [EYES, HEIGHT] = [0.063, 1.6];
/** Pixels along a side of an eye's picture, which shows 90 degrees. */
const SIDE = 320;
const FOCAL = SIDE / 2;
/** Length of a unit of the scene of dots, metres. */
const UNIT = 0.5;
/** Places of its dots in its axes, of which -y is up. The lowest one is the ground. All sway. */
const DOTS = { red: [0, -2.4, 0], green: [1, 0, 2], blue: [-2.4, -3, 6] };
/** Gaussians of a dot. */
const EACH = 36;

let browser, server, dots, scratch;

before(async () => {
  scratch = mkdtempSync(join(tmpdir(), "tcgs-xr-"));
  if (SHOTS) mkdirSync(SHOTS, { recursive: true });
  [browser, server, dots] = await Promise.all([launch(), serve(TCGS, SCENE), serve(TCGS, sceneOfDots())]);
});

after(async () => {
  await browser?.close();
  server?.stop();
  dots?.stop();
  rmSync(scratch, { recursive: true, force: true });
});

/** A scene of three dots, whose file says how large it is. The red one rises and sinks. */
function sceneOfDots() {
  const folder = mkdtempSync(join(scratch, "dots-"));
  const names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
  names.push("rot_0", "rot_1", "rot_2", "rot_3");
  const header = ["ply", "format binary_little_endian 1.0", `element vertex ${3 * EACH}`];
  header.push(...names.map((name) => `property float ${name}`), "end_header", "");
  for (let timestep = 0; timestep < 20; timestep++) {
    const rows = Object.values(DOTS).flatMap(([x, y, z], i) => {
      const shift = 0.2 * Math.sin((2 * Math.PI * timestep) / 20);
      const color = [0, 1, 2].map((c) => (c === i ? 1.7 : -1.7));
      const size = Math.log(0.02);
      // Level discs.
      return Array.from({ length: EACH }, (_, k) => {
        const [angle, radius] = [(2 * Math.PI * k) / EACH, 0.015 * (1 + (k % 3))];
        const place = [x + shift + radius * Math.cos(angle), y, z + radius * Math.sin(angle)];
        return [...place, ...color, 4, size, size, size, 1, 0, 0, 0];
      }).flat();
    });
    const bytes = Buffer.concat([Buffer.from(header.join("\n")), Buffer.from(new Float32Array(rows).buffer)]);
    writeFileSync(join(folder, `${String(timestep).padStart(2, "0")}.ply`), bytes);
  }
  const units = join(scratch, "units.json");
  writeFileSync(units, JSON.stringify({ metres_per_unit: UNIT }));
  const scene = join(scratch, "dots.tcgs");
  const options = ["--out", scene, "--up=-y", "--attach", `units=${units}`];
  execFileSync(TCGS, ["compress", folder, ...options], { stdio: ["ignore", "ignore", "inherit"] });
  return scene;
}

/** Where the dots stand in the room, metres: x right, y up, z back of the start view, which is the page's. */
async function standing(page) {
  await page.keyboard.press("k");
  const download = page.waitForEvent("download");
  await page.evaluate(() => document.querySelector("#path-save").click());
  const [{ cameraFromWorld: m }] = JSON.parse(readFileSync(await (await download).path())).cameras;
  const center = [0, 1, 2].map((j) => -(m[j] * m[3] + m[4 + j] * m[7] + m[8 + j] * m[11]));
  const [ahead, across] = [m[8], m[10]].map((v) => v / Math.hypot(m[8], m[10]));
  return Object.fromEntries(
    Object.entries(DOTS).map(([color, [x, y, z]]) => {
      const [dx, dz] = [x - center[0], z - center[2]];
      return [color, [UNIT * (across * dx - ahead * dz), -UNIT * y, -UNIT * (ahead * dx + across * dz)]];
    }),
  );
}

/** Opens the page with a headset on. An error in its scripts fails the test. */
async function open(t, { from = dots, query = "autoplay=0&renderer=webgl2", side = SIDE } = {}) {
  const viewport = { width: 2 * side, height: side };
  const context = await browser.newContext({ viewport, colorScheme: "dark", reducedMotion: "reduce" });
  context.setDefaultTimeout(PATIENCE_MS);
  const page = await watchedPage(t, context);
  await page.addInitScript({ path: IWER });
  await page.addInitScript((ipd) => {
    const { XRDevice, metaQuest3 } = globalThis.IWER;
    // Hands are where their controllers are.
    const identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
    for (const layout of Object.values(metaQuest3.controllerConfig.layout)) layout.gripOffsetMatrix = identity;
    globalThis.headset = new XRDevice(metaQuest3, { stereoEnabled: true, ipd, visibilityMask: null });
    globalThis.headset.installRuntime({ forceInstall: true });
    // Ten frames a second leave a software GPU time for all else.
    const next = globalThis.requestAnimationFrame;
    globalThis.requestAnimationFrame = (draw) => setTimeout(() => next(draw), 100);
    // The emulator cancels its last frame: the number of a timer may be that of a frame of the page.
    globalThis.cancelAnimationFrame = clearTimeout;
  }, EYES);
  await page.goto(`${from.address}?quality=fixed&dpr=1&${query}`);
  await page.waitForSelector("body.has-scene");
  return page;
}

const inVr = (page) => page.evaluate(() => Boolean(document.querySelector("[data-webxr_runtime]")));

async function enter(page) {
  await page.click("#vr[title='Enter VR']");
  await page.waitForSelector("[data-webxr_runtime] canvas");
  for (;;) {
    const picture = await seen(page);
    if ((await compare(page, picture, picture)).covered > 0) return picture;
  }
}

async function leave(page) {
  await page.evaluate(() => document.querySelector("#vr[title='Leave VR']").click());
  await page.waitForSelector("#vr[title='Enter VR']");
  assert.equal(await inVr(page), false);
}

/** Lets the headset draw some frames. */
const frames = (page) =>
  page.evaluate(async () => {
    for (let i = 0; i < 3; i++) await new Promise((resolve) => requestAnimationFrame(resolve));
  });

/** What both eyes see. */
async function seen(page) {
  await frames(page);
  return page.screenshot();
}

/** Where each eye sees the dots, pixels of its picture, and their numbers of pixels: `{red: [[x, y, count], …], …}`. */
function places(page, picture) {
  return page.evaluate(
    async ([text, colors]) => {
      const bitmap = await createImageBitmap(new Blob([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))]));
      const context = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d");
      context.drawImage(bitmap, 0, 0);
      const width = bitmap.width / 2;
      const found = colors.map((_, channel) =>
        [0, width].map((left) => {
          const { data } = context.getImageData(left, 0, width, bitmap.height);
          const sums = [0, 0, 0];
          for (let i = 0; i < data.length; i += 4) {
            const others = [0, 1, 2].filter((c) => c !== channel).map((c) => data[i + c]);
            const weight = Math.max(0, data[i + channel] - Math.max(...others)) / 255;
            [((i / 4) % width) + 0.5, Math.floor(i / 4 / width) + 0.5, 1].forEach((x, k) => (sums[k] += weight * x));
          }
          return [sums[0] / sums[2], sums[1] / sums[2], sums[2]];
        }),
      );
      return Object.fromEntries(colors.map((color, i) => [color, found[i]]));
    },
    [picture.toString("base64"), Object.keys(DOTS)],
  );
}

/** Asserts that both eyes see each dot where it stands in the room. */
async function agree(page, picture, dots, { head = [0, HEIGHT, 0], what }) {
  const found = await places(page, picture);
  for (const [color, [x, y, z]] of Object.entries(dots)) {
    for (const eye of [0, 1]) {
      const [ex, ey, ez] = [head[0] + (eye - 0.5) * EYES, head[1], head[2]];
      const expected = [FOCAL * (1 + (x - ex) / (ez - z)), FOCAL * (1 - (y - ey) / (ez - z))];
      const off = Math.hypot(found[color][eye][0] - expected[0], found[color][eye][1] - expected[1]);
      assert.ok(off < 0.5, `${what}: ${color} at ${found[color][eye]}, expected ${expected} in eye ${eye}`);
    }
  }
  return found;
}

/** The page's picture without its controls. */
async function middle(page) {
  await page.waitForSelector("#canvas[data-resting]").catch(async (error) => {
    // What the page shows instead says why.
    const texts = ["#frame-number", "#toast", "#failure-detail", "#stat-renderer"].map((id) => page.textContent(id));
    throw new Error(`${await Promise.all(texts)}, ${await page.getAttribute("#play", "aria-label")}`, { cause: error });
  });
  const { width, height } = page.viewportSize();
  return page.screenshot({ clip: { x: 0, y: height / 8, width: (5 * width) / 8, height: height / 2 } });
}

const shot = (name, picture) => SHOTS && writeFileSync(join(SHOTS, `xr-${name}.png`), picture);

test("each eye sees a scene with metres at its size, on the floor, from its own place", async (t) => {
  const page = await open(t);
  const before = await middle(page);
  const dots = await standing(page);
  const picture = await enter(page);
  shot("dots", picture);
  const found = await agree(page, picture, dots, { what: "at first" });
  // Near things shift more: by the distance of the eyes over the depth.
  const shift = (color) => found[color][0][0] - found[color][1][0];
  for (const color of ["red", "blue"]) {
    const expected = (FOCAL * EYES) / -dots[color][2];
    assert.ok(Math.abs(shift(color) - expected) < 0.2, `${color} by ${shift(color)}, expected ${expected}`);
  }

  // The head moves.
  const head = [0.2, 1.3, 0.4];
  await page.evaluate((head) => headset.position.set(...head), head);
  await agree(page, await seen(page), dots, { head, what: "from another place" });
  await page.evaluate((height) => headset.position.set(0, height, 0), HEIGHT);

  // A hand moves the scene and turns it.
  const squeeze = async (hand, value) => {
    await page.evaluate(([hand, value]) => headset.controllers[hand].updateButtonValue("squeeze", value), [hand, value]);
    await frames(page);
  };
  const put = async (hand, place, turn = 0) => {
    const moved = ([hand, place, turn]) => {
      headset.controllers[hand].position.set(...place);
      headset.controllers[hand].quaternion.set(0, Math.sin(turn / 2), 0, Math.cos(turn / 2));
    };
    await page.evaluate(moved, [hand, place, turn]);
    await frames(page);
  };
  await put("right", [0.2, 1, -0.5]);
  await squeeze("right", 1);
  await put("right", [0.3, 1.1, -1], 0.3);
  await squeeze("right", 0);
  // Around the vertical axis through the hand.
  const [c, s] = [Math.cos(0.3), Math.sin(0.3)];
  const turned = ([x, y, z]) => [0.3 + c * (x - 0.2) + s * (z + 0.5), y + 0.1, -1 + c * (z + 0.5) - s * (x - 0.2)];
  const moved = Object.fromEntries(Object.entries(dots).map(([color, place]) => [color, turned(place)]));
  await agree(page, await seen(page), moved, { what: "moved" });

  // Two hands move apart: the scene grows around their middle.
  await put("left", [-0.2, 1.6, -1]);
  await put("right", [0.2, 1.6, -1]);
  await squeeze("left", 1);
  await squeeze("right", 1);
  await put("left", [-0.25, 1.6, -1]);
  await put("right", [0.25, 1.6, -1]);
  await squeeze("left", 0);
  await squeeze("right", 0);
  const grown = Object.fromEntries(
    Object.entries(moved).map(([color, [x, y, z]]) => [color, [1.25 * x, 1.6 + 1.25 * (y - 1.6), -1 + 1.25 * (z + 1)]]),
  );
  shot("grown", await seen(page));
  await agree(page, await seen(page), grown, { what: "grown" });

  await leave(page);
  assert.deepEqual(await middle(page), before, "the page shows the scene as before");
});

test("a trigger plays and pauses, and the page goes on at the time of the headset", async (t) => {
  const page = await open(t, { query: "autoplay=0&timestep=3&renderer=webgl2" });
  const number = () => page.textContent("#frame-number");
  await settled(page);
  const first = await number();
  await enter(page);
  assert.equal(await number(), first, "it stands at the time of the page");
  const press = async () => {
    for (const value of [1, 0]) {
      await page.evaluate((value) => headset.controllers.right.updateButtonValue("trigger", value), value);
      await frames(page);
    }
  };
  await press();
  await page.waitForFunction((first) => document.querySelector("#frame-number").textContent !== first, first);
  assert.equal(await page.getAttribute("#play", "aria-label"), "Pause");
  await press();
  await page.waitForSelector("#play[aria-label=Play]");
  await seen(page);
  const last = await number();
  await leave(page);
  const after = await middle(page);
  assert.equal(await number(), last);
  // The same time by the page alone.
  await page.keyboard.press("Home");
  for (let i = 1; i < Number(last.split(" ")[0]); i++) await page.keyboard.press(".");
  await page.waitForFunction((last) => document.querySelector("#frame-number").textContent === last, last);
  assert.deepEqual(await middle(page), after);

  // A hand pinches on the spot.
  await enter(page);
  await page.evaluate(() => (headset.primaryInputMode = "hand"));
  await frames(page);
  for (const value of [1, 0]) {
    await page.evaluate((value) => headset.hands.right.updatePinchValue(value), value);
    await frames(page);
  }
  await page.waitForSelector("#play[aria-label=Pause]");

  // Another scene ends the session.
  await page.evaluate(() => {
    document.querySelector("#link").value = new URL("scene.tcgs", location.href).href;
    document.querySelector("#link-form").requestSubmit();
  });
  await page.waitForFunction(() => !document.querySelector("[data-webxr_runtime]"));
  await page.waitForSelector("body.has-scene");
  await page.waitForSelector("#vr[title='Enter VR']");
});

test("a scene of unknown size stands in the room", async (t) => {
  const page = await open(t, { from: server });
  const picture = await enter(page);
  shot("demo", picture);
  assert.ok((await compare(page, picture, picture)).covered > 0.9);
  await leave(page);
});

/** Colours of a picture at the corners of both eyes, and above their middles. */
function colors(page, picture) {
  return page.evaluate(async (text) => {
    const bitmap = await createImageBitmap(new Blob([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))]));
    const context = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d");
    context.drawImage(bitmap, 0, 0);
    const [width, height] = [bitmap.width / 2, bitmap.height];
    const at = (x, y) => [...context.getImageData(x, y, 1, 1).data].slice(0, 3);
    const corners = [2, width - 3].flatMap((x) => [2, height - 3].map((y) => [x, y]));
    const ofEyes = (points) => [0, width].flatMap((left) => points.map(([x, y]) => at(left + x, y)));
    return { corners: ofEyes(corners), above: ofEyes([[width / 2, height / 4]]) };
  }, picture.toString("base64"));
}

test("both eyes see an edge where pictures cannot be trusted, unless it is off", async (t) => {
  const far = (page) => page.evaluate((height) => headset.position.set(0, height, 60), HEIGHT);
  const plain = await open(t, { from: server, query: "autoplay=0&renderer=webgl2&trust=0" });
  const trusted = await enter(plain);
  await far(plain);
  const { corners: without, above } = await colors(plain, await seen(plain));
  assert.deepEqual(without, without.map(() => above[0]), "there is the background alone");

  const page = await open(t, { from: server });
  assert.deepEqual(await colors(page, await enter(page)), await colors(plain, trusted), "the start view is trusted");
  await far(page);
  const picture = await seen(page);
  shot("edge", picture);
  const { corners, above: same } = await colors(page, picture);
  assert.deepEqual(same, above);
  for (const corner of corners) {
    // 55 % of the page's amber over the background.
    [255, 176, 64].forEach((level, c) => {
      const expected = 0.55 * level + 0.45 * above[0][c];
      assert.ok(Math.abs(corner[c] - expected) < 3, `${corner}, expected ${expected} in channel ${c}`);
    });
  }
});

test("a page that draws with WebGPU shows its scene in a headset, too", async (t) => {
  // A software GPU takes about a second for a frame of WebGPU.
  const page = await open(t, { query: "autoplay=0&stats=1", side: 120 });
  await page.waitForFunction(() => document.querySelector("#stat-renderer").textContent === "WebGPU");
  await enter(page);
  await leave(page);
  await page.waitForSelector("#canvas[data-resting]");
  assert.equal(await page.textContent("#stat-renderer"), "WebGPU");
});
