// Tests of the page that need no browser. Run, after web/build.sh: node --test web/test/unit.mjs

import assert from "node:assert/strict";
import { existsSync, readFileSync } from "node:fs";
import { test } from "node:test";

import { digits, line } from "../src/chart.js";
import { explain } from "../src/failures.js";
import { cameraOfAll, carried, eyeOf, stand } from "../src/headset.js";
import { readParams } from "../src/params.js";
import { AdaptiveResolution } from "../src/resolution.js";
import { follow } from "../src/sound.js";
import { describe } from "../src/training.js";
import { nameOf, nextSpeed } from "../src/ui.js";

test("a curve fills its box, and a single point is a short line", () => {
  assert.equal(line([[0, 1], [5, 3], [10, 2]]), "0.0,45.0 120.0,3.0 240.0,24.0");
  assert.equal(line([[0, 1], [1, 10], [2, 100]], { log: true }), "0.0,45.0 120.0,24.0 240.0,3.0");
  assert.equal(line([[1, 0], [2, 0.5]], { log: true, range: [0, 1] }), "0.0,45.0 240.0,24.0", "no logarithm of 0");
  assert.equal(line([[7, 2]]), "120.0,24.0 124.0,24.0");
  assert.deepEqual([0.012345, 31.26, 0, 12345].map(digits), ["0.0123", "31.3", "0", "12300"]);
});

test("a training is told in a line", () => {
  const state = { has_ended: false, num_timesteps: 24, num_gaussians: 8123, running: null, timesteps: { psnr: [] } };
  assert.equal(describe(state), "About to begin");
  assert.equal(describe({ ...state, timesteps: { psnr: [30] } }), "After timestep 1 of 24");
  const running = { timestep: 1, iterations: 20, of_iterations: 300 };
  assert.equal(describe({ ...state, running }), "Timestep 2 of 24, iteration 20 of 300, 8\u202f123 Gaussians");
  const ended = { ...state, has_ended: true, timesteps: { psnr: [30, 31] } };
  assert.equal(describe(ended), "The training has ended: 2 timesteps, mean PSNR 30.50 dB");
});

test("addresses say what to show, and nonsense says nothing", () => {
  const nothing = readParams("");
  assert.deepEqual(
    [nothing.src, nothing.autoplay, nothing.loop, nothing.controls, nothing.trust, nothing.speed, nothing.timestep, nothing.view],
    [null, true, true, true, true, 1, 0, null],
  );
  const all = readParams("?src=a%20b.tcgs&cameras=c.json&autoplay=0&loop=false&controls=off&trust=0&speed=0.5&timestep=7&view=0&theme=dark&quality=fixed&dpr=1");
  assert.deepEqual(all, {
    src: "a b.tcgs",
    cameras: "c.json",
    autoplay: false,
    loop: false,
    controls: false,
    stats: false,
    trust: false,
    speed: 0.5,
    timestep: 7,
    view: 0,
    theme: "dark",
    quality: "fixed",
    renderer: null,
    dpr: 1,
  });
  assert.equal(readParams("?renderer=webgl2").renderer, "webgl2");
  const odd = readParams("?speed=fast&timestep=-3&view=&dpr=0&theme=pink&quality=best");
  assert.deepEqual([odd.speed, odd.timestep, odd.view, odd.dpr, odd.theme, odd.quality], [1, 0, null, null, null, "auto"]);
});

/** Draws frames whose time depends on the scale, and returns the scale of each. */
function drawn(resolution, count, milliseconds) {
  return Array.from({ length: count }, () => {
    const { scale } = resolution;
    resolution.frame(Math.max(1000 / 60, milliseconds(scale)));
    return scale;
  });
}

test("a fast device draws all pixels", () => {
  assert.ok(drawn(new AdaptiveResolution(), 500, () => 4).every((scale) => scale === 1));
});

