// A browser, the server under test, and pictures to compare.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { once } from "node:events";
import { createInterface } from "node:readline";

import { chromium } from "playwright-core";

/** A software GPU for WebGPU and for the window. Without a window, the pictures of WebGPU would not arrive in it. */
const WITH_WEBGPU = [
  "--enable-unsafe-webgpu",
  "--use-webgpu-adapter=swiftshader",
  "--enable-gpu",
  "--enable-features=Vulkan",
  "--use-vulkan=swiftshader",
  "--disable-vulkan-surface",
];
/** Here WebGPU finds no graphics card. */
const WITHOUT_WEBGPU = ["--use-angle=swiftshader"];

/** A new page of a context. The test closes the context, and fails if a script of the page had an error. */
export async function watchedPage(t, context) {
  const page = await context.newPage();
  const errors = [];
  page.on("pageerror", (error) => errors.push(error.stack ?? String(error)));
  page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
  t.after(async () => {
    await context.close();
    assert.deepEqual(errors.filter((error) => !error.includes("404 (Not Found)")), []);
  });
  return page;
}

/**
 * Starts Debian's Chromium with a software GPU, and with a window on whatever display there is. The browser reaches this
 * machine alone.
 */
export function launch({ webgpu = true } = {}) {
  return chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    headless: false,
    args: [
      "--no-sandbox",
      ...(webgpu ? WITH_WEBGPU : WITHOUT_WEBGPU),
      "--enable-unsafe-swiftshader",
      "--ignore-gpu-blocklist",
      "--disable-gpu-watchdog",
      "--disable-background-networking",
      "--disable-component-update",
      "--disable-sync",
      "--no-first-run",
      "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
      "--force-color-profile=srgb",
    ],
  });
}

/** Starts `tcgs view`: its address, and a function that ends it. */
export async function serve(tcgs, scene) {
  const child = spawn(tcgs, ["view", scene, "--no-open", "--port", "0"], { stdio: ["ignore", "pipe", "inherit"] });
  const lines = createInterface({ input: child.stdout });
  const [address] = await once(lines, "line", { signal: AbortSignal.timeout(30_000) });
  return { address, stop: () => child.kill() };
}

/**
 * Compares two PNG files in the browser, which decodes them. Returns the share of the pixels whose channels all agree within
 * 3 (`near`), the share of those of which a channel differs by more than 8 (`far`), the mean difference of all channels
 * (`mean`), and the share of the second file's pixels that are not black (`covered`).
 * @param {Buffer} found
 * @param {Buffer} expected
 */
export function compare(page, found, expected) {
  return page.evaluate(
    async (files) => {
      const pixels = async (text) => {
        const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
        const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
        const context = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d");
        context.drawImage(bitmap, 0, 0);
        return context.getImageData(0, 0, bitmap.width, bitmap.height);
      };
      const [a, b] = await Promise.all(files.map(pixels));
      if (a.width !== b.width || a.height !== b.height) {
        throw new Error(`${a.width}x${a.height}, expected ${b.width}x${b.height}`);
      }
      let [near, far, sum, covered] = [0, 0, 0, 0];
      for (let i = 0; i < a.data.length; i += 4) {
        const channels = [0, 1, 2].map((c) => [a.data[i + c], b.data[i + c]]);
        const most = Math.max(...channels.map(([x, y]) => Math.abs(x - y)));
        if (most <= 3) near += 1;
        if (most > 8) far += 1;
        for (const [x, y] of channels) sum += Math.abs(x - y);
        if (channels.some(([, y]) => y > 8)) covered += 1;
      }
      const count = a.data.length / 4;
      return { near: near / count, far: far / count, mean: sum / (3 * count), covered: covered / count };
    },
    [found, expected].map((file) => file.toString("base64")),
  );
}

/** Takes a picture of the window once nothing changes any more. */
export async function settled(page) {
  await page.waitForSelector("#canvas[data-resting]");
  return page.screenshot();
}

/** Drops a file on the page, as a person does. */
export async function drop(page, name, bytes) {
  await page.evaluate(
    ({ name, text }) => {
      const transfer = new DataTransfer();
      transfer.items.add(new File([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))], name));
      const event = (type) => new DragEvent(type, { dataTransfer: transfer, bubbles: true, cancelable: true });
      document.body.dispatchEvent(event("dragover"));
      document.body.dispatchEvent(event("drop"));
    },
    { name, text: bytes.toString("base64") },
  );
}

/**
 * A PLY file as 3D Gaussian splatting writes it, with harmonics of degree 3: spheres on a ball that turns. Those beyond 500
 * are others at each timestep.
 * @param {number} count
 * @param {number} timestep
 */
export function plyOfSpheres(count, timestep) {
  const rest = Array.from({ length: 45 }, (_, i) => `f_rest_${i}`);
  const names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", ...rest, "opacity"];
  names.push("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3");
  const header = ["ply", "format binary_little_endian 1.0", `element vertex ${count}`];
  header.push(...names.map((name) => `property float ${name}`), "end_header", "");
  const values = new Float32Array(count * names.length);
  for (let i = 0; i < count; i++) {
    const id = i < 500 ? i : i + 1000 * timestep;
    const height = 1 - (2 * ((id * 0.618) % 500)) / 500;
    const angle = 2.4 * id + (i < 500 ? 0.05 * timestep : 0);
    const radius = (i < 500 ? 1 : 1.6) * Math.sqrt(Math.max(0, 1 - height * height));
    const shine = rest.map((_, k) => (id % 4 === 0 ? 0.25 * Math.sin(1.3 * k + id) : 0));
    const color = [0, 1, 2].map((c) => 1.2 * Math.sin(3 * height + c));
    const row = [radius * Math.cos(angle), height, radius * Math.sin(angle), ...color, ...shine, 2.5];
    values.set([...row, -2.6, -2.6, -2.6, 1, 0, 0, 0], i * names.length);
  }
  return Buffer.concat([Buffer.from(header.join("\n")), Buffer.from(values.buffer)]);
}
