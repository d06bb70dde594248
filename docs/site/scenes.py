#!/usr/bin/env python3
"""Puts a scene on the page: its file, its films and stills, and the measured numbers of its table.

    docs/site/scenes.py NAME FILE.tcgs CAPTURE [--tcgs PROGRAM]

NAME is toss, kitchen or demo; CAPTURE is the capture that FILE was trained on, on whose held-out cameras PSNR is measured.
The file gets the credits of credits/NAME.json if there are any, as `tcgs compress --attach credits=FILE` would give them.

It writes scenes/NAME.tcgs, pictures/NAME.{webm,mp4,webp}, pictures/NAME-small.webp and the entry of NAME in scenes.json; of
toss also docs/toss.webp, the first picture of the README. Nothing is written if a step fails. docs/site/build.sh then makes
the page. It needs Python 3.9, Rust, ffmpeg with SVT-AV1, x264 and WebP, and `tcgs` (built in target/release, or --tcgs).
"""

import argparse
import json
import math
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
SIZE = (960, 480)
FRAME_RATE = 30
# Frames of a film, about; a scene of few timesteps comes several times.
FRAMES = 90
# The films of all scenes together stay below what a visitor's first load may have.
MAX_FILM_BYTES = 190_000
MAX_README_BYTES = 1_500_000
# The reader of .4dgs files accepts so many Gaussians, summed over the timesteps. PSNR is measured on the first timesteps that
# stay below.
MAX_FOURDGS_ROWS = 2_900_000

# Where the camera of a film stands: on a circle of `radius` around `target`, `rise` above it (y points down in all
# three scenes), swaying `sway` to either side of `angle` (0: +z). `angle`, `sway` and the horizontal `view` are
# degrees. `timesteps`: at most so many, from the first.
FILMS = {
    "toss": {"target": (0.0, -0.95, 0.0), "radius": 3.6, "rise": 0.7, "angle": 0, "sway": 26, "view": 68, "timesteps": 48},
    "kitchen": {"target": (0.0, -1.28, 0.1), "radius": 1.75, "rise": 0.3, "angle": 180, "sway": 20, "view": 76, "timesteps": 60},
    "demo": {"target": (0.0, -0.9, 0.0), "radius": 2.4, "rise": 0.6, "angle": 180, "sway": 44, "view": 70, "timesteps": 48},
}


def refuse(message):
    sys.exit(f"scenes.py: {message}")


def run(command):
    done = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode != 0:
        refuse(f"{' '.join(map(str, command))}: {(done.stderr.strip().splitlines() or ['no message'])[-1]}")
    return done.stdout


def credited(name, file, folder):
    """A copy of the scene with the credits that it must name."""
    credits, scene = HERE / "credits" / f"{name}.json", folder / f"{name}.tcgs"
    if not credits.exists():
        shutil.copyfile(file, scene)
    else:
        cargo = ["cargo", "run", "--quiet", "--release", "--locked", "--manifest-path", HERE.parents[1] / "Cargo.toml"]
        run([*cargo, "--example", "attach", "--", file, "tcgs.credits", credits, scene])
    return scene


