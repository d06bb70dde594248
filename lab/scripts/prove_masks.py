#!/usr/bin/env python3
"""How much does a training lose with the masks that `tcgs prepare` makes?

    lab/scripts/prove_masks.py CAPTURE OUT [--tcgs target/release/tcgs] [--frames 5] [--downscale 2] [--iterations 600,150]

CAPTURE is a folder in the layout of Panoptic Sports with masks in seg/. Three captures are made of it: with the given masks,
with masks that are made of the images alone, and without any. Each gets points from `tcgs prepare`, is trained with the same
settings, and judged on the cameras that are held out. OUT, a new folder, then holds proof.json, the captures and the runs. It
needs Python 3.11.
"""

import argparse
import json
import os
import shutil
import subprocess
from pathlib import Path


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--tcgs", default="target/release/tcgs")
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--downscale", default="2")
    parser.add_argument("--iterations", default="600,150")
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir()

    def tcgs(*words):
        subprocess.run([arguments.tcgs, *map(str, words)], check=True)

    unmasked = out / "unmasked"
    unmasked.mkdir()
    for file in ("train_meta.json", "test_meta.json"):
        shutil.copy(arguments.capture / file, unmasked)
    os.symlink((arguments.capture / "ims").resolve(), unmasked / "ims")

    proof = {}
    settings = ["--frames", f"0..{arguments.frames}", "--downscale", arguments.downscale]
    settings += ["--iterations", arguments.iterations, "--backend", "cpu"]
    for name, source, masks in [
        ("given", arguments.capture, "no"),
        ("made", unmasked, "yes"),
        ("none", unmasked, "no"),
    ]:
        capture, run, result = out / f"{name}_capture", out / f"{name}_run", out / f"{name}.json"
        tcgs("prepare", source, "--out", capture, "--masks", masks)
        tcgs("train", capture, "--out", run, *settings)
        tcgs("eval", run, "--capture", capture, "--json", result)
        measured = json.loads(result.read_text())
        proof[name] = {key: measured[key] for key in ("psnr", "ssim")}
        (out / "proof.json").write_text(json.dumps(proof, indent=2) + "\n")
    print(json.dumps(proof, indent=2))


if __name__ == "__main__":
    main()
