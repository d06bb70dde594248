// The player in a page of your own, as an <iframe> that this module controls. docs/PLAYER.md describes it.

const PAGE = new URL("./index.html", import.meta.url);

/**
 * A camera: pixels, and a row-major matrix from the world to the camera, whose axes are x right, y down, z forward.
 * @typedef {{
 *   width: number, height: number, fx: number, fy: number, cx: number, cy: number, cameraFromWorld: number[]
 * }} Camera
 */

/**
 * The file's description of its scene. `numGaussians` counts all Gaussians that live at some timestep.
 * @typedef {{
 *   name: string, numGaussians: number, numTimesteps: number, frameRate: number, bytes: number, cameras: string[]
 * }} Info
 */

/**
 * Events: `ready`, `load`, `error`, `play`, `pause`, `timestep`; `detail` says more.
 *
 * ```js
 * import { TcgsPlayer } from "https://example.org/player/tcgs-player.js";
 * const player = new TcgsPlayer(document.querySelector("#here"), { controls: false });
 * await player.load("https://example.org/scene.tcgs");
 * await player.seek(12);
 * ```
 */
export class TcgsPlayer extends EventTarget {
  /**
   * Calls that have no answer yet.
   * @type {Map<number, { resolve: (result: any) => void, reject: (error: Error) => void }>}
   */
  #waiting = new Map();
  #next = 1;
  #ready;
  #stop = new AbortController();

  /**
   * @param {ParentNode & Node} container gets the <iframe> as its child
   * @param {Record<string, string | number | boolean>} [params] of the page's address: src, autoplay, controls, …
   */
  constructor(container, params = {}) {
    super();
    const address = new URL(PAGE);
    for (const [name, value] of Object.entries(params)) {
      // The <iframe> would resolve the address against its own, not against this page's.
      address.searchParams.set(name, name === "src" ? new URL(String(value), document.baseURI).href : String(value));
    }
    this.frame = document.createElement("iframe");
    this.frame.src = address.href;
    this.frame.title = "3D scene";
    this.frame.allow = "fullscreen; xr-spatial-tracking";
    this.#ready = new Promise((resolve) => this.addEventListener("ready", resolve, { once: true }));
    window.addEventListener("message", (event) => this.#hear(event), { signal: this.#stop.signal });
    container.append(this.frame);
  }

  /**
   * Opens an address or a file. Resolves to `info()` when the first picture shows.
   * @param {string | URL | Blob} source
   * @returns {Promise<Info>}
   */
  load(source) {
    return this.#ask("load", source instanceof Blob ? source : new URL(source, document.baseURI).href);
  }

  play() {
    return this.#ask("play");
  }

  pause() {
    return this.#ask("pause");
  }

  /** @param {number} timestep from 0 */
  seek(timestep) {
    return this.#ask("seek", timestep);
  }

  /** @param {number} speed in multiples of the scene's frame rate */
  setSpeed(speed) {
    return this.#ask("setSpeed", speed);
  }

  /** @param {boolean} loop */
  setLoop(loop) {
    return this.#ask("setLoop", loop);
  }

  /** @param {Camera} camera */
  setCamera(camera) {
    return this.#ask("setCamera", camera);
  }

  /** @param {number} index of a camera that the file names */
  useCamera(index) {
    return this.#ask("useCamera", index);
  }

  resetCamera() {
    return this.#ask("resetCamera");
  }

  /** The current camera, in the form that `setCamera` takes. @returns {Promise<Camera>} */
  camera() {
    return this.#ask("camera");
  }

  /** The state of the last frame: `{timestep, playing, buffering, gaussians, bytesLoaded, width, height, …}`. */
  state() {
    return this.#ask("state");
  }

  /** The file's description of its scene; null before one is open. @returns {Promise<Info | null>} */
  info() {
    return this.#ask("info");
  }

  /** Takes the player out of the page. */
  remove() {
    this.#stop.abort();
    this.frame.remove();
  }

  /** @param {string} method @param {unknown[]} args @returns {Promise<any>} */
  async #ask(method, ...args) {
    await this.#ready;
    const id = this.#next++;
    return new Promise((resolve, reject) => {
      this.#waiting.set(id, { resolve, reject });
      this.frame.contentWindow?.postMessage({ tcgs: 1, id, method, args }, PAGE.origin);
    });
  }

  /** @param {MessageEvent} event */
  #hear({ source, origin, data }) {
    if (source !== this.frame.contentWindow || origin !== PAGE.origin || data?.tcgs !== 1) return;
    if (data.event) {
      this.dispatchEvent(new CustomEvent(data.event, { detail: data.detail }));
      return;
    }
    const { resolve, reject } = this.#waiting.get(data.id) ?? {};
    this.#waiting.delete(data.id);
    if (data.error) reject?.(Object.assign(new Error(data.error.title), data.error));
    else resolve?.(data.result);
  }
}
