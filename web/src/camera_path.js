// Reads and writes the file of a camera path (docs/PLAYER.md). The engine interpolates the path, an object of its class
// `CameraPath` (crates/core/src/camera_path.rs).

const FORMAT = "tcgs-camera-path";

/** The file's text. */
export function pathToJson(path) {
  const cameras = path.keyframes().map(({ timestep, camera }) => ({ timestep, ...camera }));
  return JSON.stringify({ format: FORMAT, version: 1, cameras }, null, 1);
}

/**
 * Reads a file's text; throws an `Error` that says what is wrong.
 *
 * @param path a path without keyframes, which gets those of the file
 */
export function pathFromJson(text, path) {
  const file = JSON.parse(text);
  if (file?.format !== FORMAT || file.version !== 1) throw new Error("This is no camera path of version 1.");
  for (const { timestep, ...camera } of file.cameras ?? []) path.insert(timestep, camera);
  if (path.keyframes().length === 0) throw new Error("This path has no views.");
  return path;
}
