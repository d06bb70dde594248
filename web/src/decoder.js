// The decoder of .tcgs scenes alone: the Gaussians of a timestep as typed arrays, in browsers, workers and Node,
// without a GPU. docs/PLAYER.md describes it.

import initialise, { Decoder } from "./decoder/tcgs_js.js";

/**
 * The file's description of its scene.
 * @typedef {object} SceneInfo
 * @property {string} name of the capture; may be empty
 * @property {number} numTimesteps timesteps, counted from 0
 * @property {number} maxGaussians no timestep has more Gaussians
 * @property {number} frameRate timesteps per second; 0 if the file does not say
 * @property {number} shDegree degree of the spherical harmonics, 0 to 3
 * @property {boolean} antialiased whether a splat that is widened by a pixel's extent loses as much opacity
 * @property {Float32Array} up unit vector that points up, -y where the file does not say; axes are right-handed
 * @property {Float32Array} boundsMin smallest coordinates of all centres at all timesteps, scene units
 * @property {Float32Array} boundsMax largest coordinates
 * @property {Float32Array} background red, green and blue behind all Gaussians, sRGB in [0, 1]
 */

/**
 * The Gaussians that live at a timestep, ready to be drawn: N of them, row by row.
 * @typedef {object} Gaussians
 * @property {number} numGaussians N
 * @property {Float32Array} means [N, 3] centres, scene units
 * @property {Float32Array} quats [N, 4] unit rotations: w, x, y, z
 * @property {Float32Array} scales [N, 3] standard deviations along the axes, scene units
 * @property {Float32Array} opacities [N] 0 to 1
 * @property {Float32Array} colors [N, 3] red, green, blue; with harmonics the part that does not depend on the
 *   direction
 * @property {Float32Array} harmonics [N, (shDegree + 1)² - 1, 3] coefficients of degree 1 and above; empty if shDegree
 *   is 0
 */

/**
 * Bytes that are read in parts.
 * @typedef {object} Source
 * @property {string} name of the file, for messages; empty if there is none
 * @property {number} length of the file, bytes
 * @property {(start: number, end: number) => Promise<{ offset: number, bytes: Uint8Array }>} read
 *   reads the bytes from `start` up to but not including `end`; may return more, or only the first of them
 */

/** An open scene, which `open` returns. */
export class Scene {
  #decoder;
  #source;
  #turn = Promise.resolve();

  /** @private @param {Decoder} decoder @param {Source} source @param {SceneInfo} info */
  constructor(decoder, source, info) {
    this.#decoder = decoder;
    this.#source = source;
    /** @type {SceneInfo} */
    this.info = info;
  }

  /**
   * The Gaussians at a timestep; fastest if successive calls ask for successive timesteps. Reads or fetches only the
   * necessary parts of the file.
   * @param {number} timestep from 0
   * @returns {Promise<Gaussians>}
   */
  at(timestep) {
    const { numTimesteps } = this.info;
    if (!Number.isInteger(timestep) || timestep < 0 || timestep >= numTimesteps) {
      return Promise.reject(new RangeError(`timestep is ${timestep}, expected an integer from 0 to ${numTimesteps - 1}`));
    }
    return this.#patiently(() => this.#decoder.at(timestep));
  }

  /**
   * Data that programs attached to the scene, by name: `tcgs.credits` and `tcgs.views`, for example, are JSON in UTF-8
   * (docs/FORMAT.md).
   * @returns {Promise<Map<string, Uint8Array>>} empty if there is nothing
   */
  async data() {
    return new Map(await this.#patiently(() => this.#decoder.data()));
  }

  /**
   * @param {() => object | undefined} call
   * @returns {Promise<any>}
   */
  #patiently(call) {
    // One call after the other, because the decoder reports the missing bytes of the last call alone.
    const done = this.#turn.then(() => patiently(this.#decoder, this.#source, call));
    this.#turn = done.then(
      () => {},
      () => {},
    );
    return done;
  }

  /** Gives the scene's memory back. */
  close() {
    this.#turn = this.#turn.then(() => this.#decoder.free());
  }
}

/**
 * Opens a scene.
 * @param {string | URL | Blob | ArrayBuffer | Uint8Array} source an address, a File, or its bytes; outside pages, as
 *   in Node, also a path or a `file:` address
 * @param {{ signal?: AbortSignal }} [options] `signal` ends the requests to an address
 * @returns {Promise<Scene>}
 */
export async function open(source, { signal } = {}) {
  const [file] = await Promise.all([reader(source, signal), load()]);
  const decoder = new Decoder(file.length);
  const info = await patiently(decoder, file, () => decoder.info());
  // @ts-expect-error: the constructor is private to the module.
  return new Scene(decoder, file, info);
}

