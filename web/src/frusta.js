// The cameras of a capture, drawn over the scene: a frustum of lines for each, with its image at the far end.
//
// The page draws them, not the engine, so Gaussians do not hide them. The images are elements placed by a projective
// transform of CSS; the browser resamples them. docs/PLAYER.md describes the file of cameras.

import { element, toast } from "./ui.js";

/** The views that key C cycles through. */
const SHOWN = ["cameras with their images", "cameras", "no cameras"];
const LINE = "#6cb6ff";
const TOP = "#ffb454";
/** Near plane: share of a frustum's depth within which nothing is drawn. */
const NEAR = 0.02;
/** A viewer this near to a camera, in frustum depths, looks through it: its image lets the scene show. */
const INSIDE = 0.1;

/**
 * Loads the file of cameras and draws it with every frame.
 *
 * @param {import("./player.js").Player} player
 * @param {string | null} source address of the file; null: there is none
 * @param {boolean} starts whether the file's start view is used
 * @returns {{toggle: () => void}} `toggle` shows less, and after nothing everything
 */
export function frusta(player, source, starts) {
  const layer = element("frusta");
  const context = element("frusta-lines").getContext("2d");
  let [cameras, depth, mode, drawn] = [[], 1, 0, ""];

  const draw = () => {
    const viewer = player.camera();
    const { clientWidth: width, clientHeight: height } = layer;
    const ratio = window.devicePixelRatio;
    const now = viewer && JSON.stringify([viewer, width, height, ratio, mode, cameras.length]);
    if (!now || now === drawn) return;
    drawn = now;
    const { canvas } = context;
    [canvas.width, canvas.height] = [width, height].map((side) => Math.round(side * ratio));
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const view = { ...viewer, scale: [width / viewer.width, height / viewer.height] };
    for (const camera of cameras) drawCamera(context, camera, view, depth, mode);
  };
  const toggle = () => {
    if (cameras.length === 0) return;
    mode = (mode + 1) % SHOWN.length;
    layer.hidden = mode === 2;
    element("toggle-frusta").setAttribute("aria-pressed", String(mode !== 2));
    toast(`Shows ${SHOWN[mode]}`);
    draw();
  };
  element("toggle-frusta").addEventListener("click", toggle);
  player.addEventListener("frame", draw);
  window.addEventListener("resize", draw);
  // They belong to the first scene alone.
  let first = true;
  player.addEventListener("load", async () => {
    if (first && source) {
      try {
        const file = await (await fetch(source)).json();
        ({ cameras, depth } = read(file));
        player.home = file.start ?? null;
        if (starts) player.reset();
      } catch (error) {
        toast(`The cameras cannot be shown: ${error.message}`);
      }
    } else {
      [cameras, player.home] = [[], null];
    }
    first = false;
    layer.querySelectorAll("img").forEach((image) => image.remove());
    layer.prepend(...cameras.map(({ image }) => image));
    for (const id of ["frusta", "toggle-frusta"]) element(id).hidden = cameras.length === 0;
    layer.dataset.cameras = String(cameras.length);
    player.touch();
  });
  return { toggle };
}

/** Cameras of the file, with their image elements. Throws if the file has another form. */
function read({ cameras, depth }) {
  const isCamera = ({ width, height, fx, fy, cx, cy, cameraFromWorld }) =>
    [width, height, fx, fy, cx, cy, ...cameraFromWorld].every(Number.isFinite) && cameraFromWorld.length === 16;
  if (!Array.isArray(cameras) || !cameras.every(isCamera) || !(depth > 0)) {
    throw new Error("this is no file of cameras");
  }
  const withImage = (camera) => {
    const image = new Image();
    image.alt = `Camera ${camera.name}`;
    image.draggable = false;
    image.hidden = true;
    // Other addresses are refused, because the file may be a stranger's.
    if (camera.image?.startsWith("data:image/")) image.src = camera.image;
    [image.style.width, image.style.height] = [`${camera.width}px`, `${camera.height}px`];
    return { ...camera, image };
  };
  return { cameras: cameras.map(withImage), depth };
}

