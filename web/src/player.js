// Drives the engine on a canvas: decides when a frame is drawn and at how many pixels, and sends events to the other
// modules.

import { PATIENCE_MS, freshCanvas, startEngine } from "./engine.js";
import { AdaptiveResolution } from "./resolution.js";

/** Milliseconds after the last change until all pixels are drawn. */
const SETTLE_MS = 200;
/** Frames drawn before the page rests: the engine learns some frames later whether its buffers held all splats. */
const STILL_FRAMES = 3;
/** Longest application data that are fetched, bytes. */
const MAX_ATTACHED = 1 << 26;
/** Frames by which the GPU may lag while something moves. */
const MAX_PENDING = 1;
/** Times that the player goes on with another engine. */
const MAX_RESTARTS = 2;

/**
 * Events: `opening`, `progress` (`detail`: bytes loaded), `load` (the first picture of a scene can be drawn), `replace`
 * (the same for a scene that replaces another), `frame` (a frame was drawn; its state is `player.state`), `change` (of
 * settings, of playing, or of the path), `lost` (the path has no camera at the timestep and is no longer followed),
 * `canvas` (`detail`: the canvas that is drawn on from now on), `fallback` (WebGPU does not draw; `detail` says why),
 * `back` (the scene is no longer shown elsewhere), `failure` (`detail`: the error).
 */
export class Player extends EventTarget {
  /** Whether the camera follows the path. A drag on the scene or a key ends that. */
  following = false;
  /** The engine's `CameraPath`; null: no scene. */
  path = null;
  speed = 1;
  loop = true;
  /** The engine's description of the scene; null: no scene. */
  info = null;
  /** Camera of the start view; null: the engine's. */
  home = null;
  /** The engine's report on the last frame. */
  state = null;
  /** Frames drawn in the last second; null while nothing moves. */
  rate = null;
  /** What draws: `WebGPU`, `WebGL2`; null before the first scene. */
  renderer = null;

  #canvas;
  #options;
  #observer;
  #viewer = null;
  /** The viewer that shows the scene elsewhere, as in a headset; null: the page shows it. */
  #elsewhere = null;
  #CameraPath = null;
  #starting = null;
  #restarts = 0;
  #opening = false;
  #replacing = false;
  /** Number of calls of `open`: a scene that is replaced while opening is dropped. */
  #turn = 0;
  #source = null;
  #resolution = new AdaptiveResolution();
  #changed = 0;
  /** Number of frames drawn at all pixels since the last change. */
  #still = 0;
  #last = null;
  /** Time of the last call of the engine that draws. */
  #drawn = 0;
  /** Size requested of the engine. It sets the canvas to this size, or to the largest that the device allows. */
  #size = [0, 0];
  #times = [];
  #stopped = false;
  #capturing = false;

