// The text of errors for people: a title, the meaning and a remedy. The engine knows only the codes
// (crates/play/src/error.rs).

const FAILURES = {
  "no-webgpu": {
    title: "This browser cannot draw the scene",
    text: "The player needs WebGPU or WebGL2, and neither works here. All browsers of the last years have WebGL2. The browser's settings may switch it off (“hardware acceleration”), or the driver of the graphics card is too old.",
  },
  "not-tcgs": {
    title: "This is not a .tcgs scene",
    text: "The file is of another kind. Other scenes become one by the command “tcgs compress”.",
  },
  truncated: {
    title: "The scene is incomplete",
    text: "The file ends too early: a download or a copy of it was cut off. Fetch it again.",
  },
  "newer-version": {
    title: "The scene is newer than this player",
    text: "It was written by a later version of tcgs. Reload this page to get the newest player, or update tcgs.",
  },
  damaged: {
    title: "The scene is damaged",
    text: "Some of its bytes are not what was written. Fetch or copy the file again.",
  },
  network: {
    title: "The scene could not be loaded",
    text: "The address does not answer, does not exist, or does not allow other pages to read it (CORS).",
  },
  "out-of-memory": {
    title: "The scene is too large for this device",
    text: "There is not enough memory for it on the graphics card. Close other pages, or use a device with more.",
  },
  "bad-camera": {
    title: "These numbers are no camera",
    text: "A camera needs width, height, fx, fy, cx, cy and cameraFromWorld, 16 numbers row by row: a rotation and a shift, without scale or mirror.",
  },
  "device-lost": {
    title: "The graphics card stopped answering",
    text: "Neither WebGPU nor WebGL2 works any more on this page. Reload the page.",
  },
};

const UNKNOWN = { title: "Something went wrong", text: "The player met an error that it does not know." };

/**
 * @param {unknown} error with the engine's `code`, if it is the engine's
 * @returns {{code: string, title: string, text: string, detail: string}}
 */
export function explain(error) {
  const code = error?.code ?? "unknown";
  const known = Object.hasOwn(FAILURES, code) ? FAILURES[code] : UNKNOWN;
  return { code, ...known, detail: String(error?.message ?? error) };
}
