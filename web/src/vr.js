// Offers to enter VR where there is a headset. headset.js, which a page loads when somebody enters, does the rest.

import { element, toast } from "./ui.js";

/**
 * @param {import("./player.js").Player} player
 * @param {() => boolean} showsDoubt whether an edge shows how little pictures can be trusted
 */
export function offerVr(player, showsDoubt) {
  const { xr } = navigator;
  if (!xr) return;
  const button = element("vr");
  let session = null;
  const look = async () => {
    button.hidden = !(await xr.isSessionSupported("immersive-vr").catch(() => false));
  };
  const show = () => {
    const label = session ? "Leave VR" : "Enter VR";
    button.title = label;
    button.setAttribute("aria-label", label);
  };
  xr.addEventListener("devicechange", look);
  look();
  button.addEventListener("click", async () => {
    if (session) {
      session.end();
      return;
    }
    button.disabled = true;
    try {
      // Browsers grant a session only within seconds of a click, so the engine is loaded afterwards.
      session = await xr.requestSession("immersive-vr", { optionalFeatures: ["local-floor", "hand-tracking"] });
      button.disabled = false;
      show();
      const { showScene } = await import("./headset.js");
      await showScene(session, player, showsDoubt);
    } catch (error) {
      toast(`VR does not work: ${error.message ?? error}`);
      // It may have ended.
      await session?.end().catch(() => {});
    }
    session = null;
    button.disabled = false;
    show();
  });
}
