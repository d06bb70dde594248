// Commands and events between this page and a page that embeds it, as messages. tcgs-player.js is the other end.

import { explain } from "./failures.js";

/** The commands that an embedding page may send. @param {import("./player.js").Player} player */
function commands(player) {
  return {
    load: async (source) => {
      let failure = null;
      const failed = ({ detail }) => (failure = explain(detail));
      player.addEventListener("failure", failed, { once: true });
      const done = await player.open(source);
      player.removeEventListener("failure", failed);
      if (!done) throw failure ?? { code: "replaced", title: "Another scene was opened meanwhile", detail: "" };
      return describe(player);
    },
    play: () => player.play(),
    pause: () => player.pause(),
    seek: (timestep) => player.seek(timestep),
    setSpeed: (speed) => player.setSpeed(speed),
    setLoop: (loop) => player.setLoop(loop),
    setCamera: (camera) => player.setCamera(camera),
    useCamera: (index) => player.useCamera(index),
    resetCamera: () => player.reset(),
    camera: () => player.camera(),
    state: () => player.state,
    info: () => describe(player),
  };
}

/** Describes an error that the engine did not throw. */
const unknown = (error) => ({ code: "unknown", title: String(error.message ?? error), detail: "" });

function describe(player) {
  if (!player.info) return null;
  const { name, numGaussians, numTimesteps, frameRate, bytes, cameras } = player.info;
  return { name, numGaussians, numTimesteps, frameRate, bytes, cameras: cameras.map((camera) => camera.name) };
}

/** @param {import("./player.js").Player} player */
export function listenToEmbedder(player) {
  if (window.parent === window) return;
  const known = commands(player);
  const tell = (message) => window.parent.postMessage({ tcgs: 1, ...message }, "*");

  window.addEventListener("message", async ({ source, data }) => {
    if (source !== window.parent || data?.tcgs !== 1 || !Object.hasOwn(known, data.method)) return;
    try {
      const result = await known[data.method](...(data.args ?? []));
      tell({ id: data.id, result });
    } catch (error) {
      tell({ id: data.id, error: error.title ? error : error.code ? explain(error) : unknown(error) });
    }
  });

  player.addEventListener("load", () => tell({ event: "load", detail: describe(player) }));
  player.addEventListener("failure", ({ detail }) => tell({ event: "error", detail: explain(detail) }));
  let playing = false;
  let timestep = null;
  player.addEventListener("frame", () => {
    const { state } = player;
    if (state.playing !== playing) tell({ event: state.playing ? "play" : "pause" });
    if (state.timestep !== timestep) tell({ event: "timestep", detail: { timestep: state.timestep } });
    ({ playing, timestep } = state);
  });
  tell({ event: "ready" });
}
