// Makes the original and the files of splat-transform 2.7.1, and `spz_*.spz` by its library. This version turned SPZ files to the axes
// right, up, back (RUB), and so does this script. `make_4dgs.py` makes the .4dgs files, `scripts/compare_with_programs.py
// --keep` the others, of the programs and versions that it names.
//
//   npm install @playcanvas/splat-transform@2.7.1      (brings @adobe/spz 0.2.2)
//   node make.mjs NODE_MODULES
import { execFileSync } from "node:child_process";
import { readFileSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";
import { pathToFileURL } from "node:url";

const modules = resolve(process.argv[2] ?? "node_modules");
const here = import.meta.dirname;

// A Gaussian has 3 + 3 + 3 + 45 + 1 + 3 + 4 properties, as 3D Gaussian splatting writes them. 260 Gaussians are more than a
// chunk of compressed PLY. The numbers are those of a linear congruential generator.
let state = 1;
const random = () => (state = (Math.imul(state, 1664525) + 1013904223) >>> 0) / 2 ** 32;
const between = (low, high) => low + (high - low) * random();
const count = 260;
const numbered = (name, n) => Array.from({ length: n }, (_, i) => `${name}_${i}`);
const names = ["x", "y", "z", "nx", "ny", "nz", ...numbered("f_dc", 3), ...numbered("f_rest", 45), "opacity",
    ...numbered("scale", 3), ...numbered("rot", 4)];
const value = (name) => {
    if (name.startsWith("n")) return 0;
    if (name.startsWith("f_dc")) return between(-2, 2);
    if (name.startsWith("f_rest")) return between(-0.6, 0.6);
    if (name.startsWith("scale")) return between(-6, -1);
    if (name.startsWith("rot")) return between(-1, 1);
    return name === "opacity" ? between(-4, 6) : between(-3, 3);
};
const floats = new Float32Array(count * names.length);
floats.forEach((_, i) => (floats[i] = value(names[i % names.length])));
const header = `ply\nformat binary_little_endian 1.0\nelement vertex ${count}\n` +
    names.map((name) => `property float ${name}\n`).join("") + "end_header\n";
const original = join(here, "original.ply");
writeFileSync(original, Buffer.concat([Buffer.from(header), Buffer.from(floats.buffer)]));

const convert = (...more) => execFileSync("node",
    [join(modules, "@playcanvas/splat-transform/bin/cli.mjs"), "-q", "-w", ...more], { cwd: here });
convert("original.ply", "splat_transform.compressed.ply");
convert("original.ply", "splat_transform_v4.spz");
convert("--spz-version", "3", "original.ply", "splat_transform_v3.spz");
convert("original.ply", "--filter-harmonics", "1", "splat_transform.glb");

// What splat-transform does not write: version 2, and harmonics of degree 4.
const spz = await (await import(pathToFileURL(join(modules, "@adobe/spz/dist/spz.js")))).default();
const { RDF } = spz.CoordinateSystem;
const cloud = spz.loadSpzFromBuffer(readFileSync(join(here, "splat_transform_v4.spz")), { to: RDF });
writeFileSync(join(here, "spz_v2.spz"), spz.saveSpzToBuffer(cloud, { version: 2, from: RDF, sh1Bits: 8, shRestBits: 8 }));
const one = { ...cloud, numPoints: 1, shDegree: 4, extensions: [] };
for (const [name, width] of [["positions", 3], ["scales", 3], ["rotations", 4], ["alphas", 1], ["colors", 3]]) {
    one[name] = cloud[name].slice(0, width);
}
one.sh = new Float32Array(72).fill(0.25);
writeFileSync(join(here, "spz_degree_4.spz"), spz.saveSpzToBuffer(one, { version: 4, from: RDF, sh1Bits: 8, shRestBits: 8 }));
