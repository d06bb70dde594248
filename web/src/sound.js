// Plays a file's sound in time with the scene.

import { element, toast } from "./ui.js";

/** Seconds by which sound and picture may be apart before the sound jumps; people notice about a tenth with lips. */
const MOST_APART = 0.1;
/** Speeds at which a sound is still recognisable. */
const SPEEDS = [0.25, 4];
const TYPE = "audio/ogg; codecs=opus";

/**
 * Lets a sound follow the clock of a scene.
 *
 * @param {HTMLAudioElement} audio
 * @param {{seconds: number, playing: boolean, buffering: boolean}} state of the frame
 */
export function follow(audio, { seconds, playing, buffering }, speed) {
  const ended = Number.isFinite(audio.duration) && seconds >= audio.duration;
  if (!playing || buffering || ended || speed < SPEEDS[0] || speed > SPEEDS[1]) {
    if (!audio.paused) audio.pause();
    return;
  }
  if (audio.playbackRate !== speed) audio.playbackRate = speed;
  if (audio.paused || Math.abs(audio.currentTime - seconds) > MOST_APART * Math.max(1, speed)) audio.currentTime = seconds;
  // Browsers play no sound before a user has touched the page.
  if (audio.paused && globalThis.navigator?.userActivation?.hasBeenActive !== false) audio.play().catch(() => {});
}

/** @param {import("./player.js").Player} player */
export function sound(player) {
  let audio = null;
  const button = element("mute");
  const stop = () => {
    audio?.pause();
    if (audio) URL.revokeObjectURL(audio.src);
    audio = null;
    button.hidden = true;
  };
  const showMuted = () => {
    button.setAttribute("aria-pressed", String(audio.muted));
    button.querySelector("use").setAttribute("href", audio.muted ? "#icon-silent" : "#icon-sound");
  };
  const toggle = () => {
    if (!audio) return;
    audio.muted = !audio.muted;
    showMuted();
    toast(audio.muted ? "Sound off" : "Sound on");
  };
  player.addEventListener("opening", stop);
  player.addEventListener("failure", stop);
  player.addEventListener("load", async () => {
    const { info } = player;
    // Attached data are no reason to fail.
    const bytes = await player.attached("tcgs.sound").catch(() => null);
    const made = new Audio();
    if (!bytes || player.info !== info || !made.canPlayType(TYPE)) return;
    made.src = URL.createObjectURL(new Blob([bytes], { type: TYPE }));
    made.addEventListener("error", () => made === audio && stop());
    audio = made;
    button.hidden = false;
    showMuted();
  });
  player.addEventListener("frame", () => {
    if (audio && player.state) follow(audio, player.state, player.speed);
  });
  button.addEventListener("click", toggle);
  return { toggle };
}
