#!/usr/bin/env python3
"""Draws one scene with tcgs and with Mitsuba 3 on the same CPU cores, and compares times and pictures.

    lab/scripts/compare_with_mitsuba.py OUT [--gaussians 30000] [--size 640x360] [--threads 2] [--rounds 3]

Mitsuba 3 (Jakob et al. 2022, BSD-3) is the peer because it draws and differentiates 3D Gaussians without CUDA: its shape
`ellipsoids` and its integrator `volprim_rf_basic` compile to vectorised code by LLVM, and run on all cores. It traces a ray
for each pixel through a hierarchy of bounding volumes, and takes a Gaussian where its density along the ray is greatest;
tcgs projects Gaussians, blurs them by 0.3 pixels squared, and blends tiles. So the pictures are alike, not the same. The
script says how alike, and how far each is from 500 pixels that it computes in float64 by Mitsuba's model.

The scene is the one of `tcgs bench`, written by `tcgs bench --write-scene`. Both draw it at the same size, before black,
one sample in the middle of each pixel, and differentiate the sum of all values of the picture by means, rotations, scales,
opacities and colours. Both run on the same cores, in turns, so that other work on the machine meets both. Kernels are
compiled before the clock starts.

Both times of Mitsuba contain building its hierarchy anew, as after every step of an optimisation; so do those of tcgs
contain projecting and sorting. The time without that is given too.

OUT, a new folder, then holds comparison.json, tcgs.png, mitsuba.png, the scene, and the virtual environment with the packages
from PyPI (300 MB), which the script removes at its end unless --keep-packages is given. It needs Python 3.9, `tcgs` (built
in target/release, or --tcgs) and LLVM 16 or later: a system's libLLVM, the one beside rustc, or DRJIT_LIBLLVM_PATH.
"""

import argparse
import glob
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import time
import venv
from pathlib import Path

PACKAGES = ["mitsuba==3.9.1", "drjit==1.5.0", "numpy>=1.24"]
# Dr.Jit 1.5 writes code that LLVM 15 cannot compile for x86-64 (fminimum).
MIN_LLVM = 16
# Pixels of which the colour is known exactly by Mitsuba's model.
EXACT_PIXELS = 500


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--gaussians", type=int, default=30_000)
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3, help="turns of both programs [default: 3]")
    parser.add_argument("--iterations", type=int, default=5, help="times in each turn [default: 5]")
    parser.add_argument("--tcgs", type=Path, default=Path(__file__).resolve().parents[2] / "target/release/tcgs")
    parser.add_argument("--keep-packages", action="store_true")
    parser.add_argument("--peer", action="store_true", help=argparse.SUPPRESS)  # this script, inside of the environment
    return parser.parse_args()


def refuse(message):
    sys.exit(f"compare_with_mitsuba: {message}")


def llvm_version(path):
    found = re.search(r"libLLVM(?:\.so\.|-)(\d+)", path)
    return int(found[1]) if found else 0


def find_llvm():
    """A shared library of LLVM that Dr.Jit can use."""
    if "DRJIT_LIBLLVM_PATH" in os.environ:
        return os.environ["DRJIT_LIBLLVM_PATH"]
    folders = ["/usr/lib/*-linux-gnu", "/usr/lib64", "/usr/lib", "/usr/lib/llvm-*/lib"]
    rustc = shutil.which("rustc")
    if rustc:
        sysroot = subprocess.run([rustc, "--print", "sysroot"], capture_output=True, text=True, check=True).stdout.strip()
        folders.append(f"{sysroot}/lib")
    found = [path for folder in folders for path in sorted(glob.glob(f"{folder}/libLLVM*.so*"))]
    # Beside rustc's library lies a text for the linker.
    is_library = lambda path: Path(path).open("rb").read(4) == b"\x7fELF"
    fit = [path for path in found if llvm_version(path) >= MIN_LLVM and is_library(path)]
    if not fit:
        refuse(f"LLVM: found {', '.join(found) or 'none'}, expected libLLVM {MIN_LLVM} or later, or DRJIT_LIBLLVM_PATH")
    return fit[0]


