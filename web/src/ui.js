// The page around the scene: cards, playback, statistics, shortcuts. Menus are in menus.js.

import { explain } from "./failures.js";
import { isTyping } from "./input.js";

export const element = (id) => document.getElementById(id);

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
/** Milliseconds without input after which the controls are hidden while the scene plays. */
const IDLE_MS = 3000;

/** Writes a number of bytes with three digits, such as `162 kB`; a kB is 1000 bytes. */
export function showBytes(bytes) {
  const units = ["B", "kB", "MB", "GB"];
  let value = bytes;
  while (value >= 999.5 && units.length > 1) {
    value /= 1000;
    units.shift();
  }
  const digits = units[0] === "B" || value >= 99.95 ? 0 : value >= 9.995 ? 1 : 2;
  return `${value.toFixed(digits)} ${units[0]}`;
}

/** Shows a message for a moment. */
export function toast(text) {
  const box = element("toast");
  box.textContent = text;
  box.classList.add("shown");
  clearTimeout(toast.timer);
  toast.timer = setTimeout(() => box.classList.remove("shown"), 2600);
}

/** Shows one of the cards in the middle, or none. */
export function showCard(name) {
  for (const card of ["welcome", "loading", "failure"]) element(card).hidden = card !== name;
}

/** Lets the browser save a file. */
export function save(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

/** @param {import("./player.js").Player} player */
export function cards(player, { choose }) {
  player.addEventListener("opening", () => {
    document.body.classList.remove("has-scene");
    for (const id of ["dock", "name", "credits", "stats"]) element(id).hidden = true;
    element("loading-text").textContent = `Opening ${nameOf(player.source)}`;
    showCard("loading");
  });
  player.addEventListener("progress", ({ detail }) => {
    if (detail > 0) element("loading-text").textContent = `Opening ${nameOf(player.source)}: ${showBytes(detail)}`;
  });
  player.addEventListener("load", () => {
    const { info } = player;
    document.body.classList.add("has-scene");
    showCard(null);
    element("dock").hidden = false;
    const name = info.name || nameOf(player.source);
    element("name").textContent = name;
    document.title = `${name} – tcgs player`;
    element("canvas").setAttribute("aria-label", `${name}: ${info.numGaussians} Gaussians, ${info.numTimesteps} frames`);
    element("name").hidden = false;
    showCredits(info.credits);
  });
  player.addEventListener("failure", ({ detail }) => {
    const failure = explain(detail);
    element("failure").dataset.code = failure.code;
    element("failure-title").textContent = failure.title;
    element("failure-text").textContent = failure.text;
    element("failure-detail").textContent = failure.detail;
    const again = ["network", "truncated", "device-lost", "unknown"].includes(failure.code);
    element("failure-retry").hidden = !again;
    element("failure-open").hidden = ["no-webgpu", "device-lost"].includes(failure.code);
    document.body.classList.remove("has-scene", "idle");
    for (const id of ["dock", "name", "credits", "stats"]) element(id).hidden = true;
    showCard("failure");
    element("failure").querySelector("button:not([hidden])")?.focus();
  });
  element("failure-retry").addEventListener("click", () => {
    if (element("failure").dataset.code === "device-lost") location.reload();
    else player.open(player.source);
  });
  element("failure-open").addEventListener("click", choose);
  element("welcome-open").addEventListener("click", choose);
  element("link-form").addEventListener("submit", (event) => {
    event.preventDefault();
    player.open(element("link").value);
  });
}

/** A line of a scene's credits, such as `A. Author · CC-BY-4.0 · example.org`. The texts are a stranger's. */
function showCredits(credits) {
  const line = element("credits");
  const { authors = [], licence = null, source = null } = credits ?? {};
  const parts = [authors.join(", "), licence, source && (linkTo(source) ?? source)].filter(Boolean);
  line.replaceChildren(...parts.flatMap((part, i) => (i > 0 ? [" · ", part] : [part])));
  line.hidden = parts.length === 0;
}

/** A link to a web address; null if the text is not one. */
function linkTo(text) {
  if (!/^https?:/i.test(text) || !URL.canParse(text)) return null;
  const link = document.createElement("a");
  link.href = text;
  link.textContent = new URL(text).host;
  link.target = "_blank";
  link.rel = "noopener noreferrer";
  return link;
}

/** The file's name, for a scene without a name. */
export function nameOf(source) {
  if (source instanceof Blob) return source.name ?? "scene";
  let name = source;
  try {
    const { pathname } = new URL(source, location.href);
    name = pathname.slice(pathname.lastIndexOf("/") + 1);
    name = decodeURIComponent(name);
  } catch {
    // A text that is not an address, or whose escapes are wrong, is its own name.
  }
  return name || "scene";
}

/** @param {import("./player.js").Player} player */
export function playback(player) {
  const timeline = element("timeline");
  let resume = false;
  timeline.addEventListener("pointerdown", () => {
    resume = player.playing;
    player.pause();
  });
  timeline.addEventListener("input", () => player.seek(Number(timeline.value)));
  // A thumb that is released where it was pressed sends no `change`, and it may be released outside the timeline.
  for (const end of ["change", "pointerup", "pointercancel"]) {
    window.addEventListener(end, () => {
      if (resume) player.play();
      resume = false;
    });
  }
  element("play").addEventListener("click", () => player.toggle());
  element("back").addEventListener("click", () => player.step(-1));
  element("forth").addEventListener("click", () => player.step(1));
  element("loop").addEventListener("click", () => player.setLoop(!player.loop));
  element("speed").addEventListener("change", (event) => player.setSpeed(Number(event.target.value)));
  element("full").addEventListener("click", toggleFull);
  document.addEventListener("fullscreenchange", () => {
    element("full").setAttribute("aria-pressed", String(document.fullscreenElement !== null));
  });
  element("full").hidden = !document.fullscreenEnabled;

  let shown = "";
  for (const event of ["load", "replace"]) {
    player.addEventListener(event, () => {
      shown = "";
      timeline.max = String(player.info.numTimesteps - 1);
      element("track").hidden = player.info.numTimesteps < 2;
    });
  }
  player.addEventListener("change", () => {
    element("loop").setAttribute("aria-pressed", String(player.loop));
    const known = SPEEDS.includes(player.speed);
    if (known) element("speed").value = String(player.speed);
    else element("speed").selectedIndex = -1;
  });
  player.addEventListener("frame", () => {
    const { timestep, playing, buffering } = player.state;
    const now = `${timestep} ${playing} ${buffering}`;
    if (now === shown) return;
    shown = now;
    const { numTimesteps, frameRate, times } = player.info;
    const step = Math.round(timestep);
    timeline.value = String(step);
    timeline.style.setProperty("--played", `${(100 * step) / Math.max(1, numTimesteps - 1)}%`);
    timeline.setAttribute("aria-valuetext", `frame ${step + 1} of ${numTimesteps}`);
    const seconds = times ? times[step] : frameRate > 0 ? step / frameRate : null;
    element("seconds").textContent = seconds === null ? "" : `${seconds.toFixed(seconds < 100 ? 2 : 0)} s`;
    element("frame-number").textContent = `${step + 1} / ${numTimesteps}`;
    element("dock").classList.toggle("buffering", buffering);
    const name = playing ? "Pause" : "Play";
    const button = element("play");
    button.setAttribute("aria-label", name);
    button.title = `${name} (space)`;
    button.querySelector("use").setAttribute("href", playing ? "#icon-pause" : "#icon-play");
  });
}

export function toggleFull() {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.documentElement.requestFullscreen?.().catch(() => toast("The browser refuses full screen here"));
}

/** Shows statistics, a few times a second. @param {import("./player.js").Player} player */
export function statistics(player) {
  let last = 0;
  player.addEventListener("frame", () => {
    const now = performance.now();
    if (element("stats").hidden || (player.rate !== null && now - last < 250)) return;
    last = now;
    const { gaussians, bytesLoaded, width, height } = player.state;
    element("stat-renderer").textContent = player.renderer;
    element("stat-rate").textContent = player.rate === null ? "resting" : player.rate.toFixed(0);
    element("stat-drawn").textContent = gaussians.toLocaleString("en").replaceAll(",", "\u202f"); // thin spaces
    element("stat-bytes").textContent = `${showBytes(bytesLoaded)} of ${showBytes(player.info.bytes)}`;
    element("stat-size").textContent = `${width} × ${height}`;
  });
}

/** The next of the offered speeds. @param {number} by above 0: faster, below: slower */
export function nextSpeed(speed, by) {
  const next = by > 0 ? SPEEDS.find((s) => s > speed) : SPEEDS.findLast((s) => s < speed);
  return next ?? speed;
}

/** Listens for keys that do not move the camera. @param {Record<string, () => void>} actions by key */
export function shortcuts(player, actions) {
  const speed = (by) => () => {
    player.setSpeed(nextSpeed(player.speed, by));
    toast(`Speed ${player.speed}×`);
  };
  const keys = {
    " ": () => player.toggle(),
    ",": () => player.step(-1),
    ".": () => player.step(1),
    Home: () => player.seek(0),
    End: () => player.seek(player.info.numTimesteps - 1),
    "[": speed(-1),
    "]": speed(1),
    l: () => player.setLoop(!player.loop),
    f: toggleFull,
    r: () => player.reset(),
    ...actions,
  };
  window.addEventListener("keydown", (event) => {
    if (isTyping(event) || event.shiftKey || (event.repeat && event.key !== "," && event.key !== ".")) return;
    const onButton = event.target instanceof HTMLButtonElement && event.key === " ";
    const action = /^[1-9]$/.test(event.key) ? () => actions.camera(Number(event.key) - 1) : keys[event.key];
    const always = ["h", "?", "o"].includes(event.key);
    if (!action || onButton || (!player.info && !always)) return;
    event.preventDefault();
    action();
  });
}

/** Hides the controls while the scene plays without input. */
export function idling(player) {
  let last = performance.now();
  const stir = () => {
    last = performance.now();
    document.body.classList.remove("idle");
  };
  for (const event of ["pointermove", "pointerdown", "keydown", "wheel", "focusin"]) {
    window.addEventListener(event, stir, { passive: true });
  }
  setInterval(() => {
    const busy = document.querySelector(":popover-open, dialog[open], #dock:hover, #dock :focus-visible");
    const idle = player.playing && !busy && performance.now() - last > IDLE_MS;
    document.body.classList.toggle("idle", idle);
  }, 500);
}
