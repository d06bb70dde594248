// A program that uses the package, in TypeScript: the decoder runs, the player is compiled only.

import { readFile } from "node:fs/promises";

import type { TcgsPlayerElement } from "tcgs";
import { open, type Gaussians, type Scene } from "tcgs/decoder";

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

/** The mean of all centres at a timestep. */
async function middle(scene: Scene, timestep: number): Promise<[number, number, number]> {
  const { means, numGaussians }: Gaussians = await scene.at(timestep);
  const mean = (axis: number) => means.filter((_, i) => i % 3 === axis).reduce((a, b) => a + b, 0) / numGaussians;
  return [mean(0), mean(1), mean(2)];
}

for (const path of process.argv.slice(2)) {
  const scene = await open(await readFile(path));
  const last = scene.info.numTimesteps - 1;
  console.log(path, scene.info.numTimesteps, (await middle(scene, last)).join(" "));
  scene.close();
}
