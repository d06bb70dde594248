#!/usr/bin/env python3
"""What do the steps of `tcgs prepare` on raw videos gain or lose?

    lab/scripts/prove_footage.py colors KITCHEN OUT      cameras of different exposure and white balance, evened out or not
    lab/scripts/prove_footage.py videos PANOPTIC OUT     images of a capture handed over as videos with a calibration
    lab/scripts/prove_footage.py masks FOOTAGE OUT       trained with masks of what moves, and without

Options: [--tcgs target/release/tcgs] [--frames 4] [--downscale 8] [--iterations 400,100] [--hold-out CAMERA]
[--prepare="--to 0.6 --width 200"], the last for `masks` alone.

KITCHEN is a folder with cam00.mp4 ... and a cameras.json of exact cameras (OpenCV, camera from world, metres). PANOPTIC is in the
layout of Panoptic Sports, with masks and points. FOOTAGE is KITCHEN, or any folder of videos with a calibration. Every
training starts from points that `prepare` makes, but those of `videos`, and runs on the CPU. OUT, a new folder, then holds
proof.json, the captures and the runs. It needs ffmpeg, Python 3.11 and numpy.
"""

import argparse
import json
import math
import os
import shutil
import subprocess
import tomllib
from pathlib import Path

import numpy as np

# Nearly lossless, so that what is measured is not the codec.
CRF = {"kitchen": "8", "images": "10"}


def encode(source, target, filters="null", crf="8"):
    """`source`: arguments of ffmpeg that name the input."""
    command = ["ffmpeg", "-v", "error", "-nostdin", *map(str, source), "-vf", f"{filters},format=yuv420p"]
    subprocess.run([*command, "-c:v", "libx264", "-preset", "veryfast", "-crf", crf, str(target)], check=True)


def write_calibration(folder, cameras):
    """intri.yml and extri.yml of OpenCV; `cameras`: name, width, height, k (pixel centres at +0.5), w2c."""
    matrix = lambda name, m: (
        f"{name}: !!opencv-matrix\n  rows: {m.shape[0]}\n  cols: {m.shape[1]}\n  dt: d\n"
        f"  data: [{', '.join(repr(float(x)) for x in m.ravel())}]\n"
    )
    names = "%YAML:1.0\n---\nnames:\n" + "".join(f'  - "{name}"\n' for name, *_ in cameras)
    intrinsics, extrinsics = names, names
    for name, width, height, k, w2c in cameras:
        k, w2c = np.array(k), np.array(w2c)
        k[:2, 2] -= 0.5
        intrinsics += matrix(f"K_{name}", k) + matrix(f"dist_{name}", np.zeros((1, 5))) + f"H_{name}: {height}\nW_{name}: {width}\n"
        extrinsics += matrix(f"Rot_{name}", w2c[:3, :3]) + matrix(f"T_{name}", w2c[:3, 3:4])
    (folder / "intri.yml").write_text(intrinsics)
    (folder / "extri.yml").write_text(extrinsics)


def write_offsets(path, names):
    """All cameras began at once."""
    path.write_text("".join(f"{name} 0\n" for name in names))
    return path


def kitchen_videos(kitchen, folder, gains=None):
    """Kitchen's videos with an exact calibration; `gains`: by camera, of red, green and blue."""
    folder.mkdir()
    cameras = json.loads((kitchen / "cameras.json").read_text())
    write_calibration(folder, [(f"cam{c['id']:02}", c["w"], c["h"], c["k"], c["w2c"]) for c in cameras])
    for video in sorted(kitchen.glob("cam*.mp4")):
        if gains is None:
            os.symlink(video.resolve(), folder / video.name)
            continue
        factors = ":".join(f"{c}='clip(val*{g:.6f},0,255)'" for c, g in zip("rgb", gains[video.stem]))
        encode(["-i", video], folder / video.name, f"format=rgb24,lutrgb={factors}", CRF["kitchen"])


class Proof:
    def __init__(self, arguments):
        self.arguments, self.out, self.result = arguments, arguments.out, {}
        self.out.mkdir()

    def tcgs(self, *words):
        subprocess.run([self.arguments.tcgs, *map(str, words)], check=True)

    def train(self, name, capture, frames, more=(), eval_more=()):
        """Trains, measures the cameras that are held out, and keeps both numbers."""
        run, result = self.out / f"{name}_run", self.out / f"{name}.json"
        settings = ["--downscale", self.arguments.downscale, "--iterations", self.arguments.iterations]
        self.tcgs("train", capture, "--out", run, "--frames", frames, *settings, "--backend", "cpu", *more)
        self.tcgs("eval", run, "--capture", capture, "--json", result, "--backend", "cpu", *eval_more)
        measured = json.loads(result.read_text())
        self.keep(name, {key: measured[key] for key in ("psnr", "ssim")})

    def keep(self, name, value):
        self.result[name] = value
        (self.out / "proof.json").write_text(json.dumps(self.result, indent=2) + "\n")
        print(json.dumps({name: value}, indent=2), flush=True)