def run_outside(options):
    """Makes the environment, and runs this script in it."""
    if not options.tcgs.is_file():
        refuse(f"{options.tcgs}: no such file, expected tcgs: cargo build --release -p tcgs-cli")
    if options.out.exists():
        refuse(f"{options.out}: exists already, expected a new folder")
    llvm = find_llvm()
    options.out.mkdir(parents=True)
    environment = options.out / "venv"
    python = environment / "bin" / "python"
    try:
        venv.create(environment, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PACKAGES], check=True)
        again = [python, __file__, *sys.argv[1:], "--peer"]
        subprocess.run(again, check=True, env={**os.environ, "DRJIT_LIBLLVM_PATH": llvm})
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode if error.returncode > 0 else 1)
    finally:
        if not options.keep_packages:
            shutil.rmtree(environment, ignore_errors=True)


def bench(options, more):
    """One turn of tcgs: its times of the scene, in milliseconds."""
    result = options.out / "bench.json"
    command = [options.tcgs, "bench", "--backend", "cpu", "--gaussians", options.gaussians, "--size", options.size]
    command += ["--threads", options.threads, "--iterations", options.iterations, "--json", result, "--force", *more]
    subprocess.run([str(word) for word in command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    found = json.loads(result.read_text())
    assert found["threads"] == options.threads, found["threads"]
    return found["scenes"][0]


def read_ply(np, path):
    """Columns by name of a binary PLY file whose properties are all float32."""
    data = path.read_bytes()
    header, body = data.split(b"end_header\n", 1)
    lines = header.decode("ascii").splitlines()
    assert "format binary_little_endian 1.0" in lines, lines
    names = [line.split()[2] for line in lines if line.startswith("property float ")]
    assert len(names) == sum(line.startswith("property ") for line in lines), lines
    values = np.frombuffer(body, "<f4").reshape(-1, len(names))
    return lambda *wanted: np.ascontiguousarray(values[:, [names.index(name) for name in wanted]])


class Peer:
    """The scene in Mitsuba."""

    def __init__(self, files, threads):
        import drjit as dr
        import mitsuba as mi
        import numpy as np

        mi.set_variant("llvm_ad_rgb")
        dr.set_thread_count(threads)
        self.mi, self.dr, self.np = mi, dr, np
        camera = json.loads((files / "camera.json").read_text())
        width, height = camera["width"], camera["height"]
        centred = np.allclose(camera["principal"], [width / 2, height / 2]) and np.isclose(*camera["focal"])
        if not centred:
            refuse(f"{files}/camera.json: expected one focal length and the principal point in the middle")
        # Mitsuba's camera looks along z as ours does, but its x is left and its y is up.
        to_world = np.linalg.inv(np.array(camera["camera_from_world"])) @ np.diag([-1.0, -1.0, 1.0, 1.0])
        column = read_ply(np, files / "gaussians.ply")
        quats = column("rot_1", "rot_2", "rot_3", "rot_0")
        tensor = lambda values: mi.TensorXf(np.ascontiguousarray(values, dtype=np.float32))
        shape = {
            "type": "ellipsoids",
            "centers": tensor(column("x", "y", "z")),
            "scales": tensor(np.exp(column("scale_0", "scale_1", "scale_2"))),
            "quaternions": tensor(quats / np.linalg.norm(quats, axis=1, keepdims=True)),
            "opacities": tensor(1 / (1 + np.exp(-column("opacity")))),
            "sh_coeffs": tensor(column("f_dc_0", "f_dc_1", "f_dc_2")),
        }
        sensor = {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(width / 2 / camera["focal"][0]))),
            "fov_axis": "x",
            "near_clip": 0.01,
            "to_world": mi.ScalarTransform4f(to_world),
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
            # One sample, in the middle of the pixel.
            "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
        }
        # No bound on the number of Gaussians along a ray, as in tcgs. In the bench's scene the default of 64 changes
        # nothing.
        integrator = {"type": "volprim_rf_basic", "srgb_primitives": False, "max_depth": -1}
        self.scene = mi.load_dict({"type": "scene", "shape": shape, "sensor": sensor, "integrator": integrator})
        self.params = mi.traverse(self.scene)
        self.keys = [f"shape.{name}" for name in ("data", "opacities", "sh_coeffs")]

    def moved(self):
        """As after a step of an optimisation: the hierarchy is built anew."""
        for key in self.keys:
            self.params[key] = type(self.params[key])(self.dr.detach(self.params[key]))
        self.params.update()

    def image(self):
        return self.mi.render(self.scene, self.params, spp=1)

    def forward(self):
        image = self.image()
        self.dr.eval(image)
        self.dr.sync_thread()
        return self.np.array(image)

    def moved_forward(self):
        self.moved()
        self.forward()

    def moved_forward_backward(self):
        """Returns the gradients, of all parameters."""
        for key in self.keys:
            values = type(self.params[key])(self.dr.detach(self.params[key]))
            self.dr.enable_grad(values)
            self.params[key] = values
        self.params.update()
        self.dr.backward(self.dr.sum(self.image(), axis=None))
        gradients = [self.dr.grad(self.params[key]) for key in self.keys]
        self.dr.eval(gradients)
        self.dr.sync_thread()
        return [self.np.array(gradient) for gradient in gradients]