test("a slow device draws as many as it can in time, and does not flicker", () => {
  const cost = (scale) => 60 * scale * scale;
  const scales = drawn(new AdaptiveResolution(), 2000, cost);
  const late = scales.slice(1000);
  assert.ok(late.every((scale) => cost(scale) < 1.4 * 1.25 * (1000 / 60)), `${Math.max(...late)}`);
  assert.ok(Math.min(...late) > 0.35, "no fewer than needed");
  const changes = late.filter((scale, i) => i > 0 && scale !== late[i - 1]).length;
  assert.ok(changes <= 6, `${changes} changes in 1000 frames`);
});

test("a device that becomes fast again draws all pixels again", () => {
  const resolution = new AdaptiveResolution();
  drawn(resolution, 200, (scale) => 60 * scale * scale);
  assert.ok(resolution.scale < 0.7);
  drawn(resolution, 3000, () => 5);
  assert.equal(resolution.scale, 1);
});

test("pixels do not pay for time that goes elsewhere", () => {
  const scales = drawn(new AdaptiveResolution(), 1500, () => 45);
  assert.ok(scales.filter((scale) => scale === 1).length > 1300, "fewer pixels did not help");
});

// Tests of the built page with its WebAssembly, of what needs no GPU.
const DIST = new URL("../dist/", import.meta.url);
const ENGINES = ["engine", "engine-webgl2"];
const isBuilt = ENGINES.every((engine) => existsSync(new URL(`${engine}/tcgs_play.js`, DIST)));
assert.ok(isBuilt || !process.env.REQUIRE_PLAYER, "web/dist is missing: run web/build.sh");
const engineTest = (name, run) => {
  for (const engine of ENGINES) {
    test(`${name} (${engine})`, { skip: isBuilt ? false : "web/dist is missing: run web/build.sh" }, async () => {
      const { initSync, CameraPath } = await import(new URL(`${engine}/tcgs_play.js`, DIST));
      initSync({ module: readFileSync(new URL(`${engine}/tcgs_play_bg.wasm`, DIST)) });
      await run(CameraPath, await import(new URL("camera_path.js", DIST)));
    });
  }
};

const camera = (angle) => {
  // On a circle of radius 3 around the origin, looking at it.
  const [s, c] = [Math.sin(angle), Math.cos(angle)];
  return {
    width: 100,
    height: 60,
    fx: 80,
    fy: 80,
    cx: 50,
    cy: 30,
    cameraFromWorld: [c, 0, s, 0, 0, 1, 0, 0, -s, 0, c, 3, 0, 0, 0, 1],
  };
};

engineTest("a path meets its views and turns between them", (CameraPath) => {
  const path = new CameraPath();
  for (const timestep of [8, 2, 4, 6]) path.insert(timestep, camera(0.1 * timestep));
  assert.deepEqual(path.keyframes().map((keyframe) => keyframe.timestep), [2, 4, 6, 8]);
  assert.deepEqual(path.cameraAt(4, 100, 60), camera(0.4));
  assert.deepEqual(path.cameraAt(0, 100, 60), camera(0.2));
  assert.deepEqual(path.cameraAt(99, 100, 60), camera(0.8));
  const between = path.cameraAt(5, 100, 60).cameraFromWorld;
  for (const [i, expected] of camera(0.5).cameraFromWorld.entries()) {
    assert.ok(Math.abs(between[i] - expected) < 0.01, `${i}: ${between[i]}, expected ${expected}`);
  }
  path.insert(4, camera(1));
  assert.equal(path.keyframes().length, 4, "a view at the same timestep makes room");
});

