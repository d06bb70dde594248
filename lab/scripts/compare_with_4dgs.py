#!/usr/bin/env python3
"""Compares .tcgs with .4dgs files of one run: bytes at equal PSNR, and the time to decode all timesteps.

    lab/scripts/compare_with_4dgs.py RUN CAPTURE OUT [--rounds 3]

.4dgs (Apache-2.0; PyPI `fourdgs`, crates.io `fourdgs`) is the peer because it is an open format of dynamic Gaussians with a
writer of its own. Both hold the same floats: those of the run that its masks keep. `.tcgs` files have the qualities -3 to 2 of
`tcgs compress`. `.4dgs` files are written by the package: its model `keyframe-delta`, in which Gaussians keep their identity,
with its profiles coarse, default and fine, and a keyframe every eight timesteps, or one at the start.

PSNR is that of held-out images by `tcgs eval`, which reads both. "Bytes against .tcgs" compares with the bytes that the curve
of the `.tcgs` files has at the same PSNR, interpolated between logarithms of bytes. Decoding is timed as `tcgs export --to
NAME.f32 --threads 1`, in turns; `.4dgs` is read by its crate.

OUT, a new folder, then holds comparison.json and the files. The packages from PyPI are in OUT/packages while the script runs.
It needs Python 3.9 and `tcgs` (built in target/release, or --tcgs).
"""

import argparse
import json
import math
import os
import shutil
import statistics
import subprocess
import sys
import time
import venv
from pathlib import Path

PACKAGES = ["fourdgs==0.6.0", "numpy>=1.24"]
QUALITIES = [-3, -2, -1, 0, 1, 2]
# Of what the codec does, rounding to 16 bits alone is left.
EXACT = ["--no-keypoints", "--bits", "16,16", "--position-bits", "16"]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rounds", type=int, default=3, help="turns of decoding [default: 3]")
    parser.add_argument("--tcgs", type=Path, default=Path(__file__).resolve().parents[2] / "target/release/tcgs")
    parser.add_argument("--peer", action="store_true", help=argparse.SUPPRESS)  # this script, inside of the environment
    return parser.parse_args()


def refuse(message):
    sys.exit(f"compare_with_4dgs: {message}")


def tcgs(given, *words):
    command = [str(given.tcgs), *map(str, words)]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode != 0:
        refuse(f"{' '.join(command)}: {done.stderr.strip().splitlines()[-1]}")


def psnr(given, file):
    result = given.out / "eval.json"
    tcgs(given, "eval", file, "--capture", given.capture, "--json", result, "--force")
    found = json.loads(result.read_text())
    result.unlink()
    return found["psnr"]


def write_peer_files(given):
    """Inside of the environment: params.npz to .4dgs files."""
    import numpy as np
    from fourdgs.keyframe_delta_file import write_sequence
    from fourdgs.keyframe_delta_writer import KeyframeDeltaOptions, Sample
    from fourdgs.model import GaussianSet

    params = np.load(given.out / "params.npz")
    means = params["means3D"].astype(np.float64)
    count, rate = means.shape[1], 30.0
    duration = len(means) / rate
    logits = params["logit_opacities"].reshape(count)
    of_time = lambda name, t: params[name][t if params[name].shape[0] == len(means) and params[name].ndim == 3 else ...]
    constant = lambda value: np.full(count, value, np.float32)
    samples = []
    for t in range(len(means)):
        quats = of_time("unnorm_rotations", t)[:, [1, 2, 3, 0]]
        colors = np.concatenate([of_time("rgb_colors", t), 1 / (1 + np.exp(-logits[:, None]))], axis=1)
        samples.append(Sample(t / rate, np.arange(count), GaussianSet(
            positions=means[t].astype(np.float32),
            scales=np.exp(params["log_scales"]).astype(np.float32),
            rotations=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
            colors=colors.astype(np.float32), motions=np.zeros((count, 3), np.float32),
            mu_t=constant(t / rate), sigma_t=constant(1000), win_lo=constant(0), win_hi=constant(duration))))
    for profile in ["coarse", "default", "fine"]:
        for every in [8, len(samples)]:
            options = KeyframeDeltaOptions(keyframe_every=every)
            file = given.out / f"{profile}_{every}.4dgs"
            file.write_bytes(write_sequence(samples, duration, kd=options, profile=profile))
            print(f"{file.name}: {file.stat().st_size} bytes", flush=True)


def curve_bytes(curve, psnr):
    """Bytes of the .tcgs curve at a PSNR; none beyond its ends."""
    for a, b in zip(curve, curve[1:]):
        if a["psnr"] <= psnr <= b["psnr"]:
            share = (psnr - a["psnr"]) / (b["psnr"] - a["psnr"]) if b["psnr"] > a["psnr"] else 0
            return math.exp((1 - share) * math.log(a["bytes"]) + share * math.log(b["bytes"]))
    return None


def main():
    given = arguments()
    if given.peer:
        return write_peer_files(given)
    if not given.tcgs.exists():
        refuse(f"{given.tcgs}: no such program, expected tcgs (cargo build --release)")
    if given.out.exists():
        refuse(f"{given.out}: exists already, expected a new folder")
    given.out.mkdir(parents=True)
    packages = given.out / "packages"
    try:
        venv.create(packages, with_pip=True)
        python = packages / "bin/python"
        subprocess.run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PACKAGES], check=True)
        tcgs(given, "compress", given.run, *EXACT, "--out", given.out / "exact.tcgs")
        tcgs(given, "export", given.out / "exact.tcgs", "--to", given.out / "params.npz")
        command = [python, __file__, "--peer", given.run, given.capture, given.out]
        subprocess.run([str(word) for word in command], check=True)
    finally:
        shutil.rmtree(packages, ignore_errors=True)
    rows = []
    for quality in QUALITIES:
        file = given.out / f"quality_{quality}.tcgs"
        tcgs(given, "compress", given.run, f"--quality={quality}", "--out", file)
        rows.append({"file": file.name, "bytes": file.stat().st_size, "psnr": psnr(given, file)})
    curve = sorted(rows, key=lambda row: row["bytes"])
    for file in sorted(given.out.glob("*.4dgs"), key=lambda file: file.stat().st_size):
        rows.append({"file": file.name, "bytes": file.stat().st_size, "psnr": psnr(given, file)})
    for row in rows:
        same = curve_bytes(curve, row["psnr"])
        row["bytes_against_tcgs"] = None if same is None else row["bytes"] / same
    seconds = {}
    for _ in range(given.rounds):
        for name in ["quality_0.tcgs", "default_8.4dgs"]:
            floats = given.out / "all.f32"
            start = time.perf_counter()
            tcgs(given, "export", given.out / name, "--to", floats, "--threads", "1")
            seconds.setdefault(name, []).append(time.perf_counter() - start)
            floats.unlink()
    decode = {name: statistics.median(of) for name, of in seconds.items()}
    result = {"run": str(given.run), "rows": rows, "decode_seconds": decode, "cores": os.cpu_count()}
    (given.out / "comparison.json").write_text(json.dumps(result, indent=2) + "\n")
    print("| file | bytes | PSNR | bytes against .tcgs at equal PSNR |\n|---|---|---|---|")
    for row in rows:
        factor = row["bytes_against_tcgs"]
        print(f"| {row['file']} | {row['bytes']:,} | {row['psnr']:.3f} | {'beyond the curve' if factor is None else f'{factor:.2f}'} |")
    for name, of in decode.items():
        print(f"{name}: {of:.3f} s to decode all timesteps and write them")


if __name__ == "__main__":
    main()
