// The worker of the player with WebGL2: fetches, decodes, interpolates and sorts.

import init, { workOnScenes } from "./engine-webgl2/tcgs_play.js";

await init();
workOnScenes();
