// The code of a page that uses the package, in TypeScript. It is compiled only.

import type { TcgsPlayerElement } from "tcgs";
import { open } from "tcgs/decoder";

/** Seeks to the first frame and steps aside. */
export async function aside(element: TcgsPlayerElement): Promise<number> {
  const { player } = element;
  if (!player) return 0;
  const { numTimesteps } = await player.load("scene.tcgs");
  await player.seek(0);
  const camera = await player.camera();
  camera.cameraFromWorld[3] += 0.1;
  await player.setCamera(camera);
  return numTimesteps;
}

/** The opacities at the first timestep of a file that was dropped on the page. */
export async function opacities(file: File, signal: AbortSignal): Promise<Float32Array> {
  const scene = await open(file, { signal });
  return (await scene.at(0)).opacities;
}
