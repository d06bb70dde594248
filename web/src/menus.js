// The menu of views and camera paths, and the menu of rarely needed commands.

import { pathToJson } from "./camera_path.js";
import { element, nameOf, save, toast } from "./ui.js";

/** @param {import("./player.js").Player} player */
export function viewsMenu(player) {
  element("reset").addEventListener("click", () => player.reset());
  element("path-add").addEventListener("click", () => addToPath(player));
  element("path-follow").addEventListener("click", () => player.follow(!player.following));
  element("path-clear").addEventListener("click", () => player.setPath(player.newPath()));
  element("path-save").addEventListener("click", () => {
    save("camera-path.json", new Blob([pathToJson(player.path)], { type: "application/json" }));
  });
  player.addEventListener("load", () => {
    const buttons = player.info.cameras.map((camera, index) => {
      const button = document.createElement("button");
      button.textContent = camera.name || String(index + 1);
      button.setAttribute("aria-label", `Camera ${button.textContent}`);
      button.addEventListener("click", () => player.useCamera(index));
      return button;
    });
    element("cameras").replaceChildren(...buttons);
  });
  const show = () => {
    const { keyframes } = player;
    for (const id of ["path-follow", "path-save", "path-clear"]) element(id).disabled = keyframes.length === 0;
    element("path-follow").setAttribute("aria-pressed", String(player.following));
    const last = Math.max(1, (player.info?.numTimesteps ?? 1) - 1);
    const marks = keyframes.map(({ timestep, camera }) => {
      const mark = document.createElement("button");
      mark.style.left = `${(100 * timestep) / last}%`;
      mark.title = `View at frame ${timestep + 1}`;
      mark.setAttribute("aria-label", mark.title);
      mark.addEventListener("click", () => {
        player.pause();
        player.seek(timestep);
        player.setCamera(camera);
      });
      return mark;
    });
    element("marks").replaceChildren(...marks);
  };
  player.addEventListener("change", show);
  player.addEventListener("load", show);
}

/** @param {import("./player.js").Player} player */
export function addToPath(player) {
  player.addToPath();
  toast(player.keyframes.length === 1 ? "First view of a path; add others at other times" : "Added to the camera path");
}

/** @param {import("./player.js").Player} player */
export async function saveStill(player) {
  if (!player.info) return;
  // Another scene may be opened before the picture is ready.
  const name = (player.info.name || nameOf(player.source)).replace(/\.tcgs$/, "");
  try {
    const { width, height, timestep, data } = await player.capture();
    const canvas = new OffscreenCanvas(width, height);
    canvas.getContext("2d").putImageData(new ImageData(data, width, height), 0, 0);
    const frame = String(timestep + 1).padStart(4, "0");
    save(`${name}-${frame}.png`, await canvas.convertToBlob({ type: "image/png" }));
    toast(`Picture saved, ${width} × ${height}`);
  } catch (error) {
    toast(`No picture was saved: ${error.message ?? error}`);
  }
}

/** @param {import("./player.js").Player} player */
export function moreMenu(player, { choose, stats, theme }) {
  const menu = element("more-menu");
  const close = (action) => () => {
    menu.hidePopover();
    action();
  };
  element("open").addEventListener("click", close(choose));
  element("still").addEventListener("click", close(() => saveStill(player)));
  element("show-help").addEventListener("click", close(showHelp));
  const toggle = () => {
    const shown = element("stats").hidden;
    element("stats").hidden = !shown;
    element("toggle-stats").setAttribute("aria-pressed", String(shown));
    player.touch();
  };
  element("toggle-stats").addEventListener("click", toggle);
  player.addEventListener("load", () => {
    element("stats").hidden = element("toggle-stats").getAttribute("aria-pressed") !== "true";
  });
  element("toggle-stats").setAttribute("aria-pressed", String(stats));
  appearance(theme);
  return { toggleStatistics: toggle };
}

/** Sets light or dark: as the address says, else as a person chose before, else as the system has it. */
function appearance(asked) {
  let theme = asked;
  try {
    theme ??= localStorage.getItem("tcgs-theme");
  } catch {
    // An embedded page may have no storage; the choice then lasts as long as the page.
  }
  const set = (value) => {
    if (value === "light" || value === "dark") document.documentElement.dataset.theme = value;
    else delete document.documentElement.dataset.theme;
  };
  set(theme);
  for (const choice of document.querySelectorAll("input[name=theme]")) {
    choice.checked = choice.value === (theme ?? "auto");
    choice.addEventListener("change", () => {
      set(choice.value);
      try {
        localStorage.setItem("tcgs-theme", choice.value);
      } catch {
        // There is no storage, as above.
      }
    });
  }
}

export function showHelp() {
  const help = element("help");
  if (help.open) help.close();
  else help.showModal();
}
