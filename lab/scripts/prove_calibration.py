#!/usr/bin/env python3
"""How good are cameras that `tcgs prepare` finds without a calibration?

    lab/scripts/prove_calibration.py KITCHEN OUT [--tcgs target/release/tcgs] [--frames 4] [--downscale 4] [--iterations 600,150]

KITCHEN is a folder in the layout of Neural 3D Video, cam00.mp4 ... and poses_bounds.npy, with points3D.ply and a
cameras.json of exact cameras (OpenCV, camera from world, metres). Of it, only videos are handed to `tcgs prepare`, each
without its first frames, of every camera another number. COLMAP has to be installed, and ffmpeg.

The script then compares the cameras found with the exact ones after a similarity (degrees; centimetres), trains both captures
for the same frames with the same settings, and compares the PSNR of cam00, which both hold out. OUT, a new folder, then holds
proof.json, the captures and the runs. It needs Python 3.11 and numpy.
"""

import argparse
import json
import subprocess
import tomllib
from pathlib import Path

import numpy as np


def cut(kitchen, videos):
    """Writes the videos without their first frames; returns how many frames each lacks."""
    videos.mkdir()
    cuts = {}
    for i, video in enumerate(sorted(kitchen.glob("cam*.mp4"))):
        cuts[video.stem] = (7 * i + 5) % 31
        trim = f"trim=start_frame={cuts[video.stem]},setpts=PTS-STARTPTS"
        # Nearly lossless, so that what is measured is the calibration and not the codec.
        command = ["ffmpeg", "-v", "error", "-nostdin", "-i", video, "-vf", trim, "-c:v", "libx264", "-crf", "8"]
        subprocess.run([*command, "-preset", "veryfast", videos / video.name], check=True)
    return cuts


def compare(description, exact):
    """Angles in degrees and distances in centimetres between cameras, after the similarity between their centres."""
    found = {camera["name"]: np.array(camera["camera_from_world"]) for camera in description["camera"]}
    names = sorted(found)
    true = {name: np.array(exact[name])[:3] for name in names}
    center = lambda pose: -pose[:, :3].T @ pose[:, 3]
    a, b = (np.array([center(poses[name]) for name in names]) for poses in (found, true))
    a0, b0 = a - a.mean(0), b - b.mean(0)
    # Umeyama 1991.
    u, d, vt = np.linalg.svd(b0.T @ a0)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ sign @ vt
    scale = np.trace(np.diag(d) @ sign) / (a0**2).sum()
    apart_cm = 100 * np.linalg.norm(scale * a0 @ rotation.T - b0, axis=1)
    cosines = [(np.trace(found[n][:, :3] @ rotation.T @ true[n][:, :3].T) - 1) / 2 for n in names]
    degrees = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    return {
        "degrees": {"median": float(np.median(degrees)), "worst": float(degrees.max())},
        "centimetres": {"median": float(np.median(apart_cm)), "worst": float(apart_cm.max())},
        "scale": float(scale),
    }


def exact_cameras(kitchen):
    """Poses by name."""
    return {f"cam{camera['id']:02}": camera["w2c"] for camera in json.loads((kitchen / "cameras.json").read_text())}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kitchen", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--tcgs", default="target/release/tcgs")
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--downscale", default="4")
    parser.add_argument("--iterations", default="600,150")
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir()

    def tcgs(*words):
        subprocess.run([arguments.tcgs, *map(str, words)], check=True)

    cuts = cut(arguments.kitchen, out / "videos")
    # Two cameras are measured with a tape, so that lengths are metres.
    exact = exact_cameras(arguments.kitchen)
    center = lambda name: -np.array(exact[name])[:3, :3].T @ np.array(exact[name])[:3, 3]
    metres = np.linalg.norm(center("cam01") - center("cam02"))
    tape = f"cam01,cam02,{metres:.3f}"
    tcgs("prepare", out / "videos", "--out", out / "capture", "--hold-out", "cam00", "--scale", tape)
    proof = {"poses": compare(tomllib.loads((out / "capture/capture.toml").read_text()), exact)}
    print(json.dumps(proof["poses"], indent=2), flush=True)

    begin = max(cuts.values())
    settings = ["--downscale", arguments.downscale, "--iterations", arguments.iterations]
    for name, capture, first in [("given", arguments.kitchen, begin), ("found", out / "capture", 0)]:
        frames = f"{first}..{first + arguments.frames}"
        tcgs("train", capture, "--out", out / name, "--frames", frames, *settings)
        result = out / f"{name}.json"
        tcgs("eval", out / name, "--capture", capture, "--json", result)
        measured = json.loads(result.read_text())
        proof[name] = {key: measured[key] for key in ("psnr", "ssim")}
    (out / "proof.json").write_text(json.dumps(proof, indent=2) + "\n")
    print(json.dumps(proof, indent=2))


if __name__ == "__main__":
    main()
