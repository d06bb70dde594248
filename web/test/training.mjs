// The page of a training that goes on, in a browser, beside a training of the demo's capture. Run:
//   npm ci --prefix web
//   TCGS=target/release/tcgs CAPTURE=tcgs-demo/capture xvfb-run -a node --test web/test/training.mjs
// SHOTS=FOLDER keeps pictures of the window. What is drawn is a stand-in's affair in all tests but one (browser.mjs says why).

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { once } from "node:events";
import { mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { after, before, test } from "node:test";

import { launch, settled } from "./support.mjs";

const { TCGS = "target/release/tcgs", CAPTURE = "tcgs-demo/capture", SHOTS } = process.env;
const ENGINE = new URL("engine.mjs", import.meta.url).pathname;
const AXE = readFileSync(new URL("../node_modules/axe-core/axe.min.js", import.meta.url), "utf8");
/** Timeout of everything that waits: machines that run tests are slow and busy. */
const PATIENCE_MS = 240_000;

let browser, scratch;

before(async () => {
  scratch = mkdtempSync(join(tmpdir(), "tcgs-training-"));
  if (SHOTS) mkdirSync(SHOTS, { recursive: true });
  browser = await launch();
});

after(async () => {
  await browser?.close();
  rmSync(scratch, { recursive: true, force: true });
});

/** Begins a training: its address, and a promise of its exit. */
async function train(t, name, iterations) {
  const fixed = ["train", CAPTURE, "--out", join(scratch, name), "--preset", "fast", "--frames", "0..3", "--backend", "cpu"];
  const child = spawn(TCGS, [...fixed, "--iterations", iterations, "--view"], { stdio: ["ignore", "pipe", "ignore"] });
  t.after(() => child.kill("SIGKILL"));
  const lines = createInterface({ input: child.stdout });
  const [line] = await once(lines, "line", { signal: AbortSignal.timeout(30_000) });
  return { address: line.replace("watch at ", ""), child };
}

/** Opens the page. An error in its scripts fails the test. */
async function open(t, { address }, { standIn = true, ...options } = {}) {
  const viewport = { width: 900, height: 620 };
  const context = await browser.newContext({ viewport, colorScheme: "dark", reducedMotion: "reduce", ...options });
  context.setDefaultTimeout(PATIENCE_MS);
  const page = await context.newPage();
  const errors = [];
  page.on("pageerror", (error) => errors.push(error.stack ?? String(error)));
  t.after(async () => {
    await context.close();
    assert.deepEqual(errors, []);
  });
  if (standIn) await page.route("**/engine*/tcgs_play.js", (route) => route.fulfill({ path: ENGINE, contentType: "text/javascript" }));
  await page.goto(`${address}?quality=fixed&dpr=1`);
  return page;
}

async function shot(page, name) {
  if (SHOTS) writeFileSync(join(SHOTS, `${name}.png`), await page.screenshot());
}

const curves = (page) =>
  page.$$eval("#training figure:not([hidden]) svg", (all) =>
    all.filter((svg) => svg.checkVisibility()).map((svg) => [svg.getAttribute("aria-label"), svg.firstChild.getAttribute("points").split(" ").length]),
  );

test("a scene that is trained is replaced as it changes, and the view stays", async (t) => {
  const training = await train(t, "long", "100000,100");
  const page = await open(t, training);
  await page.waitForSelector("body.has-scene");
  await page.waitForFunction(() => /^Timestep 1 of 3, iteration [\d\u202f]+ of 100\u202f000, /.test(document.querySelector("#training-status").textContent));
  await page.waitForFunction(() => document.querySelectorAll("#training-running figure:not([hidden])").length === 2);
  const found = await curves(page);
  assert.match(found[0][0], /^Loss over \d+ points of iterations, from [\d.e-]+ to [\d.e-]+$/);
  assert.ok(found[0][1] > 20, `${found}`);
  assert.match(found[1][0], /^PSNR over \d+ points of iterations, from [\d.]+ dB to [\d.]+ dB$/);
  assert.match(await page.textContent("#training-active"), /^Trains 100 % of the tiles/);
  assert.ok(await page.isDisabled("#training-finished"), "nothing is finished");

  // Somebody moves; the next scene is seen from there.
  const opened = await page.evaluate(() => {
    window.given.viewer.setCamera({ cameraFromWorld: new Array(16).fill(0.5), mark: 7 });
    return window.given.opened;
  });
  await page.waitForFunction((before) => window.given.opened > before, opened);
  await page.waitForFunction(() => window.given.viewer.camera()?.mark === 7);
  assert.ok(await page.isVisible("#dock"), "no card instead of the scene");

  // Keys and axe, light and dark.
  await page.keyboard.press("t");
  assert.ok(await page.isHidden("#training-running"));
  await page.keyboard.press("t");
  assert.ok(await page.isVisible("#training-running"));
  for (const colorScheme of ["light", "dark"]) {
    await page.emulateMedia({ colorScheme });
    await page.evaluate(AXE);
    const { violations } = await page.evaluate(() => window.axe.run("#training"));
    assert.deepEqual(violations.map(({ id, nodes }) => [id, nodes.map(({ target }) => target)]), []);
    await shot(page, `training-${colorScheme}`);
  }

  // On a phone the curves are closed at first, and everything fits.
  const phone = await open(t, training, { viewport: { width: 360, height: 640 }, hasTouch: true, isMobile: true });
  await phone.waitForSelector("body.has-scene");
  assert.ok(await phone.isHidden("#training-running"));
  await phone.tap("#training summary");
  await phone.waitForSelector("#training-running figure:not([hidden])");
  const { left, right, bottom, dock } = await phone.evaluate(() => {
    const { left, right, bottom } = document.querySelector("#training").getBoundingClientRect();
    return { left, right, bottom, dock: document.querySelector("#dock").getBoundingClientRect().top };
  });
  assert.ok(left >= 0 && right <= 360 && bottom <= dock, JSON.stringify({ left, right, bottom, dock }));
  await shot(phone, "training-phone");

  // Ctrl-C ends the training and what shows it.
  training.child.kill("SIGINT");
  const [code] = await once(training.child, "exit");
  assert.equal(code, 130);
  await page.waitForSelector("#training[data-ended]");
  assert.match(await page.textContent("#training-status"), /has ended/);
});

test("a training that ends leaves the whole run, which shows", async (t) => {
  const training = await train(t, "short", "250,60");
  const page = await open(t, training, { standIn: false, viewport: { width: 480, height: 300 } });
  await page.waitForFunction(() => /^The training has ended: 3 timesteps, mean PSNR [\d.]+ dB$/.test(document.querySelector("#training-status").textContent));
  await page.waitForFunction(() => document.querySelector("#frame-number").textContent.endsWith(" / 3"));
  assert.ok(await page.isChecked("#training-finished"));
  assert.ok(await page.isDisabled("#training-now"));
  assert.equal(await page.locator("#training-timesteps figure:not([hidden])").count(), 4);
  await page.keyboard.press("Space");
  await page.waitForSelector("#play[aria-label=Play]");
  const still = await settled(page);
  // A black picture compresses to next to nothing.
  assert.ok(still.length > 20_000, `${still.length} bytes`);
  await shot(page, "training-ended");
  assert.equal(training.child.exitCode, null, "it goes on while the page is open");
});
