// Turns mouse, touch and keys into moves of the camera. Other controls are in ui.js.

/** Turn by a drag across the height of the canvas, radians. */
const TURN = Math.PI;
/** Turn by a held key, radians a second. */
const KEY_TURN = 1.2;
/** Move by a held key a second: heights of the canvas, or distances of the start view from its pivot when flying. */
const KEY_MOVE = 0.6;
const KEY_ZOOM = 1.8;

/** Keys that act as long as they are held: `[move, x, y, z]` a second. */
const HELD = {
  KeyW: ["fly", 0, 0, KEY_MOVE],
  KeyS: ["fly", 0, 0, -KEY_MOVE],
  KeyA: ["fly", -KEY_MOVE, 0, 0],
  KeyD: ["fly", KEY_MOVE, 0, 0],
  KeyQ: ["fly", 0, KEY_MOVE, 0],
  KeyE: ["fly", 0, -KEY_MOVE, 0],
  ArrowLeft: ["orbit", -KEY_TURN, 0],
  ArrowRight: ["orbit", KEY_TURN, 0],
  ArrowUp: ["orbit", 0, -KEY_TURN],
  ArrowDown: ["orbit", 0, KEY_TURN],
};

/** @param {import("./player.js").Player} player */
export function listenForPointers(canvas, player) {
  dragging(canvas, player);
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      // A wheel reports lines or pages, a touchpad pixels; a pinch on a touchpad arrives with the control key.
      const unit = [1, 16, 100][event.deltaMode] * (event.ctrlKey ? 6 : 1);
      player.move("zoom", Math.exp(-0.0015 * Math.max(-240, Math.min(240, unit * event.deltaY))));
    },
    { passive: false },
  );
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
}

function dragging(canvas, player) {
  /** Position and button of each finger or mouse that is down, by pointer. */
  const pointers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, button: event.button });
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer) return;
    const [dx, dy] = [event.clientX - pointer.x, event.clientY - pointer.y].map((d) => d / canvas.clientHeight);
    const before = spread(pointers);
    pointer.x = event.clientX;
    pointer.y = event.clientY;
    if (pointers.size > 1) {
      // The middle of the fingers moves by the mean of their moves.
      player.move("pan", dx / pointers.size, dy / pointers.size);
      if (before > 0) player.move("zoom", spread(pointers) / before);
    } else if (pointer.button !== 0 || event.shiftKey) {
      player.move("pan", dx, dy);
    } else if (event.altKey) {
      player.move("look", dx * TURN, dy * TURN);
    } else {
      player.move("orbit", dx * TURN, dy * TURN);
    }
  });
}

/** Distance of two fingers, pixels; 0 if there is one. */
function spread(pointers) {
  const [a, b] = [...pointers.values()];
  return b ? Math.hypot(a.x - b.x, a.y - b.y) : 0;
}

/** @param {import("./player.js").Player} player */
export function listenForHeldKeys(player) {
  const held = new Set();
  let last = null;
  const tick = (now) => {
    if (held.size === 0) {
      last = null;
      return;
    }
    const seconds = Math.min(0.1, (now - (last ?? now - 16)) / 1000);
    last = now;
    for (const key of held) {
      const [code, shift] = key.split(" ");
      if (code === "Plus" || code === "Minus") {
        player.move("zoom", KEY_ZOOM ** (code === "Plus" ? seconds : -seconds));
        continue;
      }
      const [how, ...amounts] = HELD[code];
      const sideways = shift && how === "orbit";
      player.move(sideways ? "pan" : how, ...amounts.map((amount) => amount * seconds * (sideways ? 0.5 : 1)));
    }
    requestAnimationFrame(tick);
  };
  const nameOf = (event) => {
    if (event.key === "+" || event.key === "=") return "Plus";
    if (event.key === "-") return "Minus";
    return Object.hasOwn(HELD, event.code) ? event.code + (event.shiftKey ? " shift" : "") : null;
  };
  window.addEventListener("keydown", (event) => {
    const name = nameOf(event);
    if (!name || isTyping(event)) return;
    event.preventDefault();
    if (held.size === 0) requestAnimationFrame(tick);
    held.add(name);
  });
  // A page without the focus is not told of released keys.
  window.addEventListener("blur", () => held.clear());
  window.addEventListener("keyup", (event) => {
    const code = nameOf(event)?.split(" ")[0];
    for (const name of [...held]) if (!code || name.split(" ")[0] === code) held.delete(name);
  });
}

/** Whether a key is meant for the element that has the focus, or for the browser. */
export function isTyping(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return true;
  const element = event.target instanceof Element ? event.target : document.body;
  if (element.closest("dialog[open], input[type=url], select, [popover]")) return true;
  return element.matches("input[type=range]") && /^(Arrow|Home|End|Page)/.test(event.key);
}
