// A stand-in for the engine's viewer, which opens any file as a scene at once and needs no GPU. Camera paths are those of the
// engine. A test sets `window.given`: how many timesteps scenes have (`timesteps`) and what a picture waits for (`picture`, a
// promise). It finds there how many scenes were opened (`opened`), and by which viewer (`viewer`).

import init, { CameraPath } from "./tcgs_play.js?real";

export default init;
export { CameraPath };

const given = (window.given ??= {});

export class Viewer {
  #timestep = 0;
  #playing = false;
  #size = [1, 1];
  #camera = null;

  static async create() {
    return new Viewer();
  }

  async open(source, timestep) {
    [this.#timestep, this.#playing, this.#camera] = [timestep, false, null];
    [given.viewer, given.opened] = [this, (given.opened ?? 0) + 1];
  }

  info() {
    return { name: "", numGaussians: 1, numTimesteps: given.timesteps ?? 24, firstFrame: 0, frameRate: 30, bytes: 1, cameras: [] };
  }

  frame() {
    const [width, height] = this.#size;
    const [timestep, playing] = [this.#timestep, this.#playing];
    return { time: timestep, timestep, playing, buffering: false, drawn: true, gaussians: 1, bytesLoaded: 1, width, height };
  }

  async capture() {
    const [[width, height], timestep] = [this.#size, this.#timestep];
    await given.picture;
    return { width, height, timestep, data: new Uint8ClampedArray(4 * width * height) };
  }

  setCamera(camera) {
    if (!camera.cameraFromWorld.every(Number.isFinite)) throw new Error("this is no camera");
    this.#camera = camera;
  }

  camera() {
    return this.#camera;
  }

  resize(...size) {
    this.#size = size;
  }

  play() {
    this.#playing = true;
  }

  pause() {
    this.#playing = false;
  }

  seek(timestep) {
    this.#timestep = timestep;
  }

  pending() {
    return 0;
  }

  setSpeed() {}

  setLoop() {}
}