/** Node's files; undefined in browsers. A bundler for browsers would look for the module of an `import`. */
const files = () => globalThis.process?.getBuiltinModule?.("node:fs/promises");

let loading;

/** Loads the WebAssembly, once. */
function load() {
  const address = new URL("./decoder/tcgs_js_bg.wasm", import.meta.url);
  // Node's fetch reads no files.
  const inNode = address.protocol === "file:" && files();
  const module = async () => initialise({ module_or_path: inNode ? inNode.readFile(address) : address });
  loading ??= module().catch((error) => {
    loading = undefined;
    throw error;
  });
  return loading;
}

/**
 * Repeats a call until no bytes are missing.
 * @param {Decoder} decoder
 * @param {Source} source
 * @param {() => object | undefined} call
 * @returns {Promise<any>}
 */
async function patiently(decoder, source, call) {
  for (;;) {
    try {
      const done = call();
      if (done !== undefined) return done;
    } catch (error) {
      if (!source.name || !(error instanceof Error)) throw error;
      throw new Error(`${source.name}: ${error.message}`, { cause: error });
    }
    const [start, end] = decoder.missing() ?? [0, 0];
    const { offset, bytes } = await source.read(start, end);
    if (offset > start || offset + bytes.length <= start) {
      throw new Error(`${source.name || "the file"}: ends early, bytes ${start} to ${end} cannot be had`);
    }
    decoder.arrive(offset, bytes);
  }
}

/**
 * @param {string | URL | Blob | ArrayBuffer | Uint8Array} source
 * @param {AbortSignal} [signal]
 * @returns {Promise<Source>}
 */
async function reader(source, signal) {
  if (source instanceof Blob) {
    /** @type {Source["read"]} */
    const read = async (start, end) => ({
      offset: start,
      bytes: new Uint8Array(await source.slice(start, end).arrayBuffer()),
    });
    return { name: "name" in source ? String(source.name) : "", length: source.size, read };
  }
  if (source instanceof ArrayBuffer || ArrayBuffer.isView(source)) {
    const bytes =
      source instanceof ArrayBuffer
        ? new Uint8Array(source)
        : new Uint8Array(source.buffer, source.byteOffset, source.byteLength);
    /** @type {Source["read"]} */
    const read = async (start, end) => ({ offset: start, bytes: bytes.subarray(start, end) });
    return { name: "", length: bytes.length, read };
  }
  const address = String(source);
  // Pages and workers have a location, to which addresses may be relative. Other programs have a working directory.
  const isRemote = globalThis.location !== undefined || /^(https?|blob|data):/i.test(address);
  return isRemote ? remote(address, signal) : local(address);
}

/**
 * A file of this machine, by ranges. It is open during reads only, so a scene needs no `close`.
 * @param {string} path absolute, relative to the working directory, or a `file:` address
 * @returns {Promise<Source>}
 */
async function local(path) {
  const system = files();
  if (!system) throw new Error(`${path}: no files can be read here, expected an http address, a Blob or bytes`);
  const place = /^file:/i.test(path) ? new URL(path) : path;
  const stat = await system.stat(place);
  if (!stat.isFile()) throw new Error(`${path}: is a folder or device, expected a .tcgs file`);
  return {
    name: path,
    length: stat.size,
    read: async (start, end) => {
      const file = await system.open(place);
      try {
        const { buffer, bytesRead } = await file.read(new Uint8Array(end - start), 0, end - start, start);
        return { offset: start, bytes: buffer.subarray(0, bytesRead) };
      } finally {
        await file.close();
      }
    },
  };
}

/** Bytes that the first request asks for: many files as a whole. */
const FIRST_BYTES = 1 << 18;

/**
 * A file behind an address: by ranges, or whole from a server without range requests.
 * @param {string} address
 * @param {AbortSignal} [signal]
 * @returns {Promise<Source>}
 */
async function remote(address, signal) {
  /** @param {number} start @param {number} end */
  const ask = async (start, end) => {
    const answer = await fetch(address, { headers: { Range: `bytes=${start}-${end - 1}` }, signal });
    if (!answer.ok) throw new Error(`${address}: the server answered ${answer.status} ${answer.statusText}`);
    const bytes = new Uint8Array(await answer.arrayBuffer());
    if (answer.status !== 206) return { offset: 0, bytes, length: bytes.length };
    const [, total] = /\/(\d+)$/.exec(answer.headers.get("Content-Range") ?? "") ?? [];
    return { offset: start, bytes, length: Number(total) };
  };
  const first = await ask(0, FIRST_BYTES);
  if (!Number.isFinite(first.length)) throw new Error(`${address}: the server does not say how long the file is`);
  return {
    // A data: address is as long as its file.
    name: /^data:/i.test(address) ? "" : address,
    length: first.length,
    read: async (start, end) => (start < first.bytes.length ? first : ask(start, end)),
  };
}
