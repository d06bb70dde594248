// Tests of the decoder alone, in Node. Run, after web/build.sh: node --test web/test/decoder.mjs

import assert from "node:assert/strict";
import { once } from "node:events";
import { mkdtempSync, readFileSync, readdirSync, rmSync, symlinkSync, truncateSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { join, relative } from "node:path";
import { test } from "node:test";
import { fileURLToPath, pathToFileURL } from "node:url";
import { Worker } from "node:worker_threads";

import { open } from "../dist/decoder.js";

const VECTORS = new URL("../../testdata/bitstream/", import.meta.url);
const files = (folder) => {
  const names = readdirSync(new URL(folder, VECTORS)).filter((name) => name.endsWith(".tcgs"));
  return names.map((name) => [`${folder}${name}`, readFileSync(new URL(folder + name, VECTORS))]);
};

/** Serves bytes, with ranges or without; counts requests. */
async function serve(bytes, knowsRanges) {
  const asked = [];
  const server = createServer((request, response) => {
    const [, start, end] = /bytes=(\d+)-(\d+)/.exec(request.headers.range ?? "") ?? [];
    asked.push(request.headers.range);
    if (request.url !== "/scene.tcgs") return response.writeHead(404).end();
    if (!knowsRanges) return response.writeHead(200).end(bytes);
    const part = bytes.subarray(Number(start), Number(end) + 1);
    const range = `bytes ${start}-${Number(start) + part.length - 1}/${bytes.length}`;
    return response.writeHead(206, { "Content-Range": range }).end(part);
  });
  server.listen(0, "127.0.0.1");
  await once(server, "listening");
  return { address: `http://127.0.0.1:${server.address().port}/scene.tcgs`, asked, stop: () => server.close() };
}

test("every vector is decoded, to plausible Gaussians within what the file says", async () => {
  // One has values that no float holds.
  const vectors = [...files("v1/"), ...files("v2/")].filter(([name]) => !name.includes("beyond_floats"));
  assert.ok(vectors.length > 10);
  let withHarmonics = 0;
  for (const [name, bytes] of vectors) {
    const scene = await open(bytes);
    const { numTimesteps, maxGaussians, shDegree, antialiased, background, boundsMin, boundsMax } = scene.info;
    assert.deepEqual(background, new Float32Array(3), name);
    assert.equal(antialiased, name.includes("antialiased"), name);
    assert.ok(boundsMin.every((least, i) => least <= boundsMax[i]), name);
    withHarmonics += shDegree > 0;
    for (let t = 0; t < numTimesteps; t += Math.max(1, numTimesteps >> 3)) {
      const { numGaussians: n, means, quats, scales, opacities, colors, harmonics } = await scene.at(t);
      const sizes = [means, quats, scales, opacities, colors, harmonics].map((values) => values.length);
      assert.deepEqual(sizes, [3 * n, 4 * n, 3 * n, n, 3 * n, 3 * n * ((shDegree + 1) ** 2 - 1)], name);
      assert.ok(n <= maxGaussians && scales.every((s) => s >= 0) && opacities.every((o) => o >= 0 && o <= 1), name);
      assert.ok([...means, ...colors, ...harmonics].every(Number.isFinite), name);
      for (let i = 0; i < n; i++) assert.ok(Math.abs(Math.hypot(...quats.subarray(4 * i, 4 * i + 4)) - 1) < 1e-4, name);
    }
    scene.close();
  }
  assert.ok(withHarmonics > 0);
});

test("bytes, files and addresses give the same", async () => {
  const [, bytes] = files("v2/").sort(([, a], [, b]) => b.length - a.length)[0];
  const [ranges, whole] = [await serve(bytes, true), await serve(bytes, false)];
  const copy = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
  const sources = [bytes, copy, new Blob([bytes]), ranges.address, new URL(ranges.address), whole.address];
  const scenes = await Promise.all(sources.map((source) => open(source)));
  const last = scenes[0].info.numTimesteps - 1;
  const expected = [await scenes[0].at(0), await scenes[0].at(last)];
  for (const scene of scenes) {
    assert.deepEqual(scene.info, scenes[0].info);
    // Two at once, without waiting for the first.
    assert.deepEqual(await Promise.all([scene.at(0), scene.at(last)]), expected);
    scene.close();
  }
  assert.equal(whole.asked.length, 1);
  ranges.stop();
  whole.stop();
});

/** A new folder, which goes when the test ends. */
function folder(t) {
  const made = mkdtempSync(join(tmpdir(), "tcgs-"));
  t.after(() => rmSync(made, { recursive: true }));
  return made;
}

test("a path is that of a file, of which parts are read", async (t) => {
  const [, bytes] = files("v2/").sort(([, a], [, b]) => b.length - a.length)[0];
  const expected = await (await open(bytes)).at(1);
  // As an address it would have an escape and a fragment.
  const path = join(folder(t), "a %20scene#1.tcgs");
  writeFileSync(path, bytes);
  const before = process.cwd();
  for (const source of [path, relative(before, path), pathToFileURL(path), pathToFileURL(path).href]) {
    const scene = await open(source);
    assert.deepEqual(await scene.at(1), expected, String(source));
    scene.close();
  }
  process.chdir(join(path, ".."));
  t.after(() => process.chdir(before));
  assert.deepEqual(await (await open("a %20scene#1.tcgs")).at(1), expected);

  // A part is read when it is asked for, and nothing stays open meanwhile.
  const long = join(folder(t), "long.tcgs");
  writeFileSync(long, readFileSync(new URL("../../docs/site/scenes/toss.tcgs", import.meta.url)));
  const scene = await open(long);
  truncateSync(long, 300_000);
  await assert.rejects(scene.at(0), (error) => error.message.startsWith(`${long}: ends early`));
});

test("what no path leads to is named", async (t) => {
  const made = folder(t);
  const text = join(made, "text.tcgs");
  writeFileSync(text, "# A text, which is no scene at all\n");
  writeFileSync(join(made, "empty.tcgs"), "");
  symlinkSync("nowhere", join(made, "broken.tcgs"));
  const named = (name) => (error) => error instanceof Error && error.message.includes(name) && !error.message.includes("\n");
  await assert.rejects(open(join(made, "missing.tcgs")), { code: "ENOENT", message: /missing\.tcgs/ });
  await assert.rejects(open(pathToFileURL(join(made, "missing.tcgs"))), { code: "ENOENT", message: /missing\.tcgs/ });
  await assert.rejects(open(join(made, "broken.tcgs")), { code: "ENOENT", message: /broken\.tcgs/ });
  await assert.rejects(open(made), /^Error: .*: is a folder or device, expected a \.tcgs file$/);
  await assert.rejects(open(text), named(`${text}: invalid`));
  await assert.rejects(open(join(made, "empty.tcgs")), named("empty.tcgs: "));
  await assert.rejects(open("ftp://example.org/scene.tcgs"), named("ftp://example.org/scene.tcgs"));
});

test("where there is a location, as in pages, a string is an address", async (t) => {
  const { address, asked, stop } = await serve(files("v2/")[0][1], true);
  t.after(stop);
  // A worker without Node's files, whose fetch knows relative addresses.
  const page = `
    const { parentPort, workerData } = require("node:worker_threads");
    const { pathToFileURL } = require("node:url");
    const fetched = globalThis.fetch;
    globalThis.fetch = (address, options) => fetched(new URL(address, workerData.address), options);
    import(workerData.decoder).then(async ({ open }) => {
      await open(workerData.address);
      globalThis.location = new URL(workerData.address);
      const scene = await open("scene.tcgs");
      parentPort.postMessage(scene.info.numTimesteps);
    });`;
  const decoder = new URL("../dist/decoder.js", import.meta.url).href;
  const [found] = await once(new Worker(page, { eval: true, workerData: { address, decoder } }), "message");
  assert.ok(found > 0 && asked.length >= 2);
});

test("a bundler for browsers finds no module of Node", () => {
  const dist = fileURLToPath(new URL("../dist/", import.meta.url));
  const modules = readdirSync(dist, { recursive: true }).filter((name) => name.endsWith(".js"));
  assert.ok(modules.includes("decoder.js") && modules.length > 10);
  for (const name of modules) {
    const code = readFileSync(join(dist, name), "utf8").replace(/\/\*[^]*?\*\/|\/\/.*$/gm, "");
    const imported = code.matchAll(/\b(?:from|import|require)\s*\(?\s*["'`]([^"'`]+)/g);
    for (const [, module] of imported) assert.match(module, /^\.\//, `${name} imports ${module}`);
  }
});

test("what is attached to a scene comes by name, from an address too", async (t) => {
  const bytes = readFileSync(new URL("../../docs/site/scenes/toss.tcgs", import.meta.url));
  const server = await serve(bytes, true);
  t.after(server.stop);
  for (const source of [bytes, server.address]) {
    const scene = await open(source);
    const [data, { means }] = await Promise.all([scene.data(), scene.at(1)]);
    const json = (name) => JSON.parse(new TextDecoder().decode(data.get(name)));
    assert.match(json("tcgs.credits").authors.join(), /MakeHuman/);
    assert.ok(data.has("tcgs.views") && means.length > 0);
    scene.close();
  }
  const [, bare] = files("v1/").find(([name]) => name.includes("room_default"));
  const scene = await open(bare);
  assert.equal((await scene.data()).size, 0);
});

test("what cannot be opened says why", async () => {
  const accepted = [];
  for (const [name, bytes] of [...files("refused/"), ...files("refused_v2/")]) {
    const failure = await open(bytes)
      .then(async (scene) => {
        for (let t = 0; t < scene.info.numTimesteps; t++) await scene.at(t);
      })
      .then(() => null, (error) => error);
    if (failure) assert.ok(failure instanceof Error && /^[^\n]{10,}$/.test(failure.message), `${name}: ${failure}`);
    else accepted.push(name);
  }
  // What is wrong with the others lies between or behind what a timestep needs.
  const elsewhere = /disagreement|skipped_checksum|gap|order|overlap|other_coding|section_in_piece/;
  assert.deepEqual(accepted.filter((name) => !elsewhere.test(name)), []);
  const [, bytes] = files("v1/")[0];
  await assert.rejects(open(bytes.subarray(0, 40)), /ends early/);
  await assert.rejects(open(new TextEncoder().encode("# A text, which is no scene at all\n")), /invalid/);
  const scene = await open(bytes);
  await assert.rejects(scene.at(scene.info.numTimesteps), /expected an integer from 0 to/);
  await assert.rejects(scene.at(0.5), RangeError);
  scene.close();
  const { address, stop } = await serve(bytes, true);
  await assert.rejects(open(address.replace("scene", "other")), /the server answered 404/);
  stop();
});