engineTest("a path comes back from its file, and nothing else does", (CameraPath, { pathFromJson, pathToJson }) => {
  const path = new CameraPath();
  path.insert(3, camera(3 / 10));
  path.insert(1, { ...camera(1 / 10), cameraFromWorld: new Float64Array(camera(1 / 10).cameraFromWorld) });
  const text = pathToJson(path);
  const expected = [1, 3].map((timestep) => ({ timestep, camera: camera(timestep / 10) }));
  assert.deepEqual(pathFromJson(text, new CameraPath()).keyframes(), expected);
  const { format, version, cameras } = JSON.parse(text);
  assert.deepEqual([format, version, Object.keys(cameras[0])], ["tcgs-camera-path", 1, ["timestep", ...Object.keys(camera(0))]]);
  const wrong = [
    "{}",
    "null",
    '{"format":"tcgs-camera-path","version":1,"cameras":[]}',
    text.replace('"fx"', '"f"'),
    text.replace('"timestep"', '"time"'),
  ];
  for (const text of wrong) assert.throws(() => pathFromJson(text, new CameraPath()), Error, text);
});

engineTest("a view shows all that it shows in another window, too", (CameraPath) => {
  const path = new CameraPath();
  assert.throws(() => path.cameraAt(0, 400, 120), { code: "bad-camera" });
  path.insert(0, camera(0));
  const wide = path.cameraAt(0, 400, 120);
  assert.deepEqual([wide.fx, wide.fy, wide.cx, wide.cy], [160, 160, 200, 60]);
  const tall = path.cameraAt(0, 50, 120);
  assert.deepEqual([tall.fx, tall.fy, tall.cx, tall.cy], [40, 40, 25, 60]);
});

engineTest("a camera is turned and shifted, and nothing else", (CameraPath) => {
  const { cameraFromWorld } = camera(0.3);
  const changed = (action) => ({ ...camera(0), cameraFromWorld: cameraFromWorld.map(action) });
  const path = new CameraPath();
  path.insert(0, changed((x) => x + 1e-5 * (x !== 0 && x !== 1)));
  const wrong = {
    "larger": changed((x, i) => (i < 12 ? 2 * x : x)),
    "mirrored": changed((x, i) => (i < 4 ? -x : x)),
    "flat": changed((x, i) => (i < 12 ? 0 : x)),
    "sheared": changed((x, i) => (i === 1 ? 0.1 : x)),
    "with another last row": changed((x, i) => (i === 12 ? 1 : x)),
    "by columns": { ...camera(0), cameraFromWorld: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 3, 1] },
    "of one number": { ...camera(0), cameraFromWorld: [1] },
    "with a negative focal length": { ...camera(0), fx: -1 },
    "without a width": { ...camera(0), width: undefined },
    "missing": undefined,
  };
  for (const [name, given] of Object.entries(wrong)) assert.throws(() => path.insert(0, given), { code: "bad-camera" }, name);
  assert.throws(() => path.insert(undefined, camera(0)), { code: "bad-camera" }, "nowhere in time");
});

test("speeds are next to any speed, those that the address alone can ask for included", () => {
  for (const [speed, slower, faster] of [[1, 0.5, 2], [0.3, 0.25, 0.5], [8, 4, 8], [0.05, 0.05, 0.1], [4, 2, 4], [0.1, 0.1, 0.25]]) {
    assert.deepEqual([nextSpeed(speed, -1), nextSpeed(speed, 1)], [slower, faster], `${speed}`);
  }
});

test("a scene is called as its file, however that is written", () => {
  globalThis.location = { href: "http://host/player/" };
  const names = {
    "a%20b.tcgs?x=/y": "a b.tcgs",
    "http://host/x/100%.tcgs": "100%.tcgs",
    "http://host/": "scene",
    "http://[": "http://[",
  };
  for (const [source, name] of Object.entries(names)) assert.equal(nameOf(source), name);
  assert.equal(nameOf(new File([], "a%20b.tcgs")), "a%20b.tcgs");
});

test("failures are told to people", () => {
  globalThis.isSecureContext = true;
  for (const code of ["no-webgpu", "not-tcgs", "truncated", "newer-version", "damaged", "network", "out-of-memory", "device-lost", "bad-camera"]) {
    const { title, text, detail } = explain(Object.assign(new Error("why"), { code }));
    assert.ok(title.length > 10 && text.length > 30 && detail === "why", code);
  }
  assert.equal(explain("odd").code, "unknown");
  assert.equal(explain(Object.assign(new Error("x"), { code: "toString" })).title, "Something went wrong");
});

