// Shows where pictures cannot be trusted, and leads the camera back after a move: the file says from where they can be.

import { isTyping } from "./input.js";
import { element } from "./ui.js";

/** Part of the way back that is left after a second. */
const LEFT_A_SECOND = 0.02;
/** Below this the last part of the way is a single step. */
const LAST = 0.01;
/** Milliseconds after the last turn of a wheel at which the move has ended. */
const WHEEL_MS = 120;

/** Codes of the keys that move the camera. */
const MOVES = /^(Key[WASDQE]|Arrow|Equal|Minus|Numpad(Add|Subtract)|BracketRight)/;

/**
 * @param {import("./player.js").Player} player
 * @param {boolean} on whether it begins so
 * @returns {{toggle: () => void, isOn: () => boolean}}
 */
export function trust(player, on) {
  const edge = element("edge");
  const button = element("toggle-trust");
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  /** Fingers, mouse buttons and keys that are down; while one is, a person moves the camera. */
  const down = new Set();
  let wheel = null;
  let last = null;

  const show = () => (edge.style.opacity = on ? (player.state?.doubt ?? 0) : 0);
  const step = (now) => {
    if (last === null) return;
    const doubt = player.state?.doubt ?? 0;
    if (!on || down.size > 0 || doubt === 0 || player.following) return stop();
    const share = still.matches || doubt < LAST ? 1 : 1 - LEFT_A_SECOND ** (Math.min(100, now - last) / 1000);
    last = now;
    player.move("leadBack", share);
    requestAnimationFrame(share < 1 ? step : stop);
  };
  const stop = () => (last = null);
  const lead = () => {
    if (last !== null || down.size > 0 || !on || !player.info) return;
    last = performance.now();
    requestAnimationFrame(step);
  };
  const end = (what) => down.delete(what) && lead();

  const isScene = (event) => event.target.id === "canvas";
  window.addEventListener("pointerdown", (event) => isScene(event) && down.add(event.pointerId));
  for (const type of ["pointerup", "pointercancel"]) window.addEventListener(type, (event) => end(event.pointerId));
  const moves = (event) => MOVES.test(event.code) && !isTyping(event);
  window.addEventListener("keydown", (event) => moves(event) && down.add(event.code));
  window.addEventListener("keyup", (event) => end(event.code));
  window.addEventListener("blur", () => {
    down.clear();
    lead();
  });
  const wheeled = () => {
    clearTimeout(wheel);
    down.add("wheel");
    wheel = setTimeout(() => end("wheel"), WHEEL_MS);
  };
  window.addEventListener("wheel", (event) => isScene(event) && wheeled(), { passive: true });

  const toggle = () => {
    on = !on;
    button.setAttribute("aria-pressed", String(on));
    show();
    lead();
  };
  button.addEventListener("click", toggle);
  button.setAttribute("aria-pressed", String(on));
  player.addEventListener("frame", show);
  return { toggle, isOn: () => on };
}
