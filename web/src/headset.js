// Shows the player's scene in a headset, by WebXR. A second engine draws with WebGL2, whatever the page draws with. Its
// canvas fits the headset's graphics card, and the page's picture stays as it is.
//
// Rooms have y up and -z ahead, in metres. A scene stands in the room as `{scale, turn, place}`. The point p of the
// scene is at `scale * turn * p + place`. `scale` is the metres of a scene unit. `turn` has the rows of a rotation that
// leaves the scene's up direction up.

import { startWebgl2 } from "./engine.js";
import { addressOf } from "./player.js";
import { AdaptiveResolution } from "./resolution.js";

/** Distance of the middle of a scene of unknown size, metres. */
const FITTED_DISTANCE = 2;
/** Least and greatest height of that middle above the floor, metres. */
const FITTED_HEIGHT = [0.6, 1.4];
/** Height of the eyes where the headset does not know the floor, metres. */
const EYE_HEIGHT = 1.6;
/** A scene can be made larger and smaller by this factor. */
const MOST_SCALED = 100;
/** A pinch on a shorter way, metres, counts as a press of a trigger. */
const PRESS_MOVE = 0.03;
/** Two hands that are nearer to each other from above, metres, do not turn the scene. */
const LEAST_APART = 0.05;

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [0, 1, 2].map((i) => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
/** `a + s * b` */
const added = (a, s, b) => a.map((x, i) => x + s * b[i]);
const length = (a) => Math.sqrt(dot(a, a));
const unit = (a) => a.map((x) => x / length(a));
const clamp = (x, least, most) => Math.min(most, Math.max(least, x));
const times = (matrix, p) => matrix.map((row) => dot(row, p));

/** Rows of a camera's rotation, and its centre. */
function poseOf({ cameraFromWorld: m }) {
  const axes = [0, 4, 8].map((i) => [m[i], m[i + 1], m[i + 2]]);
  return { axes, center: [0, 1, 2].map((j) => -(axes[0][j] * m[3] + axes[1][j] * m[7] + axes[2][j] * m[11])) };
}

/**
 * Where a scene stands when VR is entered. In a scene of known size, the viewer is at the place of the start view, and
 * the ground is the floor. A scene of unknown size has its middle a few steps ahead.
 *
 * @param {{camera: object, pivot: number[], up: number[], ground: number | null}} standing as the engine says
 * @param {number | null} metresPerUnit null: unknown
 */
export function stand({ camera, pivot, up, ground }, metresPerUnit) {
  const { axes, center } = poseOf(camera);
  const level = (v) => added(v, -dot(v, up), up);
  // A camera that looks down has the direction ahead in the upper part of its picture.
  const ahead = unit(level(length(level(axes[2])) > 0.1 ? axes[2] : axes[1].map((x) => -x)));
  const turn = [cross(ahead, up), up, ahead.map((x) => -x)];
  const scale = metresPerUnit ?? FITTED_DISTANCE / length(added(pivot, -1, center));
  const floor = scale * (ground ?? dot(up, pivot) - 1 / scale);
  if (metresPerUnit !== null) {
    const [x, , z] = times(turn, center);
    return { scale, turn, place: [-scale * x, -floor, -scale * z] };
  }
  const [x, y, z] = times(turn, pivot).map((v) => scale * v);
  const height = clamp(y - floor, ...FITTED_HEIGHT);
  return { scale, turn, place: [-x, height - y, -FITTED_DISTANCE - z] };
}

/**
 * The camera of an eye, in scene units.
 *
 * @param {{projectionMatrix: Float32Array, transform: {inverse: {matrix: Float32Array}}}} view an `XRView`
 * @param {{x: number, y: number, width: number, height: number}} part of the framebuffer
 * @returns the engine's camera, with `x` and `y`
 */
export function eyeOf({ projectionMatrix: p, transform }, { x, y, width, height }, { scale, turn, place }) {
  const m = transform.inverse.matrix;
  const rows = [0, 1, 2].map((i) => {
    // A camera's y points down, and its z ahead.
    const row = [m[i], m[4 + i], m[8 + i]].map((v) => (i === 0 ? v : -v));
    const shift = dot(row, place) + (i === 0 ? m[12 + i] : -m[12 + i]);
    return [...[0, 1, 2].map((j) => row[0] * turn[0][j] + row[1] * turn[1][j] + row[2] * turn[2][j]), shift / scale];
  });
  const [fx, fy] = [(p[0] * width) / 2, (p[5] * height) / 2];
  const [cx, cy] = [((1 - p[8]) * width) / 2, ((1 + p[9]) * height) / 2];
  return { x, y, width, height, fx, fy, cx, cy, cameraFromWorld: [...rows.flat(), 0, 0, 0, 1] };
}

/** A camera between the eyes that sees what any of them sees. It stands behind them by their distance. */
export function cameraOfAll(eyes) {
  const poses = eyes.map(poseOf);
  const sum = (of) => poses.map(of).reduce((a, b) => added(a, 1, b));
  const forward = unit(sum(({ axes }) => axes[2]));
  const across = sum(({ axes }) => axes[0]);
  const right = unit(added(across, -dot(across, forward), forward));
  const axes = [right, cross(forward, right), forward];
  const middle = sum(({ center }) => center).map((x) => x / eyes.length);
  const back = 2 * Math.max(...poses.map(({ center }) => length(added(center, -1, middle))));
  const position = added(middle, -back, forward);
  // An eye's picture lies between the rays through its corners. Points of a ray have slopes between that of the eye and
  // that of the ray's direction.
  const directions = poses.flatMap(({ axes: own, center }, i) => {
    const { width, height, fx, fy, cx, cy } = eyes[i];
    const corners = [[0, 0], [width, 0], [0, height], [width, height]].map(([x, y]) => {
      const ray = [(x - cx) / fx, (y - cy) / fy, 1];
      return [0, 1, 2].map((j) => dot(ray, own.map((axis) => axis[j])));
    });
    return back > 0 ? [...corners, added(center, -1, position)] : corners;
  });
  const slopes = directions.map((d) => times(axes, d)).map(([x, y, z]) => [x / z, y / z]);
  const side = (axis, focal) => {
    const all = slopes.map((slope) => slope[axis]);
    const least = Math.min(...all);
    return { side: Math.ceil((Math.max(...all) - least) * focal), center: -least * focal };
  };
  const [fx, fy] = [Math.max(...eyes.map(({ fx }) => fx)), Math.max(...eyes.map(({ fy }) => fy))];
  const [columns, rows] = [side(0, fx), side(1, fy)];
  const cameraFromWorld = [...axes.flatMap((axis) => [...axis, -dot(axis, position)]), 0, 0, 0, 1];
  return { width: columns.side, height: rows.side, fx, fy, cx: columns.center, cy: rows.center, cameraFromWorld };
}

/**
 * The scene after hands have moved that hold it. One moves it and turns it; two also change its size.
 *
 * @param {{position: number[], orientation: number[]}[]} before pose of each hand; orientations are x, y, z, w
 * @param {{position: number[], orientation: number[]}[]} now
 * @param {[number, number]} scales least and greatest scale
 */
export function carried({ scale, turn, place }, before, now, scales) {
  let [angle, factor] = [0, 1];
  if (now.length === 1) {
    const [[bx, by, bz, bw], [x, y, z, w]] = [before[0].orientation, now[0].orientation];
    // The part of the turn that is about the vertical axis.
    angle = 2 * Math.atan2(y * bw - w * by + x * bz - z * bx, w * bw + x * bx + y * by + z * bz);
  } else {
    const [a, b] = [before, now].map((hands) => added(hands[1].position, -1, hands[0].position));
    const isApart = [a, b].every(([x, , z]) => Math.hypot(x, z) > LEAST_APART);
    angle = isApart ? Math.atan2(-b[2], b[0]) - Math.atan2(-a[2], a[0]) : 0;
    factor = clamp((scale * length(b)) / length(a), ...scales) / scale;
  }
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const turned = ([x, y, z]) => [c * x + s * z, y, c * z - s * x];
  const mean = (values) => values.reduce((a, b) => a + b) / values.length;
  const middle = (hands) => [0, 1, 2].map((i) => mean(hands.map(({ position }) => position[i])));
  const columns = [0, 1, 2].map((j) => turned(turn.map((row) => row[j])));
  return {
    scale: factor * scale,
    turn: [0, 1, 2].map((i) => columns.map((column) => column[i])),
    place: added(middle(now), factor, turned(added(place, -1, middle(before)))),
  };
}

/** Metres of a scene unit; null: the file does not say. @param {import("./player.js").Player} player */
async function metresPerUnit(player) {
  try {
    const found = JSON.parse(new TextDecoder().decode(await player.attached("tcgs.units"))).metres_per_unit;
    return found > 0 && Number.isFinite(found) ? found : null;
  } catch {
    return null;
  }
}

/** The hands that hold the scene. Triggers, and hands that pinch without a move, play and pause it. */
class Hands {
  /** Pose in the last frame, and the length of the way since it took hold, by input. */
  #held = new Map();

  /** @param {() => void} toggle plays and pauses */
  constructor(session, toggle) {
    /** Inputs without a second button hold by a pinch. */
    const onlyPinches = ({ hand, targetRayMode }) => Boolean(hand) || targetRayMode === "transient-pointer";
    const hold = ({ inputSource }) => this.#held.set(inputSource, { moved: 0, pose: null });
    const release = ({ inputSource }) => this.#held.delete(inputSource);
    session.addEventListener("squeezestart", hold);
    session.addEventListener("squeezeend", release);
    session.addEventListener("selectstart", (event) => onlyPinches(event.inputSource) && hold(event));
    session.addEventListener("selectend", (event) => {
      if (!onlyPinches(event.inputSource)) return;
      const moved = this.#held.get(event.inputSource)?.moved;
      release(event);
      if (moved < PRESS_MOVE) toggle();
    });
    session.addEventListener("select", ({ inputSource }) => !onlyPinches(inputSource) && toggle());
    session.addEventListener("inputsourceschange", ({ removed }) => {
      for (const inputSource of removed) release({ inputSource });
    });
  }

  /** The scene as the hands have moved it since the last frame. */
  move(standing, frame, space, scales) {
    const [before, now] = [[], []];
    for (const [source, held] of this.#held) {
      const found = frame.getPose(source.gripSpace ?? source.targetRaySpace, space)?.transform;
      const vector = ({ x, y, z }) => [x, y, z];
      const orientation = found && [...vector(found.orientation), found.orientation.w];
      const pose = found && { position: vector(found.position), orientation };
      if (pose && held.pose) {
        held.moved += length(added(pose.position, -1, held.pose.position));
        before.push(held.pose);
        now.push(pose);
      }
      held.pose = pose;
    }
    return now.length === 0 ? standing : carried(standing, before.slice(0, 2), now.slice(0, 2), scales);
  }
}

/** A space whose origin is on the floor. */
async function floorOf(session) {
  try {
    return await session.requestReferenceSpace("local-floor");
  } catch {
    const space = await session.requestReferenceSpace("local");
    return space.getOffsetReferenceSpace(new XRRigidTransform({ y: -EYE_HEIGHT }));
  }
}

/**
 * Shows the scene until the session ends, or the page shows another one. Resolves when the page has the scene back.
 *
 * @param {XRSession} session
 * @param {import("./player.js").Player} player with a scene
 * @param {() => boolean} showsDoubt whether an edge shows how little pictures can be trusted
 */
export async function showScene(session, player, showsDoubt) {
  let hasEnded = false;
  const ended = new Promise((resolve) => {
    session.addEventListener("end", () => {
      hasEnded = true;
      resolve();
    });
  });
  // It may have ended.
  const end = () => session.end().catch(() => {});
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("webgl2", { xrCompatible: true, alpha: false, antialias: false, depth: false });
  const { viewer, stop } = await startWebgl2(canvas, null);
  player.addEventListener("back", end);
  try {
    if (hasEnded) return;
    const options = { alpha: false, antialias: false, depth: false };
    const layer = new XRWebGLLayer(session, context, options);
    session.updateRenderState({ baseLayer: layer });
    const space = await floorOf(session);
    const { source } = player;
    const address = typeof source === "string" ? addressOf(source) : source;
    const opening = Promise.all([metresPerUnit(player), viewer.open(address, player.state?.timestep ?? 0)]);
    const [metres] = (await Promise.race([opening, ended])) ?? [];
    if (hasEnded || player.source !== source || !player.info) return;
    await Promise.race([ended, draw(session, layer, space, viewer, player, metres, showsDoubt)]);
  } finally {
    player.removeEventListener("back", end);
    player.takeBack();
    await end();
    stop();
  }
}

/** Draws each frame of a session; rejects if the engine fails. */
function draw(session, layer, space, viewer, player, metres, showsDoubt) {
  let standing = stand(viewer.standing(), metres);
  const scales = [standing.scale / MOST_SCALED, standing.scale * MOST_SCALED];
  const hands = new Hands(session, () => player.toggle());
  const resolution = new AdaptiveResolution();
  let last = null;
  player.handOver(viewer);
  return new Promise((_, reject) => {
    const next = (now, frame) => {
      session.requestAnimationFrame(next);
      const pose = frame.getViewerPose(space);
      if (!pose) return;
      standing = hands.move(standing, frame, space, scales);
      if (last !== null) resolution.frame(now - last);
      last = now;
      const eyes = pose.views.map((view) => {
        view.requestViewportScale?.(resolution.scale);
        return eyeOf(view, layer.getViewport(view), standing);
      });
      try {
        const state = viewer.frameOfEyes(now, layer.framebuffer, cameraOfAll(eyes), eyes, showsDoubt());
        player.showElsewhere(viewer, { ...state, width: eyes[0].width, height: eyes[0].height });
      } catch (error) {
        reject(error);
      }
    };
    session.requestAnimationFrame(next);
  });
}
