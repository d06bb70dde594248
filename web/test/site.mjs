// The page that shows tcgs (docs/site), as people see it: on a phone and on a desk, light and dark, by keyboard alone, without
// WebGPU, and as axe-core judges it. Run:
//   npm ci --prefix web && docs/site/build.sh
//   xvfb-run -a node --test web/test/site.mjs
// SITE=FOLDER names another page than docs/site/dist; SHOTS=FOLDER keeps pictures. It needs Debian's chromium.

import assert from "node:assert/strict";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { extname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";

import { drop, launch } from "./support.mjs";

const path = (name) => fileURLToPath(new URL(name, import.meta.url));
const { SITE = path("../../docs/site/dist"), SHOTS } = process.env;
const AXE = readFileSync(path("../node_modules/axe-core/axe.min.js"), "utf8");
const TINY = readFileSync(path("../../testdata/bitstream/v1/room_default.tcgs"));
const ENGINE = path("engine.mjs");
const PHONE = { viewport: { width: 390, height: 844 }, deviceScaleFactor: 1, hasTouch: true, isMobile: true };
/** For what the software GPU draws. */
const SMALL = { viewport: { width: 320, height: 480 } };
const DESK = { viewport: { width: 1440, height: 900 } };
/** Most bytes of the first load, without scenes and the player. */
const MAX_FIRST_BYTES = 300_000;
const TYPES = {
  ".css": "text/css", ".html": "text/html", ".js": "text/javascript", ".svg": "image/svg+xml", ".wasm": "application/wasm",
  ".webm": "video/webm", ".mp4": "video/mp4", ".webp": "image/webp",
};

/** Timeout of everything that waits: machines that run tests are slow and busy. */
const PATIENCE_MS = 60_000;

let browser, server, address;

before(async () => {
  if (SHOTS) mkdirSync(SHOTS, { recursive: true });
  server = createServer((request, response) => {
    const { pathname } = new URL(request.url, "http://site.test");
    let bytes;
    try {
      bytes = readFileSync(join(SITE, pathname.endsWith("/") ? `${pathname}index.html` : pathname));
    } catch {
      response.writeHead(404).end();
      return;
    }
    const [, start, end] = /^bytes=(\d+)-(\d*)$/.exec(request.headers.range ?? "") ?? [];
    const ending = pathname.endsWith("/") ? ".html" : extname(pathname);
    const type = { "Content-Type": TYPES[ending] ?? "application/octet-stream" };
    if (start === undefined) {
      response.writeHead(200, { ...type, "Accept-Ranges": "bytes", "Content-Length": bytes.length }).end(bytes);
      return;
    }
    const part = bytes.subarray(Number(start), end ? Number(end) + 1 : undefined);
    const range = `bytes ${start}-${Number(start) + part.length - 1}/${bytes.length}`;
    response.writeHead(206, { ...type, "Content-Range": range, "Content-Length": part.length }).end(part);
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  address = `http://127.0.0.1:${server.address().port}/`;
  browser = await launch();
});

after(async () => {
  await browser?.close();
  server?.close();
});

/** Opens the page. An error in its scripts or a request to another host fails the test. */
async function open(t, { script, standIn = false, ...options } = {}) {
  const context = await browser.newContext({ ...DESK, reducedMotion: "reduce", ...options });
  context.setDefaultTimeout(PATIENCE_MS);
  const page = await context.newPage();
  const problems = [];
  page.on("pageerror", (error) => problems.push(error.stack ?? String(error)));
  page.on("console", (message) => message.type() === "error" && problems.push(message.text()));
  page.on("request", (request) => {
    if (!/^(blob|data):/.test(request.url()) && !request.url().startsWith(address)) problems.push(`asks for ${request.url()}`);
  });
  t.after(async () => {
    await context.close();
    assert.deepEqual(problems, []);
  });
  if (script) await page.addInitScript(script);
  if (standIn) {
    const stand = { path: ENGINE, contentType: "text/javascript" };
    await page.route("**/engine*/tcgs_play.js", (route) => route.fulfill(stand));
  }
  await page.goto(address);
  return page;
}

const withoutWebgpu = () => Object.defineProperty(Navigator.prototype, "gpu", { get: () => undefined });
const without = () => {
  Object.defineProperty(Navigator.prototype, "gpu", { get: () => undefined });
  HTMLCanvasElement.prototype.getContext = () => null;
};
const pressed = (page) => page.$$eval("[aria-pressed=true]", (all) => all.map((button) => button.dataset.scene));
const inPlayer = (page) => page.frames().find((frame) => frame.url().includes("/player/"));

/** What axe-core finds wrong in a page or a frame, whether serious or not. */
async function judge(frame) {
  await frame.evaluate(AXE);
  const { violations } = await frame.evaluate(() => window.axe.run(document, { iframes: false }));
  return violations.map(({ id, impact, nodes }) => `${id}, ${impact}: ${nodes.map((node) => node.html.slice(0, 120)).join(" ")}`);
}

/** Waits until a scene shows in the player, and returns the player's frame. */
async function playing(page) {
  await page.waitForSelector("tcgs-player");
  const shows = () => document.querySelector("tcgs-player").player.frame.contentDocument?.querySelector("body.has-scene");
  await page.waitForFunction(shows);
  return inPlayer(page);
}

for (const [device, options] of Object.entries({ phone: PHONE, desk: DESK })) {
  for (const colorScheme of ["light", "dark"]) {
    test(`${device}, ${colorScheme}: everything fits, is seen and has a name`, async (t) => {
      const page = await open(t, { ...options, colorScheme });
      await page.waitForFunction(() => document.querySelector("#film").poster && document.fonts.status === "loaded");
      await page.evaluate(() => Promise.all([...document.images].map((image) => image.decode())));
      if (SHOTS) {
        await page.waitForTimeout(300);
        writeFileSync(join(SHOTS, `${device}-${colorScheme}.png`), await page.screenshot());
        writeFileSync(join(SHOTS, `${device}-${colorScheme}-whole.png`), await page.screenshot({ fullPage: true }));
      }
      const { wide, screen } = await page.evaluate(() => {
        const inside = (node) => node.closest("pre, .scroll, .tabs, svg, .skip, .unseen") !== null;
        const wide = [...document.body.querySelectorAll("*")]
          .filter((node) => node.checkVisibility() && !inside(node))
          .filter((node) => node.getBoundingClientRect().right > innerWidth + 0.5 || node.getBoundingClientRect().left < -0.5)
          .map((node) => node.outerHTML.slice(0, 80));
        return { wide, screen: document.querySelector("#stage").getBoundingClientRect().bottom <= innerHeight };
      });
      assert.deepEqual(wide, []);
      assert.ok(screen, "the first screen holds the words and the picture");
      const table = page.locator(".scroll");
      assert.ok(await table.evaluate((node) => node.scrollWidth <= node.clientWidth), "the table needs no scrolling");
      assert.deepEqual(await judge(page.mainFrame()), []);
      for (const tab of await page.locator("[role=tab]").all()) {
        await tab.click();
        assert.deepEqual(await judge(page.mainFrame()), []);
      }
    });
  }
}

test("the first load is small, and its film runs", async (t) => {
  let total = 0;
  const context = await browser.newContext({ ...DESK, reducedMotion: "no-preference" });
  t.after(() => context.close());
  const page = await context.newPage();
  const session = await context.newCDPSession(page);
  await session.send("Network.enable");
  const names = new Map();
  session.on("Network.responseReceived", ({ requestId, response }) => names.set(requestId, new URL(response.url).pathname));
  session.on("Network.dataReceived", ({ dataLength }) => (total += dataLength));
  await page.goto(address);
  await page.waitForFunction(() => document.querySelector("#film").currentTime > 0.2);
  await page.waitForLoadState("networkidle");
  t.diagnostic(`first load: ${total} bytes of ${[...names.values()].join(" ")}`);
  assert.ok(total > 50_000 && total < MAX_FIRST_BYTES, `${total} bytes`);
  assert.ok([...names.values()].every((name) => !/\.(tcgs|wasm)$/.test(name) && (!name.startsWith("/player/") || name.endsWith("icon.svg"))));
  await page.click("#pause");
  await page.waitForSelector("#pause[aria-label='Play the film']");
  assert.ok(await page.$eval("#film", (film) => film.paused));
});

test("who wants no motion gets none before asking for it", async (t) => {
  const page = await open(t, { reducedMotion: "reduce" });
  await page.waitForLoadState("networkidle");
  assert.deepEqual(await page.$eval("#film", (film) => [film.paused, film.currentTime]), [true, 0]);
  await page.click("#pause");
  await page.waitForFunction(() => document.querySelector("#film").currentTime > 0);
  await page.waitForSelector("#pause[aria-label='Stop the film']");
});

test("each scene opens in the player, whole, with its credits", async (t) => {
  const page = await open(t, SMALL);
  for (const name of ["toss", "kitchen", "demo"]) {
    const size = readFileSync(join(SITE, `scenes/${name}.tcgs`)).length;
    await page.click(`[data-scene=${name}]`);
    await page.waitForSelector("tcgs-player");
    const opened = () => page.evaluate(async () => (await document.querySelector("tcgs-player").player.info())?.bytes);
    for (const end = Date.now() + PATIENCE_MS; (await opened()) !== size; await page.waitForTimeout(100)) {
      assert.ok(Date.now() < end, `${name} opens`);
    }
    assert.deepEqual(await pressed(page), [name]);
    const player = await playing(page);
    await player.waitForSelector("#play[aria-label=Pause]");
    await page.evaluate(() => document.querySelector("tcgs-player").player.pause());
    const credits = { toss: /DeepMimic.*Xue Bin Peng.*MakeHuman/, kitchen: /MakeHuman/, demo: /^$/ };
    assert.match(await player.textContent("#credits"), credits[name]);
    if (SHOTS) {
      await player.waitForSelector("#canvas[data-resting]");
      writeFileSync(join(SHOTS, `player-${name}.png`), await page.screenshot());
    }
  }
  assert.deepEqual(await judge(inPlayer(page)), []);
  assert.equal(await page.locator("tcgs-player").count(), 1);
  // The page forbids inline styles; the player fills the stage all the same.
  const sizes = await page.evaluate(() => {
    const stage = document.querySelector("#stage");
    return [stage, stage.querySelector("tcgs-player").player.frame].map((node) => [node.clientWidth, node.clientHeight]);
  });
  assert.deepEqual(sizes[1], sizes[0]);
});

test("by keyboard alone: to the scene, into the player and out, to the tabs", async (t) => {
  const page = await open(t, { standIn: true });
  const active = () => page.evaluate(() => document.activeElement.id || document.activeElement.dataset.scene || document.activeElement.textContent.trim());
  const tabTo = async (wanted, most = 30) => {
    const passed = [];
    for (let i = 0; i < most; i++) {
      await page.keyboard.press("Tab");
      passed.push(await active());
      const ring = await page.evaluate(() => getComputedStyle(document.activeElement).outlineStyle);
      if (passed.at(-1) === wanted) {
        assert.notEqual(ring, "none", `${wanted} shows that it has the focus`);
        return passed;
      }
    }
    assert.fail(`${wanted} is not among ${passed.join(", ")}`);
  };
  assert.deepEqual(await tabTo("turn"), ["Skip to the content", "tcgs", "How", "Sizes", "Start", "turn"]);
  await page.keyboard.press("Enter");
  const player = await playing(page);
  // The keys are the player's at once.
  await page.waitForFunction(() => document.activeElement.localName === "tcgs-player");
  await player.waitForSelector("#play[aria-label=Pause]");
  await page.keyboard.press("Space");
  await player.waitForSelector("#play[aria-label=Play]");
  await tabTo("kitchen");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => document.querySelector("[data-scene=kitchen]").getAttribute("aria-pressed") === "true");
  await page.waitForFunction(() => document.activeElement.localName === "tcgs-player");
  const chooser = page.waitForEvent("filechooser");
  await tabTo("own");
  await page.keyboard.press("Enter");
  await (await chooser).setFiles({ name: "mine.tcgs", mimeType: "application/octet-stream", buffer: TINY });
  await page.waitForFunction(() => document.querySelector("#name").textContent === "mine.tcgs");
  assert.deepEqual(await pressed(page), []);
  await tabTo("tab-shell");
  await page.keyboard.press("ArrowRight");
  assert.equal(await active(), "tab-python");
  assert.ok((await page.isVisible("#python")) && !(await page.isVisible("#shell")));
  await page.keyboard.press("End");
  assert.ok(await page.isVisible("#c"));
  await page.keyboard.press("ArrowRight");
  assert.ok(await page.isVisible("#shell"));
});

test("a file that is dropped plays, and one that is no scene is refused", async (t) => {
  const page = await open(t, SMALL);
  await drop(page, "room.tcgs", TINY);
  const player = await playing(page);
  assert.equal((await page.evaluate(() => document.querySelector("tcgs-player").player.info())).bytes, TINY.length);
  assert.match(await page.textContent("#about p:not([hidden])"), /^room\.tcgs is read here/);
  await drop(page, "holiday.tcgs", Buffer.from("not a scene at all, but some text"));
  await player.waitForSelector("#failure:not([hidden])");
  assert.equal(await player.textContent("#failure-title"), "This is not a .tcgs scene");
});

test("without WebGPU a scene plays by WebGL2", async (t) => {
  const page = await open(t, { ...SMALL, script: withoutWebgpu });
  await page.click("[data-scene=demo]");
  const player = await playing(page);
  await player.waitForSelector("#play[aria-label=Pause]");
  const loaded = await player.evaluate(() => performance.getEntriesByType("resource").map(({ name }) => name));
  assert.ok(loaded.some((name) => name.includes("/engine-webgl2/")), loaded.join(" "));
});

test("each scene can be taken along: as one file, and as an element of another page", async (t) => {
  const page = await open(t);
  for (const name of ["kitchen", "toss"]) {
    await page.click(`[data-scene=${name}]`);
    const address = new URL(await page.locator(`[data-of=${name}] a`).getAttribute("href"), page.url());
    const file = await (await page.request.get(address.href)).text();
    assert.ok(file.includes("<!doctype html>") && file.length > 500_000, `${name}: ${file.length} bytes`);
    const code = await page.textContent("#embed");
    const source = new URL(/^<iframe src="([^"]+)"/.exec(code)[1]);
    assert.ok((await page.request.get(source.href)).ok(), code);
    assert.ok((await page.request.get(source.searchParams.get("src"))).ok(), code);
  }
});

test("without WebGPU and WebGL2 a sentence says so, and films take the player's place", async (t) => {
  const page = await open(t, { script: without, reducedMotion: "no-preference" });
  await page.waitForSelector("#note:not([hidden])");
  assert.match(await page.textContent("#note"), /takes WebGPU or WebGL2.*This is a film/s);
  assert.ok(!(await page.isVisible("#turn")));
  await page.click("[data-scene=kitchen]");
  await page.waitForFunction(() => document.querySelector("#film").currentSrc.includes("kitchen") && document.querySelector("#film").currentTime > 0);
  assert.deepEqual(await pressed(page), ["kitchen"]);
  await drop(page, "mine.tcgs", TINY);
  await page.waitForSelector("#note span[hidden]", { state: "attached" });
  assert.equal(await page.locator("tcgs-player").count(), 0);
  assert.deepEqual(await judge(page.mainFrame()), []);
});

test("without scripts everything can be read", async (t) => {
  const page = await open(t, { javaScriptEnabled: false });
  for (const id of ["shell", "python", "javascript", "c", "film"]) assert.ok(await page.isVisible(`#${id}`), id);
  assert.ok(!(await page.isVisible("#turn")));
});

test("commands and code are those of the README", async (t) => {
  const page = await open(t);
  const readme = readFileSync(path("../../README.md"), "utf8").split("\n").map((line) => line.split(/ {2,}#| \/\//)[0].trim());
  const lines = await page.$$eval("#start pre", (all) => all.flatMap((block) => block.textContent.split("\n")));
  assert.ok(lines.length > 15);
  for (const line of lines) {
    const known = readme.some((other) => other === line.trim() || other.replace(/;.*/, ";") === line.trim());
    assert.ok(known || line.trim() === "", `README.md does not have: ${line}`);
  }
});