function drawCamera(context, camera, view, depth, mode) {
  const { width, height } = camera;
  const place = inView(camera, view, depth);
  const [apex, ...corners] = [[0, 0, 0], [0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]].map(place.of);
  const { image } = camera;
  image.hidden = mode !== 0 || !image.src || corners.some(([, , z]) => z < NEAR * depth);
  if (!image.hidden) {
    const [a, b, c] = place.matrix;
    image.style.transform = `matrix3d(${[a[0], b[0], 0, c[0], a[1], b[1], 0, c[1], 0, 0, 1, 0, a[2], b[2], 0, c[2]]
      .map((x) => x / c[2])
      .join(",")})`;
    // Far ones first.
    image.style.zIndex = String(-Math.round((1000 * corners.reduce((sum, [, , z]) => sum + z, 0)) / (4 * depth)));
    image.classList.toggle("through", Math.hypot(...apex) < INSIDE * depth);
  }
  context.lineWidth = 1.5;
  context.strokeStyle = LINE;
  // The upper side of the image in another colour: cameras that are upside down are a common mistake.
  for (const corner of corners) line(context, apex, corner, view, depth);
  corners.forEach((corner, i) => {
    context.strokeStyle = i === 0 ? TOP : LINE;
    line(context, corner, corners[(i + 1) % 4], view, depth);
  });
  if (apex[2] > NEAR * depth) {
    const [x, y] = pixel(apex, view);
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.lineWidth = 3;
    context.strokeStyle = "#000a";
    context.fillStyle = "#fff";
    context.strokeText(camera.name, x, y - 6);
    context.fillText(camera.name, x, y - 6);
  }
}

/**
 * Maps places `[u, v, 1]` of a camera's image, put at the frustum's depth, and `[0, 0, 0]` for its centre, to the
 * viewer.
 *
 * `of` gives axes x right, y down, z forward in scene units; `matrix` the homography to CSS pixels, in rows.
 */
function inView({ cameraFromWorld: m, fx, fy, cx, cy }, view, depth) {
  const v = view.cameraFromWorld;
  const row = (matrix, i) => matrix.slice(4 * i, 4 * i + 3);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  // Rotation from the camera to the viewer, and the camera's centre in the viewer's axes.
  const turn = [0, 1, 2].map((i) => [0, 1, 2].map((j) => dot(row(v, i), row(m, j))));
  const center = [0, 1, 2].map((i) => v[4 * i + 3] - dot(turn[i], [m[3], m[7], m[11]]));
  // A pixel's ray is [(u - cx) / fx, (v - cy) / fy, 1].
  const rays = turn.map(([x, y, z], i) => {
    const constant = depth * (z - (x * cx) / fx - (y * cy) / fy);
    return [(depth * x) / fx, (depth * y) / fy, constant, center[i]];
  });
  const of = ([s, t, w]) => rays.map(([a, b, c, origin]) => a * s + b * t + c * w + origin);
  const [x, y, z] = rays.map(([a, b, c, origin]) => [a, b, c + origin]);
  const onto = (axis, focal, middle, scale) => axis.map((value, i) => scale * (focal * value + middle * z[i]));
  const matrix = [onto(x, view.fx, view.cx, view.scale[0]), onto(y, view.fy, view.cy, view.scale[1]), z];
  return { of, matrix };
}

/** Projection to the viewer, CSS pixels. */
function pixel([x, y, z], { fx, fy, cx, cy, scale }) {
  return [scale[0] * ((fx * x) / z + cx), scale[1] * ((fy * y) / z + cy)];
}

/** A line between two places, clipped to the part in front of the viewer. */
function line(context, a, b, view, depth) {
  const near = NEAR * depth;
  if (a[2] < near && b[2] < near) return;
  const cut = (from, to) => {
    if (from[2] >= near) return from;
    const share = (near - from[2]) / (to[2] - from[2]);
    return from.map((value, i) => value + share * (to[i] - value));
  };
  context.beginPath();
  context.moveTo(...pixel(cut(a, b), view));
  context.lineTo(...pixel(cut(b, a), view));
  context.stroke();
}