  /** @param {{quality: "auto" | "fixed", dpr: number | null, renderer: "webgpu" | "webgl2" | null}} options */
  constructor(canvas, options) {
    super();
    this.#canvas = canvas;
    this.#options = options;
    this.#observer = new ResizeObserver(() => {
      this.#resolution.forget();
      this.touch();
    });
    this.#observer.observe(canvas);
    requestAnimationFrame(this.#tick);
  }

  /** The last address or file given to `open`. */
  get source() {
    return this.#source;
  }

  /**
   * Opens a scene at a timestep. Resolves once its first picture can be drawn, to true, or to false if there is none.
   * Failures become events; nothing is thrown.
   *
   * @param {string | Blob} given an address or a file
   */
  async open(given, timestep = 0) {
    this.takeBack();
    const turn = ++this.#turn;
    this.#source = given;
    this.#opening = true;
    this.#replacing = false;
    this.info = null;
    this.state = null;
    this.path = null;
    this.following = false;
    this.#tell("opening");
    try {
      const source = typeof given === "string" ? addressOf(given) : given;
      const viewer = await this.#start();
      await viewer.open(source, timestep);
      if (turn !== this.#turn) return false;
      this.#opening = false;
      this.info = viewer.info();
      this.path = this.newPath();
      viewer.setLoop(this.loop);
      viewer.setSpeed(this.speed);
      this.#resolution.forget();
      this.touch();
      this.#tell("load");
      return true;
    } catch (error) {
      return turn === this.#turn && this.#fail(error);
    }
  }

  /**
   * Replaces the scene by another state of it: camera, path, frame and playing stay, and the old picture stays until
   * there is a new one. Resolves as `open` does.
   *
   * @param {Blob} file
   */
  async replace(file) {
    if (!this.info) return this.open(file);
    this.takeBack();
    const turn = ++this.#turn;
    const { camera, info, playing } = { camera: this.camera(), info: this.info, playing: this.playing };
    const frame = info.firstFrame + (this.state?.timestep ?? 0);
    this.#source = file;
    this.#replacing = true;
    const viewer = this.#viewer;
    try {
      await viewer.open(file, 0);
      if (turn !== this.#turn) return false;
      this.info = viewer.info();
      viewer.setLoop(this.loop);
      viewer.setSpeed(this.speed);
      if (camera) viewer.setCamera(camera);
      viewer.seek(Math.min(Math.max(0, frame - this.info.firstFrame), this.info.numTimesteps - 1));
      if (playing) viewer.play();
      this.#replacing = false;
      this.touch();
      this.#tell("replace");
      return true;
    } catch (error) {
      return turn === this.#turn && this.#fail(error);
    }
  }

  /** Starts the engine once. @param {"webgpu" | "webgl2" | null} wanted */
  #start(wanted = this.#options.renderer) {
    this.#starting ??= (async () => {
      const { viewer, CameraPath, name, canvas, reason } = await startEngine(this.#canvas, wanted);
      this.#viewer = viewer;
      this.#CameraPath = CameraPath;
      this.renderer = name;
      this.#use(canvas);
      if (reason) this.#tell("fallback", reason);
      return viewer;
    })();
    this.#starting.catch(() => (this.#starting = null));
    return this.#starting;
  }

  #use(canvas) {
    if (canvas === this.#canvas) return;
    this.#observer.unobserve(this.#canvas);
    this.#observer.observe(canvas);
    this.#canvas = canvas;
    this.#size = [0, 0];
    this.touch();
    this.#tell("canvas", canvas);
  }

  /**
   * Goes on with WebGL2 after the engine has lost the graphics card: the same scene, camera, path, frame and playing.
   * Resolves as `open` does.
   */
  async #goOn(error) {
    const turn = ++this.#turn;
    const [lost, { info, state, keyframes, following, renderer }] = [this.#viewer, this];
    const camera = info && !this.#replacing ? lost.camera() : null;
    this.#opening = false;
    this.#replacing = true;
    this.#starting = null;
    try {
      this.#use(freshCanvas(this.#canvas));
      const viewer = await this.#start("webgl2");
      const source = typeof this.#source === "string" ? addressOf(this.#source) : this.#source;
      await viewer.open(source, state?.timestep ?? 0);
      if (turn !== this.#turn) return false;
      this.info = viewer.info();
      this.path = this.newPath();
      for (const { timestep, camera } of keyframes) this.path.insert(timestep, camera);
      this.following = following;
      viewer.setLoop(this.loop);
      viewer.setSpeed(this.speed);
      if (camera) viewer.setCamera(camera);
      if (state?.playing) viewer.play();
      this.#replacing = false;
      this.#last = null;
      this.touch();
      this.#tell("fallback", `${renderer} has lost the graphics card`);
      this.#tell(info ? "replace" : "load");
      return true;
    } catch (second) {
      if (turn !== this.#turn) return false;
      this.#stopped = true;
      return this.#fail(Object.assign(new Error(`${error.message}; ${second.message}`), { code: "device-lost" }));
    }
  }

  /** A camera path without keyframes, once the engine has started. */
  newPath() {
    return new this.#CameraPath();
  }

  /**
   * Hands the clock to a viewer that shows the same scene elsewhere. Until `takeBack` the page draws nothing, and the
   * event `frame` tells of each call of `showElsewhere`.
   */
  handOver(viewer) {
    this.#setClock(viewer);
    this.#viewer.pause();
    this.#elsewhere = viewer;
    this.rate = null;
  }

  /** Takes the state of a frame that was drawn elsewhere, as the engine reports it. */
  showElsewhere(viewer, state) {
    if (viewer !== this.#elsewhere) return;
    this.state = state;
    this.#tell("frame");
  }

  /** Shows the scene on the page again, at the time that it has reached. */
  takeBack() {
    if (!this.#elsewhere) return;
    this.#elsewhere = null;
    this.#setClock(this.#viewer);
    this.#drawn = performance.now();
    this.#last = null;
    this.#resolution.forget();
    this.touch();
    this.#tell("back");
  }

  /** Sets the clock of a viewer to the current time. */
  #setClock(viewer) {
    viewer.setLoop(this.loop);
    viewer.setSpeed(this.speed);
    viewer.seek(this.state?.timestep ?? 0);
    if (this.playing) viewer.play();
    else viewer.pause();
  }

  get playing() {
    return this.state?.playing ?? false;
  }

  play() {
    this.#doClock((viewer) => viewer.play());
  }

  pause() {
    this.#doClock((viewer) => viewer.pause());
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  seek(timestep) {
    this.#doClock((viewer) => viewer.seek(Math.min(Math.max(0, timestep), this.info.numTimesteps - 1)));
  }

  step(count) {
    this.#doClock((viewer) => viewer.step(count));
  }

  setSpeed(speed) {
    this.speed = speed;
    this.#doClock((viewer) => viewer.setSpeed(speed));
    this.#tell("change");
  }

  setLoop(loop) {
    this.loop = loop;
    this.#doClock((viewer) => viewer.setLoop(loop));
    this.#tell("change");
  }

  /** Moves the camera by a method of the engine: `move("orbit", dx, dy)`. */
  move(how, ...amounts) {
    if (this.following) this.follow(false);
    this.#do((viewer) => viewer[how](...amounts));
  }

  /** Moves to the start view. */
  reset() {
    if (this.home) this.setCamera(this.home);
    else this.move("reset");
  }

  camera() {
    return this.info && !this.#replacing ? this.#viewer.camera() : null;
  }

  /** Cameras of the path by increasing timestep: `[{timestep, camera}]`. */
  get keyframes() {
    return this.path?.keyframes() ?? [];
  }

  /** Moves to a camera. A window of another shape shows more. Throws the engine's error if the camera is not valid. */
  setCamera(camera) {
    this.#do((viewer) => viewer.setCamera(camera));
    this.following = false;
    this.#tell("change");
  }

  useCamera(index) {
    this.following = false;
    this.#do((viewer) => viewer.useCamera(index));
    this.#tell("change");
  }

  /** Adds the current camera to the path, at the current timestep. */
  addToPath() {
    if (!this.state || this.#replacing) return;
    this.path.insert(this.state.timestep, this.camera());
    this.#tell("change");
  }

  setPath(path) {
    this.path = path;
    this.follow(this.keyframes.length > 0);
  }

  follow(on) {
    this.following = on && this.keyframes.length > 0;
    this.touch();
    this.#tell("change");
  }

  /**
   * Named data of the file. Data far from the start of the file are fetched.
   *
   * @returns {Promise<Uint8Array | null>} null if there are none, or another scene was opened meanwhile
   */
  async attached(name) {
    const [viewer, source, turn] = [this.#viewer, this.#source, this.#turn];
    const near = viewer.data(name);
    if (near) return near;
    // A text of that name begins with its length.
    const text = new TextEncoder().encode(name);
    const wanted = [text.length & 255, text.length >> 8, ...text];
    for (const [index, [start, end]] of viewer.farRanges().entries()) {
      if (end - start < wanted.length || end - start > MAX_ATTACHED) continue;
      const head = await rangeOf(source, start, start + wanted.length);
      if (!head || wanted.some((byte, i) => head[i] !== byte)) continue;
      const bytes = await rangeOf(source, start, end);
      return bytes && turn === this.#turn ? (viewer.farData(index, bytes)?.data ?? null) : null;
    }
    return null;
  }

  /** Draws a picture at all pixels: `{width, height, timestep, data}`, RGBA. */
  async capture() {
    this.#capturing = true;
    try {
      this.#resize(1);
      return await this.#viewer.capture();
    } finally {
      this.#capturing = false;
      this.touch();
    }
  }

  /** Notes that the picture will change. Until a complete picture shows the change, the canvas lacks `data-resting`. */
  touch() {
    this.#changed = performance.now();
    this.#still = 0;
    delete this.#canvas.dataset.resting;
  }

  #do(action, viewer = this.#viewer) {
    if (!this.info || this.#replacing) return;
    action(viewer);
    this.touch();
  }

  #doClock(action) {
    this.#do(action, this.#elsewhere ?? this.#viewer);
  }

  #tell(type, detail) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  /** Resolves to whether the player goes on. */
  async #fail(error) {
    const isLost = error?.code === "device-lost";
    if (isLost && !this.#stopped && this.#options.renderer !== "webgpu" && this.#restarts < MAX_RESTARTS) {
      this.#restarts += 1;
      return this.#goOn(error);
    }
    this.info = null;
    this.#opening = this.#replacing = false;
    if (isLost) this.#stopped = true;
    this.#tell("failure", error);
    return false;
  }

  #tick = (now) => {
    requestAnimationFrame(this.#tick);
    if (this.#stopped || this.#elsewhere) return;
    if (this.#opening && this.#viewer) return this.#watch(now);
    if (!this.info || this.#replacing) return;
    const incomplete = this.state === null || this.state.buffering || !this.state.drawn;
    // A picture of another size begins incomplete. If that counted as moving, the size would change again and again.
    const moving = this.playing || now - this.#changed < SETTLE_MS;
    if (this.#viewer.pending() > (moving ? MAX_PENDING : 0)) return this.#wait(now);
    if (!moving && !incomplete && this.#still >= STILL_FRAMES) return this.#rest();
    const fixed = this.#options.quality === "fixed" || this.#capturing;
    if (!fixed && moving && this.#last !== null) this.#resolution.frame(now - this.#last);
    this.#resize(fixed || !moving ? 1 : this.#resolution.scale);
    this.#still = moving || incomplete ? 0 : this.#still + 1;
    this.#last = now;
    this.#draw(now);
  };

  /** Calls the engine while a scene opens, so that it takes the bytes that have arrived, and reports their number. */
  #watch(now) {
    if (this.#viewer.pending() > 0) return this.#wait(now);
    this.#drawn = now;
    try {
      this.#tell("progress", this.#viewer.frame(now).bytesLoaded);
    } catch (error) {
      this.#fail(error);
    }
  }

  /** Notices that the graphics card is gone while a frame is not finished. */
  #wait(now) {
    try {
      this.#viewer.check();
      if (now - this.#drawn < PATIENCE_MS) return;
    } catch (error) {
      return this.#fail(error);
    }
    this.#fail(Object.assign(new Error(`${this.renderer} does not answer`), { code: "device-lost" }));
  }

  /** Stops drawing to save power: nothing moves and the picture is complete. */
  #rest() {
    if (this.#last === null) return;
    this.#last = null;
    this.#times = [];
    this.rate = null;
    this.#resolution.forget();
    this.#canvas.dataset.resting = "";
    this.#tell("frame");
  }

  #draw(now) {
    this.#drawn = now;
    if (this.following && this.state) {
      const { width, height } = this.#canvas;
      try {
        this.#viewer.setCamera(this.path.cameraAt(this.state.timestep, width, height));
      } catch {
        this.follow(false);
        this.#tell("lost");
      }
    }
    try {
      const before = this.state;
      this.state = this.#viewer.frame(now);
      if (this.following && before?.timestep !== this.state.timestep) this.touch();
    } catch (error) {
      return this.#fail(error);
    }
    this.#times = [...this.#times.filter((time) => time > now - 1000), now];
    const span = now - this.#times[0];
    this.rate = span > 300 ? (1000 * (this.#times.length - 1)) / span : null;
    this.#tell("frame");
  }

  /** Resizes the canvas. */
  #resize(scale) {
    const ratio = this.#options.dpr ?? window.devicePixelRatio;
    const side = (css) => Math.max(1, Math.round(css * ratio * scale));
    const [width, height] = [side(this.#canvas.clientWidth), side(this.#canvas.clientHeight)];
    if (this.#size[0] === width && this.#size[1] === height) return;
    this.#size = [width, height];
    this.#viewer.resize(width, height);
  }
}

/** Bytes of a file or of an address; null if the host supports no ranges. */
async function rangeOf(source, start, end) {
  if (source instanceof Blob) return new Uint8Array(await source.slice(start, end).arrayBuffer());
  const answer = await fetch(addressOf(source), { headers: { Range: `bytes=${start}-${end - 1}` } });
  return answer.status === 206 ? new Uint8Array(await answer.arrayBuffer()) : null;
}

/** Resolves the address of a scene against that of the page. */
export function addressOf(text) {
  try {
    return new URL(text, location.href).href;
  } catch {
    throw Object.assign(new Error(`${text} is no address`), { code: "network" });
  }
}