def exact_pixels(np, files, num_pixels):
    """Some pixels in float64 by Mitsuba's model: all Gaussians along a ray, each where its density is greatest, nearest first.

    Returns rows, columns and colours. Judges both pictures, and shares no code with either.
    """
    camera = json.loads((files / "camera.json").read_text())
    column = read_ply(np, files / "gaussians.ply")
    quats = column("rot_0", "rot_1", "rot_2", "rot_3").astype(float)
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    world_from_local = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    means = column("x", "y", "z").astype(float)
    scales = np.exp(column("scale_0", "scale_1", "scale_2").astype(float))
    opacities = 1 / (1 + np.exp(-column("opacity")[:, 0].astype(float)))
    colors = np.maximum(0.5 + 0.28209479177387814 * column("f_dc_0", "f_dc_1", "f_dc_2"), 0)
    camera_from_world = np.array(camera["camera_from_world"])
    rotation = camera_from_world[:3, :3]
    center = -rotation.T @ camera_from_world[:3, 3]
    # In units of each Gaussian's axes.
    origins = np.einsum("jin,nj->ni", world_from_local, center - means) / scales
    random = np.random.default_rng(0)
    rows, columns = (random.integers(0, camera[side], num_pixels) for side in ("height", "width"))
    found = np.zeros((num_pixels, 3))
    for i, (row, col) in enumerate(zip(rows, columns)):
        (cx, cy), (fx, fy) = camera["principal"], camera["focal"]
        ray = rotation.T @ [(col + 0.5 - cx) / fx, (row + 0.5 - cy) / fy, 1.0]
        directions = np.einsum("jin,j->ni", world_from_local, ray) / scales
        peaks = -np.sum(origins * directions, 1) / np.sum(directions**2, 1)
        squared = np.sum((origins + peaks[:, None] * directions) ** 2, 1)
        alphas = np.minimum(opacities * np.exp(-0.5 * squared), 0.9999)
        seen = np.flatnonzero((alphas > 1e-4) & (peaks > 0))
        seen = seen[np.argsort(peaks[seen])]
        transmittances = np.concatenate([[1], np.cumprod(1 - alphas[seen])[:-1]]) if len(seen) else []
        found[i] = (alphas[seen] * transmittances) @ colors[seen] if len(seen) else 0
    return rows, columns, found


