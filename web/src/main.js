// Assembles the page and opens the scene that the address names.

import { pathFromJson } from "./camera_path.js";
import { listenToEmbedder } from "./embed.js";
import { explain } from "./failures.js";
import { frusta } from "./frusta.js";
import { listenForHeldKeys, listenForPointers } from "./input.js";
import { addToPath, moreMenu, saveStill, showHelp, viewsMenu } from "./menus.js";
import { readParams } from "./params.js";
import { Player } from "./player.js";
import { sound } from "./sound.js";
import { training } from "./training.js";
import { trust } from "./trust.js";
import { cards, element, idling, playback, shortcuts, showCard, statistics, toast } from "./ui.js";
import { offerVr } from "./vr.js";

const params = readParams(location.search);
const named = (what) => document.querySelector(`meta[name=tcgs-${what}]`).content;
const player = new Player(element("canvas"), { ...params, renderer: named("renderer") || params.renderer });
const file = element("file");
const choose = () => file.click();

document.body.classList.toggle("bare", !params.controls);
player.setLoop(params.loop);
player.setSpeed(params.speed);
cards(player, { choose });
playback(player);
statistics(player);
viewsMenu(player);
const { toggleStatistics } = moreMenu(player, { choose, stats: params.stats, theme: params.theme });
const { toggle: toggleSound } = sound(player);
// Cameras named by the page belong to the scene that the page names.
const cameras = params.cameras ?? (params.src === null ? named("cameras") : "");
const { toggle: toggleFrusta } = frusta(player, cameras || null, params.view === null);
// The page's training, unless the address names another scene.
const train = params.src === null && named("train");
const { toggle: toggleCurves } = train ? training(player, train, params) : { toggle: () => {} };
listenForPointers(element("canvas"), player);
player.addEventListener("canvas", ({ detail }) => listenForPointers(detail, player));
listenForHeldKeys(player);
const { toggle: toggleTrust, isOn: showsDoubt } = trust(player, params.trust);
idling(player);
shortcuts(player, {
  camera: (index) => index < player.info.cameras.length && player.useCamera(index),
  h: showHelp,
  "?": showHelp,
  c: toggleFrusta,
  g: toggleTrust,
  i: toggleStatistics,
  k: () => addToPath(player),
  m: toggleSound,
  o: choose,
  p: () => saveStill(player),
  t: toggleCurves,
});
listenToEmbedder(player);
offerVr(player, showsDoubt);

player.addEventListener("lost", () => toast("The camera path breaks off here"));
player.addEventListener("fallback", ({ detail }) => toast(`${detail}: drawing with ${player.renderer} now`));

/** Only the first scene starts at the view that the address names. */
let starting = true;
player.addEventListener("load", () => {
  if (starting && params.view !== null && params.view < player.info.cameras.length) player.useCamera(params.view);
  if (params.autoplay && player.info.numTimesteps > 1) player.play();
  starting = false;
});

/** Opens a scene, or follows a camera path, from a file of this machine. */
async function take(chosen) {
  if (!chosen) return;
  if (!chosen.name.endsWith(".json")) {
    player.open(chosen);
    return;
  }
  if (!player.info) {
    toast("Open a scene first, then its camera path");
    return;
  }
  try {
    player.setPath(pathFromJson(await chosen.text(), player.newPath()));
    toast(`Following ${chosen.name}`);
  } catch (error) {
    toast(error instanceof SyntaxError ? "This file is no JSON" : error.code ? explain(error).text : error.message);
  }
}

file.addEventListener("change", () => {
  take(file.files[0]);
  file.value = "";
});
window.addEventListener("dragover", (event) => {
  event.preventDefault();
  document.body.classList.add("dropping");
});
window.addEventListener("dragleave", (event) => {
  if (event.relatedTarget === null) document.body.classList.remove("dropping");
});
window.addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("dropping");
  take(event.dataTransfer.files[0]);
});

// A page that is one file has the scene in it.
const source = params.src ?? globalThis.tcgsScene ?? named("src");
if (source) player.open(source, params.timestep);
else if (!train) showCard("welcome");
