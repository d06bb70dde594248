// The player in Firefox, which draws with WebGL2. Run as browser.mjs; the tests need Debian's firefox-esr.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdirSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { pathToFileURL } from "node:url";

import puppeteer from "puppeteer-core";

import { serve } from "./support.mjs";

const { TCGS = "target/release/tcgs", SCENE = "tcgs-demo/scene.tcgs", SHOTS } = process.env;
const PATIENCE_MS = 120_000;

let browser, server, scratch;

before(async () => {
  scratch = mkdtempSync(join(tmpdir(), "tcgs-firefox-"));
  if (SHOTS) mkdirSync(SHOTS, { recursive: true });
  server = await serve(TCGS, SCENE);
  browser = await puppeteer.launch({
    browser: "firefox",
    executablePath: process.env.FIREFOX ?? "/usr/bin/firefox-esr",
    headless: false,
    // Without a graphics card, and as any user of the machine that tests.
    extraPrefsFirefox: { "webgl.force-enabled": true, "security.sandbox.content.level": 0 },
  });
});

after(async () => {
  await browser?.close();
  server?.stop();
  rmSync(scratch, { recursive: true, force: true });
});

/** Opens a page, lets it play, and pauses it: what it draws and shows. */
async function played(t, address, name) {
  const page = await browser.newPage();
  t.after(() => page.close());
  page.setDefaultTimeout(PATIENCE_MS);
  const errors = [];
  page.on("pageerror", (error) => errors.push(error.message));
  await page.setViewport({ width: 480, height: 300 });
  await page.goto(`${address}?stats=1&dpr=1`);
  await page.waitForSelector("body.has-scene");
  const text = (id) => page.evaluate((id) => document.querySelector(id).textContent, id);
  await page.waitForFunction(() => document.querySelector("#stat-renderer").textContent === "WebGL2");
  const first = await text("#frame-number");
  await page.waitForFunction((n) => document.querySelector("#frame-number").textContent !== n, {}, first);
  await page.keyboard.press(" ");
  await page.waitForSelector("#canvas[data-resting]");
  const picture = await page.screenshot();
  if (SHOTS) writeFileSync(join(SHOTS, `firefox-${name}.png`), picture);
  assert.deepEqual(errors, []);
  return page;
}

test("a scene plays, and turns by the mouse", async (t) => {
  const page = await played(t, server.address, "served");
  // Statistics change without the scene, and controls come and go.
  await page.keyboard.press("i");
  await page.waitForFunction(() => document.querySelector("#stats").hidden);
  const middle = async () => {
    await page.waitForSelector("#canvas[data-resting]");
    return page.screenshot({ clip: { x: 100, y: 60, width: 280, height: 100 } });
  };
  const before = await middle();
  assert.deepEqual(await middle(), before, "paused is paused");
  await page.mouse.move(200, 120);
  await page.mouse.down();
  await page.mouse.move(260, 130, { steps: 4 });
  await page.mouse.up();
  assert.notDeepEqual(await middle(), before);
});

test("a page that is one file plays from a disk", async (t) => {
  const file = join(scratch, "scene.html");
  execFileSync(TCGS, ["export", SCENE, "--to", file], { stdio: ["ignore", "ignore", "inherit"] });
  await played(t, pathToFileURL(file).href, "one-file");
});