def colors(proof):
    kitchen, out, frames = proof.arguments.source, proof.out, f"0..{proof.arguments.frames}"
    hold_out = proof.arguments.hold_out or "cam00"
    names = [video.stem for video in sorted(kitchen.glob("cam*.mp4"))]
    # Exposure by up to a fifth, white balance by up to a tenth.
    applied = {
        name: [0.9 * math.exp(0.18 * math.sin(2.3 * i) + 0.09 * math.cos(1.7 * i + 2 * c)) for c in range(3)]
        for i, name in enumerate(names)
    }
    offsets_file = write_offsets(out / "offsets.txt", names)
    # As bright as the camera in the middle, which the others are brought to: PSNR depends on brightness.
    common = np.median(list(applied.values()), 0)
    kitchen_videos(kitchen, out / "untouched", {name: common for name in names})
    kitchen_videos(kitchen, out / "uneven", applied)
    for name, videos, measured in [
        ("untouched", "untouched", "yes"),
        ("evened", "uneven", "yes"),
        ("uneven", "uneven", "no"),
    ]:
        capture = out / f"{name}_capture"
        tail = ["--refine-calibration", "no", "--hold-out", hold_out, "--colors", measured, "--offsets", offsets_file]
        proof.tcgs("prepare", out / videos, "--out", capture, *tail)
        if name == "evened":
            description = tomllib.loads((capture / "capture.toml").read_text())
            found = np.array([camera["gains"] for camera in description["camera"]])
            true = 1 / np.array([applied[camera["name"]] for camera in description["camera"]])
            errors = np.abs(found * np.median(true, 0) / true - 1)
            largest = lambda gains: float(np.abs(gains / np.median(gains, 0) - 1).max())
            offsets = [camera.get("offsets", [0, 0, 0]) for camera in description["camera"]]
            proof.keep("gains", {
                "applied_largest": largest(true),
                "error_median": float(np.median(errors)),
                "error_largest": float(errors.max()),
                "offsets_largest": float(np.abs(offsets).max()),
                "found": description["colors"]["found"][0],
            })
        proof.train(name, capture, frames)


def videos(proof):
    capture, out, count = proof.arguments.source, proof.out, proof.arguments.frames
    metas = [json.loads((capture / f"{split}_meta.json").read_text()) for split in ("train", "test")]
    folder = out / "videos"
    folder.mkdir()
    cameras, held_out = [], []
    for meta, is_test in zip(metas, (False, True)):
        for i, id in enumerate(meta["cam_id"][0]):
            name = f"cam{id:02}"
            cameras.append((name, meta["w"], meta["h"], meta["k"][0][i], meta["w2c"][0][i]))
            held_out += [name] if is_test else []
            listing = out / "images.txt"
            files = [(capture / "ims" / meta["fn"][t][i]).resolve() for t in range(count)]
            listing.write_text("".join(f"file '{file}'\nduration 0.033333\n" for file in files))
            source = ["-f", "concat", "-safe", "0", "-r", "30", "-i", listing]
            encode(source, folder / f"{name}.mp4", f"setpts=N/30/TB,trim=end_frame={count}", CRF["images"])
            for t in range(0 if is_test else count):
                mask = folder / "masks" / name / f"{t:06}.png"
                mask.parent.mkdir(parents=True, exist_ok=True)
                # As the layout has it a mask is 0 and 1, which a described capture reads as well.
                shutil.copy(capture / "seg" / meta["fn"][t][i].replace(".jpg", ".png"), mask)
    write_calibration(folder, cameras)
    shutil.copy(capture / "init_pt_cld.npz", folder)
    offsets = write_offsets(out / "offsets.txt", [name for name, *_ in cameras])
    tail = [word for name in held_out for word in ("--hold-out", name)]
    # Everything as given: neither calibration nor colours are measured, and the points that are made are replaced.
    tail += ["--refine-calibration", "no", "--colors", "no", "--offsets", offsets, "--points", 2000, "--width", 100]
    proof.tcgs("prepare", folder, "--out", out / "capture", *tail)
    shutil.copy(capture / "init_pt_cld.npz", out / "capture")
    # The layout says that there is a floor; a folder of videos does not.
    for name, source in [("images", capture), ("videos", out / "capture")]:
        proof.train(name, source, f"0..{count}", ["--set", "weights.floor=0"])
    proof.keep("loss_db", proof.result["images"]["psnr"] - proof.result["videos"]["psnr"])


def masks(proof):
    source, out, hold_out = proof.arguments.source, proof.out, proof.arguments.hold_out
    if (source / "cameras.json").is_file():
        kitchen_videos(source, out / "videos")
        source, hold_out = out / "videos", hold_out or "cam00"
    tail = proof.arguments.prepare.split() + (["--hold-out", hold_out] if hold_out else [])
    for name, made in [("without", "no"), ("with", "yes")]:
        proof.tcgs("prepare", source, "--out", out / f"{name}_capture", "--masks", made, *tail)
        more = [] if hold_out else ["--cameras", "train"]
        proof.train(name, out / f"{name}_capture", f"0..{proof.arguments.frames}", eval_more=more)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("proof", choices=["colors", "videos", "masks"])
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--tcgs", default="target/release/tcgs")
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--downscale", default="8")
    parser.add_argument("--iterations", default="400,100")
    parser.add_argument("--hold-out")
    parser.add_argument("--prepare", default="")
    proof = Proof(parser.parse_args())
    {"colors": colors, "videos": videos, "masks": masks}[proof.arguments.proof](proof)


if __name__ == "__main__":
    main()
