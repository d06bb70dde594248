// A program of Node that uses the package, in TypeScript.

import { open, type Gaussians, type Scene } from "tcgs/decoder";

/** The mean of all centres at a timestep. */
async function middle(scene: Scene, timestep: number): Promise<[number, number, number]> {
  const { means, numGaussians }: Gaussians = await scene.at(timestep);
  const mean = (axis: number) => means.filter((_, i) => i % 3 === axis).reduce((a, b) => a + b, 0) / numGaussians;
  return [mean(0), mean(1), mean(2)];
}

for (const path of process.argv.slice(2)) {
  const scene = await open(path);
  const last = scene.info.numTimesteps - 1;
  console.log(path, scene.info.numTimesteps, (await middle(scene, last)).join(" "));
  scene.close();
}
