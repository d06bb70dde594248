// Chooses the renderer: WebGPU where it works, else WebGL2. Each is a module of WebAssembly; a page loads one of them.

/** Milliseconds until WebGPU counts as one that does not answer. */
export const PATIENCE_MS = 20_000;

/**
 * `viewer` is the module's `Viewer`, on `canvas`. `reason` says why WebGPU does not draw. It is null if WebGPU draws, was
 * not wanted, or is unknown to the browser.
 * @typedef {{
 *   name: "WebGPU" | "WebGL2", viewer: any, CameraPath: any, canvas: HTMLCanvasElement, reason: string | null
 * }} Engine
 */

/**
 * Starts an engine.
 *
 * @param {HTMLCanvasElement} canvas without a context; it is replaced by a copy if WebGPU took it and then failed
 * @param {"webgpu" | "webgl2" | null} wanted the only one to try; null: the better one that works
 * @returns {Promise<Engine>} rejects with a code if none works
 */
export async function startEngine(canvas, wanted) {
  if (wanted === "webgl2") return startWebgl2(canvas, null);
  let reason = null;
  try {
    await findAdapter();
    const module = await import("./engine/tcgs_play.js");
    await module.default();
    const viewer = await module.Viewer.create(canvas);
    return { name: "WebGPU", viewer, CameraPath: module.CameraPath, canvas, reason };
  } catch (error) {
    if (wanted === "webgpu") throw error;
    reason = error;
  }
  try {
    return await startWebgl2(freshCanvas(canvas), navigator.gpu ? reason.message : null);
  } catch (error) {
    throw Object.assign(new Error(`${reason.message}; ${error.message}`), { code: error.code });
  }
}

/** A copy of a canvas in its place: a canvas that has had a context never gets one of another kind. */
export function freshCanvas(canvas) {
  const fresh = canvas.cloneNode();
  const hasFocus = document.activeElement === canvas;
  canvas.replaceWith(fresh);
  if (hasFocus) fresh.focus();
  return fresh;
}

async function findAdapter() {
  const missing = (message) => Object.assign(new Error(message), { code: "no-webgpu" });
  if (!navigator.gpu) throw missing("this browser has no WebGPU");
  let timer;
  const late = new Promise((_, reject) => {
    timer = setTimeout(() => reject(missing("WebGPU does not answer")), PATIENCE_MS);
  });
  try {
    const adapter = await Promise.race([navigator.gpu.requestAdapter({ powerPreference: "high-performance" }), late]);
    if (!adapter) throw missing("WebGPU finds no graphics card");
  } finally {
    clearTimeout(timer);
  }
}

/**
 * Starts WebGL2 on a canvas.
 *
 * @param {string | null} reason why WebGPU does not draw
 * @returns {Promise<Engine & {stop: () => void}>} `stop` frees what the engine holds; it draws no more then
 */
export async function startWebgl2(canvas, reason) {
  const module = await import("./engine-webgl2/tcgs_play.js");
  await module.default();
  const worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  try {
    const viewer = await module.Viewer.create(canvas, worker);
    const stop = () => {
      worker.terminate();
      viewer.free();
      canvas.getContext("webgl2").getExtension("WEBGL_lose_context")?.loseContext();
    };
    return { name: "WebGL2", viewer, CameraPath: module.CameraPath, canvas, reason, stop };
  } catch (error) {
    worker.terminate();
    throw error;
  }
}