test("a sound follows the clock, and falls silent with it", () => {
  const audio = {
    paused: true,
    currentTime: 0,
    playbackRate: 1,
    duration: 10,
    play() {
      this.paused = false;
      return Promise.resolve();
    },
    pause() {
      this.paused = true;
    },
  };
  const at = (seconds, speed = 1, more = {}) => {
    follow(audio, { seconds, playing: true, buffering: false, ...more }, speed);
    return [audio.paused, audio.currentTime, audio.playbackRate];
  };
  assert.deepEqual(at(3), [false, 3, 1]);
  assert.deepEqual(at(3.05), [false, 3, 1], "a little apart is left alone");
  assert.deepEqual(at(3.2), [false, 3.2, 1]);
  assert.deepEqual(at(3.3, 2), [false, 3.2, 2], "at a higher speed a little is more");
  assert.deepEqual(at(4, 2, { buffering: true }), [true, 3.2, 2]);
  assert.deepEqual(at(4), [false, 4, 1]);
  for (const [seconds, speed, more] of [[4, 1, { playing: false }], [12, 1], [4, 8], [4, 0.1], [4, -1]]) {
    at(4);
    assert.equal(at(seconds, speed, more)[0], true, `${seconds} s at ${speed}`);
  }
});

/** Where a camera sees a point, pixels and depth. */
function seen({ fx, fy, cx, cy, cameraFromWorld: m }, p) {
  const [x, y, z] = [0, 4, 8].map((i) => m[i] * p[0] + m[i + 1] * p[1] + m[i + 2] * p[2] + m[i + 3]);
  return [(fx * x) / z + cx, (fy * y) / z + cy, z];
}

const near = (found, expected, what) =>
  found.forEach((x, i) => assert.ok(Math.abs(x - expected[i]) < 1e-5, `${what}: ${found}, expected ${expected}`));

/** Where a point of the scene is in the room. */
const inRoom = ({ scale, turn, place }, p) => turn.map((row, i) => scale * row.reduce((sum, x, j) => sum + x * p[j], 0) + place[i]);

test("a scene stands at its size on the floor, or is fitted", () => {
  // It looks along +x and down by 45 degrees, from 1.5 above the ground; +z is up.
  const half = Math.SQRT1_2;
  const cameraFromWorld = [0, -1, 0, 5, -half, 0, -half, 2 * half, half, 0, -half, 0, 0, 0, 0, 1];
  const camera = { width: 64, height: 48, fx: 50, fy: 50, cx: 32, cy: 24, cameraFromWorld };
  near(seen(camera, [2, 5, 0]), [32, 24, 2 * half], "the camera of this test");
  const standing = { camera, pivot: [4, 5, -2], up: [0, 0, 1], ground: 0.5 };
  const metric = stand(standing, 0.1);
  near(inRoom(metric, [1, 5, 1]), [0, 0.05, 0], "the start view");
  near(inRoom(metric, [11, 4, 0.5]), [0.1, 0, -1], "ahead to the right, on the ground");
  const fitted = stand(standing, null);
  near([fitted.scale], [2 / Math.hypot(3, 3)], "scale");
  near(inRoom(fitted, [4, 5, -2]), [0, 0.6, -2], "the middle, not below the floor");
  near(inRoom(stand({ ...standing, ground: null }, null), [4, 5, -2]), [0, 1, -2], "without a ground");
});

