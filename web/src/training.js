// A running training (`tcgs train --view`): its scene, replaced as it changes, beside its curves. docs/PLAYER.md, "A
// training", describes the requests to the program. A hidden page sends no requests.

import { chart, digits } from "./chart.js";
import { element, showCard, toast } from "./ui.js";

/** Milliseconds between two requests. */
const TURN_MS = 2000;
/** Number of consecutive requests without an answer after which the program counts as ended. */
const MAX_SILENCE = 3;

const count = (number) => number.toLocaleString("en").replaceAll(",", "\u202f"); // thin spaces
const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;

/** The state of a training in words. @param {object} state as the program reports it */
export function describe(state) {
  const { running, num_timesteps: all, num_gaussians: gaussians, timesteps } = state;
  const of = (timestep) => `Timestep ${timestep + 1} of ${all}`;
  if (state.has_ended) {
    const psnr = timesteps.psnr.length > 0 ? `, mean PSNR ${mean(timesteps.psnr).toFixed(2)} dB` : "";
    return `The training has ended: ${count(timesteps.psnr.length)} timesteps${psnr}`;
  }
  if (!running) return timesteps.psnr.length > 0 ? `After timestep ${timesteps.psnr.length} of ${all}` : "About to begin";
  const { iterations, of_iterations: most } = running;
  const place = most > 0 ? `, iteration ${count(iterations)} of ${count(most)}` : "";
  return `${of(running.timestep)}${place}, ${count(gaussians)} Gaussians`;
}

/**
 * @param {import("./player.js").Player} player
 * @param {string} address of the training's state
 * @param {{autoplay: boolean}} options
 * @returns {{toggle: () => void}} `toggle` shows and hides the curves
 */
export function training(player, address, { autoplay }) {
  const panel = element("training");
  const curves = element("training-curves");
  const ofTimestep = { loss: chart("Loss", "iterations", { log: true }), psnr: chart("PSNR", "iterations", { unit: " dB" }) };
  const share = { unit: " %", factor: 100, range: [0, 1] };
  const ofAll = {
    loss: chart("Loss", "timesteps", { log: true }),
    psnr: chart("PSNR", "timesteps", { unit: " dB" }),
    active_tiles: chart("Active tiles", "timesteps", share),
    active_gaussians: chart("Active Gaussians", "timesteps", share),
  };
  element("training-running").append(...Object.values(ofTimestep).map(({ figure }) => figure));
  element("training-timesteps").append(...Object.values(ofAll).map(({ figure }) => figure));
  panel.hidden = false;
  curves.open = matchMedia("(min-width: 561px)").matches;
  element("loading-text").textContent = "Waiting for the first picture of the training";
  showCard("loading");

  const choices = { running: element("training-now"), finished: element("training-finished") };
  /** The kind of scene shown, the tag of its file, and the file. */
  let [mode, tag, file] = ["running", null, null];
  let [hasEnded, silence, isAsking] = [false, 0, false];

  const ended = () => silence >= MAX_SILENCE;
  const choose = (chosen) => {
    [mode, tag, file] = [chosen, null, null];
    choices[chosen].checked = true;
    refresh();
  };
  for (const [name, choice] of Object.entries(choices)) choice.addEventListener("change", () => choose(name));

  const show = (state) => {
    const { running, timesteps } = state;
    element("training-status").textContent = describe(state);
    const evidence = running?.active_tiles;
    element("training-active").textContent =
      typeof evidence === "number"
        ? `Trains ${digits(100 * evidence)} % of the tiles and ${digits(100 * running.active_gaussians)} % of the Gaussians`
        : "";
    element("training-camera").textContent =
      running?.psnr.length > 0 ? `PSNR of ${state.held_out ? "held-out" : "training"} camera ${running.psnr_camera}` : "";
    for (const [name, { show }] of Object.entries(ofTimestep)) show(running?.[name] ?? []);
    for (const [name, { show }] of Object.entries(ofAll)) show(timesteps[name].map((value, i) => [i + 1, value]));
    element("training-running-part").hidden = !running || running.loss.length === 0;
    element("training-timesteps-part").hidden = timesteps.psnr.length === 0;
    choices.finished.disabled = timesteps.psnr.length === 0;
    if (state.has_ended && !hasEnded) {
      hasEnded = true;
      choices.running.disabled = true;
      toast("The training has ended: this is the whole run");
      choose("finished");
    }
  };

  /** Requests a newer file of the scene shown. The program limits how often it writes one. */
  const refresh = async () => {
    // Another file may have been opened.
    if (isAsking || document.hidden || ended() || (file && player.source !== file)) return;
    isAsking = true;
    const asked = mode;
    try {
      const headers = tag ? { "If-None-Match": tag } : {};
      const answer = await fetch(`${asked}.tcgs`, { headers });
      if (answer.status === 500) toast(await answer.text());
      if (answer.status !== 200 || asked !== mode) return;
      const isFirst = file === null;
      [tag, file] = [answer.headers.get("ETag"), new File([await answer.blob()], `${asked}.tcgs`)];
      await player.replace(file);
      if (isFirst && autoplay && player.info?.numTimesteps > 1) player.play();
    } catch {
      // The other request detects a program that has ended.
    } finally {
      isAsking = false;
      if (asked !== mode) refresh();
    }
  };

  const turn = async () => {
    try {
      const answer = await fetch(address);
      if (answer.status === 200) show(await answer.json());
      silence = 0;
      refresh();
    } catch {
      silence += 1;
      if (ended()) {
        element("training-status").textContent = "tcgs has ended, and with it what this page shows";
        panel.dataset.ended = "";
        return;
      }
    }
    setTimeout(turn, TURN_MS);
  };
  turn();
  return { toggle: () => (curves.open = !curves.open) };
}