def camera(film, degrees):
    """A camera of the film at an angle, in the form that the player's paths have."""
    angle = math.radians(film["angle"] + degrees)
    eye = [film["target"][0] + film["radius"] * math.sin(angle), film["target"][1] - film["rise"],
           film["target"][2] + film["radius"] * math.cos(angle)]
    unit = lambda v: [x / math.sqrt(sum(y * y for y in v)) for x in v]
    cross = lambda a, b: [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    forward = unit([to - at for to, at in zip(film["target"], eye)])
    right = unit(cross([0.0, 1.0, 0.0], forward))
    rows = [right, cross(forward, right), forward]
    matrix = [x for row in rows for x in (*row, -sum(r * e for r, e in zip(row, eye)))] + [0.0, 0.0, 0.0, 1.0]
    width, height = SIZE
    focal = width / 2 / math.tan(math.radians(film["view"]) / 2)
    intrinsics = {"fx": focal, "fy": focal, "cx": width / 2, "cy": height / 2}
    return {"width": width, "height": height, **intrinsics, "cameraFromWorld": matrix}


def render(tcgs, scene, film, num_timesteps, folder):
    """Writes the film's frames, 000000.png and so on, and returns how many. Time runs forth and back, and the camera sways once
    from end to end, so the film has no seam."""
    count = min(num_timesteps, film["timesteps"])
    turn = 2 * (count - 1)
    total = turn * max(1, round(FRAMES / turn))
    for start in range(0, total, count - 1):
        forth = (start // (count - 1)) % 2 == 0
        # Timesteps in the order of the film; a pass ends before the next one's first.
        times = list(range(count - 1)) if forth else list(range(count - 1, 0, -1))
        sways = [film["sway"] * math.sin(2 * math.pi * (start + i) / total) for i in range(len(times))]
        cameras = sorted(({"timestep": t, **camera(film, sway)} for t, sway in zip(times, sways)), key=lambda c: c["timestep"])
        path = folder / "path.json"
        path.write_text(json.dumps({"format": "tcgs-camera-path", "version": 1, "cameras": cameras}))
        out = folder / "pass"
        first = json.loads((folder / "info.json").read_text())["first_frame"]
        frames = f"{first + min(times)}..{first + max(times) + 1}"
        run([tcgs, "render", scene, "--path", path, "--frames", frames, "--size", f"{SIZE[0]}x{SIZE[1]}", "--out", out, "--force"])
        pictures = sorted(out.glob("*.png"))
        for i, picture in enumerate(pictures if forth else reversed(pictures)):
            shutil.move(picture, folder / f"{start + i:06}.png")
        shutil.rmtree(out)
    return total


def encode(name, folder, made):
    """Encodes the film and its stills. A quality is lowered until the film is small enough."""
    ffmpeg = ["ffmpeg", "-v", "error", "-y", "-framerate", FRAME_RATE, "-i", folder / "%06d.png"]
    yuv = ["-vf", "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p"]
    yuv += [word for name in ("colorspace", "color_primaries", "color_trc") for word in (f"-{name}", "bt709")]
    kinds = {
        "webm": (range(34, 63, 2), ["-c:v", "libsvtav1", "-preset", "4", "-svtav1-params", "tune=0"]),
        "mp4": (range(26, 46, 2), ["-c:v", "libx264", "-preset", "veryslow", "-profile:v", "high", "-movflags", "+faststart"]),
    }
    for ending, (qualities, words) in kinds.items():
        file = made / f"{name}.{ending}"
        for quality in qualities:
            run([*ffmpeg, *yuv, *words, "-crf", quality, file])
            if file.stat().st_size <= MAX_FILM_BYTES:
                break
        else:
            refuse(f"{file.name}: {file.stat().st_size} bytes at the lowest quality, expected at most {MAX_FILM_BYTES}")
    still = ["ffmpeg", "-v", "error", "-y", "-i", folder / "000000.png", "-c:v", "libwebp"]
    run([*still, "-quality", 72, made / f"{name}.webp"])
    run([*still, "-vf", "scale=320:-2:flags=lanczos", "-quality", 70, made / f"{name}-small.webp"])
    if name == "toss":
        file = made / "readme.webp"
        for quality in range(70, 20, -10):
            webp = ["-c:v", "libwebp_anim", "-quality", quality, "-loop", "0"]
            run([*ffmpeg, "-vf", "scale=640:-2:flags=lanczos", *webp, file])
            if file.stat().st_size <= MAX_README_BYTES:
                return
        refuse(f"the README's picture: {file.stat().st_size} bytes, expected at most {MAX_README_BYTES}")


def measure(tcgs, scene, capture, info, folder):
    """Sizes of the same Gaussians in three formats, and what PSNR each has on held-out cameras."""
    plys, fourdgs, part, result = folder / "plys", folder / "scene.4dgs", folder / "part.4dgs", folder / "eval.json"
    run([tcgs, "export", scene, "--to", plys])
    run([tcgs, "export", scene, "--to", fourdgs])
    first, count = info["first_frame"], min(info["num_timesteps"], MAX_FOURDGS_ROWS // info["num_gaussians"])
    run([tcgs, "export", scene, "--frames", f"{first}..{first + count}", "--to", part])
    entry = {}
    for name, file, measured in (("ply", plys, plys), ("fourdgs", fourdgs, part), ("tcgs", scene, scene)):
        files = file.iterdir() if file.is_dir() else [file]
        entry[f"{name}_bytes"] = sum(part.stat().st_size for part in files)
        # Other formats do not say at which size their scene was trained.
        run([tcgs, "eval", measured, "--capture", capture, "--json", result, "--force", "--downscale", info["downscale"]])
        entry[f"{name}_psnr"] = round(json.loads(result.read_text())["psnr"], 2)
    return entry


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=sorted(FILMS))
    parser.add_argument("file", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--tcgs", type=Path, default=HERE.parents[1] / "target/release/tcgs")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        scene = credited(given.name, given.file.resolve(), folder)
        said = run([given.tcgs, "info", scene, "--json", folder / "info.json"])
        info = json.loads((folder / "info.json").read_text())
        if info["num_timesteps"] < 2:
            refuse(f"{given.file}: has {info['num_timesteps']} timesteps, expected a scene that moves")
        info["downscale"] = int(next(line.split()[1] for line in said.splitlines() if line.startswith("downscale")))
        entry = {"timesteps": info["num_timesteps"], "gaussians": info["num_gaussians"], "downscale": info["downscale"]}
        entry |= measure(given.tcgs, scene, given.capture, info, folder)
        made = folder / "made"
        made.mkdir()
        render(given.tcgs, scene, FILMS[given.name], info["num_timesteps"], folder)
        encode(given.name, folder, made)

        for place in ("scenes", "pictures"):
            (HERE / place).mkdir(exist_ok=True)
        shutil.copyfile(scene, HERE / "scenes" / f"{given.name}.tcgs")
        if (made / "readme.webp").exists():
            shutil.move(made / "readme.webp", HERE.parent / "toss.webp")
        for file in made.iterdir():
            shutil.move(file, HERE / "pictures" / file.name)
        table = HERE / "scenes.json"
        entries = json.loads(table.read_text()) if table.exists() else {}
        entries[given.name] = entry
        table.write_text(json.dumps({name: entries[name] for name in FILMS if name in entries}, indent=2) + "\n")
        print(f"{given.name}: {json.dumps(entry)}")


main()