/** Eyes of a head at a place, which each look outwards by an angle. */
function eyesAt(position, outwards, standing) {
  return [-1, 1].map((side) => {
    const [c, s] = [Math.cos(side * outwards), Math.sin(side * outwards)];
    const [x, y, z] = [position[0] + side * 0.03, position[1], position[2]];
    // Columns; the eye's right is (c, 0, s), its back (-s, 0, c).
    const matrix = [c, 0, -s, 0, 0, 1, 0, 0, s, 0, c, 0, -(c * x + s * z), -y, s * x - c * z, 1];
    // It sees less towards the nose than outwards.
    const projectionMatrix = [1, 0, 0, 0, 0, 1.2, 0, 0, 0.2 * side, 0.1, -1, -1, 0, 0, -0.1, 0];
    return eyeOf({ projectionMatrix, transform: { inverse: { matrix } } }, { x: 0, y: 0, width: 100, height: 80 }, standing);
  });
}

test("the camera of the order sees what the eyes see", () => {
  const [c, s] = [Math.cos(0.8), Math.sin(0.8)];
  const standing = { scale: 0.5, turn: [[c, 0, s], [0, 1, 0], [-s, 0, c]], place: [0.1, 0.7, -0.2] };
  let count = 0;
  for (const outwards of [0, 0.2]) {
    const eyes = eyesAt([0.1, 1.5, 0.2], outwards, standing);
    const all = cameraOfAll(eyes);
    assert.ok(all.width < 3 * 100 && all.height < 3 * 80, `${all.width}x${all.height}`);
    for (let i = 0; i < 20000; i++) {
      const point = [0, 1, 2].map((k) => 8 * (((i + 1) * [0.754877, 0.569840, 0.438579][k]) % 1) - 4);
      for (const eye of eyes) {
        const [x, y, depth] = seen(eye, point);
        if (depth <= 0 || x < 0 || x > 100 || y < 0 || y > 80) continue;
        count += 1;
        const [column, row, ahead] = seen(all, point);
        const isSeen = ahead > 0 && column > -1e-6 && column < all.width && row > -1e-6 && row < all.height;
        assert.ok(isSeen, `${[x, y, depth]} at ${[column, row, ahead]}`);
      }
    }
  }
  assert.ok(count > 2000, String(count));
  const [one] = eyesAt([0, 1, 0], 0, standing);
  const { cameraFromWorld, fx } = cameraOfAll([one]);
  near(cameraFromWorld, one.cameraFromWorld, "one eye is its own camera");
  assert.equal(fx, one.fx);
});

test("hands carry a scene and keep its floor level", () => {
  const start = { scale: 2, turn: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], place: [1, 0, -3] };
  const [upright, scales] = [[0, 0, 0, 1], [1, 3]];
  // A quarter to the left about the vertical axis, and a roll that does not count.
  const [q, r] = [Math.PI / 4, 0.3];
  const rolled = [Math.sin(q) * Math.sin(r), Math.sin(q) * Math.cos(r), Math.cos(q) * Math.sin(r), Math.cos(q) * Math.cos(r)];
  const one = carried(start, [{ position: [0, 1, -1], orientation: upright }], [{ position: [0, 2, -1], orientation: rolled }], scales);
  near(inRoom(one, [0, 0, 0]), [-2, 1, -2], "moved and turned");
  near(inRoom(one, [0, 1, 0]), [-2, 3, -2], "level");
  const at = (...positions) => positions.map((position) => ({ position, orientation: upright }));
  const two = carried(start, at([-1, 1, 0], [1, 1, 0]), at([0, 1, 1.25], [0, 1, -1.25]), scales);
  near([two.scale], [2.5], "larger");
  near(inRoom(two, [0, 0, 0]), [-3.75, -0.25, -1.25], "about the middle of both");
  assert.equal(carried(start, at([-1, 1, 0], [1, 1, 0]), at([-9, 1, 0], [9, 1, 0]), scales).scale, 3, "not too large");
  assert.deepEqual(carried(start, at([0, 1, 0], [0, 2, 0]), at([0, 1, 0.01], [0, 2, -0.01]), [2, 2]).turn[0], [1, 0, 0], "hands above each other");
});