def milliseconds(work, iterations):
    times = []
    for _ in range(iterations):
        begin = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - begin))
    return times


def run_inside(options):
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        if len(cores) < options.threads:
            refuse(f"--threads {options.threads}: this process may use {len(cores)} cores, expected no more threads")
        os.sched_setaffinity(0, cores[: options.threads])
    first = bench(options, ["--write-scene", options.out / "scene"])
    files = Path(first["files"])
    peer = Peer(files, options.threads)
    np, mi = peer.np, peer.mi

    ours, theirs = np.load(files / "image.npz")["image"], peer.forward()
    for name, image in [("tcgs", ours), ("mitsuba", theirs)]:
        pixels = np.clip(255 * image + 0.5, 0, 255).astype(np.uint8)
        mi.Bitmap(pixels).write(str(options.out / f"{name}.png"))
    psnr = lambda found, expected: float(-10 * np.log10(np.mean((found.astype(np.float64) - expected) ** 2)))
    rows, columns, exact = exact_pixels(np, files, EXACT_PIXELS)
    difference = ours.astype(np.float64) - theirs
    pictures = {
        "psnr_db": psnr(ours, theirs),
        "psnr_db_tcgs_to_exact": psnr(ours[rows, columns], exact),
        "psnr_db_mitsuba_to_exact": psnr(theirs[rows, columns], exact),
        "largest_difference": float(np.abs(difference).max()),
        "mean_difference": float(np.abs(difference).mean()),
        "mean_tcgs": float(ours.mean()),
        "mean_mitsuba": float(theirs.mean()),
    }

    work = {"forward": peer.moved_forward, "forward_backward": peer.moved_forward_backward, "forward_still": peer.forward}
    gradients = peer.moved_forward_backward()
    if not all(np.isfinite(gradient).all() and np.abs(gradient).max() > 0 for gradient in gradients):
        refuse("mitsuba: gradients that are not finite or all 0, expected finite ones; its times mean nothing")
    for each in work.values():
        each()
    peer_times = {name: [] for name in work}
    our_times = {"forward": [], "forward_backward": []}
    for _ in range(options.rounds):
        scene = bench(options, [])
        for name, times in our_times.items():
            times.append(scene[f"{name}_ms"]["median"])
        for name, times in peer_times.items():
            times.append(statistics.median(milliseconds(work[name], options.iterations)))
    median = lambda times: {name: statistics.median(values) for name, values in times.items()}
    of_tcgs, of_peer = median(our_times), median(peer_times)
    result = {
        "scene": {name: first[name] for name in ("name", "gaussians", "width", "height", "splats", "pairs")},
        "threads": options.threads,
        "rounds": options.rounds,
        "iterations": options.iterations,
        "tcgs": {"median_ms": of_tcgs, "rounds_ms": our_times},
        "mitsuba": {"version": mi.__version__, "median_ms": of_peer, "rounds_ms": peer_times},
        # How many times as long Mitsuba takes.
        "ratio": {name: of_peer[name] / of_tcgs[name] for name in of_tcgs},
        "pictures": pictures,
    }
    (options.out / "comparison.json").write_text(json.dumps(result, indent=2) + "\n")
    (options.out / "bench.json").unlink()
    print(json.dumps({name: result[name] for name in ("ratio", "pictures")}, indent=2))
    for name in of_tcgs:
        print(f"{name}: tcgs {of_tcgs[name]:.1f} ms, mitsuba {of_peer[name]:.1f} ms")
    print(f"mitsuba's forward without building its hierarchy: {of_peer['forward_still']:.1f} ms")


if __name__ == "__main__":
    chosen = arguments()
    chosen.out, chosen.tcgs = chosen.out.resolve(), chosen.tcgs.resolve()
    run_inside(chosen) if chosen.peer else run_outside(chosen)
