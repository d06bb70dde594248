// The decoder of .tcgs scenes alone: the Gaussians of a timestep as typed arrays, in browsers, workers and Node, without a GPU.
// docs/PLAYER.md describes it.

import initialise, { Decoder } from "./decoder/tcgs_js.js";

/**
 * What a file says of its scene.
 * @typedef {object} SceneInfo
 * @property {string} name of the capture; may be empty
 * @property {number} numTimesteps timesteps, counted from 0
 * @property {number} maxGaussians most Gaussians that live at one timestep
 * @property {number} frameRate timesteps per second; 0 if the file does not say
 * @property {number} shDegree degree of the spherical harmonics, 0 to 3
 * @property {boolean} antialiased whether a splat that is widened by a pixel's extent gives up as much opacity
 * @property {Float32Array} up unit vector that points up, -y where the file does not say; axes are right-handed
 * @property {Float32Array} boundsMin smallest coordinates of all centres at all timesteps, scene units
 * @property {Float32Array} boundsMax largest coordinates
 */

/**
 * The Gaussians that live at a timestep, ready to be drawn: N of them, row by row.
 * @typedef {object} Gaussians
 * @property {number} numGaussians N
 * @property {Float32Array} means [N, 3] centres, scene units
 * @property {Float32Array} quats [N, 4] unit rotations: w, x, y, z
 * @property {Float32Array} scales [N, 3] standard deviations along the axes, scene units
 * @property {Float32Array} opacities [N] 0 to 1
 * @property {Float32Array} colors [N, 3] red, green, blue; of harmonics what does not depend on the direction
 * @property {Float32Array} harmonics [N, (shDegree + 1)² - 1, 3] coefficients of degree 1 and above; empty where shDegree is 0
 */

/**
 * Gives the bytes from `start` up to but not including `end`; more is welcome.
 * @typedef {(start: number, end: number) => Promise<{ offset: number, bytes: Uint8Array }>} Read
 */

/** An open scene. */
export class Scene {
  #decoder;
  #read;
  #turn = Promise.resolve();

  /** @param {Decoder} decoder @param {Read} read @param {SceneInfo} info */
  constructor(decoder, read, info) {
    this.#decoder = decoder;
    this.#read = read;
    /** @type {SceneInfo} */
    this.info = info;
  }

  /**
   * The Gaussians at a timestep; fastest if successive calls ask for successive timesteps. Of a file behind an address only the
   * parts are fetched that this takes.
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
   * What programs attached to the scene, by name: `tcgs.credits` and `tcgs.views` are JSON in UTF-8, for one (docs/FORMAT.md).
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
    // One after the other: the decoder says what it lacks of the last call alone.
    const done = this.#turn.then(() => patiently(this.#decoder, this.#read, call));
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
 * @param {string | URL | Blob | ArrayBuffer | Uint8Array} source an address, a file, or its bytes
 * @param {{ signal?: AbortSignal }} [options] `signal` ends the requests to an address
 * @returns {Promise<Scene>}
 */
export async function open(source, { signal } = {}) {
  const [{ length, read }] = await Promise.all([reader(source, signal), load()]);
  const decoder = new Decoder(length);
  const info = await patiently(decoder, read, () => decoder.info());
  return new Scene(decoder, read, info);
}

let loading;

/** Loads the WebAssembly, once. */
function load() {
  const address = new URL("./decoder/tcgs_js_bg.wasm", import.meta.url);
  // Node's fetch reads no files.
  const inNode = address.protocol === "file:";
  const module = async () =>
    initialise({ module_or_path: inNode ? (await import("node:fs/promises")).readFile(address) : address });
  loading ??= module().catch((error) => {
    loading = undefined;
    throw error;
  });
  return loading;
}

/**
 * Makes a call again until it lacks no bytes.
 * @param {Decoder} decoder
 * @param {Read} read
 * @param {() => object | undefined} call
 * @returns {Promise<any>}
 */
async function patiently(decoder, read, call) {
  for (;;) {
    const done = call();
    if (done !== undefined) return done;
    const [start, end] = decoder.missing() ?? [0, 0];
    const { offset, bytes } = await read(start, end);
    if (offset > start || offset + bytes.length <= start) {
      throw new Error(`the file ends early: bytes ${start} to ${end} cannot be had`);
    }
    decoder.arrive(offset, bytes);
  }
}

/**
 * @param {string | URL | Blob | ArrayBuffer | Uint8Array} source
 * @param {AbortSignal} [signal]
 * @returns {Promise<{ length: number, read: Read }>}
 */
async function reader(source, signal) {
  if (source instanceof Blob) {
    /** @type {Read} */
    const read = async (start, end) => ({
      offset: start,
      bytes: new Uint8Array(await source.slice(start, end).arrayBuffer()),
    });
    return { length: source.size, read };
  }
  if (source instanceof ArrayBuffer || ArrayBuffer.isView(source)) {
    const bytes =
      source instanceof ArrayBuffer
        ? new Uint8Array(source)
        : new Uint8Array(source.buffer, source.byteOffset, source.byteLength);
    return { length: bytes.length, read: async (start, end) => ({ offset: start, bytes: bytes.subarray(start, end) }) };
  }
  return remote(String(source), signal);
}

/** Bytes that the first request asks for: many files as a whole. */
const FIRST_BYTES = 1 << 18;

/**
 * A file behind an address: by ranges, or as a whole from a server that knows none.
 * @param {string} address
 * @param {AbortSignal} [signal]
 * @returns {Promise<{ length: number, read: Read }>}
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
    length: first.length,
    read: async (start, end) => (start < first.bytes.length ? first : ask(start, end)),
  };
}
