// Reads and writes the file of a camera path (docs/PLAYER.md). The engine interpolates the path
// (crates/core/src/camera_path.rs).

import { CameraPath } from "./engine/tcgs_play.js";

const FORMAT = "tcgs-camera-path";

/** The file's text. @param {CameraPath} path */
export function pathToJson(path) {
  const cameras = path.keyframes().map(({ timestep, camera }) => ({ timestep, ...camera }));
  return JSON.stringify({ format: FORMAT, version: 1, cameras }, null, 1);
}

/** Reads a file's text, once the engine has started; throws an `Error` that says what is wrong. */
export function pathFromJson(text) {
  const file = JSON.parse(text);
  if (file?.format !== FORMAT || file.version !== 1) throw new Error("This is no camera path of version 1.");
  const path = new CameraPath();
  for (const { timestep, ...camera } of file.cameras ?? []) path.insert(timestep, camera);
  if (path.keyframes().length === 0) throw new Error("This path has no views.");
  return path;
}
