// Views at timesteps and the cameras between them. `tcgs render --path` computes the same
// (crates/cli/src/render/path_file.rs).

const FORMAT = "tcgs-camera-path";
/** How far products of a rotation's rows may be from 0 and 1. */
const ROTATION_TOLERANCE = 1e-3;

export class CameraPath {
  /** `{timestep, camera}` by increasing timestep. */
  keys = [];

  /** Adds a view; one at the same timestep makes room. */
  add(timestep, camera) {
    this.keys = this.keys.filter((key) => key.timestep !== timestep);
    this.keys.push({ timestep, camera });
    this.keys.sort((a, b) => a.timestep - b.timestep);
  }

  /** The camera at a timestep, for a picture of a size. Needs at least one view. */
  camera(timestep, width, height) {
    const keys = this.keys;
    const after = keys.filter((key) => key.timestep <= timestep).length;
    const key = keys[Math.max(0, after - 1)];
    if (after === 0 || after === keys.length || key.timestep === timestep) return fitted(key.camera, width, height);
    const numbers = keys.map((k) => numbersOf(fitted(k.camera, width, height)));
    const times = keys.map((k) => k.timestep);
    const slopes = (index) => numbers[index].map((_, i) => slope(times, numbers.map((n) => n[i]), index));
    const [from, to, fromSlope, toSlope] = [numbers[after - 1], numbers[after], slopes(after - 1), slopes(after)];
    const h = times[after] - times[after - 1];
    const s = (timestep - key.timestep) / h;
    const mixed = from.map(
      (x, i) =>
        (2 * s ** 3 - 3 * s ** 2 + 1) * x +
        (s ** 3 - 2 * s ** 2 + s) * h * fromSlope[i] +
        (3 * s ** 2 - 2 * s ** 3) * to[i] +
        (s ** 3 - s ** 2) * h * toSlope[i],
    );
    return cameraOf(mixed, width, height);
  }

  /** The file's text. */
  toJson() {
    const cameras = this.keys.map(({ timestep, camera }) => ({
      timestep,
      width: camera.width,
      height: camera.height,
      fx: camera.fx,
      fy: camera.fy,
      cx: camera.cx,
      cy: camera.cy,
      cameraFromWorld: Array.from(camera.cameraFromWorld),
    }));
    return JSON.stringify({ format: FORMAT, version: 1, cameras }, null, 1);
  }

  /** Reads a file's text; throws an `Error` that says what is wrong. */
  static fromJson(text) {
    const file = JSON.parse(text);
    if (file?.format !== FORMAT || file.version !== 1) throw new Error("This is no camera path of version 1.");
    const path = new CameraPath();
    for (const { timestep, ...camera } of file.cameras ?? []) {
      checkCamera(camera);
      if (!Number.isFinite(timestep)) throw new Error("A view of this path has no timestep.");
      path.add(timestep, camera);
    }
    if (path.keys.length === 0) throw new Error("This path has no views.");
    return path;
  }
}

/** Throws an `Error` if something is no camera. */
export function checkCamera(camera) {
  const numbers = ["width", "height", "fx", "fy", "cx", "cy"].map((name) => camera?.[name]);
  const matrix = Array.from(camera?.cameraFromWorld ?? []);
  const right = [...numbers, ...matrix].every(Number.isFinite) && matrix.length === 16;
  if (!right || numbers.slice(0, 4).some((x) => x <= 0)) {
    throw new Error("A camera needs width, height, fx, fy, cx, cy and cameraFromWorld, 16 numbers row by row.");
  }
  if (!isRotation(matrix)) {
    throw new Error("A camera's cameraFromWorld needs to be a rotation and a shift: no scale, no mirror.");
  }
}

/** Whether the engine takes a matrix, 16 numbers row by row (crates/core/src/camera.rs). */
function isRotation(m) {
  const [x, y, z, last] = [0, 4, 8, 12].map((i) => m.slice(i, i + 3));
  const near = (a, b, expected) => Math.abs(dot(a, b) - expected) <= ROTATION_TOLERANCE;
  return (
    [x, y, z].every((axis) => near(axis, axis, 1)) &&
    near(x, y, 0) && near(y, z, 0) && near(z, x, 0) &&
    dot(cross(x, y), z) > 0 &&
    last.every((number) => number === 0) && m[15] === 1
  );
}

/** The same view in a picture of another size: square pixels, and all that it shows is shown. */
export function fitted(camera, width, height) {
  if (camera.width === width && camera.height === height) return camera;
  const scale = Math.min(width / camera.width, height / camera.height);
  return {
    width,
    height,
    fx: scale * camera.fx,
    fy: scale * camera.fy,
    cx: width / 2 + scale * (camera.cx - camera.width / 2),
    cy: height / 2 + scale * (camera.cy - camera.height / 2),
    cameraFromWorld: camera.cameraFromWorld,
  };
}

/** Centre, forward and down axis, focal lengths, principal point. */
function numbersOf({ fx, fy, cx, cy, cameraFromWorld: m }) {
  const center = [0, 1, 2].map((j) => -(m[j] * m[3] + m[4 + j] * m[7] + m[8 + j] * m[11]));
  return [...center, ...m.slice(8, 11), ...m.slice(4, 7), fx, fy, cx, cy];
}

function cameraOf(numbers, width, height) {
  const center = numbers.slice(0, 3);
  const z = unit(numbers.slice(3, 6));
  const x = unit(cross(numbers.slice(6, 9), z));
  const y = cross(z, x);
  const row = (axis) => [...axis, -(axis[0] * center[0] + axis[1] * center[1] + axis[2] * center[2])];
  const [fx, fy, cx, cy] = numbers.slice(9);
  return { width, height, fx, fy, cx, cy, cameraFromWorld: [...row(x), ...row(y), ...row(z), 0, 0, 0, 1] };
}

/**
 * Of values at times, at one of these times: of the parabola through it and its neighbours, at an end the two nearest;
 * of two values, of the line.
 */
function slope(times, values, index) {
  if (times.length === 2) return (values[1] - values[0]) / (times[1] - times[0]);
  const first = Math.min(Math.max(0, index - 1), times.length - 3);
  const [[t0, t1, t2], [x0, x1, x2]] = [times, values].map((list) => list.slice(first, first + 3));
  const t = times[index];
  return (
    (x0 * (2 * t - t1 - t2)) / ((t0 - t1) * (t0 - t2)) +
    (x1 * (2 * t - t0 - t2)) / ((t1 - t0) * (t1 - t2)) +
    (x2 * (2 * t - t0 - t1)) / ((t2 - t0) * (t2 - t1))
  );
}

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

const unit = (v) => v.map((x) => x / Math.hypot(...v));
