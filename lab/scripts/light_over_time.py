#!/usr/bin/env python3
"""How much of a scene's error over time is light that grows or fades: SCENE CAPTURE, with `tcgs` on the PATH.

For each training camera and timestep it takes the gain of each colour that brings the picture of the scene nearest to
the image, and then multiplies all pictures of a timestep by the median of the gains, each divided by its mean over time.
Reads captures as Dynamic 3D Gaussians stores them. Needs NumPy and Pillow.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

STEP = 15
# Brighter pixels are clipped in the image.
MAX_VALUE = 0.95


def load(path):
    return np.asarray(Image.open(path).convert("RGB")) / 255.0


def pairs(folder, scene, capture, meta, frame):
    """Pictures and images of all cameras of `meta` at one frame."""
    views = folder / f"cameras-{Path(meta).stem}"
    views.mkdir(exist_ok=True)
    for name in ("ims", "seg", "init_pt_cld.npz", "train_meta.json"):
        if not (views / name).exists():
            (views / name).symlink_to(capture / name)
    if not (views / "test_meta.json").exists():
        (views / "test_meta.json").symlink_to(capture / meta)
    pictures = folder / f"{meta}-{frame}"
    command = ["tcgs", "render", scene, "--out", pictures, "--cameras", views, "--frames", f"{frame}..{frame + 1}"]
    subprocess.run([*command, "--backend", "cpu"], check=True, stdout=subprocess.DEVNULL)
    names = json.loads((capture / meta).read_text())["fn"][frame]
    return [(load(pictures / Path(name).parent / f"{frame:06d}.png"), load(capture / "ims" / name)) for name in names]


def gain(picture, image):
    seen = image.max(-1) < MAX_VALUE
    picture, image = picture[seen], image[seen]
    return (picture * image).sum(0) / (picture**2).sum(0)


def psnr(picture, image):
    return -10 * np.log10(((np.clip(picture, 0, 1) - image) ** 2).mean())


def main():
    scene, capture = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    num_frames = len(json.loads((capture / "train_meta.json").read_text())["fn"])
    frames = [*range(0, num_frames - 1, STEP), num_frames - 1]
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        gains = np.array([[gain(*p) for p in pairs(folder, scene, capture, "train_meta.json", t)] for t in frames])
        change = gains[-1] / gains[0] - 1
        print("gain from first to last, red green blue: mean", change.mean(0).round(4), "std", change.std(0).round(4))
        light = np.median(gains / gains.mean(0), axis=1)
        rows = []
        for frame, factor in zip(frames, light):
            held_out = pairs(folder, scene, capture, "test_meta.json", frame)
            rows.append([np.mean([psnr(p * f, i) for p, i in held_out]) for f in (1.0, factor)])
            print(f"frame {frame}: gain {factor.round(4)}, PSNR {rows[-1][0]:.2f}, with the gain {rows[-1][1]:.2f}")
        print("mean PSNR {:.2f}, with the gain {:.2f}".format(*np.mean(rows, axis=0)))


if __name__ == "__main__":
    main()
